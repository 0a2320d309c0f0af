//! `docs/architecture.md` and the table of passes, held against the schedules as they are built: what is written to come
//! before is ordered so, and no system of ours is left out.

use std::{
    collections::{BTreeMap, BTreeSet},
    path::{Path, PathBuf},
};

use bevy::{
    ecs::schedule::{NodeId, Schedule, Schedules, graph::Direction},
    pbr::{EARLY_SHADOW_PASS, LATE_SHADOW_PASS},
    prelude::*,
    render::RenderApp,
};
use bevy_skyline::{panel::PanelPlugin, prelude::*};

const DOCUMENT: &str = "docs/architecture.md";
const PASSES: &str = "src/render_graph/mod.rs";

fn root(path: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(path)
}

fn read(path: &Path) -> String {
    std::fs::read_to_string(path).unwrap_or_else(|problem| panic!("{}: {problem}", path.display()))
}

/// Systems that neither shows.
const EXCEPTIONS: [(&str, &str); 1] = [("RenderStartup", "makes pipelines, in no frame")];

/// What runs in one schedule, and what before what.
#[derive(Default)]
struct Order {
    /// By name without module path; several where a system was added more than once.
    systems: BTreeMap<String, Vec<NodeId>>,
    ours: BTreeSet<String>,
    /// By what `Debug` prints.
    sets: BTreeMap<String, Vec<NodeId>>,
    before: BTreeMap<NodeId, Vec<NodeId>>,
    /// Pairs that may run in either order and touch the same, one of them ours: by their names, with what they touch.
    conflicts: BTreeSet<(String, String, String)>,
    members: BTreeMap<NodeId, Vec<NodeId>>,
    holders: BTreeMap<NodeId, Vec<NodeId>>,
}

impl Order {
    fn of(schedule: &Schedule, world: &World) -> Self {
        let graph = schedule.graph();
        let mut order = Self::default();
        let mut add = |node: NodeId, full: String, name: String| {
            // A closure goes by the function that it is written in.
            let name = match full.strip_suffix("::{{closure}}") {
                Some(outer) => plain(outer).to_owned(),
                None => name,
            };
            if full.starts_with("bevy_skyline::") {
                order.ours.insert(name.clone());
            }
            order.systems.entry(name).or_default().push(node);
        };
        if let Ok(systems) = schedule.systems() {
            for (key, system) in systems {
                let name = system.name();
                add(
                    NodeId::System(key),
                    name.to_string(),
                    name.shortname().to_string(),
                );
            }
        } else {
            for (key, system, _) in graph.systems.iter() {
                let name = system.name();
                add(
                    NodeId::System(key),
                    name.to_string(),
                    name.shortname().to_string(),
                );
            }
        }
        if let Ok(systems) = schedule.systems() {
            let names: BTreeMap<_, _> = systems
                .map(|(key, system)| (key, system.name().to_string()))
                .collect();
            for (a, b, touched) in &graph.conflicting_systems().0 {
                let [a, b] = [a, b].map(|of| names.get(of).cloned().unwrap_or_default());
                if ![&a, &b].iter().any(|of| of.starts_with("bevy_skyline::")) {
                    continue;
                }
                let what = touched
                    .iter()
                    .map(|id| match world.components().get_name(*id) {
                        Some(name) => name.shortname().to_string(),
                        None => "?".to_owned(),
                    });
                let what: Vec<_> = what.collect();
                let (a, b) = if a < b { (a, b) } else { (b, a) };
                order.conflicts.insert((a, b, what.join(", ")));
            }
        }
        for (key, set, _) in graph.system_sets.iter() {
            if set.system_type().is_none() {
                let name = format!("{set:?}");
                order.sets.entry(name).or_default().push(NodeId::Set(key));
            }
        }
        for node in graph.dependency().graph().nodes() {
            let after = graph
                .dependency()
                .neighbors_directed(node, Direction::Outgoing);
            order.before.insert(node, after.collect());
        }
        for node in graph.hierarchy().graph().nodes() {
            let members = graph
                .hierarchy()
                .neighbors_directed(node, Direction::Outgoing);
            order.members.insert(node, members.collect());
            let holders = graph
                .hierarchy()
                .neighbors_directed(node, Direction::Incoming);
            order.holders.insert(node, holders.collect());
        }
        order
    }

