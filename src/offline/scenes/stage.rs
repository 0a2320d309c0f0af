//! A scene in a headless app, and cameras that cull it in different ways.

use core::any::TypeId;

use bevy::{
    camera::{
        ClearColorConfig,
        visibility::{NoFrustumCulling, VisibleEntities},
    },
    core_pipeline::{
        core_3d::Opaque3d,
        prepass::DepthPrepass,
        tonemapping::{DebandDither, Tonemapping},
    },
    light::AmbientLight,
    prelude::*,
    render::{
        RenderApp,
        batching::gpu_preprocessing::{
            IndirectBatchSet, IndirectParametersBuffers, IndirectParametersBuffersSettings,
            IndirectParametersIndexed,
        },
        occlusion_culling::OcclusionCulling,
        render_resource::{Buffer, TextureUsages},
        sync_world::RenderEntity,
        view::ViewDepthTexture,
    },
};

use super::{
    Look, Scene, SceneObject,
    compare::Frame,
    ids::{self, ObjectIdPlugin},
};
use crate::{
    occlusion::{OcclusionCounts, ZBufferOcclusion, meshes::OccludeeMeshes},
    offline::{Offline, OfflineError},
};

/// Frames after which a change of what culls has reached everything.
const WARM_FRAMES: u32 = 6;
/// Frames after which it is not waited for any longer.
const MOST_WARM_FRAMES: u32 = 2_000;

/// What is left out of a picture.
#[derive(Clone, Debug, PartialEq)]
pub enum Culling {
    /// Nothing: every object is drawn, in view or not.
    None,
    /// What is out of view, by Bevy.
    Frustum,
    /// That, and what is hidden, by Bevy's `OcclusionCulling` behind a depth prepass.
    Bevy,
    /// That, and what is hidden, by [`ZBufferOcclusion`].
    ZBuffer(ZBufferOcclusion),
    /// The same behind a depth prepass, as Bevy's must have it.
    ZBufferAfterPrepass(ZBufferOcclusion),
}

impl Culling {
    /// The settings, if it is [`ZBufferOcclusion`] that culls.
    pub fn settings(&self) -> Option<&ZBufferOcclusion> {
        match self {
            Self::ZBuffer(settings) | Self::ZBufferAfterPrepass(settings) => Some(settings),
            _ => None,
        }
    }
}

/// The depth of every pixel. Reverse-Z, 0 = far.
#[derive(Clone, Debug, PartialEq)]
pub struct DepthImage {
    /// units: px
    pub size: UVec2,
    /// Row by row from the top left.
    pub ndc_depth: Vec<f32>,
}

/// What a scene's cameras have in common, without the target they draw to: they stand at its first view, and what they
/// show is what was drawn, pixel for pixel.
pub(in crate::offline) fn eye(scene: &Scene, look: Look, is_active: bool) -> impl Bundle + use<> {
    let clear_color = match look {
        Look::Shaded => Color::linear_rgb(0.5, 0.65, 0.85),
        Look::Ids => Color::BLACK,
    };
    (
        Camera {
            is_active,
            clear_color: ClearColorConfig::Custom(clear_color),
            ..default()
        },
        Projection::Perspective(scene.projection()),
        Msaa::Off,
        Tonemapping::None,
        DebandDither::Disabled,
        scene.view(""),
        AmbientLight {
            brightness: 900.0,
            ..default()
        },
    )
}

/// A scene, its entities, and a camera for each way to cull of which one is on.
pub struct SceneStage {
    /// The app.
    pub offline: Offline,
    /// What is shown.
    pub scene: Scene,
    /// Entities of [`Scene::objects`], in their order.
    pub entities: Vec<Entity>,
    /// What the cameras draw to.
    pub target: Handle<Image>,
    plain: Entity,
    bevy: Entity,
    zbuffer: Entity,
    culling: Culling,
}

impl SceneStage {
    /// Opens a device and spawns a scene, with the plain camera on and frustum culling alone.
    ///
    /// # Errors
    /// [`OfflineError`].
    pub fn new(scene: Scene, size: UVec2, look: Look) -> Result<Self, OfflineError> {
        let mut offline = Offline::with(|app| {
            if look == Look::Ids {
                app.add_plugins(ObjectIdPlugin);
            }
            // So that what Bevy's culling left can be counted.
            if let Some(render) = app.get_sub_app_mut(RenderApp) {
                render.insert_resource(IndirectParametersBuffersSettings {
                    allow_copies_from_indirect_parameter_buffers: true,
                });
            }
        })?;
        let limit = offline.max_image_side();
        if size.max_element() > limit {
            return Err(OfflineError::Unsupported(format!(
                "a picture of {}x{} pixels is larger than this GPU can draw: at most {limit} a side",
                size.x, size.y
            )));
        }
        let entities = scene.spawn(offline.app.world_mut(), look);
        let target = offline.target(size);
        let mut camera = |is_active: bool| offline.camera(&target, eye(&scene, look, is_active));
        let (plain, bevy, zbuffer) = (camera(true), camera(false), camera(false));
        let world = offline.app.world_mut();
        world
            .entity_mut(bevy)
            .insert((DepthPrepass, OcclusionCulling));
        for camera in [plain, bevy, zbuffer] {
            if let Some(mut camera) = world.get_mut::<Camera3d>(camera) {
                let usages = TextureUsages::RENDER_ATTACHMENT | TextureUsages::COPY_SRC;
                camera.depth_texture_usages = usages.into();
            }
        }
        Ok(Self {
            offline,
            scene,
            entities,
            target,
            plain,
            bevy,
            zbuffer,
            culling: Culling::Frustum,
        })
    }

