//! A small scene with every effect in it, for tests of an app's whole life: hills with shadows, a wall with boxes
//! behind it, a box in a box, a ball that is cut into chunks, things too small to draw.

use bevy::{
    asset::RenderAssetUsages,
    light::{
        CascadeShadowConfigBuilder, DirectionalLightShadowMap, cluster::GlobalClusterSettings,
    },
    prelude::*,
};
use bevy_skyline::{offline::Offline, prelude::*};

pub const SIZE: UVec2 = UVec2::new(64, 48);
/// Frames that nothing here needs to settle.
const LIMIT: u32 = 6_000;

/// See the [module](self).
pub struct Stage {
    pub offline: Offline,
    pub camera: Entity,
    pub target: Handle<Image>,
    pub terrain: Entity,
    pub field: Handle<HeightField>,
    pub sun: Entity,
    /// The root of the box in a box.
    pub model: Entity,
    pub ball: Entity,
    pub boxes: Vec<Entity>,
    pub meshes: Meshes,
    pub paint: Handle<StandardMaterial>,
    pub albedo: Handle<Image>,
}

/// Handles of what is drawn more than once.
#[derive(Clone)]
pub struct Meshes {
    pub cube: Handle<Mesh>,
    pub hull: Handle<Mesh>,
    pub core: Handle<Mesh>,
    pub ball: Handle<Mesh>,
}

/// 65 × 65 samples, 64 m a side, around 2 m high.
pub fn hills() -> HeightField {
    HeightField::from_fn(UVec2::splat(65), 1.0, (-8.0, 24.0), |x, z| {
        let (x, z) = (x as f32 * 0.21, z as f32 * 0.17);
        1.0 + 1.5 * x.sin() + 1.2 * z.cos()
    })
    .expect("hills are sound")
}

/// A ball of so many rings, twice as many sectors.
pub fn ball(rings: u32) -> Mesh {
    Sphere::new(1.5).mesh().uv(2 * rings, rings)
}

/// A picture for the ground: stripes.
pub fn stripes() -> Image {
    use bevy::render::render_resource::{Extent3d, TextureDimension, TextureFormat};
    let pixels = (0..16 * 16_u32)
        .flat_map(|i| [if i / 2 % 2 == 0 { 200 } else { 90 }, 150, 90, 255])
        .collect();
    let size = Extent3d {
        width: 16,
        height: 16,
        depth_or_array_layers: 1,
    };
    Image::new(
        size,
        TextureDimension::D2,
        pixels,
        TextureFormat::Rgba8UnormSrgb,
        RenderAssetUsages::default(),
    )
}

/// From the front, a little above.
pub fn front() -> Transform {
    Transform::from_xyz(32.0, 9.0, 62.0).looking_at(Vec3::new(32.0, 4.0, 30.0), Vec3::Y)
}

/// Shadows in small slices, so that they take some frames.
pub fn shadow() -> TerrainShadow {
    TerrainShadow {
        slice_ms: 0.2,
        ..default()
    }
}

pub fn interior() -> InteriorCulling {
    InteriorCulling {
        grid: InteriorGrid::Resolution(40),
        ..default()
    }
}

pub fn index() -> SphericalIndex {
    SphericalIndex {
        chunk_triangles: 64,
        chunk_cost: 0,
        ..default()
    }
}

/// What a camera has here: all that leaves something out, and never rests.
pub fn culling() -> (Msaa, ZBufferOcclusion, ContributionCulling) {
    let occlusion = ZBufferOcclusion {
        rests: false,
        ..default()
    };
    let contribution = ContributionCulling {
        threshold_px2: 2.0,
        ..default()
    };
    (Msaa::Off, occlusion, contribution)
}

impl Stage {
    /// `None` with the reason printed where there is no device.
    pub fn new() -> Option<Self> {
        Self::with(|_| {})
    }

    /// The same, with more in the app.
    pub fn with(configure: impl FnOnce(&mut App)) -> Option<Self> {
        let mut offline = crate::device_with(|app| {
            app.insert_resource(DirectionalLightShadowMap { size: 128 });
            configure(app);
        })?;
        let target = offline.target(SIZE);
        let camera = offline.camera(&target, (culling(), front()));
        let world = offline.app.world_mut();
        let mut add = |mesh: Mesh| world.resource_mut::<Assets<Mesh>>().add(mesh);
        let meshes = Meshes {
            cube: add(Cuboid::from_length(1.0).into()),
            hull: add(Cuboid::from_length(4.0).into()),
            core: add(Sphere::new(1.0).mesh().uv(24, 12)),
            ball: add(ball(16)),
        };
        let field = world.resource_mut::<Assets<HeightField>>().add(hills());
        let albedo = world.resource_mut::<Assets<Image>>().add(stripes());
        let paint = world
            .resource_mut::<Assets<StandardMaterial>>()
            .add(StandardMaterial::from_color(Color::srgb(0.8, 0.3, 0.2)));
        let nobody = Entity::PLACEHOLDER;
        let mut stage = Self {
            offline,
            camera,
            target,
            terrain: nobody,
            field,
            sun: nobody,
            model: nobody,
            ball: nobody,
            boxes: Vec::new(),
            meshes,
            paint,
            albedo,
        };
        stage.spawn_terrain();
        stage.spawn_sun();
        stage.spawn_model();
        stage.spawn_ball();
        stage.spawn_boxes();
        Some(stage)
    }

    /// Has Bevy put lights in clusters on the CPU: what it keeps on the GPU for that, it counts on.
    pub fn cluster_on_the_cpu(&mut self) {
        let settings = self.world().get_resource_mut::<GlobalClusterSettings>();
        if let Some(mut settings) = settings {
            settings.gpu_clustering = None;
        }
    }

