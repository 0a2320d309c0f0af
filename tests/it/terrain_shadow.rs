use bevy::prelude::*;
use bevy_skyline::{offline::*, prelude::*, terrain_shadow::{ShadowMethod, light::GridLight}};
use bevy::math::{DVec3, DAffine3};

fn cpu_ms() -> f64 {
    let s = std::fs::read_to_string("/proc/self/stat").unwrap();
    let f: Vec<&str> = s.rsplit(')').next().unwrap().split_whitespace().collect();
    (f[11].parse::<f64>().unwrap() + f[12].parse::<f64>().unwrap()) * 10.0
}

#[test]
fn probe() {
    let mut off = Offline::new().unwrap();
    let path = std::env::var("DEM").unwrap_or("../shared/data/dem/taiwan_central_range_1024.png".into());
    let (field, _) = bevy_skyline::terrain::read_height_field(std::path::Path::new(&path), &Default::default()).unwrap();
    let local = field.local_from_grid();
    let size = field.size();
    let handle = off.app.world_mut().resource_mut::<Assets<HeightField>>().add(field);
    off.app.world_mut().spawn(Terrain::new(handle.clone()));
    for el in [45.0f64, 20.0, 5.0] {
        let (s, c) = (el.to_radians().sin(), el.to_radians().cos());
        let az = 0.7f64;
        let light = GridLight::directional(DVec3::new(c * az.sin(), s, c * az.cos()), 0.0, DAffine3::IDENTITY * local);
        let mut base: Option<Vec<u8>> = None;
        for (m, l, strips) in [(ShadowMethod::PerTexel, light, 0), (ShadowMethod::MaxMip, light, 0), (ShadowMethod::Sweep, light, 0)] {
            if m == ShadowMethod::PerTexel && size.x > 2048 { continue; }
            off.cast_shadow(handle.id(), &l, m, strips, 1).unwrap();
            let c0 = cpu_ms();
            let runs = if m == ShadowMethod::PerTexel { 1 } else { 8 };
            let (img, mut times) = off.cast_shadow(handle.id(), &l, m, strips, runs).unwrap();
            let cpu = (cpu_ms() - c0) / runs as f64;
            times.sort_by(f64::total_cmp);
            let lit = img.visibility.iter().filter(|v| **v > 127).count() as f64 / img.visibility.len() as f64;
            let b = base.get_or_insert(img.visibility.clone());
            let diff = b.iter().zip(&img.visibility).filter(|(a, b)| (**a > 127) != (**b > 127)).count();
            println!("el {el} {m:?}: best {:.1} ms cpu {cpu:.1} lit {lit:.4} differs {diff}", times[0]);
        }
    }
}