    /// The systems or the set of that name; generic ones without their types too, if the name has none.
    fn find(&self, name: &str) -> Result<Vec<NodeId>, String> {
        if let Some(found) = self.systems.get(name) {
            return Ok(found.clone());
        }
        let generic: Vec<_> = self
            .systems
            .iter()
            .filter(|(of, _)| of.split('<').next() == Some(name))
            .flat_map(|(_, nodes)| nodes.clone())
            .collect();
        if !generic.is_empty() {
            return Ok(generic);
        }
        match self.sets.get(name).map(Vec::as_slice) {
            Some([one]) => Ok(vec![*one]),
            Some(_) => Err(format!("{name}: more than one set is called so")),
            None => Err(format!("{name}: no such system or set")),
        }
    }

    fn spread(&self, from: &[NodeId], by: &BTreeMap<NodeId, Vec<NodeId>>) -> BTreeSet<NodeId> {
        let mut found: BTreeSet<_> = from.iter().copied().collect();
        let mut open: Vec<_> = from.to_vec();
        while let Some(node) = open.pop() {
            for next in by.get(&node).into_iter().flatten() {
                if found.insert(*next) {
                    open.push(*next);
                }
            }
        }
        found
    }

    fn systems_of(&self, nodes: &[NodeId]) -> BTreeSet<NodeId> {
        let mut all = self.spread(nodes, &self.members);
        all.retain(NodeId::is_system);
        all
    }

    /// What cannot begin before the system has ended.
    fn later(&self, system: NodeId) -> BTreeSet<NodeId> {
        let mut found = BTreeSet::new();
        let mut open: Vec<_> = self.spread(&[system], &self.holders).into_iter().collect();
        while let Some(node) = open.pop() {
            for next in self.before.get(&node).into_iter().flatten() {
                let mut reached = self.systems_of(&[*next]);
                if reached.is_empty() {
                    // An empty set passes the order on.
                    reached.insert(*next);
                }
                for reached in reached {
                    if found.insert(reached) {
                        open.extend(self.spread(&[reached], &self.holders));
                    }
                }
            }
        }
        found
    }

    fn check_pair(&self, first: &str, then: &str) -> Result<(), String> {
        // Of a set with nothing in it, the set itself.
        let nodes = |name: &str| -> Result<BTreeSet<NodeId>, String> {
            let found = self.find(name)?;
            let systems = self.systems_of(&found);
            Ok(if systems.is_empty() {
                found.into_iter().collect()
            } else {
                systems
            })
        };
        let (firsts, thens) = (nodes(first)?, nodes(then)?);
        for a in &firsts {
            if !thens.is_subset(&self.later(*a)) {
                return Err(format!("{first} --> {then}: not in that order"));
            }
        }
        Ok(())
    }

    fn is_in(&self, name: &str, set: &str) -> Result<(), String> {
        let members = self.systems_of(&self.find(set)?);
        if self.find(name)?.iter().all(|node| members.contains(node)) {
            Ok(())
        } else {
            Err(format!("{name} is not in {set}"))
        }
    }
}

/// A path's last name.
fn plain(path: &str) -> &str {
    path.split('<')
        .next()
        .and_then(|p| p.rsplit("::").next())
        .unwrap_or(path)
}

