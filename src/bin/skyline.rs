//! probe
use bevy::prelude::*;
use bevy_skyline::{offline::Offline, prelude::*};
fn main() {
    let args: Vec<String> = std::env::args().collect();
    let img = image::open(&args[1]).unwrap().into_luma16();
    let (w, h) = img.dimensions();
    let spacing: f32 = args[2].parse().unwrap();
    let mut off = Offline::new().unwrap();
    println!("{}", off.adapter());
    let field = HeightField::from_u16(UVec2::new(w, h), spacing, (0.0, 4095.9375), img.into_raw()).unwrap();
    let handle = off.app.world_mut().resource_mut::<Assets<HeightField>>().add(field);
    off.app.world_mut().spawn(Terrain::new(handle));
    off.app.world_mut().spawn((DirectionalLight { illuminance: 8000.0, ..default() }, Transform::from_xyz(1.0, 0.7, 0.3).looking_at(Vec3::ZERO, Vec3::Y)));
    let size = UVec2::new(1600, 900);
    let target = off.target(size);
    let views = [("low", Vec3::new(30000.0, 2600.0, 60000.0), Vec3::new(50000.0, 1500.0, 20000.0)),
        ("high", Vec3::new(41000.0, 14000.0, 50000.0), Vec3::new(41000.0, 0.0, 40000.0))];
    let camera = off.camera(&target, (Msaa::Off, Transform::default(), TerrainRayCasting::default()));
    for (name, eye, at) in views {
        *off.app.world_mut().get_mut::<Transform>(camera).unwrap() = Transform::from_translation(eye).looking_at(at, Vec3::Y);
        for e in args[3].split(',') {
            let err: f32 = e.parse().unwrap();
            let mut base: Option<Vec<f32>> = None;
            for tr in args[4].split(',') {
                let (traversal, tau) = match tr { "c" => (Traversal::MaxMip, 16), "b" => (Traversal::PerTexel, 16), a if a.starts_with('a') => (Traversal::Boxes, a[1..].parse().unwrap()), a => (Traversal::Hybrid, a[1..].parse().unwrap()) };
                *off.app.world_mut().get_mut::<TerrainRayCasting>(camera).unwrap() = TerrainRayCasting { traversal, box_texels: tau, max_error_px: err };
                off.settle(camera, 40).unwrap();
                let n: usize = args[5].parse().unwrap();
                off.step();
                let mut runs: Vec<[f64; 4]> = (0..n).map(|_| off.time_cast(camera).unwrap()).collect();
                runs.sort_by(|a, b| a[3].total_cmp(&b[3]));
                let last = runs[0];
                let hits = off.hits(camera).unwrap().unwrap();
                let diff = match &base { None => { base = Some(hits.ndc_depth.clone()); 0 } Some(b) => b.iter().zip(&hits.ndc_depth).filter(|(a, b)| a != b).count() };
                println!("{name} E={err} {tr}: sub {:.1} box {:.1} beam {:.1} ray {:.1} total {:.1} | reads {:.2} max {} diff {diff} | {}", last[0], last[1], last[2], last[3], last.iter().sum::<f64>(), hits.mean_reads(), hits.reads().max().unwrap(), off.app.world().resource::<Effects>().terrain());
                off.picture(&target).unwrap().save(format!("/tmp/p_{name}_{tr}_{err}.png")).unwrap();
            }
        }
    }
}
