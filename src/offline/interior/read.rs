//! From a glTF's nodes and meshes to the [`Model`] that is culled.

use std::{
    collections::{BTreeMap, btree_map::Entry},
    sync::Arc,
};

use bevy::math::DVec3;
use serde_json::Value;

use super::{
    accessor::{Component, Numbers},
    error::{Budget, ModelFileError},
    extensions::{TRANSMISSION, VARIANTS},
    json::{count, extension, index, list, named},
    scene::{Move, Place, Scene},
};
use crate::interior::{Model, Part, Surface};

/// A model this small cannot be divided any more. units: of the model's frame
const SMALLEST: f64 = 1e-200;

/// A primitive of a mesh: its triangles, or `None` if it has points, lines or no positions.
type Triangles = Option<Arc<Surface>>;

/// What was read.
#[derive(Debug)]
pub(super) struct Reading {
    /// All that stands still and is in the scene.
    pub model: Model,
    /// Which mesh and which of its primitives each part is of.
    pub sites: Vec<(usize, usize)>,
    /// The primitives of each mesh that is in the model.
    pub meshes: BTreeMap<usize, Vec<Triangles>>,
    /// Nodes that have triangles and may move, by why.
    pub moving: BTreeMap<Move, usize>,
    /// Of the model. units: of the scene
    pub longest: f64,
    /// Where the model's origin is in the scene.
    pub middle: DVec3,
    /// Of each node: whether another scene shows it, too.
    pub is_shown_elsewhere: Vec<bool>,
}

/// How a primitive's vertices make triangles.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Topology {
    List,
    Strip,
    Fan,
}

impl Topology {
    /// `None`: points or lines.
    fn of(primitive: &Value) -> Result<Option<Self>, ModelFileError> {
        Ok(match count(primitive, "mode")? {
            None | Some(4) => Some(Self::List),
            Some(5) => Some(Self::Strip),
            Some(6) => Some(Self::Fan),
            Some(0..=3) => None,
            Some(mode) => {
                let what = format!("a mesh has a primitive of mode {mode}");
                return Err(ModelFileError::Broken(what));
            }
        })
    }

    /// The most triangles of so many vertices.
    fn most(self, vertices: usize) -> usize {
        match self {
            Self::List => vertices / 3,
            Self::Strip | Self::Fan => vertices.saturating_sub(2),
        }
    }

    /// In the order of glTF 2.0, §3.7.2.1; strips and fans without those that are only there to join others.
    fn triangles(self, indices: &[u32], positions: &[[f32; 3]]) -> Vec<[u32; 3]> {
        let joins = |triangle: &[u32; 3]| {
            let [a, b, c] = triangle.map(|index| positions[index as usize]);
            a == b || b == c || c == a
        };
        let starts = 0..indices.len().saturating_sub(2);
        let pick = |three: [usize; 3]| three.map(|at| indices[at]);
        match self {
            Self::List => indices.as_chunks().0.to_vec(),
            Self::Strip => starts
                .map(|i| pick([i, i + 1 + i % 2, i + 2 - i % 2]))
                .filter(|triangle| !joins(triangle))
                .collect(),
            Self::Fan => starts
                .map(|i| pick([i + 1, i + 2, 0]))
                .filter(|triangle| !joins(triangle))
                .collect(),
        }
    }
}

/// Reads all that stands still, around its middle: far from the origin numbers are coarse.
pub(super) fn read(
    json: &Value,
    numbers: &Numbers,
    budget: &mut Budget,
) -> Result<Reading, ModelFileError> {
    let scene = Scene::of(json)?;
    let looks = looks(json);
    let mut reader = Reader {
        json,
        numbers,
        surfaces: BTreeMap::new(),
        budget,
    };
    let mut reading = Reading {
        model: Model::default(),
        sites: Vec::new(),
        meshes: BTreeMap::new(),
        moving: BTreeMap::new(),
        longest: 0.0,
        middle: DVec3::ZERO,
        is_shown_elsewhere: scene.is_shown_elsewhere,
    };
    for (node, place) in scene.places.into_iter().enumerate() {
        let Some(mesh) = list(json, "nodes")[node].get("mesh").and_then(index) else {
            continue;
        };
        let world = match place {
            Place::Elsewhere => continue,
            Place::Moves(why) => {
                if reader.has_triangles(mesh)? {
                    *reading.moving.entry(why).or_default() += 1;
                }
                continue;
            }
            Place::Still(world) => world,
        };
        let primitives = match reading.meshes.entry(mesh) {
            Entry::Occupied(entry) => entry.into_mut(),
            Entry::Vacant(entry) => entry.insert(reader.mesh(mesh)?),
        };
        for (number, triangles) in primitives.iter().enumerate() {
            let Some(surface) = triangles else { continue };
            let primitive = &list(&list(json, "meshes")[mesh], "primitives")[number];
            let look = Look::of(primitive, &looks)?;
            reader.budget.take(1, size_of::<Part>())?;
            reading.sites.push((mesh, number));
            reading.model.parts.push(Part {
                node: u32::try_from(node).map_err(|_| ModelFileError::broken("too many nodes"))?,
                surface: surface.clone(),
                model_from_local: world,
                is_transparent: look.is_transparent,
                is_two_sided: look.is_two_sided,
            });
        }
    }
    reading.centre(json)?;
    Ok(reading)
}

