//! The volumes of mesh assets: made once for each mesh, in the background, and shared by all its entities.

mod source;

use std::{collections::VecDeque, sync::Arc};

use bevy::{
    camera::primitives::Aabb,
    platform::collections::HashMap,
    prelude::*,
    tasks::{AsyncComputeTaskPool, Task, futures::check_ready},
};

use crate::{
    culling::volume::{LocalBox, Proxy},
    occlusion::{OccludeeVolume, obb, proxy},
};

/// So many vertices are copied for one task that makes boxes, or those of one mesh if it has more.
const BATCH_VERTICES: usize = 65_536;
/// So many vertices are copied for one task that makes proxies, or those of one mesh if it has more: a city of small
/// meshes is done in as many runs as it has batches.
const PROXY_BATCH_VERTICES: usize = 4096;
/// So many batches of proxies are made at a time, beside one of boxes.
const MOST_PROXY_TASKS: usize = 2;
/// So many runs after its last edit a mesh is taken up again: one that is edited every frame has no volumes, and
/// costs nothing.
const QUIET_RUNS: u64 = 8;

/// What stands for one mesh, in its own space. Until they are there, and where there are none, the entity's
/// `Aabb` stands for it.
#[derive(Clone, Debug, Default)]
pub struct MeshVolumes {
    /// The smaller of the box along the axes of its vertices' covariance and the one along its own axes. It
    /// encloses every vertex that the asset has. `None`: not ready, or the positions can't be read.
    pub obb: Option<LocalBox>,
    /// The simplified mesh that encloses it. `None`: not asked for, not ready, or not a mesh of triangles.
    pub proxy: Option<Arc<Proxy>>,
    /// Lowest and highest corner of its vertices.
    reach: Option<[Vec3; 2]>,
    morphs: bool,
    generation: u32,
}

impl MeshVolumes {
    /// Changes whenever the volumes do; no two sets of volumes share one, of whichever mesh.
    pub fn generation(&self) -> u32 {
        self.generation
    }

    /// Whether an entity's `Aabb` reaches no further than the mesh's own vertices. One that does was given by a user
    /// who knows what moves them, and the volumes do not enclose what it encloses.
    pub fn bounds_all_of(&self, aabb: &Aabb) -> bool {
        self.reach.is_some_and(|[low, high]| {
            let (min, max) = (Vec3::from(aabb.min()), Vec3::from(aabb.max()));
            // Bevy rounds corners to a centre and half extents, and back.
            let slack = (low.abs().max(high.abs()) * (8.0 * f32::EPSILON)).max_element();
            (min + slack).cmpge(low).all() && (max - slack).cmple(high).all()
        })
    }

    /// Whether the mesh has morph targets: the volumes are those of its unmorphed shape, and don't enclose what
    /// weights make of it. What a skin or a vertex shader moves, they don't enclose either.
    pub fn has_morph_targets(&self) -> bool {
        self.morphs
    }
}

/// The volumes of the mesh assets that somebody asked for, kept up to date by [`build_mesh_volumes`].
#[derive(Resource, Default)]
pub struct OccludeeMeshes {
    entries: HashMap<AssetId<Mesh>, Entry>,
    /// May name a mesh that is not due any more, or twice.
    boxes_due: VecDeque<AssetId<Mesh>>,
    proxies_due: VecDeque<AssetId<Mesh>>,
    boxes: Option<Task<Vec<BoxMade>>>,
    proxies: Vec<Task<Vec<ProxyMade>>>,
    changed: Vec<AssetId<Mesh>>,
    /// What changed since the last run, outside of it.
    changed_between: Vec<AssetId<Mesh>>,
    last_number: u32,
    runs: u64,
}

