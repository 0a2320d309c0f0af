//! The order that triangles are put in, and where it may be cut.

use core::ops::Range;

use bevy::math::{DVec3, Vec3};

use super::bins::Bins;

/// In what order the bins follow one another.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Layout {
    /// As published: row by row of θ, so that a range of θ is one range of triangles. A bin is one range, its triangles
    /// that face outward before those that face inward.
    Rows,
    /// In blocks of bins that are near one another and whose triangles face alike, first all that face outward, then
    /// all that face inward. A bin is up to two ranges. What `chunks` are best cut from.
    #[default]
    Blocks,
}

/// What a triangle is ordered by.
#[derive(Clone, Copy, Debug)]
pub(super) struct Key {
    pub bin: u32,
    /// Its front is turned to the centre.
    pub is_inward: bool,
    /// From the centre to its centroid.
    pub distance: f64,
    /// Of length 1, or 0.
    pub normal: DVec3,
}

/// The triangles' numbers in order, and the places to cut it into pieces of at most `size`, both ends included.
pub(super) fn order(keys: &[Key], bins: Bins, layout: Layout, size: usize) -> (Vec<u32>, Vec<u32>) {
    let mut order: Vec<u32> = (0..keys.len() as u32).collect();
    let mut cuts = vec![0];
    match layout {
        Layout::Rows => {
            sort(&mut order, keys);
            cut_rows(&order, keys, size, &mut cuts);
        }
        Layout::Blocks => {
            let mut splitter = Splitter::new(keys, bins, size);
            let outward = partition(&mut order, |triangle| !keys[triangle as usize].is_inward);
            // Blocks still to be split, the first last.
            let mut blocks = vec![(outward, keys.len()), (0, outward)];
            while let Some((from, to)) = blocks.pop() {
                let block = &mut order[from..to];
                let split = if block.len() > size {
                    splitter.split(block)
                } else {
                    None
                };
                if let Some(count) = split {
                    blocks.push((from + count, to));
                    blocks.push((from, from + count));
                } else {
                    sort(block, keys);
                    cut_evenly(from, to, size, &mut cuts);
                }
            }
        }
    }
    (order, cuts)
}

/// By bin, in it by facing, then by distance.
fn sort(triangles: &mut [u32], keys: &[Key]) {
    triangles.sort_unstable_by(|&a, &b| {
        let (key, other) = (&keys[a as usize], &keys[b as usize]);
        (key.bin, key.is_inward)
            .cmp(&(other.bin, other.is_inward))
            .then(key.distance.total_cmp(&other.distance))
            .then(a.cmp(&b))
    });
}

/// As few pieces as hold it, of nearly one size.
fn cut_evenly(from: usize, to: usize, size: usize, cuts: &mut Vec<u32>) {
    let pieces = (to - from).div_ceil(size);
    for piece in 1..=pieces {
        cuts.push((from + (to - from) * piece / pieces) as u32);
    }
}

/// Whole bins as long as they fit.
fn cut_rows(order: &[u32], keys: &[Key], size: usize, cuts: &mut Vec<u32>) {
    let (mut from, mut at) = (0, 0);
    for bin in order.chunk_by(|&a, &b| keys[a as usize].bin == keys[b as usize].bin) {
        if at > from && at + bin.len() - from > size {
            cut_evenly(from, at, size, cuts);
            from = at;
        }
        at += bin.len();
    }
    if at > from {
        cut_evenly(from, at, size, cuts);
    }
}

/// Moves those for which it holds to the front, and says how many they are.
fn partition(triangles: &mut [u32], is_first: impl Fn(u32) -> bool) -> usize {
    let mut count = 0;
    for at in 0..triangles.len() {
        if is_first(triangles[at]) {
            triangles.swap(at, count);
            count += 1;
        }
    }
    count
}

/// Normals added up, and their number.
#[derive(Clone, Copy, Default)]
struct Sum {
    normals: DVec3,
    count: usize,
}

impl Sum {
    fn add(&mut self, other: Self) {
        self.normals += other.normals;
        self.count += other.count;
    }

    fn without(self, other: Self) -> Self {
        Self {
            normals: self.normals - other.normals,
            count: self.count - other.count,
        }
    }

    /// How far from all alike: 0 if they are, their number if they cancel out. With *n* of them and *r* for the
    /// length of their mean, *n*·√(1 − *r*²): for normals that are all at one angle to their mean, its sine for each.
    /// Seen from anywhere, normals within an angle of one another are all turned away in a share of ½·(1 − sine) of
    /// cases.
    fn spread(self) -> f64 {
        let (count, length) = (self.count as f64, self.normals.length());
        ((count - length) * (count + length)).max(0.0).sqrt()
    }
}

/// Blocks of at most so many chunks are split by their normals too. Greater ones only across their longer side, so that
/// chunks stay small enough to be told from what is out of view. Of 4, 6, 8 and 16, on the bunny: with more, fewer
/// triangles face the eye; with fewer, fewer are in view.
const BY_NORMALS: usize = 6;
/// Parts that a component of normals is told apart by, from −1 to 1.
const PARTS: u32 = 64;