impl Reading {
    /// Moves the model's middle to the origin.
    fn centre(&mut self, json: &Value) -> Result<(), ModelFileError> {
        let most = DVec3::splat(f64::from(f32::MAX));
        let mut bounds: Option<(DVec3, DVec3)> = None;
        for part in &self.model.parts {
            for corner in part.corners().flatten() {
                let corner = part.place(corner);
                if !corner.abs().cmple(most).all() {
                    let node = part.node as usize;
                    return Err(ModelFileError::NotFinite {
                        node: named(node, &list(json, "nodes")[node]),
                    });
                }
                let (least, greatest) = bounds.get_or_insert((corner, corner));
                *least = least.min(corner);
                *greatest = greatest.max(corner);
            }
        }
        let Some((least, greatest)) = bounds else {
            return Ok(());
        };
        let longest = (greatest - least).max_element();
        if longest > 0.0 && longest < SMALLEST {
            return Err(ModelFileError::Small(longest));
        }
        self.longest = longest;
        self.middle = (least + greatest) / 2.0;
        for part in &mut self.model.parts {
            part.model_from_local.translation -= self.middle;
        }
        Ok(())
    }
}

struct Reader<'a> {
    json: &'a Value,
    numbers: &'a Numbers<'a>,
    /// By accessor of positions, accessor of indices, topology: many meshes differ in their materials only.
    surfaces: BTreeMap<(usize, Option<usize>, Topology), Arc<Surface>>,
    budget: &'a mut Budget,
}

impl Reader<'_> {
    fn has_triangles(&self, mesh: usize) -> Result<bool, ModelFileError> {
        for primitive in list(&list(self.json, "meshes")[mesh], "primitives") {
            if Topology::of(primitive)?.is_some() {
                return Ok(true);
            }
        }
        Ok(false)
    }

    fn mesh(&mut self, mesh: usize) -> Result<Vec<Triangles>, ModelFileError> {
        let value = &list(self.json, "meshes")[mesh];
        list(value, "primitives")
            .iter()
            .map(|primitive| {
                self.triangles(primitive).map_err(|error| match error {
                    ModelFileError::Broken(what) => {
                        ModelFileError::Broken(format!("mesh {}: {what}", named(mesh, value)))
                    }
                    error => error,
                })
            })
            .collect()
    }

    fn triangles(&mut self, primitive: &Value) -> Result<Triangles, ModelFileError> {
        let attributes = &primitive["attributes"];
        let (Some(topology), Some(positions)) = (
            Topology::of(primitive)?,
            attributes.get("POSITION").and_then(index),
        ) else {
            return Ok(None);
        };
        let indices = primitive.get("indices").and_then(index);
        let key = (positions, indices, topology);
        let vertices = self.numbers.accessors[positions].count;
        let each = attributes
            .as_object()
            .into_iter()
            .flat_map(|all| all.values());
        for attribute in each.filter_map(index) {
            if self.numbers.accessors[attribute].count != vertices {
                let what = "its attributes are not all of as many vertices";
                return Err(ModelFileError::broken(what));
            }
        }
        if let Some(surface) = self.surfaces.get(&key) {
            return Ok(Some(surface.clone()));
        }
        let positions = self.positions(positions)?;
        let indices = self.indices(indices, vertices)?;
        self.budget
            .take(topology.most(indices.len()), size_of::<[u32; 3]>())?;
        let triangles = topology.triangles(&indices, &positions);
        let surface = Arc::new(Surface {
            positions,
            triangles,
        });
        self.surfaces.insert(key, surface.clone());
        Ok(Some(surface))
    }

    fn positions(&mut self, accessor: usize) -> Result<Vec<[f32; 3]>, ModelFileError> {
        let elements = self.numbers.elements(accessor);
        let accessor = &elements.accessor;
        if accessor.width != 3 || accessor.component == Component::U32 {
            return Err(ModelFileError::broken("its positions are no vectors of 3"));
        }
        self.budget.take(accessor.count, size_of::<[f32; 3]>())?;
        Ok((0..accessor.count)
            .map(|at| elements.numbers(at).map(|number: f64| number as f32))
            .collect())
    }

    fn indices(
        &mut self,
        accessor: Option<usize>,
        vertices: usize,
    ) -> Result<Vec<u32>, ModelFileError> {
        let too_many = |_| ModelFileError::broken("it has more vertices than indices can tell");
        let vertices = u32::try_from(vertices).map_err(too_many)?;
        let Some(accessor) = accessor else {
            self.budget.take(vertices as usize, size_of::<u32>())?;
            return Ok((0..vertices).collect());
        };
        let elements = self.numbers.elements(accessor);
        let accessor = &elements.accessor;
        let is_index = matches!(
            accessor.component,
            Component::U8 | Component::U16 | Component::U32
        );
        if accessor.width != 1 || !is_index {
            return Err(ModelFileError::broken("its indices are no whole numbers"));
        }
        self.budget.take(accessor.count, size_of::<u32>())?;
        let indices: Vec<u32> = (0..accessor.count)
            .map(|at| accessor.component.read(elements.get(at)) as u32)
            .collect();
        match indices.iter().find(|index| **index >= vertices) {
            Some(index) => Err(ModelFileError::Broken(format!(
                "it has an index {index} into {vertices} vertices"
            ))),
            None => Ok(indices),
        }
    }
}