struct Entry {
    volumes: MeshVolumes,
    /// Triangles of the proxy that is asked for; 0 for none.
    triangles: u32,
    /// Triangles that were allowed to the proxy that is there or being made.
    proxy_of: u32,
    progress: Progress,
    /// Tells results for the mesh as it is from those for what it was.
    ticket: u32,
    /// The run from which on it is taken up.
    from_run: u64,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Progress {
    Due,
    /// Due once there is such an asset.
    NoAsset,
    InTask,
    /// With or without a result.
    Done,
}

struct BoxMade {
    id: AssetId<Mesh>,
    ticket: u32,
    made: Option<(LocalBox, [Vec3; 2])>,
}

struct ProxyMade {
    id: AssetId<Mesh>,
    ticket: u32,
    triangles: u32,
    made: Option<Proxy>,
}

impl OccludeeMeshes {
    /// What stands for this mesh; `None` if nobody asked for it.
    pub fn get(&self, id: AssetId<Mesh>) -> Option<&MeshVolumes> {
        Some(&self.entries.get(&id)?.volumes)
    }

    /// Asks for a volume of this mesh. Cheap enough for every entity in every frame. Of different wishes the
    /// strongest holds, until the asset or all wishes are gone; [`OccludeeVolume::Aabb`] asks for nothing.
    pub fn want(&mut self, id: AssetId<Mesh>, volume: OccludeeVolume) {
        let triangles = match volume {
            OccludeeVolume::Aabb => return,
            OccludeeVolume::Obb => 0,
            OccludeeVolume::Proxy { triangles } => triangles.min(proxy::MOST_TRIANGLES),
        };
        match self.entries.get_mut(&id) {
            Some(entry) if entry.triangles >= triangles => {}
            Some(entry) => {
                entry.triangles = triangles;
                if entry.progress == Progress::Done {
                    self.proxies_due.push_back(id);
                }
            }
            None => {
                let entry = Entry {
                    volumes: MeshVolumes::default(),
                    triangles,
                    proxy_of: 0,
                    progress: Progress::Due,
                    ticket: next(&mut self.last_number),
                    from_run: 0,
                };
                self.entries.insert(id, entry);
                self.boxes_due.push_back(id);
            }
        }
    }

    /// Meshes whose volumes came, changed or went in the last run of [`build_mesh_volumes`] or between it and
    /// the one before; each once.
    pub fn changed(&self) -> &[AssetId<Mesh>] {
        &self.changed
    }

    /// Whether volumes that were asked for are still to come. What waits for its asset doesn't count.
    pub fn is_busy(&self) -> bool {
        self.boxes.is_some()
            || !self.proxies.is_empty()
            || !self.boxes_due.is_empty()
            || !self.proxies_due.is_empty()
    }

    /// Main memory that it holds. Asks every mesh: once after a change is enough. units: bytes
    pub fn bytes(&self) -> u64 {
        let slots = self.entries.capacity() * size_of::<(AssetId<Mesh>, Entry)>()
            + (self.boxes_due.capacity() + self.proxies_due.capacity())
                * size_of::<AssetId<Mesh>>();
        let proxies: usize = self
            .entries
            .values()
            .filter_map(|entry| entry.volumes.proxy.as_deref())
            .map(|proxy| size_of_val(proxy.triangles.as_slice()))
            .sum();
        (slots + proxies) as u64
    }

    /// Forgets all wishes, and frees the volumes that were made for them.
    pub fn clear(&mut self) {
        let had = self.entries.iter().filter(|(_, entry)| entry.has_any());
        let mut changed_between = core::mem::take(&mut self.changed_between);
        changed_between.extend(had.map(|(id, _)| *id));
        *self = Self {
            changed: core::mem::take(&mut self.changed),
            changed_between,
            last_number: self.last_number,
            runs: self.runs,
            ..default()
        };
    }

    /// The mesh is another from now on: what was made of it must not stand for it any more.
    fn edited(&mut self, id: AssetId<Mesh>) {
        let Some(entry) = self.entries.get_mut(&id) else {
            return;
        };
        if entry.has_any() {
            self.changed.push(id);
        }
        entry.volumes = MeshVolumes {
            generation: next(&mut self.last_number),
            ..default()
        };
        entry.ticket = next(&mut self.last_number);
        entry.proxy_of = 0;
        entry.from_run = self.runs + QUIET_RUNS;
        if entry.progress != Progress::Due {
            entry.progress = Progress::Due;
            self.boxes_due.push_back(id);
        }
    }

