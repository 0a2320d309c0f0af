//! Values of flags.

use bevy::math::{DVec3, UVec2};
use bevy_skyline::{
    offline::{
        TRAVERSALS,
        accuracy::occlusion::{SCENES, SceneKind},
        render::Sun,
        shadow::METHODS,
        workload::{Clock, Policies},
    },
    terrain::Traversal,
    terrain_shadow::ShadowMethod,
};

fn numbers<const N: usize>(text: &str) -> Result<[f64; N], String> {
    let parts: Vec<_> = text
        .split(',')
        .map(|part| part.trim().parse::<f64>())
        .collect();
    let parts: Vec<f64> = parts
        .into_iter()
        .collect::<Result<_, _>>()
        .map_err(|_| format!("expected {N} numbers with commas between them"))?;
    if parts.iter().any(|part| !part.is_finite()) {
        return Err("the numbers must be finite".into());
    }
    parts
        .try_into()
        .map_err(|_| format!("expected {N} numbers with commas between them"))
}

pub(crate) fn vector(text: &str) -> Result<DVec3, String> {
    numbers(text).map(DVec3::from_array)
}

pub(crate) fn range(text: &str) -> Result<(f32, f32), String> {
    numbers(text).map(|[min, max]| (min as f32, max as f32))
}

pub(crate) fn sun(text: &str) -> Result<Sun, String> {
    numbers(text).map(|[azimuth_deg, elevation_deg]| Sun {
        azimuth_deg,
        elevation_deg,
    })
}

pub(crate) fn positive(text: &str) -> Result<f32, String> {
    let [value] = numbers(text)?;
    let value = value as f32;
    if value > 0.0 && value.is_finite() {
        Ok(value)
    } else {
        Err("must be positive".into())
    }
}

pub(crate) fn size(text: &str) -> Result<UVec2, String> {
    text.split_once(['x', 'X'])
        .and_then(|(w, h)| Some(UVec2::new(w.trim().parse().ok()?, h.trim().parse().ok()?)))
        .ok_or_else(|| {
            "expected width and height in pixels with an x between them, as 1280x720".into()
        })
}

pub(crate) fn traversal(text: &str) -> Result<Traversal, String> {
    TRAVERSALS
        .iter()
        .find(|(_, name)| *name == text)
        .map(|(traversal, _)| *traversal)
        .ok_or_else(|| "expected per-texel, max-mip, boxes or hybrid".into())
}

pub(crate) fn method(text: &str) -> Result<ShadowMethod, String> {
    METHODS
        .iter()
        .find(|(_, name)| *name == text)
        .map(|(method, _)| *method)
        .ok_or_else(|| "expected per-texel, max-mip or sweep".into())
}

pub(crate) fn scene(text: &str) -> Result<SceneKind, String> {
    SCENES
        .iter()
        .find(|(_, name)| *name == text)
        .map(|(kind, _)| *kind)
        .ok_or_else(|| "expected city, bunnies or seabed".into())
}

pub(crate) fn policies(text: &str) -> Result<Policies, String> {
    match text {
        "all" => Ok(Policies::All),
        _ => text.parse().map(Policies::One),
    }
}

pub(crate) fn clock(text: &str) -> Result<Clock, String> {
    [Clock::Time, Clock::Counted]
        .into_iter()
        .find(|clock| clock.name() == text)
        .ok_or_else(|| "expected time or counted".into())
}

pub(crate) fn number(text: &str) -> Result<f64, String> {
    numbers(text).map(|[value]| value)
}
