//! Scenes that culling is measured and shown on: plain data first, entities when spawned. A scene is the same on
//! every machine, and everything that moves in it is a function of the frame's number alone.
//!
//! | Scene | What hides | After |
//! |---|---|---|
//! | [`city`] | thousands of buildings of very different sizes hide each other along streets | – |
//! | [`city::furnished`] | the same with thousands of small things of many triangles | P4 |
//! | [`bunnies`] | a grid of detailed models, the front rows before the others | P2, Fig. 16, Table 1 |
//! | [`seabed`] | ground in 256 blocks, hidden behind its own ridges | P2, Fig. 17 |

pub mod bunnies;
pub mod city;
mod city_file;
pub mod compare;
pub mod furniture;
pub mod ids;
pub mod obj;
pub mod paths;
pub mod seabed;
mod shapes;
pub mod stage;
mod streets;

use std::path::{Path, PathBuf};

use bevy::{mesh::MeshTag, prelude::*};

use ids::{ObjectIdMaterial, tag_of};
pub use paths::CameraPath;

/// Why a scene could not be made.
#[derive(thiserror::Error, Debug)]
#[non_exhaustive]
pub enum SceneError {
    /// The file is not there, or not to be read.
    #[error("cannot read {}: {reason}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// What the system says.
        reason: String,
    },
    /// The file is no glTF, or a broken one.
    #[error("{}: {reason}", path.display())]
    Gltf {
        /// The file.
        path: PathBuf,
        /// What is wrong with it, and what would help.
        reason: String,
    },
    /// The file has nothing that could be shown.
    #[error("{} has no node with triangles: a city needs one node and mesh a building", path.display())]
    NoBuildings {
        /// The file.
        path: PathBuf,
    },
    /// The buildings are too far apart, or from the origin.
    #[error(
        "{}: its buildings are {across_m:.0} m across and up to {farthest_m:.0} m from the origin, where 20000 and \
         1000000 are the most: scale the city to metres, and move it nearer",
        path.display()
    )]
    TooLarge {
        /// The file.
        path: PathBuf,
        /// The longest side of the box around them. units: m
        across_m: f32,
        /// Their greatest coordinate. units: m
        farthest_m: f32,
    },
    /// A line of an OBJ file is wrong.
    #[error("{}, line {line}: {what}", path.display())]
    Obj {
        /// The file.
        path: PathBuf,
        /// The line, from 1.
        line: usize,
        /// What is wrong with it.
        what: &'static str,
    },
    /// An OBJ file without a triangle.
    #[error("{} has no faces: give a triangle mesh with v and f lines", path.display())]
    NoFaces {
        /// The file.
        path: PathBuf,
    },
}

impl SceneError {
    fn read(path: &Path, reason: &dyn core::fmt::Display) -> Self {
        Self::Read {
            path: path.to_owned(),
            reason: reason.to_string(),
        }
    }
}

/// A scene as plain data.
#[derive(Clone, Debug)]
pub struct Scene {
    /// For file names and tables, `snake_case`. Says so where generated data stand in for real ones.
    pub name: String,
    /// Meshes in their own space, shared between objects.
    pub meshes: Vec<Mesh>,
    /// Colours of the classes of material.
    pub paints: Vec<Color>,
    /// What stands in it.
    pub objects: Vec<Object>,
    /// Where pictures are taken from.
    pub views: Vec<View>,
    /// Both ends of the way a walker's eye takes. units: m
    pub walk: [Vec3; 2],
    /// Lowest and highest corner of everything that stands still. units: m
    pub bounds: [Vec3; 2],
    /// Length of a step, which all paths are scaled by. units: m/frame
    pub stride_m: f32,
}

/// One object.
#[derive(Clone, Debug, PartialEq)]
pub struct Object {
    /// Index of its mesh.
    pub mesh: usize,
    /// Index of its paint.
    pub paint: usize,
    /// Where it stands in frame 0.
    pub transform: Transform,
    /// How it moves, if it does.
    pub shuttle: Option<Shuttle>,
}

impl Object {
    fn still(mesh: usize, paint: usize, transform: Transform) -> Self {
        Self {
            mesh,
            paint,
            transform,
            shuttle: None,
        }
    }

    /// Where it stands in a frame.
    pub fn place(&self, frame: u32) -> Transform {
        let mut place = self.transform;
        if let Some(shuttle) = self.shuttle {
            let part = paths::there_and_back(frame, shuttle.period);
            place.translation = place.translation.lerp(shuttle.to, part);
        }
        place
    }
}

