//! Keeps the table of [`Candidates`] as the scene is.

use bevy::{
    camera::{
        primitives::Aabb,
        visibility::{DynamicSkinnedMeshBounds, NoAutoAabb, NoFrustumCulling},
    },
    ecs::{lifecycle::RemovedComponents, query::QueryData},
    mesh::{PrimitiveTopology, morph::MeshMorphWeights, skinning::SkinnedMesh},
    platform::time::Instant,
    prelude::*,
};

use crate::{
    contribution::{ContributionCulling, NoContributionCulling},
    culling::{
        self, CullSteps,
        candidates::{Candidate, Candidates, CullableBy},
        volume::LocalBox,
    },
    occlusion::{
        NoOcclusionCulling, OccludeeVolume, ZBufferOcclusion,
        meshes::{OccludeeMeshes, build_mesh_volumes},
    },
    render_graph::shaders,
};

/// What asks for the table of candidates.
type Asking = Or<(With<ZBufferOcclusion>, With<ContributionCulling>)>;

/// Whether a camera asks for it, or it is still there.
fn are_wanted(asking: Query<(), Asking>, table: Res<Candidates>) -> bool {
    !asking.is_empty() || table.is_kept
}

/// Registers what the two cullings share, once.
pub(crate) fn register(app: &mut App) {
    if app.world().contains_resource::<Candidates>() {
        return;
    }
    culling::register(app);
    shaders::culling::embed(app);
    app.init_resource::<Candidates>()
        .init_resource::<OccludeeMeshes>()
        .add_systems(
            PostUpdate,
            (build_mesh_volumes, update_candidates)
                .chain()
                .run_if(are_wanted)
                .in_set(CullSteps::Candidates),
        );
}

/// What [`update_candidates`] looks at.
#[derive(QueryData)]
pub struct CandidateQuery {
    entity: Entity,
    mesh: &'static Mesh3d,
    aabb: &'static Aabb,
    place: &'static GlobalTransform,
    own_aabb: Has<NoAutoAabb>,
    skinned: Has<SkinnedMesh>,
    skin_bounds: Has<DynamicSkinnedMeshBounds>,
    morphing: Has<MeshMorphWeights>,
    unbounded: Has<NoFrustumCulling>,
    never_occluded: Has<NoOcclusionCulling>,
    never_too_small: Has<NoContributionCulling>,
}

/// What the active cameras ask for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Asked {
    /// The finest volume of all.
    volume: OccludeeVolume,
    by: CullableBy,
}

impl CandidateQueryItem<'_, '_> {
    /// Whether something encloses the entity wherever its vertices go: the `Aabb` of a skinned mesh does not
    /// unless it follows the skin, that of a morphing one does not unless the user gave it, and what must not be
    /// culled by the frustum has none that can be trusted.
    fn is_bounded(&self) -> bool {
        !self.unbounded
            && (!self.skinned || self.skin_bounds || self.own_aabb)
            && (!self.morphing || self.own_aabb)
    }

    /// What may remove the entity, of what is asked for.
    fn cullable(&self, asked: CullableBy) -> CullableBy {
        let bounded = self.is_bounded();
        CullableBy {
            occlusion: bounded && asked.occlusion && !self.never_occluded,
            contribution: bounded && asked.contribution && !self.never_too_small,
        }
    }

    /// Whether the mesh's own volumes enclose the entity, too: not where its vertices are moved, and not where
    /// the user gave it a bound of its own.
    fn is_as_its_mesh(&self) -> bool {
        !self.own_aabb && !self.skinned && !self.morphing
    }

    fn candidate(
        &self,
        meshes: &OccludeeMeshes,
        assets: Option<&Assets<Mesh>>,
        asked: Asked,
    ) -> Candidate {
        let volume = asked.volume;
        let by = self.cullable(asked.by);
        let known = (self.is_as_its_mesh() && volume != OccludeeVolume::Aabb)
            .then(|| meshes.get(self.mesh.id()))
            .flatten()
            .filter(|mesh| mesh.bounds_all_of(self.aabb));
        let proxies = matches!(volume, OccludeeVolume::Proxy { .. });
        Candidate {
            entity: self.entity,
            mesh: self.mesh.id(),
            world_from_local: self.place.affine(),
            volume: LocalBox::from(*self.aabb),
            turned: known
                .and_then(|mesh| mesh.obb)
                .filter(|obb| !obb.is_along_axes()),
            proxy: known
                .filter(|_| proxies)
                .and_then(|mesh| mesh.proxy.clone()),
            triangles: assets
                .filter(|_| by.contribution)
                .and_then(|assets| assets.get(self.mesh.id()))
                .map_or(0, triangles),
            by,
        }
    }
}

