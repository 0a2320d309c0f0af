//! A small scene in which every effect finds something to do, and what can be counted of what they do and hold.

use core::fmt;
use std::collections::{BTreeMap, BTreeSet};

use bevy::{
    asset::AssetEvent,
    diagnostic::DiagnosticsStore,
    light::{CascadeShadowConfigBuilder, DirectionalLightShadowMap},
    platform::time::Instant,
    prelude::*,
    render::{
        RenderApp,
        render_resource::{PipelineCache, PipelineDescriptor},
        renderer::{RenderDevice, RenderInstance},
    },
};
use bevy_skyline::{
    budget::{Budget, GivenFrameTimes},
    culling::candidates::Candidates,
    offline::Offline,
    prelude::*,
    render_graph::{
        contribution::ContributionStats, occlusion::OcclusionStats, upscale::Upscalers,
    },
};

const SIZE: UVec2 = UVec2::new(64, 64);

/// A side of the ground. 32 of two bytes are as much as a software driver rounds rows up to.
pub const SAMPLES: u32 = 32;

/// Every effect.
pub const EFFECTS: [Effect; 8] = [
    Effect::Terrain,
    Effect::TerrainShadow,
    Effect::ZBufferOcclusion,
    Effect::ContributionCulling,
    Effect::InteriorCulling,
    Effect::SphericalIndex,
    Effect::ResolutionScale,
    Effect::FrameBudget,
];

/// Which effects are asked for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Asked(u16);

impl Asked {
    pub const NONE: Self = Self(0);
    pub const ALL: Self = Self((1 << EFFECTS.len()) - 1);

    /// These and no others.
    pub fn of(effects: &[Effect]) -> Self {
        let bit = |effect: &Effect| 1 << EFFECTS.iter().position(|of| of == effect).unwrap_or(0);
        Self(
            effects
                .iter()
                .map(bit)
                .fold(0, |all: u16, bit: u16| all | bit),
        )
    }

    pub fn has(self, effect: Effect) -> bool {
        self.0 & Self::of(&[effect]).0 != 0
    }

    /// None, each alone, each pair, all.
    pub fn matrix() -> Vec<Self> {
        let mut rows = vec![Self::NONE];
        rows.extend(EFFECTS.map(|effect| Self::of(&[effect])));
        for (i, a) in EFFECTS.iter().enumerate() {
            rows.extend(EFFECTS[i + 1..].iter().map(|b| Self::of(&[*a, *b])));
        }
        rows.push(Self::ALL);
        rows
    }
}

impl fmt::Display for Asked {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let names: Vec<_> = EFFECTS
            .iter()
            .filter(|effect| self.has(**effect))
            .map(|effect| format!("{effect:?}"))
            .collect();
        f.pad(&match names.len() {
            0 => "none".to_owned(),
            8 => "all".to_owned(),
            _ => names.join(" + "),
        })
    }
}

/// What was done, by name: dispatches and draws of passes, systems that chose, slots and meshes that changed.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Work(pub BTreeMap<&'static str, u64>);

impl Work {
    /// What came to it since then; nothing that did not change is among it.
    pub fn since(&self, before: &Self) -> Self {
        let new = self.0.iter().filter_map(|(name, count)| {
            let more = count - before.0.get(name).copied().unwrap_or(0);
            (more > 0).then_some((*name, more))
        });
        Self(new.collect())
    }

    pub fn get(&self, name: &str) -> u64 {
        self.0.get(name).copied().unwrap_or(0)
    }

    /// What is counted without being a pass.
    const NO_PASSES: [&str; 4] = [
        "slots_changed",
        "slots_assigned",
        "meshes_changed",
        "choose",
    ];

    /// The passes among it.
    pub fn passes(&self) -> BTreeSet<&'static str> {
        let names = self.0.keys().copied();
        names
            .filter(|name| !Self::NO_PASSES.contains(name) && !name.ends_with(" work"))
            .collect()
    }
}

/// A wall with boxes behind it, crumbs, a hollow model, a ball, ground, a sun and a camera.
pub struct Scene {
    pub offline: Offline,
    pub camera: Entity,
    pub ground: Entity,
    pub field: Handle<HeightField>,
    pub sun: Entity,
    pub wall: Entity,
    pub boxes: Vec<Entity>,
    pub model: Entity,
    pub inside: Entity,
    pub ball: Entity,
    /// Entities with a mesh.
    pub meshes: usize,
    /// What is counted frame by frame.
    counted: Work,
}