    fn added(&mut self, id: AssetId<Mesh>) {
        // What is not waiting has been read as it is: an edit since would be told as one.
        if let Some(entry) = self.entries.get_mut(&id)
            && entry.progress == Progress::NoAsset
        {
            entry.progress = Progress::Due;
            self.boxes_due.push_back(id);
        }
    }

    fn removed(&mut self, id: AssetId<Mesh>) {
        if self
            .entries
            .remove(&id)
            .is_some_and(|entry| entry.has_any())
        {
            self.changed.push(id);
        }
    }

    /// Takes what the tasks have finished, if it is of the meshes as they are now.
    fn collect(&mut self) {
        if let Some(made) = self.boxes.as_mut().and_then(check_ready) {
            self.boxes = None;
            for BoxMade { id, ticket, made } in made {
                let Some(entry) = self.entries.get_mut(&id).filter(|e| e.ticket == ticket) else {
                    continue;
                };
                entry.progress = Progress::Done;
                if let Some((obb, reach)) = made {
                    entry.volumes.obb = Some(obb);
                    entry.volumes.reach = Some(reach);
                    entry.volumes.generation = next(&mut self.last_number);
                    self.changed.push(id);
                    if entry.triangles > 0 {
                        self.proxies_due.push_back(id);
                    }
                }
            }
        }
        let (entries, changed, last) =
            (&mut self.entries, &mut self.changed, &mut self.last_number);
        self.proxies.retain_mut(|task| {
            let Some(results) = check_ready(task) else {
                return true;
            };
            for result in results {
                if let Some(entry) = entries.get_mut(&result.id)
                    && entry.ticket == result.ticket
                    && entry.proxy_of == result.triangles
                    && let Some(made) = result.made
                {
                    entry.volumes.proxy = Some(Arc::new(made));
                    entry.volumes.generation = next(last);
                    changed.push(result.id);
                }
            }
            false
        });
    }

    /// Starts the next batch of boxes once the last is done.
    fn start_boxes(&mut self, meshes: &Assets<Mesh>, pool: &AsyncComputeTaskPool) {
        if self.boxes.is_some() {
            return;
        }
        let mut batch: Vec<(AssetId<Mesh>, u32, Vec<Vec3>)> = Vec::new();
        let mut vertices = 0;
        for _ in 0..self.boxes_due.len() {
            let Some(id) = self.boxes_due.pop_front() else {
                break;
            };
            let Some(entry) = self.entries.get_mut(&id) else {
                continue;
            };
            if entry.progress != Progress::Due {
                continue;
            }
            if self.runs < entry.from_run {
                self.boxes_due.push_back(id);
                continue;
            }
            let Some(mesh) = meshes.get(id) else {
                entry.progress = Progress::NoAsset;
                continue;
            };
            let Some(positions) = source::positions(mesh) else {
                entry.progress = Progress::Done;
                continue;
            };
            entry.volumes.morphs = mesh.try_has_morph_targets().unwrap_or(false);
            entry.progress = Progress::InTask;
            vertices += positions.len();
            batch.push((id, entry.ticket, copied(positions)));
            if vertices >= BATCH_VERTICES {
                break;
            }
        }
        if !batch.is_empty() {
            self.boxes = Some(pool.spawn(async move {
                let made = |(id, ticket, positions): (_, _, Vec<Vec3>)| BoxMade {
                    id,
                    ticket,
                    made: obb::fit(&positions).map(|obb| {
                        let low = positions.iter().copied().fold(Vec3::INFINITY, Vec3::min);
                        let high = positions
                            .iter()
                            .copied()
                            .fold(Vec3::NEG_INFINITY, Vec3::max);
                        (obb, [low, high])
                    }),
                };
                batch.into_iter().map(made).collect()
            }));
        }
    }

