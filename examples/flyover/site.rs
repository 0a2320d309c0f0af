//! Where on a terrain a city has room: from a flat place, near the shore if there is one, block by block to wherever
//! the ground asks least.

use std::{
    cmp::Ordering,
    collections::{BinaryHeap, HashSet},
};

use bevy::prelude::*;
use bevy_skyline::terrain::HeightField;

use super::texture::unit;

/// Size of a block of houses, and of a block with the streets beside it. units: m
pub const BLOCK_M: Vec2 = Vec2::new(150.0, 56.0);
/// See [`BLOCK_M`]. units: m
pub const PITCH_M: Vec2 = Vec2::new(176.0, 72.0);
/// Ground that is lower is sea or beach. units: m
const LEAST_M: f32 = 3.5;
/// From the city's middle to the beach, where there is one. units: m
const FROM_SHORE_M: f32 = 620.0;
/// Ground that rises more from one end of a block to the other is not built on. units: m
const MOST_RISE_M: f32 = 34.0;

/// A city's place.
#[derive(Clone, Debug)]
pub struct Site {
    /// The middle of block (0, 0). units: m
    pub centre: Vec2,
    /// Where the sea lies, or else the valley. A unit vector.
    pub seaward: Vec2,
    /// From the middle to the shore, or where it would be. units: m
    pub shore_m: f32,
    /// Its blocks, the first first.
    pub blocks: Vec<Block>,
}

/// A block of a city.
#[derive(Clone, Copy, Debug)]
pub struct Block {
    /// Counted across and along from the first.
    pub index: IVec2,
    /// Share of all blocks that were taken before it: 0 in the middle of the city, 1 at its edge.
    pub outward: f32,
}

impl Site {
    /// The place for so many blocks; fewer where there is no room for them.
    pub fn find(field: &HeightField, blocks: usize) -> Self {
        let flat = flattest(field);
        let seaward = downhill(field, flat);
        let centre = ashore(field, flat, seaward);
        let mut site = Self {
            centre,
            seaward,
            shore_m: 1_500.0,
            blocks: Vec::new(),
        };
        let steps = (0..400).map(|step| 15.0 * step as f32);
        let wet = |m: &f32| {
            field
                .height_at(site.at(0.0, *m))
                .is_some_and(|height| height < 0.0)
        };
        site.shore_m = steps.into_iter().find(wet).unwrap_or(site.shore_m);
        site.grow(field, blocks);
        site
    }

    /// Across, to the right of who looks at the sea.
    pub fn across(&self) -> Vec2 {
        self.seaward.perp()
    }

    /// A place from a way across and a way seaward. units: m
    pub fn at(&self, across_m: f32, seaward_m: f32) -> Vec2 {
        self.centre + self.across() * across_m + self.seaward * seaward_m
    }

    /// The middle of a block. units: m
    pub fn middle(&self, index: IVec2) -> Vec2 {
        let way = index.as_vec2() * PITCH_M;
        self.at(way.x, way.y)
    }

    /// How objects along streets are turned.
    pub fn turn(&self) -> Quat {
        Quat::from_rotation_y(-self.across().to_angle())
    }

    /// Ways across and seaward from the centre. units: m
    pub fn local(&self, at: Vec2) -> Vec2 {
        let way = at - self.centre;
        Vec2::new(way.dot(self.across()), way.dot(self.seaward))
    }

    fn grow(&mut self, field: &HeightField, blocks: usize) {
        let mut open = BinaryHeap::from([Step {
            cost: 0.0,
            index: IVec2::ZERO,
        }]);
        let mut known = HashSet::from([IVec2::ZERO]);
        while let Some(Step { cost, index }) = open.pop() {
            self.blocks.push(Block {
                index,
                outward: 0.0,
            });
            if self.blocks.len() == blocks {
                break;
            }
            for way in [IVec2::X, IVec2::NEG_X, IVec2::Y, IVec2::NEG_Y] {
                let next = index + way;
                if !known.insert(next) {
                    continue;
                }
                if let Some(rise) = rise(field, self, next) {
                    let luck = unit(next.x, next.y, 1);
                    let steep = rise / 8.0;
                    // As far as it is, whatever the blocks' shape.
                    let far = (PITCH_M * way.as_vec2()).length() / PITCH_M.y;
                    open.push(Step {
                        cost: cost + far * (1.0 + steep * steep + 0.5 * luck),
                        index: next,
                    });
                }
            }
        }
        let all = self.blocks.len() as f32;
        for (order, block) in self.blocks.iter_mut().enumerate() {
            block.outward = order as f32 / all;
        }
    }
}