/// Every schedule of an app with everything in it, of both worlds; `None` without a device.
fn schedules() -> Option<BTreeMap<String, Order>> {
    let mut offline = crate::device_with(|app| {
        app.add_plugins(PanelPlugin);
    })?;
    let target = offline.target(UVec2::splat(16));
    offline.camera(
        &target,
        (
            Msaa::Off,
            FrameBudget::from_hz(60.0),
            ContributionCulling::default(),
            ZBufferOcclusion::default(),
            ResolutionScale(0.5),
        ),
    );
    // Schedules are built when they first run.
    offline.step();
    offline.step();
    let mut all = BTreeMap::new();
    let worlds = [
        Some(offline.app.world()),
        offline.app.get_sub_app(RenderApp).map(|app| app.world()),
    ];
    for world in worlds.into_iter().flatten() {
        for (label, schedule) in world.resource::<Schedules>().iter() {
            let order = Order::of(schedule, world);
            let name = format!("{label:?}");
            // Of the schedules that are ours, one has a system of Bevy's in it.
            if !order.ours.is_empty() || name == "UnpackLateBins" {
                let double = all.insert(name, order);
                assert!(double.is_none(), "{label:?} is in both worlds");
            }
        }
    }
    Some(all)
}

/// The diagrams' edges and nodes, by schedule.
#[derive(Default)]
struct Drawn {
    nodes: BTreeSet<String>,
    edges: Vec<(String, String)>,
}

/// What the Mermaid diagrams of a document say: a subgraph a schedule; nodes are systems and sets by their names, which
/// are their labels where they have one; lines of `a & b --> c --> d`.
fn drawn(document: &str) -> Result<BTreeMap<String, Drawn>, String> {
    let mut schedules: BTreeMap<String, Drawn> = BTreeMap::new();
    let diagrams = document.split("```mermaid\n").skip(1);
    for diagram in diagrams.filter_map(|rest| rest.split("```").next()) {
        let mut labels = BTreeMap::new();
        let mut at: Option<String> = None;
        for line in diagram.lines().map(str::trim) {
            if let Some(title) = line.strip_prefix("subgraph ") {
                at = title.split(['[', ' ']).next().map(Into::into);
            } else if line == "end" {
                at = None;
            } else if let Some(schedule) = &at
                && !line.is_empty()
                && !line.starts_with("direction ")
            {
                let drawn = schedules.entry(schedule.clone()).or_default();
                let mut last: Vec<String> = Vec::new();
                for step in line.split("-->") {
                    let mut now = Vec::new();
                    for node in step.split('&').map(str::trim) {
                        let (id, label) = match node.split_once(['[', '(']) {
                            Some((id, rest)) => (
                                id,
                                rest.split('"')
                                    .nth(1)
                                    .ok_or_else(|| format!("{node}: no label"))?,
                            ),
                            None => (node, node),
                        };
                        let label = with_types(&label.replace("#lt;", "<").replace("#gt;", ">"));
                        let label = if label == id {
                            labels.get(id).cloned().unwrap_or(label)
                        } else {
                            labels.insert(id.to_owned(), label.clone());
                            label
                        };
                        drawn.nodes.insert(label.clone());
                        now.push(label);
                    }
                    for first in &last {
                        drawn
                            .edges
                            .extend(now.iter().map(|then| (first.clone(), then.clone())));
                    }
                    last = now;
                }
            }
        }
    }
    Ok(schedules)
}

/// What of the drawn is not so, and what is not drawn.
fn wrong_in_diagrams(document: &str, real: &BTreeMap<String, Order>) -> Vec<String> {
    let drawn = match drawn(document) {
        Ok(drawn) => drawn,
        Err(problem) => return vec![problem],
    };
    let mut wrong = Vec::new();
    for (schedule, diagram) in &drawn {
        let Some(order) = real.get(schedule) else {
            wrong.push(format!("{schedule}: nothing of ours runs there"));
            continue;
        };
        let problems = diagram
            .nodes
            .iter()
            .map(|node| order.find(node).map(drop))
            .chain(diagram.edges.iter().map(|(a, b)| order.check_pair(a, b)));
        wrong.extend(
            problems
                .filter_map(Result::err)
                .map(|p| format!("{schedule}: {p}")),
        );
    }
    for (schedule, order) in real {
        if EXCEPTIONS.iter().any(|(name, _)| name == schedule) {
            continue;
        }
        let nodes = drawn.get(schedule).map(|diagram| &diagram.nodes);
        let is_drawn = |name: &str| nodes.is_some_and(|nodes| is_named(nodes, name));
        wrong.extend(
            order
                .ours
                .iter()
                .filter(|name| !is_drawn(name))
                .map(|name| format!("{schedule}: {name} is not drawn")),
        );
    }
    wrong
}

