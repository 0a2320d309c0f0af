//! How many meshes a camera does not show, by reason.
//!
//! The reasons are those of [`Culling::reason`](crate::culling::Culling::reason), counted without asking it for every
//! mesh: what a camera draws and what Skyline removed are lists whose lengths are known, what is hidden or on other
//! layers takes a look at each mesh, and what is left is out of view. Linear in the meshes, no memory.

use bevy::camera::visibility::RenderLayers;

/// Meshes of the scene as one camera sees them. The counts but `all` add up to `all`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ReasonCounts {
    /// Entities with `Mesh3d`.
    pub all: usize,
    /// Among the camera's visible entities.
    pub drawn: usize,
    /// [`CullReason::Hidden`](crate::culling::CullReason::Hidden).
    pub hidden: usize,
    /// [`CullReason::Layers`](crate::culling::CullReason::Layers).
    pub layers: usize,
    /// [`CullReason::Frustum`](crate::culling::CullReason::Frustum).
    pub frustum: usize,
    /// [`CullReason::Contribution`](crate::culling::CullReason::Contribution).
    pub contribution: usize,
    /// [`CullReason::Occluded`](crate::culling::CullReason::Occluded).
    pub occluded: usize,
    /// With `NoCpuCulling`: only the GPU knows.
    pub gpu: usize,
}

/// What of a mesh decides, for cameras that do not show it.
#[derive(Clone, Copy, Debug)]
pub struct MeshState<'a> {
    /// Whether nothing above it, nor itself, is hidden.
    pub inherited_visible: bool,
    /// Its layers; `None` is the default layer.
    pub layers: Option<&'a RenderLayers>,
    /// Whether it has `NoCpuCulling`.
    pub no_cpu_culling: bool,
    /// Whether it is one of those removed, which are counted already. Only of one that is hidden or on other layers
    /// does it matter: what the GPU removes is known frames later.
    pub removed: bool,
}

impl ReasonCounts {
    /// Counts what is not among the `drawn`, the `contribution` and the `occluded` meshes of a camera that shows
    /// `layers`.
    pub fn of<'a>(
        meshes: impl Iterator<Item = MeshState<'a>>,
        layers: &RenderLayers,
        drawn: usize,
        contribution: usize,
        occluded: usize,
    ) -> Self {
        let default_layers = RenderLayers::default();
        let mut counts = Self {
            drawn,
            contribution,
            occluded,
            ..Self::default()
        };
        for mesh in meshes {
            counts.all += 1;
            if mesh.removed {
                continue;
            }
            if !mesh.inherited_visible {
                counts.hidden += 1;
            } else if !layers.intersects(mesh.layers.unwrap_or(&default_layers)) {
                counts.layers += 1;
            } else if mesh.no_cpu_culling {
                counts.gpu += 1;
            }
        }
        // What is drawn or removed is neither hidden nor on other layers, and the CPU saw it.
        counts.frustum = counts.all.saturating_sub(
            drawn + contribution + occluded + counts.hidden + counts.layers + counts.gpu,
        );
        counts
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_mesh_has_one_reason() {
        let other = RenderLayers::layer(3);
        let mesh = |inherited_visible, layers, no_cpu_culling| MeshState {
            inherited_visible,
            layers,
            no_cpu_culling,
            removed: false,
        };
        let meshes = [
            mesh(true, None, false),
            mesh(true, None, false),
            mesh(true, None, false),
            mesh(true, None, false),
            mesh(true, None, false),
            // Hidden comes before layers, as in `Culling::reason`.
            mesh(false, Some(&other), false),
            mesh(false, None, true),
            mesh(true, Some(&other), false),
            mesh(true, None, true),
        ];
        let counts = ReasonCounts::of(meshes.into_iter(), &RenderLayers::default(), 2, 1, 1);
        assert_eq!(
            counts,
            ReasonCounts {
                all: 9,
                drawn: 2,
                hidden: 2,
                layers: 1,
                frustum: 1,
                contribution: 1,
                occluded: 1,
                gpu: 1,
            }
        );
        let elsewhere = ReasonCounts::of(meshes.into_iter(), &other, 0, 0, 0);
        assert_eq!((elsewhere.layers, elsewhere.frustum), (6, 1));
        assert_eq!(elsewhere.all, 9);
        // Removed a few frames ago, and hidden since.
        let late = MeshState {
            removed: true,
            ..mesh(false, None, false)
        };
        let late = ReasonCounts::of([late].into_iter(), &other, 0, 1, 0);
        assert_eq!((late.hidden, late.frustum, late.contribution), (0, 0, 1));
    }
}
