//! The flight without a window: its pictures, a contact sheet, and how long its frames take without culling, with it,
//! and with a frame budget on top.

use bevy::{light::DirectionalLightShadowMap, prelude::*};
use bevy_skyline::{
    offline::{
        OfflineError,
        plot::{Axis, LinePlot, Series},
    },
    prelude::*,
};
use image::{RgbImage, imageops};

use super::{
    label::write,
    stage::{Film, StageError},
    world::{self, CutOpen, Flight, Scenery, Switches},
};

/// Frames after which background work is not waited for any longer.
const MOST_FRAMES: u32 = 5_000;
/// Frames before a flight that are not timed: pipelines are compiled, read-backs come in, the budget learns.
const WARM_FRAMES: u32 = 12;
/// How long a frame may work on the terrain's shadow map. units: ms
const SLICE_MS: f32 = 60.0;
/// Where along the flight the picture with culling is put beside the one without.
const SPLITS: [f32; 3] = [0.25, 0.5, 0.9];
/// When the tower is cut open, and from where: the way from its foot to the camera. units: m
const CUT_AT: f32 = 0.2;
/// See [`CUT_AT`].
const CUT_FROM_M: Vec3 = Vec3::new(84.0, 190.0, 50.0);
/// Columns and rows of the contact sheet.
const SHEET: [u32; 2] = [3, 4];

/// A flight's frames.
struct Takes {
    name: &'static str,
    times_ms: Vec<f64>,
    /// Pictures at [`SPLITS`].
    splits: Vec<RgbImage>,
}

/// Flies, and writes everything; or only pictures at some moments.
pub fn make(film: &mut Film, at: &[f32], target_ms: Option<f32>) -> Result<(), StageError> {
    if film.offline.is_software() {
        // Every texel of the shadow maps is drawn by the cores that do all else.
        let size = DirectionalLightShadowMap { size: 1024 };
        film.world().insert_resource(size);
    }
    let mut studio = Studio { film };
    if at.is_empty() {
        studio.film(target_ms)
    } else {
        studio.stills(at)
    }
}

struct Studio<'a> {
    film: &'a mut Film,
}