pub fn eye() -> Transform {
    Transform::from_xyz(0.0, 6.0, 44.0).looking_at(Vec3::new(0.0, 3.0, 0.0), Vec3::Y)
}

pub fn sun_at(elevation: f32) -> Transform {
    let to_sun = Vec3::new(elevation.cos(), elevation.sin(), 0.4);
    Transform::default().looking_to(-to_sun, Vec3::Y)
}

/// Hills below everything, 124 m a side.
fn hills() -> HeightField {
    HeightField::from_fn(UVec2::splat(SAMPLES), 4.0, (0.0, 8.0), |x, z| {
        1.0 + (x as f32 * 0.7).sin() * (z as f32 * 0.5).cos()
    })
    .expect("a field")
}

impl Scene {
    pub fn new() -> Option<Self> {
        let mut offline = crate::device()?;
        let target = offline.target(SIZE);
        let camera = offline.camera(&target, (Msaa::Off, eye()));
        let world = offline.app.world_mut();
        world.insert_resource(DirectionalLightShadowMap { size: 64 });
        let cube = Cuboid::from_length(1.0).mesh().build();
        // Closed, with another in it: all of that is hidden and is trimmed away.
        let mut hollow = Cuboid::from_length(2.0).mesh().build();
        hollow
            .merge(&Cuboid::from_length(1.6).mesh().build())
            .expect("the same attributes");
        let ball = Sphere::new(2.0).mesh().uv(64, 32);
        let mut meshes = world.resource_mut::<Assets<Mesh>>();
        let [cube, hollow, ball] = [cube, hollow, ball].map(|mesh| Mesh3d(meshes.add(mesh)));
        let paint = world
            .resource_mut::<Assets<StandardMaterial>>()
            .add(StandardMaterial::default());
        let paint = MeshMaterial3d(paint);
        let field = world.resource_mut::<Assets<HeightField>>().add(hills());
        let ground = (
            Transform::from_xyz(-62.0, -4.0, -62.0),
            Visibility::default(),
        );
        let ground = world.spawn(ground).id();
        let sun = world
            .spawn((
                DirectionalLight {
                    shadow_maps_enabled: true,
                    ..default()
                },
                CascadeShadowConfigBuilder {
                    num_cascades: 1,
                    maximum_distance: 60.0,
                    ..default()
                }
                .build(),
                sun_at(0.8),
            ))
            .id();
        let place = |at: Vec3, size: Vec3| Transform::from_translation(at).with_scale(size);
        let wall = place(Vec3::new(0.0, 4.0, 12.0), Vec3::new(20.0, 12.0, 0.3));
        let wall = world.spawn((cube.clone(), paint.clone(), wall)).id();
        let mut boxes = Vec::new();
        for i in 0..24 {
            let at = Vec3::new(2.0 * (i % 8) as f32 - 7.0, 2.0, -3.0 * (i / 8) as f32);
            let behind = (cube.clone(), paint.clone(), place(at, Vec3::ONE));
            boxes.push(world.spawn(behind).id());
        }
        for i in 0..8 {
            let at = Vec3::new(0.5 * i as f32 - 2.0, 3.0, 24.0);
            let crumb = place(at, Vec3::splat(0.02));
            world.spawn((cube.clone(), paint.clone(), crumb));
        }
        let at = Transform::from_xyz(-6.0, 4.0, 26.0);
        let model = world.spawn((at, Visibility::default())).id();
        world.spawn((hollow, paint.clone(), Transform::default(), ChildOf(model)));
        let inside = place(Vec3::ZERO, Vec3::splat(0.6));
        let inside = (cube, paint.clone(), inside, ChildOf(model));
        let inside = world.spawn(inside).id();
        let at = Transform::from_xyz(6.0, 4.0, 26.0);
        let ball = world.spawn((ball, paint, at)).id();
        // What the render world holds is there from its first frame on.
        offline.step();
        Some(Self {
            offline,
            camera,
            ground,
            field,
            sun,
            wall,
            boxes,
            model,
            inside,
            ball,
            // The wall, what is behind it, the crumbs, the model, the ball.
            meshes: 1 + 24 + 8 + 2 + 1,
            counted: Work::default(),
        })
    }

