//! Looks through a model's hierarchy, some entities a frame.

use bevy::{
    math::{DAffine3, DMat3, DQuat},
    platform::collections::HashSet,
    prelude::*,
};

use super::{
    models::{Job, Load, Node, Part, PartOf, Shown, Step},
    node::{Judge, Kind, Left, Look, NodeQuery, NodeQueryItem},
};

use crate::systems::slice::Slice;

/// So many entities are looked at before the clock is.
const BATCH: usize = 64;

/// How far a walk has come. What it finds is in the model at once, so that changes of it are noticed.
#[derive(Default)]
pub(super) struct Walk {
    has_begun: bool,
    open: Vec<Open>,
    /// By part, how it comes to be shown.
    chains: Vec<Chain>,
    loading_meshes: HashSet<AssetId<Mesh>>,
    loading_materials: HashSet<AssetId<StandardMaterial>>,
}

/// To be looked at.
struct Open {
    entity: Entity,
    above: Option<u32>,
    root_from_above: DAffine3,
    chain: Chain,
}

/// What an entity's being shown depends on, by `Visibility` from the root down.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Chain {
    /// On whether the root is.
    Root,
    Shown,
    Hidden,
}

impl Chain {
    fn below(self, visibility: Option<&Visibility>) -> Self {
        match visibility {
            Some(Visibility::Inherited) => self,
            Some(Visibility::Hidden) => Self::Hidden,
            // What lacks the component hides nothing below it.
            Some(Visibility::Visible) | None => Self::Shown,
        }
    }
}

/// What a walk needs of the world.
pub(super) struct Ground<'a, 'w, 's> {
    pub nodes: &'a Query<'w, 's, NodeQuery>,
    pub meshes: &'a Assets<Mesh>,
    pub materials: &'a Assets<StandardMaterial>,
    /// Whether the root is shown.
    pub is_root_shown: bool,
}

impl Walk {
    /// Goes on until the slice is over. Whether it has come to the end.
    pub fn run(
        &mut self,
        job: &mut Job,
        ground: &Ground,
        commands: &mut Commands,
        slice: &Slice,
    ) -> bool {
        if !self.has_begun {
            self.has_begun = true;
            job.forget_nodes();
            self.open.push(Open {
                entity: job.root,
                above: None,
                root_from_above: DAffine3::IDENTITY,
                chain: Chain::Root,
            });
        }
        let mut count = 0;
        while let Some(open) = self.open.pop() {
            if let Ok(item) = ground.nodes.get(open.entity)
                && !item.is_chunk
            {
                if item.part.is_none_or(|part| part.root != job.root)
                    && !(item.is_root && open.above.is_some())
                {
                    commands.entity(open.entity).try_insert(PartOf {
                        root: job.root,
                        is_hidden: false,
                    });
                }
                self.look_at(job, ground, &item, open);
            }
            count += 1;
            if count % BATCH == 0 && slice.is_over() {
                break;
            }
        }
        self.open.is_empty()
    }

