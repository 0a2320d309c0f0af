//! What the measured lines come down to: whether anything visible went missing, and how our defaults stand against
//! Bevy's culling and against P2.

use serde::Serialize;

use super::{
    super::report::{Table, short},
    CostLine, OcclusionLine, RestLine,
    report::{distinct, of as of_scene, parts},
};

/// P2's gains, frames a second with culling to without: scene, view, volume, gain (Pentium III 667, GeForce3 Ti200).
const PAPER: [(&str, &str, &str, f64); 4] = [
    ("100 models", "front", "obb", 14.08 / 1.85),
    ("100 models", "front", "proxy", 8.32 / 1.85),
    ("sea bed", "view_1", "obb", 10.0 / 0.825),
    ("sea bed", "view_2", "obb", 3.8 / 0.825),
];
/// P2's time with everything visible, to that without culling.
const PAPER_VISIBLE: f64 = 0.825 / 0.811;

/// Everything a run comes down to. "Defaults" are the rows of ours with every setting at its default, behind a
/// prepass or not.
#[derive(Serialize, Clone, Debug)]
pub(super) struct Highlights {
    /// Pixels that show another surface than the unculled picture, in all rows of the defaults together.
    pub false_cull_px: u64,
    /// Pixels of another colour at the very same depth, there.
    pub tied_px: u64,
    /// Frames that these rows looked at.
    pub frames: u32,
    /// The least share that the defaults removed of what an exact test of the same volumes would remove.
    pub of_exact_min: Option<f64>,
    /// Every scene and view or path where Bevy's culling and ours were measured.
    pub against_bevy: Vec<AgainstBevy>,
    /// Where ours draws more than Bevy's, and by how many.
    pub draws_more_than_bevy: Vec<String>,
    /// P2's experiments, made again.
    pub against_p2: Vec<AgainstP2>,
    /// Where next to nothing is hidden.
    pub everything_visible: Vec<RestLine>,
    /// Time of the main world.
    pub main_world: Vec<CostLine>,
}

/// A scene and view or path: objects drawn, and time as a multiple of Bevy's occlusion culling.
#[derive(Serialize, Clone, Debug, PartialEq)]
pub(super) struct AgainstBevy {
    pub scene: String,
    pub drawn_bevy: f64,
    pub drawn_z_buffer: Option<f64>,
    pub drawn_z_buffer_prepass: Option<f64>,
    /// units: ms
    pub bevy_ms: f64,
    pub z_buffer_to_bevy: Option<f64>,
    pub z_buffer_prepass_to_bevy: Option<f64>,
}

/// How many times as fast as without culling.
#[derive(Serialize, Clone, Debug, PartialEq)]
pub(super) struct AgainstP2 {
    pub scene: String,
    pub volume: &'static str,
    pub p2: f64,
    pub ours: f64,
    /// Objects that ours draws.
    pub drawn: f64,
}

/// Sums up.
pub(super) fn of(
    lines: &[OcclusionLine],
    rests: Vec<RestLine>,
    costs: Vec<CostLine>,
) -> Highlights {
    let defaults = || lines.iter().filter(|line| line.setting.is_default());
    let against_bevy: Vec<_> = distinct(lines.iter().map(|line| line.scene.as_str()))
        .into_iter()
        .filter_map(|scene| against_bevy(scene, &of_scene(lines, scene)))
        .collect();
    let more = |row: &AgainstBevy| {
        let ways = [
            ("z-buffer", row.drawn_z_buffer),
            ("z-buffer-prepass", row.drawn_z_buffer_prepass),
        ];
        let bevy = row.drawn_bevy;
        ways.into_iter()
            .filter_map(|(way, ours)| Some((way, ours.filter(|ours| *ours > bevy)?)))
            .map(|(way, ours)| {
                let (ours, bevy) = (short(ours), short(bevy));
                format!("{} {way}: {ours} to Bevy's {bevy}", row.scene)
            })
            .collect::<Vec<_>>()
    };
    Highlights {
        false_cull_px: defaults().map(|line| line.error.false_cull_px).sum(),
        tied_px: defaults().map(|line| line.error.tied_px).sum(),
        frames: defaults().map(|line| line.frames).sum(),
        of_exact_min: defaults()
            .filter_map(|line| line.error.of_exact)
            .min_by(f64::total_cmp),
        draws_more_than_bevy: against_bevy.iter().flat_map(more).collect(),
        against_bevy,
        against_p2: PAPER
            .iter()
            .filter_map(|paper| against_p2(lines, paper))
            .collect(),
        everything_visible: rests,
        main_world: costs,
    }
}

