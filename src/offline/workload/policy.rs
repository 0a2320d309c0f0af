//! What decides which objects a frame draws: nothing, the frustum, P4's baselines, a fixed threshold, or the budget.

use core::{any::TypeId, fmt, str::FromStr};

use bevy::{
    camera::{primitives::Aabb, visibility::VisibleEntities},
    prelude::*,
};

use crate::culling::{CullSteps, CullSystems};

/// What decides which objects are drawn.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Policy {
    /// Everything is, in view or not.
    None,
    /// What is in view.
    Frustum,
    /// Of that, the nearest, until so many triangles are reached (P4's fixed polygon count).
    Polygons(u64),
    /// Of that, what is nearer than this (P4's fixed view distance). units: m
    Distance(f32),
    /// Of that, what covers at least so much, by [`ContributionCulling`](crate::contribution::ContributionCulling)
    /// (P4 itself). units: px²
    Threshold(f32),
    /// Of that, what [`FrameBudget`](crate::budget::FrameBudget) lets through.
    Budget,
}

impl Policy {
    /// Its kind alone: `polygons` and the like.
    pub fn kind(&self) -> &'static str {
        match self {
            Self::None => "none",
            Self::Frustum => "frustum",
            Self::Polygons(_) => "polygons",
            Self::Distance(_) => "distance",
            Self::Threshold(_) => "threshold",
            Self::Budget => "budget",
        }
    }

    /// The number behind the kind, if it has one.
    pub fn parameter(&self) -> Option<f64> {
        match *self {
            Self::Polygons(most) => Some(most as f64),
            Self::Distance(metres) => Some(f64::from(metres)),
            Self::Threshold(area) => Some(f64::from(area)),
            Self::None | Self::Frustum | Self::Budget => None,
        }
    }
}

impl fmt::Display for Policy {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Polygons(most) => write!(f, "polygons:{most}"),
            Self::Distance(metres) => write!(f, "distance:{metres}"),
            Self::Threshold(area) => write!(f, "threshold:{area}"),
            Self::None | Self::Frustum | Self::Budget => f.write_str(self.kind()),
        }
    }
}

impl FromStr for Policy {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (kind, number) = match text.split_once(':') {
            Some((kind, number)) => (kind, Some(number.trim())),
            None => (text, None),
        };
        let real = |what: &str, least: f32| {
            number
                .and_then(|number| number.parse::<f32>().ok())
                .filter(|value| value.is_finite() && *value >= least)
                .ok_or_else(|| format!("{kind} takes {what}"))
        };
        match (kind, number) {
            ("none", None) => Ok(Self::None),
            ("frustum", None) => Ok(Self::Frustum),
            ("budget", None) => Ok(Self::Budget),
            ("polygons", _) => number
                .and_then(|number| number.parse().ok())
                .filter(|most| *most > 0)
                .map(Self::Polygons)
                .ok_or_else(|| {
                    "polygons takes a whole number of triangles above 0, as polygons:300000".into()
                }),
            ("distance", _) => {
                real("metres above 0, as distance:650", f32::MIN_POSITIVE).map(Self::Distance)
            }
            ("threshold", _) => {
                real("square pixels, 0 or more, as threshold:16", 0.0).map(Self::Threshold)
            }
            ("none" | "frustum" | "budget", Some(_)) => Err(format!("{kind} takes no number")),
            _ => Err(
                "expected none, frustum, polygons:N, distance:M, threshold:A, budget or all".into(),
            ),
        }
    }
}

/// On an object: triangles of its mesh.
#[derive(Component, Clone, Copy, Debug)]
pub struct Triangles(pub u32);

/// On a camera: of the objects in view, which are drawn. Unlike
/// [`WorkloadPolicy`](crate::budget::WorkloadPolicy) it goes by the nearest point of a bound rather than by its middle,
/// or the ground would go before what stands on it; and it measures no areas, which the baselines do not need.
#[derive(Component, Clone, Copy, Debug, PartialEq)]
pub(super) enum Keep {
    /// The nearest, until the next would make it more triangles than these.
    Polygons(u64),
    /// Those of which some point is no farther. units: m
    Within(f32),
    /// Those with at least so many triangles and at most so many. For telling what objects cost from what triangles
    /// do.
    Between(u32, u32),
}

/// Adds the baselines to an app.
pub(super) struct PolicyPlugin;

impl Plugin for PolicyPlugin {
    fn build(&self, app: &mut App) {
        app.add_systems(
            PostUpdate,
            keep.in_set(CullSystems)
                // A camera has one or the other; the order is for certainty's sake.
                .after(CullSteps::Occlusion),
        );
    }
}