/// Whether a system is among these, by itself or by the name of all of its kinds.
fn is_named(names: &BTreeSet<String>, system: &str) -> bool {
    names.contains(system)
        || system
            .split('<')
            .next()
            .is_some_and(|kind| names.contains(kind))
}

/// A system's name as Bevy prints it: with the values of constants.
fn with_types(name: &str) -> String {
    name.replace("::<", "<")
        .replace("EARLY_SHADOW_PASS", &EARLY_SHADOW_PASS.to_string())
        .replace("LATE_SHADOW_PASS", &LATE_SHADOW_PASS.to_string())
        .replace("<WithPrepass>", &format!("<Or<({})>>", prepasses("With")))
        .replace("<WithoutPrepass>", &format!("<({})>", prepasses("Without")))
}

/// The types that `WithPrepass` and `WithoutPrepass` are short for.
fn prepasses(filter: &str) -> String {
    let of = ["Depth", "Normal", "MotionVector", "Deferred"];
    of.map(|kind| format!("{filter}<{kind}Prepass>")).join(", ")
}

/// The names in backticks.
fn quoted(cell: &str) -> Vec<String> {
    let quoted = cell.split('`').skip(1).step_by(2);
    quoted.map(with_types).collect()
}

/// What of the table of passes is not so, and what is not in it; and how many orders were looked at.
fn wrong_in_table(source: &str, real: &BTreeMap<String, Order>) -> (Vec<String>, usize) {
    let mut wrong = Vec::new();
    let mut orders = 0;
    let mut listed: BTreeMap<String, BTreeSet<String>> = BTreeMap::new();
    for line in source.lines().filter(|line| line.starts_with("//! | `")) {
        let cells: Vec<_> = line.split('|').collect();
        let [_, passes, place, after, before, ..] = cells.as_slice() else {
            wrong.push(format!("not a row: {line}"));
            continue;
        };
        let (passes, place) = (quoted(passes), quoted(place));
        let Some(order) = place.first().and_then(|schedule| real.get(schedule)) else {
            wrong.push(format!("{passes:?}: nothing of ours runs in {place:?}"));
            continue;
        };
        listed
            .entry(place[0].clone())
            .or_default()
            .extend(passes.iter().cloned());
        let mut checks = Vec::new();
        for pass in &passes {
            checks.push(order.find(pass).map(drop));
            checks.extend(place[1..].iter().map(|set| order.is_in(pass, set)));
            checks.extend(
                quoted(after)
                    .iter()
                    .map(|first| order.check_pair(first, pass)),
            );
            checks.extend(
                quoted(before)
                    .iter()
                    .map(|then| order.check_pair(pass, then)),
            );
        }
        if line.contains("chained") {
            checks.extend(
                passes
                    .windows(2)
                    .map(|pair| order.check_pair(&pair[0], &pair[1])),
            );
        }
        orders += checks.len();
        wrong.extend(checks.into_iter().filter_map(Result::err));
    }
    let render = [
        "ExtractSchedule",
        "Render",
        "RenderGraph",
        "Core3d",
        "UnpackLateBins",
    ];
    for schedule in render {
        let Some(order) = real.get(schedule) else {
            wrong.push(format!("{schedule}: nothing of ours runs there"));
            continue;
        };
        let names = listed.remove(schedule).unwrap_or_default();
        let left_out = order.ours.iter().filter(|name| !is_named(&names, name));
        wrong.extend(left_out.map(|name| format!("{schedule}: {name} is not in the table")));
    }
    (wrong, orders)
}