    pub fn world(&self) -> &World {
        self.offline.app.world()
    }

    pub fn world_mut(&mut self) -> &mut World {
        self.offline.app.world_mut()
    }

    fn render_world(&self) -> &World {
        let render = self.offline.app.get_sub_app(RenderApp);
        render.expect("it renders").world()
    }

    pub fn effects(&self) -> &Effects {
        self.world().resource::<Effects>()
    }

    /// Puts the components of these effects in.
    pub fn ask(&mut self, asked: Asked) {
        let (camera, ground, model, ball) = (self.camera, self.ground, self.model, self.ball);
        let terrain = Terrain::new(self.field.clone());
        let world = self.world_mut();
        for effect in EFFECTS.into_iter().filter(|effect| asked.has(*effect)) {
            match effect {
                Effect::Terrain => {
                    world.entity_mut(ground).insert(terrain.clone());
                    let casting = TerrainRayCasting::default();
                    world.entity_mut(camera).insert(casting);
                }
                Effect::TerrainShadow => {
                    world.entity_mut(ground).insert(TerrainShadow::default());
                }
                Effect::ZBufferOcclusion => {
                    world.entity_mut(camera).insert(ZBufferOcclusion {
                        rests: false,
                        ..default()
                    });
                }
                Effect::ContributionCulling => {
                    world.entity_mut(camera).insert(ContributionCulling {
                        threshold_px2: 1.0,
                        gpu_from: 1,
                        ..default()
                    });
                }
                Effect::InteriorCulling => {
                    world.entity_mut(model).insert(InteriorCulling {
                        grid: InteriorGrid::Resolution(32),
                        ..default()
                    });
                }
                Effect::SphericalIndex => {
                    world.entity_mut(ball).insert(SphericalIndex {
                        chunk_triangles: 256,
                        chunk_cost: 0,
                        ..default()
                    });
                }
                Effect::ResolutionScale => {
                    world.entity_mut(camera).insert(ResolutionScale(0.5));
                }
                Effect::FrameBudget => {
                    world.entity_mut(camera).insert(FrameBudget {
                        clock: BudgetClock::Given,
                        ..FrameBudget::from_ms(16.0)
                    });
                }
            }
        }
    }

    /// Takes all of them out.
    pub fn ask_for_nothing(&mut self) {
        let (camera, ground, model, ball) = (self.camera, self.ground, self.model, self.ball);
        let world = self.world_mut();
        world
            .entity_mut(ground)
            .remove::<(Terrain, TerrainShadow)>();
        world.entity_mut(camera).remove::<(
            TerrainRayCasting,
            ZBufferOcclusion,
            ContributionCulling,
            FrameBudget,
            ResolutionScale,
        )>();
        world.entity_mut(model).remove::<InteriorCulling>();
        world.entity_mut(ball).remove::<SphericalIndex>();
    }

    /// One frame, which a budget is told took a quarter of its time.
    pub fn step(&mut self) {
        let mut given = self.world_mut().resource_mut::<GivenFrameTimes>();
        given.last_ms = Some(4.0);
        self.offline.step();
        let world = self.offline.app.world();
        let table = world.resource::<Candidates>();
        let events = world.resource::<Messages<AssetEvent<Mesh>>>();
        let meshes = events
            .iter_current_update_messages()
            .filter(|event| !matches!(event, AssetEvent::LoadedWithDependencies { .. }))
            .count();
        for (name, count) in [
            ("slots_changed", table.dirty().len()),
            ("slots_assigned", table.assigned().len()),
            ("meshes_changed", meshes),
        ] {
            *self.counted.0.entry(name).or_default() += count as u64;
        }
    }

    pub fn steps(&mut self, frames: u32) {
        for _ in 0..frames {
            self.step();
        }
    }

    /// What these many frames do.
    pub fn work_of(&mut self, frames: u32) -> Work {
        let before = self.work();
        self.steps(frames);
        self.work().since(&before)
    }

