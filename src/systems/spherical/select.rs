//! Of each camera's visible entities, removes the chunks that it cannot see, and either the chunks of an entity or the
//! entity.

use core::{any::TypeId, ops::Range};

use bevy::{
    camera::{MainPassResolutionOverride, visibility::VisibleEntities},
    math::{DAffine3, DVec2, DVec3},
    platform::time::Instant,
    prelude::*,
    render::render_resource::Face,
};

use super::models::{Drawn, Indexed, Record, Root, SphericalModels};
use crate::{
    culling::CulledEntities,
    precision::affine64,
    spherical::{Eye, Frustum, PaperScratch, Shown, SphericalCounts, SphericalMode, View},
};

/// Kept from frame to frame, so that nothing is allocated.
#[derive(Default)]
pub struct Scratch {
    /// By root, what the camera draws of it.
    plans: Vec<Plan>,
    /// By visible entity, what it is.
    marks: Vec<Mark>,
    paper: PaperScratch,
    /// By root, what P3's rules select.
    ranges: Vec<Vec<Range<u32>>>,
}

/// What a camera draws of an entity.
#[derive(Clone, Copy, Default)]
struct Plan {
    is_in_view: bool,
    /// `None`: it has no chunks, or not yet.
    view: Option<View>,
    chunks: u32,
    triangles: u64,
    is_by_chunks: bool,
}

/// A visible entity.
#[derive(Clone, Copy)]
enum Mark {
    /// No business of ours.
    Other,
    /// One that has chunks, of this root.
    Whole(u32),
    /// A chunk of this root that the camera may see something of.
    Seen(u32),
    Unseen,
}

/// What is looked at of each camera.
type Cameras<'w, 's> = Query<
    'w,
    's,
    (
        &'static Camera,
        &'static GlobalTransform,
        Option<&'static MainPassResolutionOverride>,
        Option<&'static CulledEntities>,
        &'static mut VisibleEntities,
    ),
>;

/// See the [module](self). The order of what is left is kept.
pub fn select_chunks(
    mut models: ResMut<SphericalModels>,
    mut cameras: Cameras,
    entities: Query<(&GlobalTransform, &Mesh3d)>,
    mut counts: Query<&mut SphericalCounts>,
    mut scratch: Local<Scratch>,
) {
    let began = Instant::now();
    let models = &mut *models;
    for root in models.roots.values_mut() {
        root.drawn = Drawn::default();
    }
    if !models.chunks.is_empty() {
        for (camera, place, resolution, culled, visible) in &mut cameras {
            if camera.is_active {
                let eye = Sight::of(camera, place, resolution);
                let list = visible.into_inner().get_mut(TypeId::of::<Mesh3d>());
                scratch.judge(models, list, eye.as_ref(), culled, &entities);
                scratch.decide(models);
                scratch.remove(list);
            }
        }
    }
    for (entity, root) in &models.roots {
        if let Ok(mut counts) = counts.get_mut(*entity) {
            counts.set_if_neq(root.counts());
        }
    }
    models.selecting_ms = began.elapsed().as_secs_f32() * 1e3;
}

/// How a camera looks.
struct Sight {
    eye: Eye,
    world_from_view: DAffine3,
    /// Which side is drawn is not the material's alone to say.
    shows_both: bool,
    /// Of the view, at depth 1, or anywhere if it is orthographic: from the middle to the four corners of the picture.
    corners: [DVec2; 4],
}