/// All of the crate's Rust and WGSL.
fn sources() -> String {
    let mut open = vec![root("src"), root("assets/shaders")];
    let mut all = String::new();
    while let Some(path) = open.pop() {
        if let Ok(folder) = std::fs::read_dir(&path) {
            open.extend(folder.flatten().map(|entry| entry.path()));
        } else {
            all += &read(&path);
        }
    }
    all
}

/// What is named in the text outside of its diagrams and is not in the crate.
fn not_there(document: &str, sources: &str) -> Vec<String> {
    let is_word = |c: char| c.is_alphanumeric() || c == '_';
    let known: BTreeSet<_> = sources.split(|c| !is_word(c)).collect();
    let text = document.split("```").step_by(2);
    let names = text.flat_map(|text| text.split('`').skip(1).step_by(2));
    names
        .filter(|name| {
            let is_there = if name.contains('/') {
                root(name).exists()
            } else if name.ends_with(".wgsl") {
                root("assets/shaders").join(name).exists()
            } else if name.ends_with(".rs") {
                root("src/terrain/loader").join(name).exists()
            } else {
                let parts = name
                    .split(|c: char| !is_word(c))
                    .filter(|part| !part.is_empty());
                name.starts_with('.')
                    || name.contains(' ')
                    || name.contains('…')
                    || parts.clone().all(|part| known.contains(part))
            };
            !is_there
        })
        .map(Into::into)
        .collect()
}

#[test]
fn files_and_names_in_the_document_are_there() {
    let (document, sources) = (read(&root(DOCUMENT)), sources());
    let missing = not_there(&document, &sources);
    assert!(missing.is_empty(), "{missing:?}");
    for (from, to) in [
        ("`src/occlusion/pace.rs`", "`src/occlusion/rest.rs`"),
        ("`subdivide.wgsl`", "`divide.wgsl`"),
        ("`is_near`", "`is_next_to`"),
    ] {
        assert_eq!(
            not_there(&with(&document, from, to), &sources).len(),
            1,
            "{to}"
        );
    }
}

#[test]
fn the_diagrams_are_the_schedules() {
    let Some(real) = schedules() else { return };
    let document = read(&root(DOCUMENT));
    let wrong = wrong_in_diagrams(&document, &real);
    assert!(wrong.is_empty(), "{wrong:#?}");
    let edges: usize = drawn(&document)
        .into_iter()
        .flat_map(BTreeMap::into_values)
        .map(|diagram| diagram.edges.len())
        .sum();
    assert!(edges > 50, "{edges} orders are drawn");
}

#[test]
fn the_table_of_passes_is_the_schedules() {
    let Some(real) = schedules() else { return };
    let (wrong, orders) = wrong_in_table(&read(&root(PASSES)), &real);
    assert!(wrong.is_empty(), "{wrong:#?}");
    assert!(orders > 80, "{orders} orders are in the table");
}

/// A text with one thing changed, which it has.
fn with(text: &str, from: &str, to: &str) -> String {
    assert!(text.contains(from), "{from} is nowhere in the text");
    text.replacen(from, to, 1)
}

#[test]
fn what_is_drawn_or_listed_wrongly_is_noticed() {
    let Some(real) = schedules() else { return };
    let (document, passes) = (read(&root(DOCUMENT)), read(&root(PASSES)));
    let diagrams = [
        // Swapped.
        (
            "height_mips --> terrain_shadow",
            "terrain_shadow --> height_mips",
        ),
        ("measure_areas --> choose", "choose --> measure_areas"),
        // In no order at all.
        ("extract_scales", "extract_terrains --> extract_scales"),
        // Left out.
        ("--> fade_small", ""),
        // Under another name.
        ("--> cull_occluded", "--> cull_hidden"),
    ];
    for (from, to) in diagrams {
        let wrong = wrong_in_diagrams(&with(&document, from, to), &real);
        assert!(!wrong.is_empty(), "{from} became {to}, and nobody noticed");
    }
    let table = [
        (
            "| `height_mips` | `camera_driver` |",
            "| `camera_driver` | `height_mips` |",
        ),
        (
            "| `main_opaque_pass_3d` | `main_transmissive_pass_3d`, ",
            "| `main_transmissive_pass_3d` | ",
        ),
        ("//! | `upscale` ", "//! | `upscaled` "),
        (
            "//! | `note_uploads` | `Render`, `PrepareAssets`",
            "//! | `note_uploads` | `Render`, `PrepareViews`",
        ),
        (
            "`build_late_main`, `late_opaque`",
            "`late_opaque`, `build_late_main`",
        ),
    ];
    for (from, to) in table {
        let (wrong, _) = wrong_in_table(&with(&passes, from, to), &real);
        assert!(!wrong.is_empty(), "{from} became {to}, and nobody noticed");
    }
}

