//! How a way to cull is named in tables and files.

use bevy::math::UVec2;
use serde::Serialize;

use crate::{
    occlusion::{DepthSampling, OccludeeVolume, Recheck, ZBufferOcclusion},
    offline::scenes::stage::Culling,
};

/// A setting, by the names of its flags.
#[derive(Serialize, Clone, Debug, PartialEq)]
pub struct Setting {
    /// `none`, `frustum`, `bevy`, `z-buffer`, or `z-buffer-prepass`: behind a depth prepass.
    pub culling: &'static str,
    /// What stands for an object.
    pub volume: Option<&'static str>,
    /// How the depth buffer is read.
    pub sampling: Option<String>,
    /// Whether each removed object is tested again.
    pub recheck: Option<&'static str>,
}

impl Setting {
    pub(super) fn of(culling: &Culling) -> Self {
        let (name, settings) = match culling {
            Culling::None => ("none", None),
            Culling::Frustum => ("frustum", None),
            Culling::Bevy => ("bevy", None),
            Culling::ZBuffer(settings) => ("z-buffer", Some(settings)),
            Culling::ZBufferAfterPrepass(settings) => ("z-buffer-prepass", Some(settings)),
        };
        Self {
            culling: name,
            volume: settings.map(|settings| match settings.volume {
                OccludeeVolume::Aabb => "aabb",
                OccludeeVolume::Obb => "obb",
                OccludeeVolume::Proxy { .. } => "proxy",
            }),
            sampling: settings.map(|settings| match settings.sampling {
                DepthSampling::Conservative { block: 0 } => "conservative".into(),
                DepthSampling::Conservative { block } => format!("conservative-{block}"),
                DepthSampling::Strided { x, y } => format!("strided-{x}x{y}"),
            }),
            recheck: settings.map(|settings| match settings.recheck {
                Recheck::SameFrame => "same-frame",
                Recheck::Never => "never",
            }),
        }
    }

    /// In words, for tables.
    pub(super) fn words(&self) -> String {
        [
            Some(self.culling),
            self.volume,
            self.sampling.as_deref(),
            self.recheck,
        ]
        .into_iter()
        .flatten()
        .collect::<Vec<_>>()
        .join(" ")
    }

    /// Whether it is ours with every setting at its default, behind a prepass or not.
    pub(super) fn is_default(&self) -> bool {
        let default = Self::of(&Culling::ZBuffer(ZBufferOcclusion::default()));
        self.volume == default.volume
            && self.sampling == default.sampling
            && self.recheck == default.recheck
    }

    /// Side of the blocks that depth is reduced to in pictures of a size, of conservative samplings. units: px
    pub(super) fn block_px(&self, size: UVec2) -> Option<u32> {
        let side = self.sampling.as_deref()?.strip_prefix("conservative")?;
        match side.strip_prefix('-') {
            Some(side) => side.parse().ok(),
            None => Some(DepthSampling::Conservative { block: 0 }.block(size).x),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn named(settings: ZBufferOcclusion) -> Setting {
        Setting::of(&Culling::ZBuffer(settings))
    }

    #[test]
    fn the_default_is_known_and_nothing_else_is_taken_for_it() {
        let default = ZBufferOcclusion::default;
        assert!(named(default()).is_default());
        assert!(Setting::of(&Culling::ZBufferAfterPrepass(default())).is_default());
        assert!(!Setting::of(&Culling::Bevy).is_default());
        for other in [
            ZBufferOcclusion {
                volume: OccludeeVolume::Aabb,
                ..default()
            },
            ZBufferOcclusion {
                sampling: DepthSampling::Conservative { block: 4 },
                ..default()
            },
            ZBufferOcclusion {
                recheck: Recheck::Never,
                ..default()
            },
        ] {
            assert!(!named(other.clone()).is_default(), "{other:?}");
        }
    }

    #[test]
    fn blocks_are_those_of_the_picture() {
        let side = |sampling, size| {
            let settings = ZBufferOcclusion {
                sampling,
                ..ZBufferOcclusion::default()
            };
            named(settings).block_px(size)
        };
        let [small, large] = [UVec2::new(1280, 720), UVec2::new(3840, 2160)];
        assert_eq!(side(DepthSampling::default(), small), Some(1));
        assert_eq!(side(DepthSampling::default(), large), Some(3));
        assert_eq!(
            side(DepthSampling::Conservative { block: 8 }, large),
            Some(8)
        );
        assert_eq!(side(DepthSampling::Strided { x: 5, y: 4 }, small), None);
        assert_eq!(Setting::of(&Culling::Frustum).block_px(small), None);
    }
}