/// Triangles of a mesh; 0 where its data are in the render world alone.
fn triangles(mesh: &Mesh) -> u32 {
    let corners = match mesh.try_indices_option() {
        Ok(Some(indices)) => indices.len(),
        Ok(None) => mesh.count_vertices(),
        Err(_) => 0,
    };
    let count = match mesh.primitive_topology() {
        PrimitiveTopology::TriangleList => corners / 3,
        PrimitiveTopology::TriangleStrip => corners.saturating_sub(2),
        _ => 0,
    };
    count as u32
}

/// A mesh that moved.
type MeshMoved = (With<Mesh3d>, Changed<GlobalTransform>);

/// Marks whose loss may make a candidate of a mesh.
type MarksLost<'w, 's> = (
    RemovedComponents<'w, 's, NoOcclusionCulling>,
    RemovedComponents<'w, 's, NoContributionCulling>,
    RemovedComponents<'w, 's, NoFrustumCulling>,
    RemovedComponents<'w, 's, SkinnedMesh>,
    RemovedComponents<'w, 's, MeshMorphWeights>,
    RemovedComponents<'w, 's, NoAutoAabb>,
    RemovedComponents<'w, 's, DynamicSkinnedMeshBounds>,
);

/// What makes [`update_candidates`] look at an entity again, of what every mesh has.
type MeshChanged = Or<(Changed<Mesh3d>, Changed<Aabb>)>;

/// The same, of what few have: filters apart, so that a scene's meshes are not gone through once for each.
type FewChanged<'w, 's> = (
    Query<'w, 's, CandidateQuery, Changed<ChildOf>>,
    Query<'w, 's, CandidateQuery, Added<NoOcclusionCulling>>,
    Query<'w, 's, CandidateQuery, Added<NoContributionCulling>>,
    Query<'w, 's, CandidateQuery, Added<NoAutoAabb>>,
    Query<'w, 's, CandidateQuery, Added<NoFrustumCulling>>,
    Query<'w, 's, CandidateQuery, Added<SkinnedMesh>>,
    Query<'w, 's, CandidateQuery, Added<MeshMorphWeights>>,
    Query<'w, 's, CandidateQuery, Added<DynamicSkinnedMeshBounds>>,
);