impl Sight {
    /// `None` if the camera has no viewport, or no one place or direction that it looks from.
    fn of(
        camera: &Camera,
        place: &GlobalTransform,
        resolution: Option<&MainPassResolutionOverride>,
    ) -> Option<Self> {
        let size = camera.physical_viewport_size()?;
        let size = resolution.map_or(size, |to| to.0).as_dvec2();
        let clip_from_view = camera.clip_from_view().as_dmat4();
        let [x, y, z, w] = [0, 1, 2, 3].map(|row| clip_from_view.row(row));
        let across = DVec2::new(x.x, y.y);
        let world_from_view = affine64(place.affine());
        // Either what is across does not depend on depth, or all rays meet in the view's origin.
        let is_orthographic = w.truncate() == DVec3::ZERO && x.z == 0.0 && y.z == 0.0;
        let is_perspective =
            x.w == 0.0 && y.w == 0.0 && w.w == 0.0 && w.x == 0.0 && w.y == 0.0 && w.z < 0.0;
        if !is_orthographic && !is_perspective {
            return None;
        }
        let middle = if is_orthographic {
            -DVec2::new(x.w, y.w)
        } else {
            DVec2::new(x.z, y.z)
        };
        let corners = [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)]
            .map(|(u, v)| (DVec2::new(u, v) + middle) / across);
        // Where depth is 1; how far its corners are.
        let near = if z.x == 0.0 && z.y == 0.0 {
            (z.w / (z.z - w.z)).abs()
        } else {
            // It lies aslant: nothing is known to be beyond it.
            f64::INFINITY
        };
        let farthest = corners.map(|corner| 1.0 + corner.length_squared());
        let farthest = farthest.into_iter().fold(1.0, f64::max).sqrt();
        Some(Self {
            eye: Eye {
                position: world_from_view.translation,
                backward: is_orthographic.then_some(world_from_view.matrix3.z_axis),
                pixel: (2.0 / (across.abs() * size)).max_element(),
                viewport: size.max_element(),
                sub_pixel_bits: Eye::SUB_PIXEL_BITS,
                near: if is_orthographic {
                    0.0
                } else {
                    near * farthest
                },
                is_mirrored: (world_from_view.matrix3.determinant() < 0.0)
                    != (across.x * across.y < 0.0),
            },
            world_from_view,
            // Only some materials heed it.
            shows_both: camera.invert_culling,
            corners,
        })
    }

    /// The picture's corners in a mesh's space.
    fn frustum(&self, world_from_local: &DAffine3) -> Frustum {
        let local_from_view = world_from_local.inverse() * self.world_from_view;
        if self.eye.backward.is_some() {
            let corners = self.corners;
            Frustum::orthographic(
                corners.map(|corner| local_from_view.transform_point3(corner.extend(0.0))),
                local_from_view.transform_vector3(DVec3::NEG_Z),
            )
        } else {
            Frustum::perspective(
                local_from_view.translation,
                self.corners
                    .map(|corner| local_from_view.transform_vector3(corner.extend(-1.0))),
            )
        }
    }
}

impl Scratch {
    /// Says of each visible entity what it is, and sums up what each root would have drawn of it.
    fn judge(
        &mut self,
        models: &SphericalModels,
        list: &[Entity],
        eye: Option<&Sight>,
        culled: Option<&CulledEntities>,
        entities: &Query<(&GlobalTransform, &Mesh3d)>,
    ) {
        self.plans.clear();
        self.ranges.resize(models.roots.len(), Vec::new());
        for (number, (entity, root)) in models.roots.iter().enumerate() {
            let mut plan = Plan {
                is_in_view: list.binary_search(entity).is_ok(),
                ..Plan::default()
            };
            if plan.is_in_view
                && let (Some(eye), Some(indexed)) = (eye, root.ready())
                && let Ok((place, mesh)) = entities.get(*entity)
                // It may have been given another in this frame.
                && mesh.id() == root.mesh
                // What the GPU leaves out for being small stays in the list, and is to be left out whole.
                && culled.is_none_or(|culled| culled.reason(*entity).is_none())
            {
                let world_from_local = affine64(place.affine());
                let reach = indexed.chunks.reach();
                let shown = if eye.shows_both {
                    Shown::Both
                } else {
                    root.shown()
                };
                let view = View::new(&eye.eye, &world_from_local, reach, shown);
                if let Some(source) = &indexed.source {
                    indexed.maps.select_as_published(
                        &source.positions,
                        &source.triangles,
                        &eye.frustum(&world_from_local),
                        &mut self.paper,
                        &mut self.ranges[number],
                    );
                }
                plan.view = Some(view);
            }
            self.plans.push(plan);
        }
        self.marks.clear();
        // Both are sorted by entity.
        let mut records = models.chunks.iter().peekable();
        for entity in list {
            while records.next_if(|record| record.entity < *entity).is_some() {}
            let mark = match records.peek() {
                Some(record) if record.entity == *entity => self.judge_chunk(models, record),
                _ => match models.roots.get_index_of(entity) {
                    Some(root) => Mark::Whole(root as u32),
                    None => Mark::Other,
                },
            };
            self.marks.push(mark);
        }
    }

