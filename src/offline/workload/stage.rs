//! A scene in a headless app, and one camera at a time whose frames are measured and counted.

use core::any::TypeId;

use bevy::{
    camera::{
        primitives::{Aabb, Frustum},
        visibility::{NoFrustumCulling, VisibleEntities},
    },
    platform::time::Instant,
    prelude::*,
};

use super::{
    WorkloadError,
    cost::{Cost, Drawn},
    path::{Pose, WorkloadPath},
    policy::{Only, OnlyPlugin, Policy, Triangles},
};
use crate::{
    budget::{
        BudgetClock, FrameBudget, GivenFrameTimes, Knobs, WorkloadPolicy, policy::distance_m,
    },
    contribution::{ContributionCounts, ContributionCulling, ContributionExit, area::AreaView},
    culling::volume::LocalBox,
    occlusion::ZBufferOcclusion,
    offline::{
        Offline, OfflineError,
        scenes::{Look, Scene, SceneObject, stage::eye},
    },
};

fn contribution(threshold_px2: f32) -> ContributionCulling {
    ContributionCulling {
        threshold_px2,
        exit: ContributionExit::Cut,
        // What the GPU leaves out could not be counted in the same frame.
        gpu_from: usize::MAX,
        ..default()
    }
}

/// Frames after a change of what is drawn that are not believed.
const SETTLE_FRAMES: usize = 2;

/// Which time the budget is given.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Clock {
    /// What the whole frame took, until the GPU was done.
    Time,
    /// What was drawn in it, counted.
    Counted,
}

impl Clock {
    /// Its name as a flag's value.
    pub fn name(self) -> &'static str {
        match self {
            Self::Time => "time",
            Self::Counted => "counted",
        }
    }
}

/// What one frame drew, and how long it took.
#[derive(Clone, Debug, PartialEq)]
pub struct Measured {
    /// From its start until the GPU was done. units: ms
    pub frame_ms: f64,
    /// What was drawn.
    pub drawn: Drawn,
    /// The threshold that held. units: px²
    pub threshold_px2: f64,
    /// The budget's knobs and their values, `name=value` with semicolons between; else empty.
    pub knobs: String,
}

/// One object in view of a frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(in crate::offline) struct Seen {
    /// How far its nearest point is. units: m
    pub distance_m: f32,
    /// Its area, as contribution culling measures it. units: px²
    pub area_px2: f32,
    /// What drawing it counts.
    pub drawn: Drawn,
}

/// A scene whose frames are measured under one [`Policy`] after another.
pub struct WorkloadStage {
    /// The app.
    pub offline: Offline,
    /// What is shown.
    pub scene: Scene,
    /// What everything is counted as.
    pub cost: Cost,
    size: UVec2,
    entities: Vec<Entity>,
    target: Handle<Image>,
    camera: Entity,
    occludes: bool,
    unculled: bool,
    budget: Option<Clock>,
    /// Frames since the camera was made.
    frames: usize,
}

impl WorkloadStage {
    /// Opens a device and spawns a scene.
    ///
    /// # Errors
    /// [`WorkloadError::Offline`] without a GPU, [`WorkloadError::Size`] where it cannot draw such a picture.
    pub fn new(scene: Scene, size: UVec2) -> Result<Self, WorkloadError> {
        let mut offline = Offline::with(|app| {
            app.add_plugins(OnlyPlugin);
        })?;
        let limit = offline.max_image_side();
        if size.max_element() > limit || size.min_element() == 0 {
            return Err(WorkloadError::Size { size, limit });
        }
        let world = offline.app.world_mut();
        let entities = scene.spawn(world, Look::Shaded);
        let of_mesh = scene.triangles_of_meshes();
        for (entity, object) in entities.iter().zip(&scene.objects) {
            let triangles = of_mesh.get(object.mesh).copied().unwrap_or(0);
            world
                .entity_mut(*entity)
                .insert(Triangles(triangles as u32));
        }
        let target = offline.target(size);
        let camera = offline.camera(&target, eye(&scene, Look::Shaded, true));
        // Bevy gives no bounds to what is not to be culled: all have theirs before any policy begins.
        for _ in 0..SETTLE_FRAMES {
            offline.step();
        }
        Ok(Self {
            offline,
            scene,
            cost: Cost::default(),
            size,
            entities,
            target,
            camera,
            occludes: false,
            unculled: false,
            budget: None,
            frames: 0,
        })
    }

    /// The camera that is on.
    pub fn camera(&self) -> Entity {
        self.camera
    }