    /// Starts at most one batch of proxies.
    fn start_proxies(&mut self, meshes: &Assets<Mesh>, pool: &AsyncComputeTaskPool) {
        if self.proxies.len() >= MOST_PROXY_TASKS {
            return;
        }
        let mut batch = Vec::new();
        let mut vertices = 0;
        while vertices < PROXY_BATCH_VERTICES
            && let Some(id) = self.proxies_due.pop_front()
        {
            let Some(entry) = self.entries.get_mut(&id) else {
                continue;
            };
            if entry.progress != Progress::Done
                || entry.volumes.obb.is_none()
                || entry.proxy_of >= entry.triangles
            {
                continue;
            }
            let mesh = meshes.get(id);
            let positions = mesh.and_then(source::positions);
            // A large one is a batch of its own: no small one has to wait for it.
            if positions.is_some_and(|all| all.len() >= PROXY_BATCH_VERTICES) && !batch.is_empty() {
                self.proxies_due.push_front(id);
                break;
            }
            entry.proxy_of = entry.triangles;
            let Some((positions, indices)) = positions
                .and_then(|positions| Some((copied(positions), source::triangles(mesh?)?)))
            else {
                continue;
            };
            vertices += positions.len();
            batch.push((id, entry.ticket, entry.triangles, positions, indices));
        }
        if !batch.is_empty() {
            self.proxies.push(pool.spawn(async move {
                let made =
                    |(id, ticket, triangles, positions, indices): (_, _, _, Vec<_>, Vec<_>)| {
                        ProxyMade {
                            id,
                            ticket,
                            triangles,
                            made: proxy::build(&positions, &indices, triangles),
                        }
                    };
                batch.into_iter().map(made).collect()
            }));
        }
    }
}

impl Entry {
    fn has_any(&self) -> bool {
        self.volumes.obb.is_some() || self.volumes.proxy.is_some()
    }
}

/// Makes the volumes that are asked for, a few at a time, and never waits for them: first every mesh's box, then
/// the proxies.
///
/// A mesh that was edited, or is gone, loses its volumes in the run that hears of it. So that no frame is drawn
/// with an edited mesh and its old volumes, it must run after `AssetEventSystems`, in whose messages the renderer
/// hears of edits too, and before the volumes are read. An edited mesh is taken up again once it has been left
/// alone for some runs.
///
/// # Limits
/// A mesh whose data is in the render world only (`RenderAssetUsages`) has no volumes unless they were asked for
/// before it went there. A proxy needs triangles; a mesh of lines or points has a box at most. Positions and
/// indices are copied for the task in the run that starts it: of one batch for boxes and one for proxies a
/// run, but of a mesh of millions of vertices all at once.
pub fn build_mesh_volumes(
    mut kept: ResMut<OccludeeMeshes>,
    meshes: Res<Assets<Mesh>>,
    mut events: MessageReader<AssetEvent<Mesh>>,
) {
    let kept = &mut *kept;
    kept.runs += 1;
    kept.changed.clear();
    kept.changed.append(&mut kept.changed_between);
    for event in events.read() {
        match *event {
            AssetEvent::Added { id } => kept.added(id),
            AssetEvent::Modified { id } => kept.edited(id),
            AssetEvent::Removed { id } | AssetEvent::Unused { id } => kept.removed(id),
            AssetEvent::LoadedWithDependencies { .. } => {}
        }
    }
    kept.collect();
    if let Some(pool) = AsyncComputeTaskPool::try_get() {
        kept.start_boxes(&meshes, pool);
        kept.start_proxies(&meshes, pool);
    }
    kept.changed.sort_unstable();
    kept.changed.dedup();
}

fn next(last: &mut u32) -> u32 {
    *last = last.wrapping_add(1);
    *last
}

fn copied(positions: &[[f32; 3]]) -> Vec<Vec3> {
    positions.iter().copied().map(Vec3::from).collect()
}