impl Studio<'_> {
    fn world(&mut self) -> &mut World {
        self.film.world()
    }

    /// Switches effects, and waits for what they do in the background; nothing is drawn meanwhile.
    fn switch(&mut self, switches: Switches) -> Result<(), StageError> {
        let camera = self.world().resource::<Scenery>().camera;
        self.world().insert_resource(switches);
        self.set_active(camera, false);
        let mut waited = 0;
        while !world::is_settled(self.world(), switches) {
            if waited == MOST_FRAMES {
                return Err(OfflineError::NotFinished(MOST_FRAMES).into());
            }
            self.film.offline.step();
            waited += 1;
        }
        self.set_active(camera, true);
        // From frame to frame the sun goes as far as in seconds of a flight in a window.
        let world = self.world();
        let mut shadows = world.query::<&mut TerrainShadow>();
        for mut shadow in shadows.iter_mut(world) {
            shadow.slice_ms = SLICE_MS;
        }
        Ok(())
    }

    fn set_active(&mut self, camera: Entity, is_active: bool) {
        if let Some(mut camera) = self.world().get_mut::<Camera>(camera) {
            camera.is_active = is_active;
        }
    }

    fn go_to(&mut self, share: f32) {
        self.world().resource_mut::<Flight>().share = share;
    }

    /// Pictures at some moments, with every effect but the budget.
    fn stills(&mut self, shares: &[f32]) -> Result<(), StageError> {
        self.switch(Switches::all(None))?;
        for &share in shares {
            self.go_to(share);
            self.film.offline.settle_shadows(200)?;
            self.film.offline.step();
            self.film.picture(&format!("at_{:04.0}", 1_000.0 * share))?;
        }
        Ok(())
    }

    /// The whole flight, three times.
    fn film(&mut self, target_ms: Option<f32>) -> Result<(), StageError> {
        let plain = self.fly("without culling", Switches::SHADOW_ALONE, false)?;
        let culled = self.fly("with culling", Switches::all(None), false)?;
        let target_ms = target_ms.unwrap_or(part(&culled.times_ms, 0.75) as f32);
        let held = self.fly(
            "with culling and a budget",
            Switches::all(Some(target_ms)),
            true,
        )?;
        let flights = [&plain, &culled, &held];
        self.write_splits(&culled, &plain)?;
        self.write_sheet()?;
        self.write_plot(&flights, target_ms)?;
        self.say(&flights, target_ms);
        self.write_cut_away()
    }

    /// Flies once from the start to the end, and keeps each picture if asked to.
    fn fly(
        &mut self,
        name: &'static str,
        switches: Switches,
        keep: bool,
    ) -> Result<Takes, StageError> {
        self.go_to(0.0);
        self.switch(switches)?;
        for _ in 0..WARM_FRAMES {
            self.film.offline.step();
        }
        let mut takes = Takes {
            name,
            times_ms: Vec::new(),
            splits: Vec::new(),
        };
        let frames = self.film.options.frames;
        let last = (frames - 1).max(1) as f32;
        let splits = SPLITS.map(|share| (share * last).round() as u32);
        for frame in 0..frames {
            self.go_to(frame as f32 / last);
            takes.times_ms.push(self.film.step());
            if keep {
                self.film.picture(&frame_name(frame))?;
            }
            for _ in splits.iter().filter(|split| **split == frame) {
                takes.splits.push(self.film.look()?);
            }
            if (frame + 1) % 8 == 0 || frame + 1 == frames {
                eprintln!("flyover: {name}: {} of {frames} frames", frame + 1);
            }
        }
        self.film.tell(name, takes.times_ms.clone());
        Ok(takes)
    }

    /// The left half with culling, the right half without, of the same moment, each with the time of its frame.
    fn write_splits(&self, culled: &Takes, plain: &Takes) -> Result<(), StageError> {
        let last = (self.film.options.frames - 1).max(1) as f32;
        for (index, (with, without)) in culled.splits.iter().zip(&plain.splits).enumerate() {
            let frame = (SPLITS[index.min(SPLITS.len() - 1)] * last).round() as usize;
            let (width, height) = with.dimensions();
            let mut picture = with.clone();
            let right = imageops::crop_imm(without, width / 2, 0, width - width / 2, height);
            imageops::replace(&mut picture, &right.to_image(), i64::from(width / 2), 0);
            for y in 0..height {
                picture.put_pixel(width / 2, y, image::Rgb([255; 3]));
            }
            let label = |takes: &Takes| {
                let time = takes.times_ms.get(frame).copied().unwrap_or_default();
                format!("{} {time:.0} ms", takes.name)
            };
            write(&mut picture, [12, 12], &label(culled));
            write(&mut picture, [width / 2 + 12, 12], &label(plain));
            self.film.write(&format!("split_{}", index + 1), &picture)?;
            println!(
                "  {:.2} % of all pixels differ between the two",
                100.0 * differing(with, without)
            );
        }
        Ok(())
    }

    /// The tower cut open, before interior culling on the left and after it on the right.
    fn write_cut_away(&mut self) -> Result<(), StageError> {
        self.go_to(CUT_AT);
        self.world().insert_resource(CutOpen);
        self.world().resource_mut::<Flight>().scripted = false;
        let (camera, landmark) = {
            let scenery = self.world().resource::<Scenery>();
            (scenery.camera, scenery.landmark)
        };
        let foot = self
            .world()
            .get::<Transform>(landmark)
            .map_or(Vec3::ZERO, |t| t.translation);
        let place = Transform::from_translation(foot + CUT_FROM_M)
            .looking_at(foot + Vec3::Y * (CUT_FROM_M.y - 34.0), Vec3::Y);
        if let Some(mut camera) = self.world().get_mut::<Transform>(camera) {
            *camera = place;
        }
        let mut halves = Vec::new();
        for interior in [false, true] {
            self.switch(Switches {
                interior,
                // The walls that hide what is inside are cut away.
                occlusion: false,
                ..Switches::all(None)
            })?;
            self.film.offline.settle_shadows(200)?;
            for _ in 0..3 {
                self.film.offline.step();
            }
            halves.push(self.film.look()?);
        }
        self.world().remove_resource::<CutOpen>();
        self.world().resource_mut::<Flight>().scripted = true;
        let counts = world::landmark_counts(self.world()).unwrap_or_default();
        let labels = [
            format!("as it is: {} triangles", counts.triangles),
            format!(
                "interior culling: {} triangles",
                counts.triangles - counts.hidden_triangles
            ),
        ];
        let (width, height) = halves[0].dimensions();
        let mut picture = RgbImage::new(width, height);
        for (index, (half, label)) in halves.iter().zip(&labels).enumerate() {
            let left = index as u32 * (width / 2);
            let middle = imageops::crop_imm(half, width / 4, 0, width / 2, height);
            imageops::replace(&mut picture, &middle.to_image(), i64::from(left), 0);
            write(&mut picture, [left + 12, 12], label);
        }
        self.film.write("cut_away", &picture)
    }

    /// Some of the frames on one page.
    fn write_sheet(&self) -> Result<(), StageError> {
        let [columns, rows] = SHEET;
        let count = (columns * rows).min(self.film.options.frames);
        let mut sheet: Option<RgbImage> = None;
        for index in 0..count {
            let frame = index * (self.film.options.frames - 1) / (count - 1).max(1);
            let path = self.film.path(&frame_name(frame));
            let picture = image::open(&path).map_err(|error| StageError::Write {
                path,
                reason: error.to_string(),
            })?;
            let (width, height) = (picture.width() / 3, picture.height() / 3);
            let (width, height) = (width.max(1), height.max(1));
            let small = picture.resize_exact(width, height, imageops::FilterType::Triangle);
            let sheet = sheet.get_or_insert_with(|| {
                RgbImage::new(columns * width, count.div_ceil(columns) * height)
            });
            let (x, y) = ((index % columns) * width, (index / columns) * height);
            imageops::replace(sheet, &small.into_rgb8(), i64::from(x), i64::from(y));
        }
        match sheet {
            Some(sheet) => self.film.write("contact_sheet", &sheet),
            None => Ok(()),
        }
    }

    fn write_plot(&self, flights: &[&Takes], target_ms: f32) -> Result<(), StageError> {
        let last = (self.film.options.frames - 1).max(1) as f64;
        let mut series: Vec<Series> = flights
            .iter()
            .map(|takes| Series {
                name: takes.name.into(),
                points: takes
                    .times_ms
                    .iter()
                    .enumerate()
                    .map(|(frame, ms)| (frame as f64 / last, *ms))
                    .collect(),
                quoted: false,
            })
            .collect();
        series.push(Series {
            name: format!("target {target_ms:.0} ms"),
            points: vec![(0.0, f64::from(target_ms)), (1.0, f64::from(target_ms))],
            quoted: true,
        });
        LinePlot {
            title: format!(
                "Frame times along the flight, {}",
                self.film.offline.adapter()
            ),
            x: Axis::linear("share of the flight"),
            y: Axis::linear("frame time, ms"),
            series,
        }
        .write(&self.film.path("frame_times"))
        .map_err(StageError::input)?;
        self.film.wrote("frame_times");
        Ok(())
    }

    /// How steady the flights were, and what is not drawn of the tower.
    fn say(&mut self, flights: &[&Takes], target_ms: f32) {
        for takes in flights {
            let times = &takes.times_ms;
            let mean = times.iter().sum::<f64>() / times.len() as f64;
            let variance = times.iter().map(|ms| (ms - mean).powi(2)).sum::<f64>();
            println!(
                "{}: mean {mean:.0} ms, standard deviation {:.0} ms",
                takes.name,
                (variance / times.len() as f64).sqrt(),
            );
        }
        println!("target: {target_ms:.0} ms");
        if let Some(counts) = world::landmark_counts(self.world()) {
            println!(
                "tower: {} of {} nodes and {} of {} triangles are not drawn",
                counts.hidden_nodes, counts.nodes, counts.hidden_triangles, counts.triangles
            );
        }
    }
}

fn frame_name(frame: u32) -> String {
    format!("frame_{frame:04}")
}

/// What so large a part of the frames does not exceed.
fn part(times: &[f64], share: f64) -> f64 {
    let mut sorted = times.to_vec();
    sorted.sort_by(f64::total_cmp);
    let at = (share * sorted.len() as f64) as usize;
    let last = sorted.len().saturating_sub(1);
    sorted.get(at.min(last)).copied().unwrap_or_default()
}

/// Share of the pixels that are visibly another colour.
fn differing(a: &RgbImage, b: &RgbImage) -> f64 {
    let differ =
        |(a, b): (&image::Rgb<u8>, &image::Rgb<u8>)| (0..3).any(|i| a.0[i].abs_diff(b.0[i]) > 8);
    let count = a
        .pixels()
        .zip(b.pixels())
        .filter(|pair| differ(*pair))
        .count();
    count as f64 / f64::from(a.width() * a.height()).max(1.0)
}