    /// Whether what is hidden is left out, too, under every policy but [`Policy::None`]; from the next [`begin`](Self::begin) on.
    pub fn set_occludes(&mut self, occludes: bool) {
        self.occludes = occludes;
    }

    /// Sets what decides what is drawn, on a new camera: nothing is left of what an older one had learned.
    pub fn begin(&mut self, policy: &Policy, target_ms: f64, clock: Clock) {
        match *policy {
            Policy::None | Policy::Frustum => self.begin_with(()),
            Policy::Polygons(most) => self.begin_with(WorkloadPolicy::Polygons(most)),
            Policy::Distance(metres) => self.begin_with(WorkloadPolicy::Distance(metres)),
            // P4 has no hysteresis.
            Policy::Threshold(area) => self.begin_with(ContributionCulling {
                hysteresis: 1.0,
                ..contribution(area)
            }),
            Policy::Budget => {
                let budget = FrameBudget {
                    clock: BudgetClock::Given,
                    ..FrameBudget::from_ms(target_ms as f32)
                };
                self.begin_with((contribution(0.0), budget));
                self.budget = Some(clock);
            }
        }
        self.set_unculled(*policy == Policy::None);
        if self.occludes && *policy != Policy::None {
            let world = self.offline.app.world_mut();
            // What is measured is culling, not when to leave it.
            world.entity_mut(self.camera).insert(ZBufferOcclusion {
                rests: false,
                ..default()
            });
        }
    }

    /// The same with any components on the camera, and frustum culling.
    pub fn begin_with(&mut self, components: impl Bundle) {
        self.set_unculled(false);
        self.offline.app.world_mut().despawn(self.camera);
        let bundle = (eye(&self.scene, Look::Shaded, true), components);
        self.camera = self.offline.camera(&self.target, bundle);
        let world = self.offline.app.world_mut();
        if let Some(mut given) = world.get_resource_mut::<GivenFrameTimes>() {
            given.last_ms = None;
        }
        self.budget = None;
        self.frames = 0;
    }

    fn set_unculled(&mut self, unculled: bool) {
        if unculled == self.unculled {
            return;
        }
        self.unculled = unculled;
        let world = self.offline.app.world_mut();
        for &entity in &self.entities {
            if unculled {
                world.entity_mut(entity).insert(NoFrustumCulling);
            } else {
                world.entity_mut(entity).remove::<NoFrustumCulling>();
            }
        }
    }

    /// Puts the camera there, and what moves where it is in a frame.
    pub fn look(&mut self, pose: Pose, frame: u32) {
        let lens = Projection::Perspective(PerspectiveProjection {
            fov: pose.fov,
            ..self.scene.projection()
        });
        let world = self.offline.app.world_mut();
        self.scene.place(world, &self.entities, frame);
        world.entity_mut(self.camera).insert((pose.transform, lens));
    }

    /// Draws and measures one frame of a path of `frames`. Frames before the first lead up to it.
    pub fn frame(&mut self, path: WorkloadPath, frame: i64, frames: u32) -> Measured {
        let pose = path.at(&self.scene, path.part(frame, frames));
        self.look(pose, frame.max(0) as u32);
        self.step()
    }

    /// Draws and measures one frame.
    pub fn step(&mut self) -> Measured {
        let start = Instant::now();
        self.offline.step();
        let frame_ms = 1e3 * start.elapsed().as_secs_f64();
        let drawn = self.seen().map(|(_, seen)| seen.drawn).sum();
        let measured = Measured {
            frame_ms,
            drawn,
            threshold_px2: self.threshold_px2(),
            knobs: self.knobs(),
        };
        self.frames += 1;
        // A new camera's first frames are those of its making.
        if let Some(clock) = self.budget.filter(|_| self.frames > SETTLE_FRAMES) {
            let counted_ms = self.cost.of(drawn);
            let world = self.offline.app.world_mut();
            if let Some(mut given) = world.get_resource_mut::<GivenFrameTimes>() {
                given.last_ms = Some(match clock {
                    Clock::Time => frame_ms,
                    Clock::Counted => counted_ms,
                } as f32);
            }
        }
        measured
    }