    pub fn world(&mut self) -> &mut World {
        self.offline.app.world_mut()
    }

    pub fn spawn_terrain(&mut self) {
        let look = TerrainLook {
            colour: TerrainColour::Albedo(self.albedo.clone()),
            ..default()
        };
        let terrain = (Terrain::new(self.field.clone()).with_look(look), shadow());
        self.terrain = self.world().spawn(terrain).id();
    }

    pub fn spawn_sun(&mut self) {
        let cascades = CascadeShadowConfigBuilder {
            num_cascades: 1,
            maximum_distance: 80.0,
            ..default()
        };
        let sun = (
            DirectionalLight {
                shadow_maps_enabled: true,
                ..default()
            },
            cascades.build(),
            Transform::default().looking_to(Vec3::new(-1.0, -0.6, -0.5), Vec3::Y),
        );
        self.sun = self.world().spawn(sun).id();
    }

    pub fn spawn_camera(&mut self) {
        let target = self.target.clone();
        self.camera = self.offline.camera(&target, (culling(), front()));
    }

    pub fn spawn_model(&mut self) {
        let (hull, core) = (self.meshes.hull.clone(), self.meshes.core.clone());
        let paint = MeshMaterial3d(self.paint.clone());
        let place = Transform::from_xyz(24.0, 5.0, 42.0).with_rotation(Quat::from_rotation_y(0.5));
        self.model = self
            .world()
            .spawn((place, Visibility::default(), interior()))
            .with_children(|parts| {
                parts.spawn((Mesh3d(hull), paint.clone()));
                parts.spawn((Mesh3d(core), paint));
            })
            .id();
    }

    pub fn spawn_ball(&mut self) {
        let parts = (
            Mesh3d(self.meshes.ball.clone()),
            MeshMaterial3d(self.paint.clone()),
            Transform::from_xyz(38.0, 6.0, 46.0),
            index(),
        );
        self.ball = self.world().spawn(parts).id();
    }

    /// A wall and what is behind it, and beside it what is too small.
    fn spawn_boxes(&mut self) {
        let wall = Transform::from_xyz(44.0, 5.0, 36.0).with_scale(Vec3::new(12.0, 9.0, 0.4));
        self.spawn_box(wall);
        for i in 0..6 {
            let behind = Vec3::new(40.0 + 1.5 * i as f32, 5.0, 30.0);
            self.spawn_box(Transform::from_translation(behind));
            let small = Vec3::new(20.0 + 2.0 * i as f32, 9.0, 30.0);
            self.spawn_box(Transform::from_translation(small).with_scale(Vec3::splat(0.02)));
        }
    }

    pub fn spawn_box(&mut self, place: Transform) -> Entity {
        let cube = Mesh3d(self.meshes.cube.clone());
        let paint = MeshMaterial3d(self.paint.clone());
        let entity = self.world().spawn((cube, paint, place)).id();
        self.boxes.push(entity);
        entity
    }

    pub fn step(&mut self) {
        self.offline.step();
    }

    pub fn steps(&mut self, frames: u32) {
        for _ in 0..frames {
            self.step();
        }
    }

    pub fn effects(&self) -> &Effects {
        self.offline.app.world().resource::<Effects>()
    }

    /// Whether the renderer has given up: Bevy asks the app to end then.
    pub fn has_ended(&self) -> bool {
        self.offline.app.should_exit().is_some()
    }

    /// Whether shadow maps are out of date, or something else has not come to its end.
    pub fn is_working(&self) -> bool {
        let shadows = self.offline.counts().shadows;
        let says = |state: &EffectState, what: &str| state.to_string().contains(what);
        let effects = self.effects();
        shadows.maps == 0
            || shadows.waiting
            || shadows.shown < shadows.maps
            || !matches!(effects.terrain(), EffectState::Active(_))
            || !says(effects.interior(), "are hidden")
            || !says(effects.spherical(), "triangles are drawn")
    }

    /// Steps until nothing is left to do, all effects are at work, and the picture stands still.
    pub fn settle(&mut self) {
        for _ in 0..LIMIT {
            self.step();
            if !self.is_working() {
                // What comes back from the GPU late.
                self.steps(12);
                return;
            }
            std::thread::sleep(core::time::Duration::from_millis(1));
        }
        panic!("it does not settle: {}", self.states());
    }

    /// All effects in words.
    pub fn states(&self) -> String {
        let mut states: Vec<String> = self
            .effects()
            .iter()
            .map(|(effect, state)| format!("{effect:?}: {state}"))
            .collect();
        states.sort();
        format!("{}; {:?}", states.join("; "), self.offline.counts().shadows)
    }

    pub fn picture(&self) -> image::RgbaImage {
        self.offline.picture(&self.target).expect("a picture")
    }

    /// Settles, and looks.
    pub fn settled(&mut self) -> image::RgbaImage {
        self.settle();
        let picture = self.picture();
        let background = *picture.get_pixel(0, 0);
        let drawn = picture
            .pixels()
            .filter(|pixel| **pixel != background)
            .count();
        assert!(drawn > 500, "an empty picture: {}", self.states());
        picture
    }

    /// Entities of the main world, and assets.
    pub fn count(&self) -> Counts {
        let world = self.offline.app.world();
        Counts {
            entities: world.entities().count_spawned() as usize,
            meshes: world.resource::<Assets<Mesh>>().len(),
            materials: world.resource::<Assets<StandardMaterial>>().len(),
            images: world.resource::<Assets<Image>>().len(),
            fields: world.resource::<Assets<HeightField>>().len(),
        }
    }
}

/// See [`Stage::count`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Counts {
    pub entities: usize,
    pub meshes: usize,
    pub materials: usize,
    pub images: usize,
    pub fields: usize,
}
