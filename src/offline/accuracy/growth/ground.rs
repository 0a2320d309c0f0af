//! Terrain and its shadows over more and more samples of the same ground, and over more and more lights.

use bevy::{math::UVec2, prelude::*};
use indicatif::ProgressBar;

use super::{Curve, Plan};
use crate::{
    offline::{
        accuracy::{
            AccuracyError, Timing,
            scene::{mountains, views},
        },
        render::{Shot, Stage, Sun},
        shadow::method_name,
        shadow_map::{MapLight, MapStage},
        traversal_name,
    },
    terrain::{TerrainRayCasting, Traversal},
    terrain_shadow::ShadowMethod,
};

/// What takes longer is not measured at the next size. units: ms
const SLOW_MS: f64 = 4_000.0;
/// units: px
const PICTURE: UVec2 = UVec2::new(320, 180);

/// Curves of several ways over the same sizes: each ends where it gets too slow.
struct Curves(Vec<Curve>);

impl Curves {
    fn is_slow(&self, way: usize) -> bool {
        self.0[way]
            .points
            .last()
            .is_some_and(|(_, ms)| ms.median > SLOW_MS)
    }
}

/// Casting all rays of a picture of one size.
pub(super) fn terrain(
    plan: Plan,
    progress: &ProgressBar,
    curves: &mut Vec<Curve>,
) -> Result<(), AccuracyError> {
    let cast = |traversal, max_error_px| TerrainRayCasting {
        traversal,
        max_error_px,
        ..default()
    };
    let default = TerrainRayCasting::default();
    let ways = [
        cast(default.traversal, default.max_error_px),
        cast(Traversal::MaxMip, 0.0),
        cast(Traversal::PerTexel, 0.0),
    ];
    let mut own = Curves(
        ways.iter()
            .map(|way| Curve {
                effect: "terrain",
                of: "samples",
                way: format!("{}, {} px", traversal_name(way.traversal), way.max_error_px),
                points: Vec::new(),
                adapter: String::new(),
            })
            .collect(),
    );
    let sides: &[u32] = if plan.quick {
        &[65, 129, 257, 513, 1025]
    } else {
        &[65, 129, 257, 513, 1025, 2049, 4097]
    };
    for &side in sides {
        progress.set_message(format!("terrain of {side}×{side} samples"));
        let field = mountains(side)?;
        let [view, ..] = views(&field);
        let shot = Shot {
            size: PICTURE,
            casting: ways[0],
            ..Shot::new(view.eye, view.target)
        };
        let mut stage = Stage::new(field, &shot)?;
        stage.settle()?;
        for (at, way) in ways.iter().enumerate() {
            if own.is_slow(at) {
                continue;
            }
            stage.cast(*way);
            // The first waits for the driver's compiler, and the list of boxes for its size.
            for _ in 0..3 {
                stage.offline.step();
            }
            let times = (0..plan.rounds()).map(|_| stage.gpu_ms().0.values().sum());
            let ms = Timing::of(times.collect());
            own.0[at].points.push((f64::from(side * side), ms));
            own.0[at].adapter = stage.offline.adapter();
            progress.inc(1);
        }
    }
    curves.extend(own.0);
    Ok(())
}

/// One whole map of hard shadows of a sun; and, of one size, as many maps as there are lights.
pub(super) fn shadow(
    plan: Plan,
    progress: &ProgressBar,
    curves: &mut Vec<Curve>,
) -> Result<(), AccuracyError> {
    let sun = |azimuth_deg| MapLight::Sun {
        sun: Sun {
            azimuth_deg,
            elevation_deg: 20.0,
        },
        angular_size_deg: 0.0,
    };
    let ways = [
        ShadowMethod::MaxMip,
        ShadowMethod::PerTexel,
        ShadowMethod::Sweep,
    ];
    let curve = |of, way: String| Curve {
        effect: "shadow",
        of,
        way,
        points: Vec::new(),
        adapter: String::new(),
    };
    let mut own = Curves(
        ways.iter()
            .map(|way| curve("samples", method_name(*way).to_owned()))
            .collect(),
    );
    let sides: &[u32] = if plan.quick {
        &[64, 128, 256, 512, 1024]
    } else {
        &[64, 128, 256, 512, 1024, 2048, 4096]
    };
    let mut stage: Option<MapStage> = None;
    for &side in sides {
        progress.set_message(format!("shadows of {side}×{side} samples"));
        let field = mountains(side)?;
        let light = sun(235.0).over(&field);
        let stage = match &mut stage {
            Some(stage) => {
                stage.replace(field);
                stage
            }
            None => stage.insert(MapStage::new(field)?),
        };
        for (at, way) in ways.iter().enumerate() {
            if own.is_slow(at) {
                continue;
            }
            // The first waits for the driver's compiler.
            stage.cast(&light, *way, 0, 1)?;
            let (_, times) = stage.cast(&light, *way, 0, plan.rounds())?;
            own.0[at]
                .points
                .push((f64::from(side * side), Timing::of(times)));
            own.0[at].adapter = stage.offline.adapter();
            progress.inc(1);
        }
    }
    curves.extend(own.0);
    // Each light has a map of its own: whatever their number, what is told is their sum.
    let field = mountains(256)?;
    let lights: Vec<_> = (0..64u8)
        .map(|i| sun(f64::from(i) * 5.625).over(&field))
        .collect();
    if let Some(stage) = &mut stage {
        stage.replace(field);
        let way = ShadowMethod::default();
        let mut of_lights = curve("lights", format!("{}, 256×256 samples", method_name(way)));
        for count in [1, 4, 16, 64] {
            progress.set_message(format!("shadows of {count} lights"));
            let mut times = Vec::new();
            for _ in 0..plan.rounds() {
                let mut sum = 0.0;
                for light in &lights[..count] {
                    sum += stage.cast(light, way, 0, 1)?.1.iter().sum::<f64>();
                }
                times.push(sum);
            }
            of_lights.points.push((count as f64, Timing::of(times)));
            progress.inc(1);
        }
        of_lights.adapter = stage.offline.adapter();
        curves.push(of_lights);
    }
    Ok(())
}