    /// The camera that is on.
    pub fn camera(&self) -> Entity {
        match self.culling {
            Culling::None | Culling::Frustum => self.plain,
            Culling::Bevy => self.bevy,
            Culling::ZBuffer(_) | Culling::ZBufferAfterPrepass(_) => self.zbuffer,
        }
    }

    /// Sets what culls, and draws until it does.
    pub fn cull(&mut self, culling: &Culling) {
        self.set_culling(culling);
        let mut left = WARM_FRAMES;
        for _ in 0..MOST_WARM_FRAMES {
            self.offline.step();
            // Until its volumes are there, a mesh's `Aabb` stands in for them.
            let making = self.offline.app.world().get_resource::<OccludeeMeshes>();
            left = match making {
                Some(making) if making.is_busy() => WARM_FRAMES,
                _ => left - 1,
            };
            if left == 0 {
                break;
            }
        }
    }

    /// Sets what culls from the next frame on.
    pub fn set_culling(&mut self, culling: &Culling) {
        let was_none = self.culling == Culling::None;
        self.culling = culling.clone();
        let on = self.camera();
        let world = self.offline.app.world_mut();
        if let Some(settings) = culling.settings() {
            let mut camera = world.entity_mut(self.zbuffer);
            if camera.get() != Some(settings) {
                camera.insert(settings.clone());
            }
            if matches!(culling, Culling::ZBufferAfterPrepass(_)) {
                camera.insert_if_new(DepthPrepass);
            } else {
                camera.remove::<DepthPrepass>();
            }
        }
        let is_none = *culling == Culling::None;
        if is_none != was_none {
            for &entity in &self.entities {
                if is_none {
                    world.entity_mut(entity).insert(NoFrustumCulling);
                } else {
                    world.entity_mut(entity).remove::<NoFrustumCulling>();
                }
            }
        }
        for camera in [self.plain, self.bevy, self.zbuffer] {
            if let Some(mut camera_of) = world.get_mut::<Camera>(camera)
                && camera_of.is_active != (camera == on)
            {
                camera_of.is_active = camera == on;
            }
        }
    }

    /// Puts all cameras there.
    pub fn look(&mut self, transform: Transform) {
        let world = self.offline.app.world_mut();
        for camera in [self.plain, self.bevy, self.zbuffer] {
            world.entity_mut(camera).insert(transform);
        }
    }

    /// Puts everything that moves, and the cameras, where they are in a frame of a path.
    pub fn set_frame(&mut self, path: super::CameraPath, frame: u32) {
        self.scene
            .place(self.offline.app.world_mut(), &self.entities, frame);
        self.look(path.at(&self.scene, frame));
    }

    /// The picture last drawn.
    ///
    /// # Errors
    /// [`OfflineError::ReadBack`].
    pub fn picture(&self) -> Result<image::RgbaImage, OfflineError> {
        self.offline.picture(&self.target)
    }

    /// The picture last drawn, and its depth.
    ///
    /// # Errors
    /// [`OfflineError::ReadBack`].
    pub fn frame(&self) -> Result<Frame, OfflineError> {
        Frame::new(self.picture()?, &self.depth()?)
    }

    /// Objects drawn in the last frame.
    ///
    /// # Errors
    /// [`OfflineError`], where Bevy's counts cannot be read back.
    pub fn drawn(&self) -> Result<usize, OfflineError> {
        drawn(&self.offline, self.camera(), &self.culling)
    }

