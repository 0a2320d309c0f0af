//! Interior culling and the spherical index over more and more triangles, cells and views: on the CPU.

use bevy::{
    math::{DAffine3, DVec3},
    mesh::VertexAttributeValues,
    platform::time::Instant,
    prelude::*,
};
use indicatif::ProgressBar;

use super::{Curve, Plan};
use crate::{
    interior::{InteriorCulling, InteriorGrid, Progress, cull},
    offline::{
        accuracy::{
            AccuracyError, Timing,
            interior::{machine::machine, threads},
        },
        scenes::bunnies,
    },
    spherical::{Eye, MapSettings, Shown, SphericalChunks, SphericalIndex, SphericalMaps, View},
};

/// Directions that an index is asked from.
const EYES: u32 = 64;

/// Finding what cannot be seen: over triangles with one grid, and over grids with one model.
pub(super) fn interior(
    plan: Plan,
    progress: &ProgressBar,
    curves: &mut Vec<Curve>,
) -> Result<(), AccuracyError> {
    let threads = threads();
    let curve = |of, way: String| Curve {
        effect: "interior",
        of,
        way,
        points: Vec::new(),
        adapter: format!("the CPU, {threads} threads"),
    };
    let run = |model: &crate::interior::Model, grid: u32| -> Result<Timing, AccuracyError> {
        let settings = InteriorCulling {
            grid: InteriorGrid::Resolution(grid),
            memory_mib: 1 << 14,
            ..default()
        };
        let mut times = Vec::new();
        for _ in 0..plan.rounds().min(3) {
            let outcome = cull(model, &settings, threads, &Progress::default())
                .map_err(AccuracyError::Interior)?;
            times.push(
                outcome
                    .took
                    .iter()
                    .map(|took| took.as_secs_f64() * 1e3)
                    .sum(),
            );
        }
        Ok(Timing::of(times))
    };
    let (sizes, grids): (&[usize], &[u32]) = if plan.quick {
        (&[12_500, 50_000, 200_000, 1_000_000], &[32, 64, 128, 256])
    } else {
        (
            &[50_000, 200_000, 800_000, 3_200_000],
            &[32, 64, 128, 256, 512],
        )
    };
    let mut of_triangles = curve(
        "triangles",
        "a machine, 64 cells on its longest side".to_owned(),
    );
    for &size in sizes {
        progress.set_message(format!("interior of {size} triangles"));
        let machine = machine(size);
        let parts = machine.model.parts.iter();
        let triangles: usize = parts.map(|part| part.surface.triangles.len()).sum();
        of_triangles
            .points
            .push((triangles as f64, run(&machine.model, 64)?));
        progress.inc(1);
    }
    let mut of_cells = curve("cells", "a machine of 50,000 triangles".to_owned());
    let machine = machine(50_000);
    for &grid in grids {
        progress.set_message(format!("interior of {grid} cells a side"));
        of_cells
            .points
            .push((f64::from(grid).powi(3), run(&machine.model, grid)?));
        progress.inc(1);
    }
    curves.extend([of_triangles, of_cells]);
    Ok(())
}

/// Making an index, asking it for one view, and asking it for many.
pub(super) fn spherical(
    plan: Plan,
    progress: &ProgressBar,
    curves: &mut Vec<Curve>,
) -> Result<(), AccuracyError> {
    let curve = |of, way: &str| Curve {
        effect: "spherical",
        of,
        way: way.to_owned(),
        points: Vec::new(),
        adapter: "the CPU, 1 thread".to_owned(),
    };
    let mut made = curve("triangles", "making an index");
    let mut asked = curve("triangles", "selecting for one view");
    let mut of_views = curve("views", "selecting for all views");
    let sizes: &[u32] = if plan.quick {
        &[2_000, 8_000, 32_000, 128_000]
    } else {
        &[4_000, 16_000, 64_000, 256_000, 1_024_000]
    };
    for (at, &size) in sizes.iter().enumerate() {
        progress.set_message(format!("an index of {size} triangles"));
        let Some((positions, triangles)) = raw(&bunnies::bumpy_mesh(size)) else {
            continue;
        };
        let count = triangles.len() as f64;
        let settings = SphericalIndex::default();
        let mut times = Vec::new();
        let mut chunks = SphericalChunks::default();
        for _ in 0..plan.rounds().min(5) {
            let began = Instant::now();
            let maps = MapSettings {
                bins: settings.bins,
                chunk_triangles: settings.chunk_triangles,
                ..default()
            };
            let index = SphericalMaps::build(&positions, &triangles, maps)
                .and_then(|maps| SphericalChunks::build(&positions, &triangles, &maps));
            times.push(began.elapsed().as_secs_f64() * 1e3);
            chunks = index.unwrap_or_default();
        }
        made.points.push((count, Timing::of(times)));
        let mut ranges = Vec::new();
        let mut select = |number: u32| {
            let began = Instant::now();
            let eye = 3.0 * around(number);
            let camera = Eye::perspective(eye, 0.75, [1920.0, 1080.0], 0.01);
            let view = View::new(&camera, &DAffine3::IDENTITY, chunks.reach(), Shown::Front);
            core::hint::black_box(chunks.select(&view, &[], &mut ranges));
            began.elapsed().as_secs_f64() * 1e3
        };
        let times = (0..EYES).map(&mut select).collect();
        asked.points.push((count, Timing::of(times)));
        if at + 1 == sizes.len() {
            for views in [1, 4, 16, 64] {
                let times = (0..plan.rounds())
                    .map(|_| (0..views).map(&mut select).sum())
                    .collect();
                of_views.points.push((f64::from(views), Timing::of(times)));
            }
        }
        progress.inc(1);
    }
    curves.extend([made, asked, of_views]);
    Ok(())
}

/// Evenly around, by the golden angle.
fn around(number: u32) -> DVec3 {
    let y = 1.0 - (2.0 * f64::from(number) + 1.0) / f64::from(EYES);
    let (sin, cos) = (f64::from(number) * 2.399_963_229_728_653).sin_cos();
    let across = (1.0 - y * y).sqrt();
    DVec3::new(across * cos, y, across * sin)
}

/// A mesh's corners and triangles.
type Raw = (Vec<[f32; 3]>, Vec<[u32; 3]>);

fn raw(mesh: &Mesh) -> Option<Raw> {
    let VertexAttributeValues::Float32x3(positions) = mesh.attribute(Mesh::ATTRIBUTE_POSITION)?
    else {
        return None;
    };
    let corners: Vec<u32> = mesh.indices()?.iter().map(|index| index as u32).collect();
    let (triangles, _) = corners.as_chunks::<3>();
    Some((positions.clone(), triangles.to_vec()))
}