/// To a place and back, for ever.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Shuttle {
    /// The far end. units: m
    pub to: Vec3,
    /// Frames until it is back, not 0.
    pub period: u32,
}

/// Where a picture is taken from.
#[derive(Clone, Debug, PartialEq)]
pub struct View {
    /// For file names and tables.
    pub name: &'static str,
    /// The camera.
    pub transform: Transform,
}

impl View {
    fn at(name: &'static str, eye: Vec3, target: Vec3) -> Self {
        let ahead = target - eye;
        let up = if ahead.xz().length() > 1e-3 * ahead.length() {
            Vec3::Y
        } else {
            Vec3::NEG_Z
        };
        Self {
            name,
            transform: Transform::from_translation(eye).looking_at(target, up),
        }
    }
}

/// How objects look.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Look {
    /// Lit, in the colour of their paint.
    Shaded,
    /// Each in a colour of its own that [`ids::seen`] reads its index from.
    Ids,
}

/// On an object's entity: its index in [`Scene::objects`].
#[derive(Component, Clone, Copy, Debug, PartialEq, Eq)]
pub struct SceneObject(pub usize);

impl Scene {
    /// Triangles of all objects.
    pub fn triangles(&self) -> usize {
        let of_mesh = self.triangles_of_meshes();
        self.objects
            .iter()
            .map(|object| of_mesh.get(object.mesh).copied().unwrap_or(0))
            .sum()
    }

    /// Triangles of each of its meshes.
    pub fn triangles_of_meshes(&self) -> Vec<usize> {
        self.meshes.iter().map(shapes::triangles).collect()
    }

    /// The view of that name, else the first.
    pub fn view(&self, name: &str) -> Transform {
        let named = self.views.iter().find(|view| view.name == name);
        named
            .or(self.views.first())
            .map_or(Transform::IDENTITY, |view| view.transform)
    }

    /// A lens that reaches past the far end of the scene from anywhere in it.
    pub fn projection(&self) -> PerspectiveProjection {
        PerspectiveProjection {
            fov: 60f32.to_radians(),
            near: 2.0 * self.stride_m.min(0.05),
            far: 4.0 * self.bounds[0].distance(self.bounds[1]),
            ..default()
        }
    }

    /// Makes an entity of every object, in their order, and in a lit scene the sun.
    pub fn spawn(&self, world: &mut World, look: Look) -> Vec<Entity> {
        let mut assets = world.resource_mut::<Assets<Mesh>>();
        let meshes: Vec<_> = self.meshes.iter().map(|m| assets.add(m.clone())).collect();
        let bundle = |object: &Object, index: usize| {
            (
                Mesh3d(meshes[object.mesh].clone()),
                object.transform,
                SceneObject(index),
            )
        };
        match look {
            Look::Shaded => {
                let mut assets = world.resource_mut::<Assets<StandardMaterial>>();
                let paints: Vec<_> = self
                    .paints
                    .iter()
                    .map(|&base_color| {
                        assets.add(StandardMaterial {
                            base_color,
                            perceptual_roughness: 0.9,
                            ..default()
                        })
                    })
                    .collect();
                world.spawn((
                    DirectionalLight {
                        illuminance: 7_000.0,
                        ..default()
                    },
                    Transform::default().looking_to(Vec3::new(-0.55, -0.7, -0.45), Vec3::Y),
                ));
                self.objects
                    .iter()
                    .enumerate()
                    .map(|(index, object)| {
                        let paint = MeshMaterial3d(paints[object.paint].clone());
                        world.spawn((bundle(object, index), paint)).id()
                    })
                    .collect()
            }
            Look::Ids => {
                let mut assets = world.resource_mut::<Assets<ObjectIdMaterial>>();
                let material = MeshMaterial3d(assets.add(ObjectIdMaterial {}));
                self.objects
                    .iter()
                    .enumerate()
                    .map(|(index, object)| {
                        let tag = MeshTag(tag_of(index));
                        world
                            .spawn((bundle(object, index), material.clone(), tag))
                            .id()
                    })
                    .collect()
            }
        }
    }

    /// Puts what moves where it stands in a frame. `entities` are those of [`spawn`](Self::spawn).
    pub fn place(&self, world: &mut World, entities: &[Entity], frame: u32) {
        for (object, &entity) in self.objects.iter().zip(entities) {
            if object.shuttle.is_some()
                && let Some(mut transform) = world.get_mut::<Transform>(entity)
            {
                *transform = object.place(frame);
            }
        }
    }
}