    /// The depth of every pixel of the picture last drawn.
    ///
    /// # Errors
    /// [`OfflineError::ReadBack`].
    pub fn depth(&self) -> Result<DepthImage, OfflineError> {
        let gone = || OfflineError::ReadBack("the camera has no depth buffer".into());
        let render = self.offline.app.get_sub_app(RenderApp).ok_or_else(gone)?;
        let synced = self.offline.app.world().get::<RenderEntity>(self.camera());
        let depth = synced
            .and_then(|entity| render.world().get::<ViewDepthTexture>(entity.id()))
            .ok_or_else(gone)?;
        let size = UVec2::new(depth.texture.width(), depth.texture.height());
        let bytes = self.offline.read_texture(&depth.texture, size, 4)?;
        Ok(DepthImage {
            size,
            ndc_depth: bytemuck::pod_collect_to_vec(&bytes),
        })
    }

    /// How many pixels each object shows in the picture last drawn, which must be one of numbers.
    ///
    /// # Errors
    /// [`OfflineError::ReadBack`], also where the picture shows something else than the scene's objects.
    pub fn seen(&self) -> Result<Vec<u32>, OfflineError> {
        ids::seen(&self.picture()?, self.scene.objects.len()).map_err(|pixels| {
            OfflineError::ReadBack(format!("{pixels} pixels show objects there are none of"))
        })
    }
}

/// Objects that a camera's last frame drew.
///
/// Only one camera may be on, and all meshes must be indexed: Bevy's counts are those of all its opaque draws.
fn drawn(offline: &Offline, camera: Entity, culling: &Culling) -> Result<usize, OfflineError> {
    match culling {
        Culling::None | Culling::Frustum => Ok(kept(offline, camera)),
        Culling::Bevy => drawn_indirectly(offline),
        Culling::ZBuffer(_) | Culling::ZBufferAfterPrepass(_) => {
            Ok(kept(offline, camera) + rescued(offline, camera))
        }
    }
}

/// Objects in the camera's list.
fn kept(offline: &Offline, camera: Entity) -> usize {
    let world = offline.app.world();
    let visible = world.get::<VisibleEntities>(camera);
    let meshes = visible.map_or(&[][..], |visible| visible.get(TypeId::of::<Mesh3d>()));
    meshes
        .iter()
        .filter(|entity| world.get::<SceneObject>(**entity).is_some())
        .count()
}

/// Objects that `ZBufferOcclusion` took out of that list and drew after all, as the newest verdicts to come back have
/// it: one frame late.
fn rescued(offline: &Offline, camera: Entity) -> usize {
    let counts = offline.app.world().get::<OcclusionCounts>(camera);
    counts.map_or(0, |counts| counts.rescued as usize)
}

/// Instances of the opaque phase's indirect draws.
fn drawn_indirectly(offline: &Offline) -> Result<usize, OfflineError> {
    let gone = || OfflineError::ReadBack("Bevy draws nothing indirectly here".into());
    let render = offline.app.get_sub_app(RenderApp).ok_or_else(gone)?;
    let phases = render
        .world()
        .get_resource::<IndirectParametersBuffers>()
        .ok_or_else(gone)?;
    let Some(phase) = phases.get(&TypeId::of::<Opaque3d>()) else {
        return Ok(0);
    };
    let draws = phase.indexed.batch_count();
    let sets = phase.batch_set_count(true);
    let (Some(data), true) = (phase.indexed.data_buffer(), draws > 0) else {
        return Ok(0);
    };
    let draws: Vec<IndirectParametersIndexed> = read(offline, data, draws)?;
    let counts = |range: core::ops::Range<usize>| -> usize {
        let some = draws.get(range).unwrap_or_default();
        some.iter().map(|draw| draw.instance_count as usize).sum()
    };
    let features = render
        .world()
        .get_resource::<bevy::render::renderer::RenderDevice>()
        .map(|device| device.features());
    let counted = features.is_some_and(|f| f.contains(wgpu::Features::MULTI_DRAW_INDIRECT_COUNT));
    let (Some(buffer), true) = (phase.indexed.batch_sets_buffer(), counted && sets > 0) else {
        // Each draw has its own place.
        return Ok(counts(0..draws.len()));
    };
    // The draws of a set lie one after another, as many as were found to have instances.
    let sets: Vec<IndirectBatchSet> = read(offline, buffer, sets)?;
    Ok(sets
        .iter()
        .map(|set| {
            let first = set.indirect_parameters_base as usize;
            counts(first..first + set.indirect_parameters_count as usize)
        })
        .sum())
}

fn read<T: bytemuck::Pod>(
    offline: &Offline,
    from: &Buffer,
    count: usize,
) -> Result<Vec<T>, OfflineError> {
    let size = (count * size_of::<T>()) as u64;
    if size > from.size() {
        return Err(OfflineError::ReadBack(
            "Bevy's draws are more than their buffer holds".into(),
        ));
    }
    let bytes = offline.read_back(size, |encoder, buffer| {
        encoder.copy_buffer_to_buffer(from, 0, buffer, 0, size);
    })?;
    Ok(bytemuck::pod_collect_to_vec(&bytes))
}
