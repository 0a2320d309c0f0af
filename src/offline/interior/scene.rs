//! Where nodes stand, and which may move.

use bevy::math::{DAffine3, DMat3, DQuat, DVec3};
use serde_json::Value;

use super::{
    error::ModelFileError,
    extensions::{INSTANCING, POINTER, VISIBILITY, is_self_contained},
    json::{extension, extension_names, index, list, named},
};

/// Where a node stands.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Place {
    /// Not in the scene.
    Elsewhere,
    /// There, as far as the file goes.
    Still(DAffine3),
    /// Nowhere for sure.
    Moves(Move),
}

/// Why a node is nowhere for sure.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Move {
    Animated,
    Joint,
    Skinned,
    Morphed,
    Instanced,
    Switched,
    Extended,
}

impl Move {
    /// In words.
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Animated => "animated",
            Self::Joint => "below a skin's joint",
            Self::Skinned => "skinned",
            Self::Morphed => "morphed",
            Self::Instanced => "instanced by EXT_mesh_gpu_instancing",
            Self::Switched => "switched by KHR_node_visibility",
            Self::Extended => "with an extension that is not known here",
        }
    }

    /// Whether what is below it moves with it.
    fn is_handed_down(self) -> bool {
        !matches!(self, Self::Skinned | Self::Morphed | Self::Instanced)
    }
}

/// The scene that is looked at: the default one, or else the first, as viewers do; or else all nodes.
#[derive(Debug)]
pub(super) struct Scene {
    /// Where every node stands.
    pub places: Vec<Place>,
    /// Of each node: whether another scene shows it, too, perhaps without what is around it here.
    pub is_shown_elsewhere: Vec<bool>,
}

impl Scene {
    pub(super) fn of(json: &Value) -> Result<Self, ModelFileError> {
        let nodes = list(json, "nodes");
        let scenes = list(json, "scenes");
        let roots = |scene: &Value| -> Vec<usize> {
            list(scene, "nodes").iter().filter_map(index).collect()
        };
        let default = match json.get("scene") {
            Some(scene) => Some(
                index(scene)
                    .filter(|scene| *scene < scenes.len())
                    .ok_or_else(|| ModelFileError::broken("its default scene is not there"))?,
            ),
            None => (!scenes.is_empty()).then_some(0),
        };
        let mut is_shown_elsewhere = vec![false; nodes.len()];
        for (_, scene) in scenes
            .iter()
            .enumerate()
            .filter(|(number, _)| Some(*number) != default)
        {
            let mut open = roots(scene);
            while let Some(node) = open.pop() {
                if !core::mem::replace(&mut is_shown_elsewhere[node], true) {
                    open.extend(list(&nodes[node], "children").iter().filter_map(index));
                }
            }
        }
        let roots = match default {
            Some(default) => roots(&scenes[default]),
            None => {
                let mut is_child = vec![false; nodes.len()];
                let children = nodes.iter().flat_map(|node| list(node, "children"));
                children
                    .filter_map(index)
                    .for_each(|child| is_child[child] = true);
                (0..nodes.len()).filter(|node| !is_child[*node]).collect()
            }
        };
        Ok(Self {
            places: places(json, roots)?,
            is_shown_elsewhere,
        })
    }
}

fn places(json: &Value, roots: Vec<usize>) -> Result<Vec<Place>, ModelFileError> {
    let nodes = list(json, "nodes");
    let own = own_moves(json);
    let mut places = vec![Place::Elsewhere; nodes.len()];
    let mut open: Vec<(usize, DAffine3, Option<Move>)> = roots
        .into_iter()
        .rev()
        .map(|root| (root, DAffine3::IDENTITY, None))
        .collect();
    while let Some((number, above, moved)) = open.pop() {
        let node = &nodes[number];
        let broken =
            |what: &str| ModelFileError::Broken(format!("node {} {what}", named(number, node)));
        if places[number] != Place::Elsewhere {
            return Err(broken("is below two nodes, or below itself"));
        }
        let own_transform =
            transform(node).ok_or_else(|| broken("has a transform that is none"))?;
        let world = above * own_transform;
        let own = own[number];
        places[number] = match moved.or(own) {
            Some(moved) => Place::Moves(moved),
            None => Place::Still(world),
        };
        let handed_down = moved.or(own.filter(|own| own.is_handed_down()));
        let children = list(node, "children").iter().filter_map(index);
        open.extend(children.map(|child| (child, world, handed_down)));
    }
    Ok(places)
}

