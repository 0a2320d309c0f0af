//! One detailed mesh, and any number of cameras around it, each with its part of one picture.

use core::f32::consts::TAU;
use std::path::Path;

use bevy::{
    camera::{Viewport, primitives::MeshAabb},
    mesh::VertexAttributeValues,
    prelude::*,
};

use super::{
    Way,
    cones::{self, Meshlets},
};
use crate::{
    offline::{Offline, OfflineError, scenes::bunnies},
    spherical::{SphericalCounts, SphericalIndex},
};

/// Frames that an index may take to be made, at most.
const PATIENCE: u32 = 20_000;

/// How cameras look at the mesh.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Case {
    /// All of it is in view.
    Whole,
    /// A part around a pole: all azimuths (P3's case 1).
    Run,
    /// A part in the middle of the (θ, φ) map (P3's case 2).
    Clump,
    /// A part across φ = 0 (P3's case 3).
    Split,
    /// From within its box, in all directions.
    Inside,
}

impl Case {
    /// Those that are timed.
    pub const TIMED: [Self; 4] = [Self::Whole, Self::Run, Self::Clump, Self::Split];

    pub fn name(self) -> &'static str {
        match self {
            Self::Whole => "whole",
            Self::Run => "cut, run",
            Self::Clump => "cut, clump",
            Self::Split => "cut, split",
            Self::Inside => "inside",
        }
    }

    /// Where a camera is that looks at a mesh within radius 1 of the origin, and the vertical angle that it sees. `turn`, from
    /// 0 to 1, goes through the views of a case.
    fn view(self, turn: f32) -> (Transform, f32) {
        let (sin, cos) = (TAU * turn).sin_cos();
        // The eye sways by some degrees.
        let sway = 0.1 * Vec3::new(sin, 0.6 * (2.0 * TAU * turn).sin(), cos);
        let toward = |way: Vec3| {
            let way = (way + sway).normalize();
            (
                Transform::from_translation(1.5 * way)
                    .looking_at(Vec3::ZERO, way.any_orthonormal_vector()),
                10.0_f32.to_radians(),
            )
        };
        match self {
            Self::Whole => {
                let height = (1.0 - 2.0 * ((turn * 7.31).fract())) * 0.9;
                let across = (1.0 - height * height).sqrt();
                let from = 3.2 * Vec3::new(across * cos, height, across * sin);
                (
                    Transform::from_translation(from).looking_at(Vec3::ZERO, Vec3::Y),
                    0.75,
                )
            }
            // From below, whatever stands up from a model is not in between.
            Self::Run => toward(Vec3::NEG_Y),
            Self::Clump => toward(Vec3::NEG_X),
            Self::Split => toward(Vec3::X),
            Self::Inside => {
                let at = 0.5 * Vec3::new(sin, (3.0 * TAU * turn).sin(), cos);
                let way = Vec3::new(
                    (5.0 * TAU * turn).cos(),
                    0.4 * sin,
                    (5.0 * TAU * turn).sin(),
                );
                (
                    Transform::from_translation(at).looking_to(way, Vec3::Y),
                    1.2,
                )
            }
        }
    }
}

/// See the [module](self).
pub struct Stage {
    pub offline: Offline,
    pub name: String,
    pub triangles: usize,
    mesh: Handle<Mesh>,
    model: Entity,
    cameras: Vec<Entity>,
    target: Handle<Image>,
}

impl Stage {
    /// The first frames are drawn.
    ///
    /// # Errors
    /// No such model; no device.
    pub fn new(model: Option<&Path>, triangles: u32) -> Result<Self, super::AccuracyError> {
        let (name, mesh) = match model {
            Some(path) => (stem(path), bunnies::whole_from_file(path)?),
            None => ("bumpy_sphere".to_owned(), bunnies::bumpy_mesh(triangles)),
        };
        let triangles = mesh.indices().map_or(0, bevy::mesh::Indices::len) / 3;
        let mut offline = Offline::with(cones::register)?;
        let target = offline.target(UVec2::splat(64));
        let world = offline.app.world_mut();
        let mesh = world
            .resource_mut::<Assets<Mesh>>()
            .add(shaded_by_vertex(centred(mesh)));
        let paint = world
            .resource_mut::<Assets<StandardMaterial>>()
            .add(StandardMaterial {
                unlit: true,
                ..default()
            });
        let model = world
            .spawn((Mesh3d(mesh.clone()), MeshMaterial3d(paint)))
            .id();
        Ok(Self {
            offline,
            name,
            triangles,
            mesh,
            model,
            cameras: Vec::new(),
            target,
        })
    }

    /// So many windows of a size, side by side, at most four in a row.
    pub fn windows(&mut self, count: u32, size: UVec2) {
        for camera in self.cameras.drain(..) {
            self.offline.app.world_mut().despawn(camera);
        }
        let columns = if count == 4 { 2 } else { count.min(4) };
        let rows = count.div_ceil(columns);
        self.target = self.offline.target(size * UVec2::new(columns, rows));
        for i in 0..count {
            let place = UVec2::new(i % columns, i / columns) * size;
            let camera = Camera {
                viewport: Some(Viewport {
                    physical_position: place,
                    physical_size: size,
                    ..default()
                }),
                order: i as isize,
                clear_color: if i == 0 {
                    ClearColorConfig::Custom(Color::srgb(0.9, 0.93, 0.96))
                } else {
                    ClearColorConfig::None
                },
                ..default()
            };
            let target = self.target.clone();
            let camera = self.offline.camera(&target, (Msaa::Off, camera));
            self.cameras.push(camera);
        }
    }