/// Pairs that may come in either order: parts of one name, parts of the other, what they touch, and why it is the same.
const EITHER_ORDER: [(&str, &str, &str, &str); 15] = [
    (
        "message_update_system",
        "bevy_skyline::",
        "",
        "it turns messages over that ours do not read there",
    ),
    (
        "knobs::drive",
        "knobs::drive",
        "Knobs",
        "each has a knob of its own",
    ),
    (
        "::report_",
        "::report_",
        "Effects",
        "each has an entry of its own",
    ),
    (
        "note_changes",
        "panel::data::gather",
        "Effects",
        "one looks, the other marks",
    ),
    (
        "bevy_egui::",
        "panel::draw_panel",
        "",
        "egui passes the panel's context over, which is run by hand",
    ),
    (
        "prepare_egui_pass",
        "render_graph::",
        "",
        "it takes the whole world for egui's own",
    ),
    (
        "run_egui_context_pass_loop_system",
        "spherical::",
        "",
        "it takes the whole world for egui's own",
    ),
    (
        "camera_system",
        "panel::draw_panel",
        "Camera",
        "the panel follows its window a frame later",
    ),
    (
        "mark_3d_meshes_as_changed",
        "systems::",
        "Mesh3d",
        "what is marked after they looked they see in the next frame",
    ),
    (
        "check_entities_needing_specialization",
        "interior::apply",
        "Mesh3d",
        "a trimmed mesh has its mesh's layout",
    ),
    (
        "follow_",
        "follow_",
        "SphericalModels",
        "each asks for its own to be looked at",
    ),
    (
        "prepass",
        "terrain_cascade",
        "TerrainCascades",
        "it takes the world for its draws, and reads none of ours",
    ),
    (
        "shared_shadow_pass",
        "terrain_cascade",
        "TerrainCascades",
        "it takes the world for its draws, and reads none of ours",
    ),
    (
        "configure_camera_depth_usages",
        "make_depth_readable",
        "Camera3d",
        "both add to the usages",
    ),
    (
        "prepare_terrain_cascades",
        "prepare_terrain_shadows",
        "TerrainPipelines",
        "each asks for its own pipelines",
    ),
];

/// Systems that touch the same, one of them ours, are ordered, or it is said why either order gives the same.
#[test]
fn what_touches_the_same_is_in_an_order() {
    let Some(real) = schedules() else { return };
    let mut used = [false; EITHER_ORDER.len()];
    let mut unordered = Vec::new();
    for (schedule, order) in &real {
        for (a, b, touched) in &order.conflicts {
            let is_of = |(one, other, what, _): &(&str, &str, &str, &str)| {
                let both =
                    a.contains(one) && b.contains(other) || b.contains(one) && a.contains(other);
                both && (what.is_empty() || touched == what)
            };
            match EITHER_ORDER.iter().position(is_of) {
                Some(rule) => used[rule] = true,
                None => unordered.push(format!("{schedule}: {a} and {b} both touch {touched}")),
            }
        }
    }
    assert!(unordered.is_empty(), "{unordered:#?}");
    let unused: Vec<_> = used
        .iter()
        .zip(EITHER_ORDER)
        .filter(|(used, _)| !**used)
        .collect();
    assert!(unused.is_empty(), "these are in an order now: {unused:?}");
}