/// Keeps [`Candidates`] as the scene is. While no camera asks for culling the table is empty and this does nothing;
/// otherwise the work is that of what changed.
#[expect(clippy::too_many_arguments, reason = "each is a kind of change")]
pub fn update_candidates(
    cameras: Query<(Option<&ZBufferOcclusion>, Has<ContributionCulling>, &Camera)>,
    assets: Option<Res<Assets<Mesh>>>,
    mut table: ResMut<Candidates>,
    mut meshes: ResMut<OccludeeMeshes>,
    mut wanted: Local<Option<Asked>>,
    everything: Query<CandidateQuery>,
    changed: Query<CandidateQuery, MeshChanged>,
    few: FewChanged,
    moved: Query<(Entity, &GlobalTransform), MeshMoved>,
    parents: Query<&ChildOf>,
    children: Query<&Children>,
    reparented: Query<Entity, (Changed<ChildOf>, Without<Mesh3d>)>,
    (mut no_parent, mut no_mesh, mut no_aabb): (
        RemovedComponents<ChildOf>,
        RemovedComponents<Mesh3d>,
        RemovedComponents<Aabb>,
    ),
    (
        mut occludable,
        mut weighable,
        mut bounded,
        mut unskinned,
        mut unmorphed,
        mut auto_aabb,
        mut unfollowed,
    ): MarksLost,
) {
    let asked = asked_by(&cameras);
    if table.is_kept != asked.is_some() {
        table.is_kept = asked.is_some();
    }
    let known = core::mem::replace(&mut *wanted, asked);
    let began = Instant::now();
    let Some(what) = asked else {
        if known.is_some() {
            table.forget();
            meshes.clear();
        }
        return;
    };
    table.begin();
    let table = &mut *table;
    let assets = assets.as_deref();
    let mut put = |table: &mut Candidates, item: CandidateQueryItem| {
        let by = item.cullable(what.by);
        if by == CullableBy::default() {
            table.remove(item.entity);
            return;
        }
        if by.occlusion && item.is_as_its_mesh() {
            meshes.want(item.mesh.id(), what.volume);
        }
        let slot = table.insert(item.candidate(&meshes, assets, what));
        if by.occlusion {
            table
                .groups
                .place(slot, parents.iter_ancestors(item.entity));
        } else {
            table.groups.leave(slot);
        }
    };
    for entity in no_mesh.read().chain(no_aabb.read()) {
        table.remove(entity);
    }
    if known != asked {
        for item in &everything {
            put(table, item);
        }
        // All that has lost its parent until now has been seen to.
        no_parent.clear();
        table.update_ms = began.elapsed().as_secs_f32() * 1e3;
        return;
    }
    let few = (few.0.iter())
        .chain(few.1.iter())
        .chain(few.2.iter())
        .chain(few.3.iter())
        .chain(few.4.iter())
        .chain(few.5.iter())
        .chain(few.6.iter())
        .chain(few.7.iter());
    for item in changed.iter().chain(few) {
        put(table, item);
    }
    let again = occludable
        .read()
        .chain(weighable.read())
        .chain(bounded.read())
        .chain(unskinned.read())
        .chain(unmorphed.read())
        .chain(auto_aabb.read())
        .chain(unfollowed.read());
    for entity in again {
        if let Ok(item) = everything.get(entity) {
            put(table, item);
        }
    }
    for entity in reparented.iter().chain(no_parent.read()) {
        let below = core::iter::once(entity).chain(children.iter_descendants(entity));
        for entity in below {
            if let Some(slot) = table.occludable(entity) {
                table.groups.place(slot, parents.iter_ancestors(entity));
            }
        }
    }
    for (entity, place) in &moved {
        if let Some(slot) = table.slot(entity) {
            table.place(slot, place.affine());
        }
    }
    // Volumes that have been built, or that an edit has made void.
    if !meshes.changed().is_empty() {
        let of_changed: Vec<Entity> = table
            .iter()
            .filter(|(_, occludee)| meshes.changed().binary_search(&occludee.mesh).is_ok())
            .map(|(_, occludee)| occludee.entity)
            .collect();
        for item in everything.iter_many(of_changed) {
            let Candidate { turned, proxy, .. } = item.candidate(&meshes, None, what);
            if let Some(slot) = table.slot(item.entity) {
                table.reshape(slot, turned, proxy);
            }
        }
    }
    table.update_ms = began.elapsed().as_secs_f32() * 1e3;
}

/// What the active cameras ask for, all of them together; `None` if none asks for anything.
fn asked_by(
    cameras: &Query<(Option<&ZBufferOcclusion>, Has<ContributionCulling>, &Camera)>,
) -> Option<Asked> {
    let mut asked = Asked {
        volume: OccludeeVolume::Aabb,
        by: CullableBy::default(),
    };
    let fineness = |volume: OccludeeVolume| match volume {
        OccludeeVolume::Aabb => 0,
        OccludeeVolume::Obb => 1,
        OccludeeVolume::Proxy { triangles } => 2 + u64::from(triangles),
    };
    for (occlusion, contribution, camera) in cameras {
        if !camera.is_active {
            continue;
        }
        asked.by.contribution |= contribution;
        if let Some(occlusion) = occlusion {
            asked.by.occlusion = true;
            if fineness(occlusion.volume) > fineness(asked.volume) {
                asked.volume = occlusion.volume;
            }
        }
    }
    (asked.by != CullableBy::default()).then_some(asked)
}