    /// What was done since the app began.
    pub fn work(&self) -> Work {
        let mut all = self.counted.clone();
        for (pass, count) in self.offline.counts().passes {
            all.0.insert(pass, count.runs);
            let work = match pass {
                "height_mips" => "height_mips work",
                "terrain_shadow" => "terrain_shadow work",
                _ => continue,
            };
            all.0.insert(work, count.work);
        }
        let occlusion = self.world().resource::<OcclusionStats>().lock().clone();
        let contribution = self.world().resource::<ContributionStats>().lock().clone();
        all.0.extend([
            ("depth_reduce", occlusion.reduced),
            ("occludee_verdicts", occlusion.tested),
            ("late_draws", occlusion.late),
            ("contribution", contribution.measured),
            ("contribution_draws", contribution.rewritten),
            (
                "upscale",
                self.render_world().resource::<Upscalers>().passes,
            ),
            ("choose", self.world().resource::<Budget>().chosen()),
        ]);
        all
    }

    /// Spans of passes, Bevy's included, that have come back since then.
    pub fn spans_since(&self, then: Instant) -> BTreeSet<String> {
        let store = self.world().resource::<DiagnosticsStore>();
        let new = store.iter().filter(|diagnostic| {
            let newest = diagnostic.measurement();
            newest.is_some_and(|newest| newest.time > then)
        });
        new.filter_map(|diagnostic| {
            let path = diagnostic.path().as_str().strip_prefix("render/")?;
            path.strip_suffix("/elapsed_cpu").map(str::to_owned)
        })
        .collect()
    }

    /// Whether what is asked for has come to where only what each frame needs is done.
    fn is_settled(&self, asked: Asked) -> bool {
        let shadow_idles = |state: &EffectState| matches!(state, EffectState::Idle(why) if why.starts_with("up to date"));
        EFFECTS.iter().all(|effect| {
            let state = self.effects().state(*effect);
            match effect {
                _ if !asked.has(*effect) => true,
                Effect::TerrainShadow if !asked.has(Effect::Terrain) => {
                    matches!(state, EffectState::Idle(_))
                }
                Effect::TerrainShadow => shadow_idles(state),
                Effect::ContributionCulling if self.is_measured_by_gpu(asked) => {
                    state.to_string().contains("compared by the GPU")
                }
                Effect::ZBufferOcclusion => {
                    let counts = self.world().get::<OcclusionCounts>(self.camera);
                    counts.is_some_and(|counts| counts.removed > 0)
                }
                Effect::ResolutionScale => {
                    let scaled = &self.render_world().resource::<Upscalers>().cameras;
                    matches!(state, EffectState::Active(_)) && !scaled.is_empty()
                }
                _ => matches!(state, EffectState::Active(_)),
            }
        })
    }

    /// Whether contribution culling leaves the measuring to the GPU: nothing else wants to know its areas.
    pub fn is_measured_by_gpu(&self, asked: Asked) -> bool {
        let others = [Effect::ZBufferOcclusion, Effect::FrameBudget];
        asked.has(Effect::ContributionCulling) && !others.iter().any(|other| asked.has(*other))
    }

    /// Frames until all that is asked for is at work and nothing changes any more.
    pub fn settle(&mut self, asked: Asked) {
        let mut still = 0;
        let mut before = Vec::new();
        for _ in 0..3000 {
            self.step();
            let held: Vec<u64> = self.bytes().into();
            let is_still =
                held == before && self.world().resource::<Candidates>().dirty().is_empty();
            before = held;
            still = if self.is_settled(asked) && is_still {
                still + 1
            } else {
                0
            };
            // Verdicts, sizes and times have come back by then.
            if still == 10 {
                return;
            }
            if still == 0 {
                // The background works, too.
                std::thread::sleep(core::time::Duration::from_millis(1));
            }
        }
        for effect in EFFECTS {
            println!("{effect:?}: {}", self.effects().state(effect));
        }
        panic!("{asked} did not settle");
    }

    /// GPU memory that each effect says it holds.
    pub fn bytes(&self) -> [u64; EFFECTS.len()] {
        EFFECTS.map(|effect| self.effects().bytes(effect))
    }

    /// What the driver holds under names of the suite: a name and its size each, sorted.
    pub fn allocations(&self) -> Vec<(String, u64)> {
        let device = self.world().resource::<RenderDevice>().wgpu_device();
        let Some(report) = device.generate_allocator_report() else {
            return Vec::new();
        };
        let mut ours: Vec<_> = report
            .allocations
            .into_iter()
            .filter(|of| of.name.contains("skyline"))
            .map(|of| (of.name, of.size))
            .collect();
        ours.sort();
        ours
    }