    fn look_at(&mut self, job: &mut Job, ground: &Ground, item: &NodeQueryItem, open: Open) {
        let is_top = open.above.is_none();
        let place = item.place.copied().unwrap_or_default();
        let (root_from_local, chain) = if is_top {
            (DAffine3::IDENTITY, Chain::Root)
        } else {
            (
                open.root_from_above * affine64(&place),
                open.chain.below(item.visibility),
            )
        };
        let is_mirrored = job.is_mirrored != (root_from_local.matrix3.determinant() < 0.0);
        let number = job.nodes.len() as u32;
        let is_closed = !is_top && item.is_root || item.is_out;
        let kind = if is_closed {
            Kind::Left(Left::OptedOut)
        } else {
            let judge = Judge {
                settings: &job.settings,
                layers: &job.layers,
                meshes: ground.meshes,
                materials: ground.materials,
            };
            judge.kind(item, item.mesh.map(|mesh| mesh.id()), is_mirrored)
        };
        let mut part = None;
        match kind {
            Kind::Empty => {}
            Kind::Left(why) => job.left.add(why),
            Kind::Pending(mesh, material) => {
                if !ground.meshes.contains(mesh) {
                    self.loading_meshes.insert(mesh);
                }
                self.loading_materials.extend(material);
                job.number_of(mesh);
            }
            Kind::Surface {
                mesh,
                material,
                is_transparent,
                is_two_sided,
            } => {
                if let Some(look) = ground.materials.get(material).map(Look::of) {
                    job.materials.insert(material, look);
                }
                if chain != Chain::Hidden
                    && let Some(original) = item.mesh
                {
                    part = Some(job.parts.len() as u32);
                    self.chains.push(chain);
                    let mesh = job.number_of(mesh);
                    job.parts.push(Part {
                        node: number,
                        mesh,
                        original: original.0.clone(),
                        root_from_local,
                        is_transparent,
                        is_two_sided,
                        shown: Shown::AsItWas,
                    });
                }
            }
        }
        let carries = matches!(kind, Kind::Surface { .. } | Kind::Pending(..));
        job.index.insert(item.entity, number);
        job.nodes.push(Node {
            entity: item.entity,
            above: open.above,
            place,
            visibility: item.visibility.copied().unwrap_or(Visibility::Visible),
            kind,
            is_mirrored,
            carries,
            part,
        });
        if carries {
            carry(&mut job.nodes, open.above);
        }
        if !is_closed {
            // The last is taken first.
            for child in item.children.iter().flat_map(|all| all.iter().rev()) {
                self.open.push(Open {
                    entity: child,
                    above: Some(number),
                    root_from_above: root_from_local,
                    chain,
                });
            }
        }
    }

    /// Says what is next.
    pub fn finish(self, job: &mut Job, ground: &Ground, commands: &mut Commands) -> Step {
        for entity in core::mem::take(&mut job.stale) {
            // It may be another model's by now.
            let part = ground.nodes.get(entity).ok().and_then(|item| item.part);
            if !job.index.contains_key(&entity) && part.is_some_and(|part| part.root == job.root) {
                commands.entity(entity).try_remove::<PartOf>();
            }
        }
        // What is shown while the root is not must not count on walls that are shown with it.
        let is_mixed = self.chains.contains(&Chain::Shown) && self.chains.contains(&Chain::Root);
        job.depends_on_root = is_mixed.then_some(ground.is_root_shown);
        if is_mixed && !ground.is_root_shown {
            let mut chains = self.chains.iter();
            job.parts.retain(|_| chains.next() == Some(&Chain::Shown));
            for node in &mut job.nodes {
                node.part = None;
            }
            for (number, part) in (0..).zip(&job.parts) {
                if let Some(node) = job.nodes.get_mut(part.node as usize) {
                    node.part = Some(number);
                }
            }
        }
        job.trimmed = vec![None; job.meshes.len()];
        if !self.loading_meshes.is_empty() || !self.loading_materials.is_empty() {
            let of = [
                job.meshes.len(),
                job.materials.len() + self.loading_materials.len(),
            ];
            // What came during the walk has been announced already. If all has, another walk begins at once.
            let (mut meshes, mut materials) = (self.loading_meshes, self.loading_materials);
            meshes.retain(|mesh| !ground.meshes.contains(*mesh));
            materials.retain(|material| !ground.materials.contains(*material));
            return Step::Load(Load {
                meshes,
                materials,
                of,
            });
        }
        if job.parts.is_empty() {
            Step::Nothing
        } else {
            Step::Turn
        }
    }
}

/// All above a surface matters too.
fn carry(nodes: &mut [Node], mut above: Option<u32>) {
    while let Some(node) = above.and_then(|above| nodes.get_mut(above as usize)) {
        if node.carries {
            break;
        }
        node.carries = true;
        above = node.above;
    }
}

/// A local transform, to be composed with others in `f64`.
fn affine64(place: &Transform) -> DAffine3 {
    let rotation = DQuat::from_xyzw(
        f64::from(place.rotation.x),
        f64::from(place.rotation.y),
        f64::from(place.rotation.z),
        f64::from(place.rotation.w),
    );
    let matrix3 =
        DMat3::from_quat(rotation.normalize()) * DMat3::from_diagonal(place.scale.as_dvec3());
    DAffine3 {
        matrix3,
        translation: place.translation.as_dvec3(),
    }
}