    /// Puts every camera where it is in a view of a case.
    pub fn look(&mut self, case: Case, turn: f32) {
        let count = self.cameras.len();
        for (i, camera) in self.cameras.iter().enumerate() {
            let (place, fov) = case.view((turn + i as f32 / count as f32).fract());
            let projection = Projection::Perspective(PerspectiveProjection {
                fov,
                near: 0.01,
                ..default()
            });
            self.offline
                .app
                .world_mut()
                .entity_mut(*camera)
                .insert((place, projection));
        }
    }

    /// Leaves out in another way from now on, and steps until that is ready.
    ///
    /// # Errors
    /// It never is.
    pub fn set(&mut self, way: &Way) -> Result<(), OfflineError> {
        let world = self.offline.app.world_mut();
        Meshlets::remove(world);
        let mut model = world.entity_mut(self.model);
        match way {
            Way::None => {
                model.remove::<SphericalIndex>();
            }
            Way::Cones => {
                model.remove::<SphericalIndex>();
                Meshlets::spawn(world, self.model, &self.mesh);
            }
            Way::Index(settings) => {
                model.insert(*settings);
            }
        }
        // Nothing is drawn meanwhile, which takes long.
        self.activate(false);
        let is_ready = (0..PATIENCE).any(|_| {
            self.offline.step();
            let counts = self.offline.app.world().get::<SphericalCounts>(self.model);
            let is_ready = match way {
                Way::None | Way::Cones => true,
                Way::Index(_) => counts.is_some_and(|counts| counts.triangles > 0),
            };
            if !is_ready {
                std::thread::sleep(core::time::Duration::from_millis(1));
            }
            is_ready
        });
        self.activate(true);
        if !is_ready {
            return Err(OfflineError::NotFinished(PATIENCE));
        }
        // What is new is drawn from the second frame on, and its meshes come to the GPU before.
        for _ in 0..3 {
            self.offline.step();
        }
        Ok(())
    }

    fn activate(&mut self, is_active: bool) {
        let world = self.offline.app.world_mut();
        for camera in &self.cameras {
            if let Some(mut camera) = world.get_mut::<Camera>(*camera) {
                camera.is_active = is_active;
            }
        }
    }

    /// What the last frame drew, over all windows: triangles, and objects that they are drawn in.
    pub fn drawn(&self, way: &Way) -> (u64, u64) {
        let world = self.offline.app.world();
        let windows = self.cameras.len() as u64;
        match way {
            Way::None => (windows * self.triangles as u64, windows),
            Way::Cones => Meshlets::drawn(world),
            Way::Index(_) => world
                .get::<SphericalCounts>(self.model)
                .map_or((0, 0), |counts| {
                    let whole = counts.views - counts.views_by_chunks;
                    (
                        counts.drawn_triangles,
                        u64::from(counts.drawn_chunks + whole),
                    )
                }),
        }
    }

    pub fn picture(&self) -> Result<image::RgbaImage, OfflineError> {
        self.offline.picture(&self.target)
    }
}

fn stem(path: &Path) -> String {
    let stem = path.file_stem().unwrap_or(path.as_os_str());
    stem.to_string_lossy().into_owned()
}

/// With the light of a sun in the colours of its vertices: what P3's hardware did, and what leaves most of a frame to the
/// triangles that the index is about.
fn shaded_by_vertex(mut mesh: Mesh) -> Mesh {
    let sun = Vec3::new(0.4, 1.0, 0.7).normalize();
    let paint = Vec3::new(0.75, 0.66, 0.55);
    let Some(VertexAttributeValues::Float32x3(normals)) = mesh.attribute(Mesh::ATTRIBUTE_NORMAL)
    else {
        return mesh;
    };
    let colors: Vec<[f32; 4]> = (normals.iter())
        .map(|normal| {
            let light = Vec3::from_array(*normal).dot(sun);
            // Half of it goes around the terminator, so that no side is flat.
            let light = 0.08 + 0.6 * (0.5 + 0.5 * light).powi(2);
            (light * paint).extend(1.0).to_array()
        })
        .collect();
    mesh.insert_attribute(Mesh::ATTRIBUTE_COLOR, colors);
    mesh
}

/// Around the origin, its box's farthest corner at 1.
fn centred(mesh: Mesh) -> Mesh {
    let Some(bounds) = mesh.compute_aabb() else {
        return mesh;
    };
    let size = bounds.half_extents.length();
    if !(size > 0.0 && size.is_finite()) {
        return mesh;
    }
    mesh.translated_by(-Vec3::from(bounds.center))
        .scaled_by(Vec3::splat(size.recip()))
}