    /// Pipelines that were queued with shaders of the suite.
    pub fn pipelines(&self) -> Vec<String> {
        let cache = self.render_world().resource::<PipelineCache>();
        let shaders = cache
            .pipelines()
            .map(|pipeline| match &pipeline.descriptor {
                PipelineDescriptor::RenderPipelineDescriptor(of) => &of.vertex.shader,
                PipelineDescriptor::ComputePipelineDescriptor(of) => &of.shader,
            });
        let paths = shaders.filter_map(|shader| Some(shader.path()?.to_string()));
        paths.filter(|path| path.contains("skyline")).collect()
    }

    /// How many there are of everything that can be counted, in both worlds and on the GPU.
    pub fn holdings(&mut self) -> BTreeMap<&'static str, u64> {
        let mut all = BTreeMap::new();
        let world = self.world_mut();
        let entities = world.query::<()>().iter(world).count();
        let render = self.offline.app.get_sub_app_mut(RenderApp);
        let render = render.expect("it renders").world_mut();
        let render_entities = render.query::<()>().iter(render).count();
        let report = render.resource::<RenderInstance>().generate_report();
        let hub = report.expect("wgpu runs natively").hub;
        for (name, count) in [
            ("entities", entities),
            ("render entities", render_entities),
            ("buffers", hub.buffers.num_kept_from_user),
            ("textures", hub.textures.num_kept_from_user),
            ("texture views", hub.texture_views.num_kept_from_user),
            ("samplers", hub.samplers.num_kept_from_user),
            ("bind groups", hub.bind_groups.num_kept_from_user),
            (
                "bind group layouts",
                hub.bind_group_layouts.num_kept_from_user,
            ),
            ("pipelines", hub.compute_pipelines.num_kept_from_user),
            ("render pipelines", hub.render_pipelines.num_kept_from_user),
            ("shader modules", hub.shader_modules.num_kept_from_user),
            ("query sets", hub.query_sets.num_kept_from_user),
            ("queued pipelines", self.pipelines().len()),
        ] {
            all.insert(name, count as u64);
        }
        let world = self.world();
        all.insert("meshes", world.resource::<Assets<Mesh>>().len() as u64);
        all.insert("images", world.resource::<Assets<Image>>().len() as u64);
        let materials = world.resource::<Assets<StandardMaterial>>().len();
        all.insert("materials", materials as u64);
        let fields = world.resource::<Assets<HeightField>>().len();
        all.insert("height fields", fields as u64);
        let device = world.resource::<RenderDevice>().wgpu_device();
        if let Some(report) = device.generate_allocator_report() {
            // Their bytes depend on where each came to lie.
            all.insert("GPU allocations", report.allocations.len() as u64);
        }
        all
    }
}

/// Two sets as words: what is in one of them alone. Empty where they are the same.
pub fn differences<'a>(
    wanted: impl IntoIterator<Item = &'a str>,
    found: impl IntoIterator<Item = &'a str>,
) -> Vec<String> {
    let wanted: BTreeSet<_> = wanted.into_iter().collect();
    let found: BTreeSet<_> = found.into_iter().collect();
    let missing = wanted
        .difference(&found)
        .map(|name| format!("{name} did not run"));
    let more = found.difference(&wanted).map(|name| format!("{name} ran"));
    missing.chain(more).collect()
}

#[test]
fn sets_that_differ_are_told_apart() {
    assert!(differences(["a", "b"], ["b", "a"]).is_empty());
    assert_eq!(differences(["a", "b"], ["b"]), ["a did not run"]);
    assert_eq!(differences(["b"], ["b", "c"]), ["c ran"]);
}

#[test]
fn the_matrix_is_none_each_alone_each_pair_and_all() {
    let rows = Asked::matrix();
    assert_eq!(rows.len(), 1 + 8 + 28 + 1);
    let different: BTreeSet<_> = rows.iter().collect();
    assert_eq!(different.len(), rows.len());
    let sizes = rows
        .iter()
        .map(|row| EFFECTS.iter().filter(|e| row.has(**e)).count());
    let mut by_size = [0; 9];
    sizes.for_each(|size| by_size[size] += 1);
    assert_eq!(by_size, [1, 8, 28, 0, 0, 0, 0, 0, 1]);
}