/// How much the ground rises over a block; `None` where it cannot be built on.
fn rise(field: &HeightField, site: &Site, index: IVec2) -> Option<f32> {
    let middle = site.middle(index);
    let (mut low, mut high) = (f32::MAX, f32::MIN);
    for (x, y) in [
        (0.0, 0.0),
        (-1.0, -1.0),
        (1.0, -1.0),
        (1.0, 1.0),
        (-1.0, 1.0),
    ] {
        let way = 0.5 * PITCH_M * Vec2::new(x, y);
        let height = field.height_at(middle + site.across() * way.x + site.seaward * way.y)?;
        low = low.min(height);
        high = high.max(height);
    }
    (low >= LEAST_M && high - low <= MOST_RISE_M).then_some(high - low)
}

/// Of 40×40 places the one that rises least around it, near the shore if there is one.
fn flattest(field: &HeightField) -> Vec2 {
    let extent = field.extent_m();
    let reach = (0.06 * extent.min_element()).min(900.0);
    let places = (4..=36).flat_map(|z| (4..=36).map(move |x| Vec2::new(x as f32, z as f32) / 40.0));
    let score = |at: Vec2| {
        let around = |reach: f32| {
            let line = move || (-3..=3).map(move |i| reach * i as f32 / 3.0);
            let heights = line().flat_map(move |z| line().map(move |x| at + Vec2::new(x, z)));
            let heights = heights.filter_map(|at| field.height_at(at));
            heights.fold((f32::MAX, f32::MIN), |(low, high), height| {
                (low.min(height), high.max(height))
            })
        };
        let (low, high) = around(reach);
        let (far_low, _) = around(2.2 * reach);
        let dry = low >= LEAST_M;
        let ashore = far_low < 1.0;
        // Rather wet feet than none: some place is the best even where all is sea.
        (high - low) + if dry { 0.0 } else { 400.0 } + if ashore { 0.0 } else { 60.0 }
    };
    places
        .map(|place| place * extent)
        .min_by(|a, b| score(*a).total_cmp(&score(*b)))
        .unwrap_or(0.5 * extent)
}

/// The place on the way to the sea from which the shore is [`FROM_SHORE_M`] away; the same place if the sea is nearer
/// than that, or nowhere.
fn ashore(field: &HeightField, from: Vec2, seaward: Vec2) -> Vec2 {
    let places = (0..400).map(|step| from + seaward * 15.0 * step as f32);
    let shore = places
        .clone()
        .find(|at| field.height_at(*at).is_some_and(|height| height < LEAST_M));
    let far = |shore: &Vec2| shore.distance(from) > FROM_SHORE_M;
    shore
        .filter(far)
        .map_or(from, |shore| shore - seaward * FROM_SHORE_M)
}

/// The way to the lowest ground some way off.
fn downhill(field: &HeightField, centre: Vec2) -> Vec2 {
    let reach = 0.35 * field.extent_m().min_element();
    let mean = |way: Vec2| {
        let heights = (1..=24).map(|step| centre + way * reach * step as f32 / 24.0);
        let heights: Vec<f32> = heights
            .map(|at| field.height_at(at).unwrap_or(0.0))
            .collect();
        heights.iter().sum::<f32>() / heights.len() as f32
    };
    (0..32)
        .map(|i| Vec2::from_angle(core::f32::consts::TAU * i as f32 / 32.0))
        .min_by(|a, b| mean(*a).total_cmp(&mean(*b)))
        .unwrap_or(Vec2::Y)
}

/// A block that could be next.
struct Step {
    cost: f32,
    index: IVec2,
}

impl Ord for Step {
    /// The cheapest is the greatest; for equal costs a fixed order.
    fn cmp(&self, other: &Self) -> Ordering {
        let by_place = || (self.index.x, self.index.y).cmp(&(other.index.x, other.index.y));
        other.cost.total_cmp(&self.cost).then_with(by_place)
    }
}

impl PartialOrd for Step {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl PartialEq for Step {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other) == Ordering::Equal
    }
}

impl Eq for Step {}