    fn judge_chunk(&mut self, models: &SphericalModels, record: &Record) -> Mark {
        let number = record.root as usize;
        let root = models.roots.get_index(number).map(|(_, root)| root);
        let (Some(plan), Some(root)) = (self.plans.get_mut(number), root) else {
            return Mark::Unseen;
        };
        let (Some(view), Some(indexed)) = (&plan.view, root.ready()) else {
            return Mark::Unseen;
        };
        let Some(chunk) = indexed.chunks.chunks().get(record.number as usize) else {
            return Mark::Unseen;
        };
        let is_seen = match root.settings.mode {
            SphericalMode::Conservative => indexed.chunks.faces_eye(chunk, view),
            SphericalMode::Paper => {
                let ranges = &self.ranges[number];
                let next = ranges.partition_point(|range| range.end <= chunk.triangles.start);
                let next = ranges.get(next);
                next.is_some_and(|range| range.start < chunk.triangles.end)
            }
        };
        if !is_seen {
            return Mark::Unseen;
        }
        plan.chunks += 1;
        plan.triangles += u64::from(chunk.triangles.end - chunk.triangles.start);
        Mark::Seen(record.root)
    }

    /// Chunks or the whole, whichever costs less.
    fn decide(&mut self, models: &mut SphericalModels) {
        for (plan, root) in self.plans.iter_mut().zip(models.roots.values_mut()) {
            if !plan.is_in_view {
                continue;
            }
            root.drawn.views += 1;
            let Some(whole) = root.ready().map(Indexed::triangles) else {
                continue;
            };
            let cost = u64::from(root.settings.chunk_cost);
            let by_chunks = plan.triangles + cost * u64::from(plan.chunks);
            plan.is_by_chunks = plan.view.is_some() && by_chunks < u64::from(whole) + cost.max(1);
            if plan.is_by_chunks {
                root.drawn.by_chunks += 1;
                root.drawn.chunks += plan.chunks;
                root.drawn.triangles += plan.triangles;
            } else {
                root.drawn.triangles += u64::from(whole);
            }
        }
    }

    fn remove(&self, list: &mut Vec<Entity>) {
        let is_by_chunks = |root: u32| {
            let plan = self.plans.get(root as usize);
            plan.is_some_and(|plan| plan.is_by_chunks)
        };
        let mut marks = self.marks.iter();
        list.retain(|_| match marks.next() {
            Some(Mark::Other) | None => true,
            Some(Mark::Whole(root)) => !is_by_chunks(*root),
            Some(Mark::Seen(root)) => is_by_chunks(*root),
            Some(Mark::Unseen) => false,
        });
    }
}

impl Root {
    fn shown(&self) -> Shown {
        match self.look.map(|look| look.cull) {
            Some(Some(Face::Back)) => Shown::Front,
            Some(Some(Face::Front)) => Shown::Back,
            Some(None) | None => Shown::Both,
        }
    }

    fn counts(&self) -> SphericalCounts {
        let Some(indexed) = self.ready() else {
            return SphericalCounts::default();
        };
        SphericalCounts {
            chunks: self.chunks.len() as u32,
            triangles: indexed.triangles(),
            views: self.drawn.views,
            views_by_chunks: self.drawn.by_chunks,
            drawn_chunks: self.drawn.chunks,
            drawn_triangles: self.drawn.triangles,
        }
    }
}