fn against_bevy(scene: &str, lines: &[&OcclusionLine]) -> Option<AgainstBevy> {
    let bevy = lines.iter().find(|line| line.setting.culling == "bevy")?;
    let ours = |culling: &str| {
        lines
            .iter()
            .find(|line| line.setting.culling == culling && line.setting.is_default())
    };
    let drawn = |culling: &str| ours(culling).map(|line| line.objects.drawn);
    let ratio = |culling: &str| Some(ours(culling)?.time_ms.median / bevy.time_ms.median.max(1e-9));
    Some(AgainstBevy {
        scene: scene.to_owned(),
        drawn_bevy: bevy.objects.drawn,
        drawn_z_buffer: drawn("z-buffer"),
        drawn_z_buffer_prepass: drawn("z-buffer-prepass"),
        bevy_ms: bevy.time_ms.median,
        z_buffer_to_bevy: ratio("z-buffer"),
        z_buffer_prepass_to_bevy: ratio("z-buffer-prepass"),
    })
}

/// One of P2's experiments, if it was made.
fn against_p2(
    lines: &[OcclusionLine],
    (scene, view, volume, p2): &(&'static str, &'static str, &'static str, f64),
) -> Option<AgainstP2> {
    let here = |line: &&OcclusionLine| {
        let (name, at) = parts(line);
        let same = match *scene {
            "sea bed" => name.contains("seabed"),
            _ => line.objects.all == 100,
        };
        same && at == *view
    };
    let without = lines
        .iter()
        .filter(here)
        .find(|line| line.setting.culling == "none")?;
    // What the volume is, all else being default.
    let ours = lines.iter().filter(here).find(|line| {
        let mut setting = line.setting.clone();
        setting.volume = Some("obb");
        line.setting.volume == Some(volume) && setting.culling == "z-buffer" && setting.is_default()
    })?;
    Some(AgainstP2 {
        scene: without.scene.clone(),
        volume,
        p2: *p2,
        ours: without.time_ms.median / ours.time_ms.median.max(1e-9),
        drawn: ours.objects.drawn,
    })
}

impl Highlights {
    /// For the command's summary.
    pub fn json(&self) -> serde_json::Value {
        serde_json::json!(self)
    }

    /// As tables, the most important first.
    pub fn tables(&self) -> Vec<Table> {
        let share = |value: Option<f64>| value.map_or_else(|| "–".into(), short);
        let table = |title: &str, heads: &[&str], rows: Vec<Vec<String>>| {
            let heads = heads.iter().map(|head| (*head).to_owned()).collect();
            (title.to_owned(), heads, rows)
        };
        let more = if self.draws_more_than_bevy.is_empty() {
            "nowhere".to_owned()
        } else {
            self.draws_more_than_bevy.join("; ")
        };
        let sums = [
            (
                "Pixels wrong, all rows of the defaults",
                format!("{} in {} frames", self.false_cull_px, self.frames),
            ),
            (
                "Pixels of another colour at the same depth, there",
                self.tied_px.to_string(),
            ),
            (
                "Removed of what an exact test would, least",
                share(self.of_exact_min),
            ),
            ("Draws more than Bevy's", more),
        ];
        let against_bevy = self.against_bevy.iter().map(|row| {
            vec![
                row.scene.clone(),
                short(row.drawn_bevy),
                share(row.drawn_z_buffer),
                share(row.drawn_z_buffer_prepass),
                short(row.bevy_ms),
                share(row.z_buffer_to_bevy),
                share(row.z_buffer_prepass_to_bevy),
            ]
        });
        let against_p2 = self.against_p2.iter().map(|row| {
            vec![
                row.scene.clone(),
                row.volume.to_owned(),
                short(row.p2),
                short(row.ours),
                short(row.drawn),
            ]
        });
        let visible = self.everything_visible.iter().map(|row| {
            vec![
                row.scene.clone(),
                short(row.frustum_ms.median),
                short(row.resting_ms.median),
                format!("{} of {}", row.rested_frames, row.resting_ms.runs),
                short(row.working_ms.median),
                // Three figures would hide what is asked about.
                format!("{:.4}", row.resting_to_frustum),
                format!("{:.4}", row.resting_to_frustum_least),
                format!("{:.4}", row.working_to_frustum),
                format!("{PAPER_VISIBLE:.4}"),
            ]
        });
        let main_world = self.main_world.iter().map(|cost| {
            vec![
                cost.candidates.to_string(),
                if cost.half_out_of_view { "yes" } else { "no" }.to_owned(),
                short(cost.check_visibility_ms.median),
                share(cost.occlusion_ms.map(|time| time.median)),
                share(cost.ratio),
            ]
        });
        vec![
            table(
                "In short",
                &["what", "measured"],
                sums.map(|(what, value)| vec![what.to_owned(), value])
                    .to_vec(),
            ),
            table(
                "Against Bevy's occlusion culling",
                &[
                    "scene",
                    "drawn, bevy",
                    "z-buffer",
                    "z-buffer-prepass",
                    "ms, bevy",
                    "z-buffer : bevy",
                    "z-buffer-prepass : bevy",
                ],
                against_bevy.collect(),
            ),
            table(
                "Times as fast as without culling, against P2",
                &["scene", "volume", "P2", "ours", "drawn"],
                against_p2.collect(),
            ),
            table(
                "Where next to nothing is hidden",
                &[
                    "scene",
                    "frustum ms",
                    "ours ms",
                    "rested in",
                    "ours kept at work ms",
                    "ours : frustum",
                    "by the quickest frames",
                    "kept at work : frustum",
                    "P2",
                ],
                visible.collect(),
            ),
            table(
                "Main-world time, against Bevy's own visibility check",
                &[
                    "candidates",
                    "half out of view",
                    "CheckVisibility ms",
                    "ours ms",
                    "ratio",
                ],
                main_world.collect(),
            ),
        ]
    }
}

#[cfg(test)]
mod tests {
    use super::{super::*, *};

    fn line(scene: &str, culling: &Culling, ms: f64, drawn: f64) -> OcclusionLine {
        OcclusionLine {
            effect: "occlusion",
            scene: scene.into(),
            setting: Setting::of(culling),
            time_ms: Timing::of(vec![ms]),
            objects: Objects {
                all: 100,
                drawn,
                seen: None,
            },
            error: OcclusionError::default(),
            frames: 1,
            size_px: [64, 64],
            adapter: String::new(),
        }
    }

    fn lines() -> Vec<OcclusionLine> {
        let ours = ZBufferOcclusion::default();
        vec![
            line("bunnies/front", &Culling::None, 80.0, 100.0),
            line("bunnies/front", &Culling::Bevy, 20.0, 10.0),
            line("bunnies/front", &Culling::ZBuffer(ours.clone()), 10.0, 9.0),
            line(
                "bunnies/front",
                &Culling::ZBufferAfterPrepass(ours),
                15.0,
                10.0,
            ),
        ]
    }

    #[test]
    fn ratios_are_those_of_the_rows_named() {
        let highlights = of(&lines(), Vec::new(), Vec::new());
        let [row] = &highlights.against_bevy[..] else {
            panic!("{highlights:?}");
        };
        assert_eq!(row.z_buffer_to_bevy, Some(0.5));
        assert_eq!(row.z_buffer_prepass_to_bevy, Some(0.75));
        let [p2] = &highlights.against_p2[..] else {
            panic!("{highlights:?}");
        };
        assert_eq!((p2.ours, p2.drawn), (8.0, 9.0));
        assert_eq!(highlights.frames, 2);
        assert!(highlights.draws_more_than_bevy.is_empty());
    }

    #[test]
    fn what_is_wrong_shows() {
        let mut lines = lines();
        lines[2].error.false_cull_px = 3;
        lines[2].error.tied_px = 5;
        lines[2].error.of_exact = Some(0.9);
        lines[3].error.of_exact = Some(0.7);
        lines[3].objects.drawn = 11.0;
        let highlights = of(&lines, Vec::new(), Vec::new());
        assert_eq!((highlights.false_cull_px, highlights.tied_px), (3, 5));
        assert_eq!(highlights.of_exact_min, Some(0.7));
        let [more] = &highlights.draws_more_than_bevy[..] else {
            panic!("{highlights:?}");
        };
        assert!(more.contains("z-buffer-prepass: 11"), "{more}");
    }

    #[test]
    fn other_settings_are_not_the_defaults() {
        let mut lines = lines();
        let strided = Culling::ZBuffer(ZBufferOcclusion {
            sampling: DepthSampling::Strided { x: 5, y: 4 },
            ..ZBufferOcclusion::default()
        });
        let mut wrong = line("bunnies/front", &strided, 1.0, 1.0);
        wrong.error.false_cull_px = 1_000;
        lines.push(wrong);
        assert_eq!(of(&lines, Vec::new(), Vec::new()).false_cull_px, 0);
    }
}