    /// What the last frame drew, object by object.
    pub(in crate::offline) fn seen(&self) -> impl Iterator<Item = (Entity, Seen)> + '_ {
        let world = self.offline.app.world();
        let visible = world.get::<VisibleEntities>(self.camera);
        let list = visible.map_or(&[][..], |visible| visible.get(TypeId::of::<Mesh3d>()));
        let camera = world.get::<Camera>(self.camera);
        let place = world.get::<GlobalTransform>(self.camera);
        let eye = place.map_or(Vec3::ZERO, GlobalTransform::translation);
        let view = camera.zip(place).map(|(camera, place)| {
            AreaView::new(
                camera.clip_from_view() * place.to_matrix().inverse(),
                self.size.as_vec2(),
            )
        });
        let most = self.size.as_dvec2().element_product();
        // Without frustum culling what is beside the camera is drawn, too, and covers nothing; its rectangle can.
        let frustum = world.get::<Frustum>(self.camera).filter(|_| self.unculled);
        list.iter().filter_map(move |&entity| {
            world.get::<SceneObject>(entity)?;
            let triangles = world.get::<Triangles>(entity)?;
            let place = world.get::<GlobalTransform>(entity)?;
            let bound = world.get::<Aabb>(entity)?;
            let out = frustum.is_some_and(|frustum| {
                !frustum.intersects_obb(bound, &place.affine(), true, false)
            });
            let volume = LocalBox::from(*bound);
            let area_px2 = match view.as_ref().filter(|_| !out) {
                Some(view) => view.area_px2(&place.affine(), &volume),
                None => 0.0,
            };
            let seen = Seen {
                distance_m: distance_m(eye, &place.affine(), &volume),
                area_px2,
                drawn: Drawn {
                    objects: 1.0,
                    triangles: f64::from(triangles.0),
                    pixels: f64::from(area_px2).min(most),
                },
            };
            Some((entity, seen))
        })
    }

    fn threshold_px2(&self) -> f64 {
        let counts = self
            .offline
            .app
            .world()
            .get::<ContributionCounts>(self.camera);
        counts.map_or(0.0, |counts| {
            f64::from(counts.threshold_px2.max(counts.demanded_px2))
        })
    }

    fn knobs(&self) -> String {
        let knobs = self.offline.app.world().get_resource::<Knobs>();
        let (Some(knobs), Some(_)) = (knobs, self.budget) else {
            return String::new();
        };
        let values = knobs.iter().map(|knob| match knob.value() {
            Some(value) => format!("{}={value}", knob.name),
            None => knob.name.to_owned(),
        });
        values.collect::<Vec<_>>().join(";")
    }

    /// The picture last drawn.
    ///
    /// # Errors
    /// [`OfflineError::ReadBack`].
    pub fn picture(&self) -> Result<image::RgbImage, OfflineError> {
        let picture = self.offline.picture(&self.target)?;
        Ok(image::DynamicImage::ImageRgba8(picture).into_rgb8())
    }

    /// Learns what everything costs from measured frames of a path: at so many places of it, everything in view, the
    /// near half of it, and what has few or many triangles by itself, so that objects, triangles and pixels can be
    /// told apart. Returns the frames. Leaves the camera without a policy.
    pub fn calibrate(&mut self, path: WorkloadPath, places: u32) -> Vec<(Drawn, f64)> {
        // All sets measure areas or distances, so that what that takes is not put down to what they draw.
        self.begin_with(contribution(0.0));
        let reach = 0.15 * self.scene.bounds[0].distance(self.scene.bounds[1]);
        let sets = [
            (None, None),
            (Some(WorkloadPolicy::Distance(reach)), None),
            (Some(WorkloadPolicy::Distance(0.4 * reach)), None),
            (None, Some(Only(0..=150))),
            (None, Some(Only(400..=u32::MAX))),
        ];
        let mut frames = Vec::new();
        for (policy, only) in sets {
            let mut camera = self.offline.app.world_mut().entity_mut(self.camera);
            camera.remove::<(WorkloadPolicy, Only)>();
            if let Some(policy) = policy {
                camera.insert(policy);
            }
            if let Some(only) = only {
                camera.insert(only);
            }
            for place in 0..places {
                let mut least = f64::INFINITY;
                let mut drawn = Drawn::default();
                // The quickest of a few: whatever else the machine does only ever adds.
                for repeat in 0..SETTLE_FRAMES + 3 {
                    let measured = self.frame(path, i64::from(place), places);
                    drawn = measured.drawn;
                    if repeat >= SETTLE_FRAMES {
                        least = least.min(measured.frame_ms);
                    }
                }
                frames.push((drawn, least));
            }
        }
        self.begin(&Policy::Frustum, 0.0, Clock::Time);
        frames
    }
}