/// Splits blocks of bins; keeps its memory between them.
struct Splitter<'a> {
    keys: &'a [Key],
    bins: Bins,
    /// At most so many triangles are split by normals.
    by_normals: usize,
    /// By bin, those that face outward and those that face inward: the direction of all their normals together.
    normals: [Vec<Vec3>; 2],
    sums: Vec<Sum>,
}

/// What bins are told apart by: row, column, or a component of the normal.
const WAYS: usize = 5;

impl<'a> Splitter<'a> {
    fn new(keys: &'a [Key], bins: Bins, size: usize) -> Self {
        let mut normals = [const { Vec::new() }; 2].map(|mut normals: Vec<Vec3>| {
            normals.resize(bins.count(), Vec3::ZERO);
            normals
        });
        for key in keys {
            normals[usize::from(key.is_inward)][key.bin as usize] += key.normal.as_vec3();
        }
        for normal in normals.iter_mut().flatten() {
            *normal = normal.normalize_or_zero();
        }
        Self {
            keys,
            bins,
            by_normals: size.saturating_mul(BY_NORMALS),
            normals,
            sums: Vec::new(),
        }
    }

    /// Where a triangle's bin is: its row and column, and the part that each component of its normal is in.
    fn place(&self, triangle: u32) -> [u32; WAYS] {
        let key = &self.keys[triangle as usize];
        let normal = self.normals[usize::from(key.is_inward)][key.bin as usize];
        let columns = u32::from(self.bins.phi);
        let part = |component: f32| ((component + 1.0) / 2.0 * PARTS as f32) as u32;
        [
            key.bin / columns,
            key.bin % columns,
            part(normal.x),
            part(normal.y),
            part(normal.z),
        ]
    }

    /// Whether a block is longer in θ or in φ, on the sphere.
    fn longer_side(&self, least: [u32; WAYS], greatest: [u32; WAYS]) -> Range<usize> {
        let [height, width] = [0, 1].map(|way| f64::from(greatest[way] - least[way]));
        let middle = f64::from(least[0] + greatest[0] + 1) / 2.0 * self.bins.theta_step();
        let (height, width) = (
            height * self.bins.theta_step(),
            width * self.bins.phi_step() * middle.sin(),
        );
        // One row or one column can't be split across it.
        if width > height || least[0] == greatest[0] {
            1..2
        } else {
            0..1
        }
    }

    /// Puts one part of a block before the other, told apart by their bins in the way that leaves the normals of each
    /// part most alike, neither part with less than an eighth if that can be; says how many are in the first. `None` if
    /// all are in one bin.
    fn split(&mut self, block: &mut [u32]) -> Option<usize> {
        let (mut least, mut greatest) = ([u32::MAX; WAYS], [0; WAYS]);
        for &triangle in &*block {
            for (way, at) in self.place(triangle).into_iter().enumerate() {
                least[way] = least[way].min(at);
                greatest[way] = greatest[way].max(at);
            }
        }
        let ways = if block.len() > self.by_normals {
            self.longer_side(least, greatest)
        } else {
            0..WAYS
        };
        let mut found: Option<(f64, usize, u32)> = None;
        for way in ways {
            self.sums.clear();
            self.sums
                .resize((greatest[way] - least[way]) as usize + 1, Sum::default());
            for &triangle in &*block {
                let at = self.place(triangle)[way] - least[way];
                self.sums[at as usize].add(Sum {
                    normals: self.keys[triangle as usize].normal,
                    count: 1,
                });
            }
            if let Some((cost, at)) = best(&self.sums, block.len())
                && found.is_none_or(|(least, ..)| cost < least)
            {
                found = Some((cost, way, least[way] + at as u32));
            }
        }
        let (_, way, border) = found?;
        Some(partition(block, |triangle| {
            self.place(triangle)[way] < border
        }))
    }
}

/// How many of the first rows or columns to split off, with what that costs; `None` if there is but one.
fn best(sums: &[Sum], count: usize) -> Option<(f64, usize)> {
    let mut whole = Sum::default();
    sums.iter().for_each(|&sum| whole.add(sum));
    let mut first = Sum::default();
    let mut found: Option<(f64, usize)> = None;
    for (at, &sum) in sums.iter().enumerate().take(sums.len() - 1) {
        first.add(sum);
        let second = whole.without(first);
        let smaller = first.count.min(second.count);
        if smaller == 0 {
            continue;
        }
        // What is lopsided comes after all that is not, the less the sooner.
        let lopsided = if smaller < count / 8 {
            (count - smaller) as f64 * 8.0
        } else {
            0.0
        };
        let cost = first.spread() + second.spread() + lopsided;
        if found.is_none_or(|(least, _)| cost < least) {
            found = Some((cost, at + 1));
        }
    }
    found
}