/// How far the nearest point of a bound is from an eye, if the object is turned, moved and scaled evenly. units: m
pub(super) fn distance_m(eye: Vec3, place: &GlobalTransform, bound: &Aabb) -> f32 {
    let local = place.affine().inverse().transform_point3(eye);
    let nearest = local.clamp(bound.min().into(), bound.max().into());
    place.transform_point(nearest).distance(eye)
}

/// One object in view.
#[derive(Clone, Copy)]
struct InView {
    at: usize,
    distance_m: f32,
    triangles: u32,
}

/// Takes what is not to be drawn out of each camera's list, which keeps its order.
fn keep(
    mut cameras: Query<(&Keep, &GlobalTransform, &mut VisibleEntities)>,
    objects: Query<(&Triangles, &GlobalTransform, &Aabb)>,
    mut scratch: Local<(Vec<InView>, Vec<bool>)>,
) {
    let (in_view, kept) = &mut *scratch;
    for (keep, place, mut visible) in &mut cameras {
        let eye = place.translation();
        let list = visible.get_mut(TypeId::of::<Mesh3d>());
        in_view.clear();
        kept.clear();
        kept.resize(list.len(), true);
        for (at, entity) in list.iter().enumerate() {
            // What has no bound yet stays.
            if let Ok((triangles, place, bound)) = objects.get(*entity) {
                in_view.push(InView {
                    at,
                    distance_m: distance_m(eye, place, bound),
                    triangles: triangles.0,
                });
            }
        }
        match *keep {
            Keep::Polygons(most) => {
                in_view.sort_unstable_by(|a, b| {
                    a.distance_m.total_cmp(&b.distance_m).then(a.at.cmp(&b.at))
                });
                let mut sum = 0;
                for object in in_view.iter() {
                    // Once it is reached nothing farther is drawn, however small.
                    sum += u64::from(object.triangles);
                    kept[object.at] = sum <= most;
                }
            }
            Keep::Within(metres) => {
                for object in in_view.iter() {
                    kept[object.at] = object.distance_m <= metres;
                }
            }
            Keep::Between(least, most) => {
                for object in in_view.iter() {
                    kept[object.at] = (least..=most).contains(&object.triangles);
                }
            }
        }
        let mut at = 0;
        list.retain(|_| {
            at += 1;
            kept[at - 1]
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn policies_are_read_back_and_wrong_ones_named() {
        for policy in [
            Policy::None,
            Policy::Frustum,
            Policy::Polygons(131_600),
            Policy::Distance(650.5),
            Policy::Threshold(0.0),
            Policy::Threshold(16.25),
            Policy::Budget,
        ] {
            assert_eq!(policy.to_string().parse(), Ok(policy));
        }
        for (wrong, names) in [
            ("", "expected"),
            ("nearest", "expected"),
            ("polygons", "polygons"),
            ("polygons:0", "polygons"),
            ("polygons:1.5", "polygons"),
            ("polygons:-3", "polygons"),
            ("distance:0", "distance"),
            ("distance:nan", "distance"),
            ("distance:inf", "distance"),
            ("threshold:-1", "threshold"),
            ("threshold:", "threshold"),
            ("budget:16", "no number"),
            ("none:1", "no number"),
        ] {
            let error = wrong.parse::<Policy>().expect_err(wrong);
            assert!(error.contains(names), "{wrong}: {error}");
        }
    }

    #[test]
    fn distance_is_to_the_nearest_point() {
        let bound = Aabb::from_min_max(Vec3::splat(-1.0), Vec3::splat(1.0));
        let place = GlobalTransform::from(
            Transform::from_xyz(10.0, 0.0, 0.0)
                .with_rotation(Quat::from_rotation_z(0.5))
                .with_scale(Vec3::splat(2.0)),
        );
        // A few roundings of numbers up to 20.
        let inside = distance_m(Vec3::new(10.5, 0.0, 0.0), &place, &bound);
        assert!(inside < 16.0 * 20.0 * f32::EPSILON, "{inside}");
        let unturned =
            GlobalTransform::from(Transform::from_xyz(10.0, 0.0, 0.0).with_scale(Vec3::splat(2.0)));
        assert_eq!(distance_m(Vec3::ZERO, &unturned, &bound), 8.0);
        let above = Vec3::new(15.0, 6.0, 0.0);
        assert_eq!(distance_m(above, &unturned, &bound), 5.0);
    }
}
