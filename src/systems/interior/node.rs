//! What an entity is to interior culling: a surface, something to be left alone, or nothing.
//!
//! Wherever it cannot be known what is drawn, the answer is the one that takes nothing visible away: the entity is left
//! alone and counts as no wall.

use bevy::{
    camera::visibility::{RenderLayers, VisibilityRange},
    ecs::query::QueryData,
    mesh::{morph::MeshMorphWeights, skinning::SkinnedMesh},
    prelude::*,
    render::render_resource::Face,
};

use crate::{
    culling::part::{ChunkOf, PartOf},
    interior::{InteriorCulling, InteriorFaces, NoInteriorCulling},
    systems::gather::{Unreadable, readable},
};

/// What is looked at of each entity of a model.
#[derive(QueryData)]
pub struct NodeQuery {
    pub entity: Entity,
    pub place: Option<&'static Transform>,
    pub visibility: Option<&'static Visibility>,
    pub children: Option<Ref<'static, Children>>,
    pub above: Option<&'static ChildOf>,
    pub mesh: Option<&'static Mesh3d>,
    pub material: Option<&'static MeshMaterial3d<StandardMaterial>>,
    pub layers: Option<&'static RenderLayers>,
    pub has_range: Has<VisibilityRange>,
    pub is_skinned: Has<SkinnedMesh>,
    pub is_morphing: Has<MeshMorphWeights>,
    pub is_out: Has<NoInteriorCulling>,
    pub is_root: Has<InteriorCulling>,
    pub part: Option<&'static PartOf>,
    /// Drawn in place of what is above it, which counts.
    pub is_chunk: Has<ChunkOf>,
}

/// What an entity is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Kind {
    /// It has no mesh.
    Empty,
    /// Its mesh is left alone; with all that is below it, if it says so itself.
    Left(Left),
    /// Its mesh or material has not loaded.
    Pending(AssetId<Mesh>, Option<AssetId<StandardMaterial>>),
    Surface {
        mesh: AssetId<Mesh>,
        material: AssetId<StandardMaterial>,
        is_transparent: bool,
        is_two_sided: bool,
    },
}

/// Why an entity with a mesh is left alone.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Left {
    /// [`NoInteriorCulling`], or a model of its own.
    OptedOut,
    /// Skins and morph targets move vertices.
    Deforms,
    /// What another material draws is not known: it may move vertices or be seen through.
    OtherMaterial,
    /// Not every camera that sees the rest sees it.
    OtherLayers,
    /// It is not drawn from everywhere.
    Ranged,
    /// Its triangles cannot be read.
    RenderWorldOnly,
    /// Lines, points, no positions, attributes of different lengths.
    NotTriangles,
    /// It is drawn in front of what it lies behind, or the other way round.
    Biased,
    /// Only the side that its triangles' winding calls the back is drawn.
    InsideOut,
}

impl Left {
    pub const COUNT: usize = 9;

    /// What there are so many nodes of.
    pub const WORDS: [&str; Self::COUNT] = [
        "opted out",
        "skinned or morphing",
        "with another material than StandardMaterial",
        "in other render layers than the model's root",
        "with a VisibilityRange",
        "with meshes in the render world only: load them with RenderAssetUsages::MAIN_WORLD too",
        "with meshes that are not of triangles",
        "with a depth bias",
        "drawn inside out: mirrored without cull_mode Front, or the other way round",
    ];
}

/// What matters of a material.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Look {
    is_transparent: bool,
    cull: Option<Face>,
    is_biased: bool,
}

impl Look {
    pub fn of(material: &StandardMaterial) -> Self {
        Self {
            is_transparent: material.alpha_mode != AlphaMode::Opaque
                || material.specular_transmission > 0.0
                || material.diffuse_transmission > 0.0,
            // `double_sided` is about normals; what is drawn is this.
            cull: material.cull_mode,
            is_biased: material.depth_bias != 0.0,
        }
    }
}

/// What entities are judged by.
pub(super) struct Judge<'a> {
    pub settings: &'a InteriorCulling,
    pub layers: &'a RenderLayers,
    pub meshes: &'a Assets<Mesh>,
    pub materials: &'a Assets<StandardMaterial>,
}

impl Judge<'_> {
    /// `mesh`: what the entity's own stands for. `is_mirrored`: the way from its space to the world is.
    pub fn kind(
        &self,
        node: &NodeQueryItem,
        mesh: Option<AssetId<Mesh>>,
        is_mirrored: bool,
    ) -> Kind {
        let Some(mesh) = mesh else {
            return Kind::Empty;
        };
        if node.is_skinned || node.is_morphing {
            return Kind::Left(Left::Deforms);
        }
        if node.layers.cloned().unwrap_or_default() != *self.layers {
            return Kind::Left(Left::OtherLayers);
        }
        if node.has_range {
            return Kind::Left(Left::Ranged);
        }
        let Some(material) = node.material.map(|material| material.id()) else {
            return Kind::Left(Left::OtherMaterial);
        };
        let looks = self.materials.get(material).map(Look::of);
        let (Some(source), Some(look)) = (self.meshes.get(mesh), looks) else {
            return Kind::Pending(mesh, looks.is_none().then_some(material));
        };
        if let Err(why) = readable(source) {
            return Kind::Left(why.into());
        }
        if look.is_biased {
            return Kind::Left(Left::Biased);
        }
        // In the model a mirrored part's front is on the other side of its triangles, as glTF has it. Bevy draws the
        // same side as ever, unless the material culls the front.
        let is_inside_out = is_mirrored != (look.cull == Some(Face::Front));
        if is_inside_out && look.cull.is_some() && self.settings.faces == InteriorFaces::AsDrawn {
            return Kind::Left(Left::InsideOut);
        }
        Kind::Surface {
            mesh,
            material,
            is_transparent: look.is_transparent,
            is_two_sided: look.cull.is_none(),
        }
    }
}

impl From<Unreadable> for Left {
    fn from(why: Unreadable) -> Self {
        match why {
            Unreadable::RenderWorldOnly => Self::RenderWorldOnly,
            Unreadable::Morphs => Self::Deforms,
            Unreadable::NotTriangles => Self::NotTriangles,
        }
    }
}