/// Why each node may move of itself.
fn own_moves(json: &Value) -> Vec<Option<Move>> {
    let nodes = list(json, "nodes");
    let meshes = list(json, "meshes");
    let is_morphed = |mesh: &Value| {
        list(mesh, "primitives")
            .iter()
            .any(|primitive| !list(primitive, "targets").is_empty())
    };
    let mut moves: Vec<Option<Move>> = nodes
        .iter()
        .map(|node| {
            let mesh = node.get("mesh").and_then(index).map(|mesh| &meshes[mesh]);
            let is_hidden = extension(node, VISIBILITY)
                .is_some_and(|visibility| visibility.get("visible") == Some(&Value::Bool(false)));
            let is_unknown = |name: &str| name != INSTANCING && !is_self_contained(name);
            if extension_names(node).any(is_unknown) {
                Some(Move::Extended)
            } else if is_hidden {
                Some(Move::Switched)
            } else if node.get("skin").is_some() {
                Some(Move::Skinned)
            } else if mesh.is_some_and(is_morphed) {
                Some(Move::Morphed)
            } else {
                extension(node, INSTANCING).map(|_| Move::Instanced)
            }
        })
        .collect();
    let joints = list(json, "skins")
        .iter()
        .flat_map(|skin| list(skin, "joints"));
    for joint in joints.filter_map(index) {
        if !moves[joint].is_some_and(Move::is_handed_down) {
            moves[joint] = Some(Move::Joint);
        }
    }
    let channels = list(json, "animations")
        .iter()
        .flat_map(|animation| list(animation, "channels"));
    for target in channels.filter_map(|channel| channel.get("target")) {
        let node = target.get("node").and_then(index);
        let pointed = extension(target, POINTER)
            .and_then(|pointer| pointer.get("pointer")?.as_str()?.strip_prefix("/nodes/"))
            .and_then(|rest| rest.split('/').next()?.parse::<usize>().ok());
        for node in node.into_iter().chain(pointed) {
            if let Some(moved) = moves.get_mut(node) {
                *moved = Some(Move::Animated);
            }
        }
    }
    moves
}

/// A node's own transform; `None` if it is none.
fn transform(node: &Value) -> Option<DAffine3> {
    if let Some(matrix) = node.get("matrix") {
        let m: [f64; 16] = numbers(matrix)?;
        let column = |at: usize| DVec3::new(m[at], m[at + 1], m[at + 2]);
        let matrix = DMat3::from_cols(column(0), column(4), column(8));
        return Some(DAffine3::from_mat3_translation(matrix, column(12)));
    }
    let vector = |key: &str, default: DVec3| match node.get(key) {
        Some(value) => numbers(value).map(DVec3::from_array),
        None => Some(default),
    };
    let rotation = match node.get("rotation") {
        Some(rotation) => DQuat::from_array(numbers(rotation)?),
        None => DQuat::IDENTITY,
    };
    let length = rotation.length();
    if !(length.is_finite() && length > 1e-6) {
        return None;
    }
    Some(DAffine3::from_scale_rotation_translation(
        vector("scale", DVec3::ONE)?,
        rotation.normalize(),
        vector("translation", DVec3::ZERO)?,
    ))
}

fn numbers<const N: usize>(value: &Value) -> Option<[f64; N]> {
    let numbers: Option<Vec<f64>> = value.as_array()?.iter().map(Value::as_f64).collect();
    numbers?.try_into().ok()
}