/// What of a material matters.
#[derive(Clone, Copy, Debug)]
struct Look {
    is_transparent: bool,
    is_two_sided: bool,
}

/// Of each material.
fn looks(json: &Value) -> Vec<Look> {
    list(json, "materials")
        .iter()
        .map(|material| {
            let alpha = material.get("alphaMode").and_then(Value::as_str);
            let transmits = extension(material, TRANSMISSION).is_some_and(|transmission| {
                let factor = transmission.get("transmissionFactor");
                factor.is_some_and(|factor| factor.as_f64() != Some(0.0))
            });
            Look {
                is_transparent: matches!(alpha, Some("BLEND" | "MASK")) || transmits,
                is_two_sided: material.get("doubleSided") == Some(&Value::Bool(true)),
            }
        })
        .collect()
}

impl Look {
    /// Of a primitive, whichever of its variants is shown: it hides no more than each of them.
    fn of(primitive: &Value, looks: &[Self]) -> Result<Self, ModelFileError> {
        let default = Self {
            is_transparent: false,
            is_two_sided: false,
        };
        let look = |material: usize| {
            looks.get(material).copied().ok_or_else(|| {
                ModelFileError::Broken(format!(
                    "a mesh is of a material {material} that is not there"
                ))
            })
        };
        let mut all = match count(primitive, "material")? {
            Some(material) => look(material)?,
            None => default,
        };
        let variants = extension(primitive, VARIANTS);
        for mapping in variants.map_or(&[][..], |variants| list(variants, "mappings")) {
            if let Some(material) = count(mapping, "material")? {
                let variant = look(material)?;
                all.is_transparent |= variant.is_transparent;
                all.is_two_sided &= variant.is_two_sided;
            }
        }
        Ok(all)
    }
}

/// The material of a primitive of a mesh.
pub(super) fn material(json: &Value, (mesh, primitive): (usize, usize)) -> Option<usize> {
    let primitive = list(list(json, "meshes").get(mesh)?, "primitives").get(primitive)?;
    primitive.get("material").and_then(index)
}

/// What a material is painted with, without its textures: linear red, green and blue. range: 0..=1
pub(super) fn colour(json: &Value, material: Option<usize>) -> [f32; 3] {
    let material = material.and_then(|material| list(json, "materials").get(material));
    let looks = material.and_then(|material| material.get("pbrMetallicRoughness"));
    let factor = looks.map_or(&[][..], |looks| list(looks, "baseColorFactor"));
    core::array::from_fn(|i| {
        let part = factor.get(i).and_then(Value::as_f64).unwrap_or(1.0);
        part.clamp(0.0, 1.0) as f32
    })
}
