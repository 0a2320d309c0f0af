//! What decides which objects a frame draws: nothing, the frustum, P4's baselines, a fixed threshold, or the budget.

use core::{any::TypeId, fmt, ops::RangeInclusive, str::FromStr};

use bevy::{camera::visibility::VisibleEntities, prelude::*};

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

impl Policy {
    /// The same kind with another number; without one, the same.
    pub(super) fn with_parameter(self, number: f64) -> Self {
        match self {
            Self::Polygons(_) => Self::Polygons(number.max(1.0) as u64),
            Self::Distance(_) => Self::Distance(number as f32),
            Self::Threshold(_) => Self::Threshold(number as f32),
            Self::None | Self::Frustum | Self::Budget => self,
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

/// On a camera: of the objects in view, those with at least so many triangles and at most so many are drawn. For telling
/// what objects cost from what triangles do.
#[derive(Component, Clone, Debug, PartialEq)]
pub(super) struct Only(pub RangeInclusive<u32>);

/// Adds [`Only`] to an app.
pub(super) struct OnlyPlugin;

impl Plugin for OnlyPlugin {
    fn build(&self, app: &mut App) {
        app.add_systems(
            PostUpdate,
            keep_only
                .in_set(CullSystems)
                // No camera has both; the order is for certainty's sake.
                .after(CullSteps::Occlusion),
        );
    }
}

/// Takes what is not to be drawn out of each camera's list, which keeps its order.
fn keep_only(mut cameras: Query<(&Only, &mut VisibleEntities)>, objects: Query<&Triangles>) {
    for (only, mut visible) in &mut cameras {
        visible
            .get_mut(TypeId::of::<Mesh3d>())
            .retain(|entity| objects.get(*entity).is_ok_and(|of| only.0.contains(&of.0)));
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
}
