//! Z-buffer occlusion culling (P2): what a camera's own depth buffer hides is not drawn.
//!
//! # How a frame goes
//! 1. **Predict** (main world, after Bevy's `CheckVisibility`). The newest depth that has come back from the GPU,
//!    with the camera that made it, says which candidates were hidden then. They are taken out of the camera's
//!    `VisibleEntities`, in order.
//! 2. **Draw** what is left, as ever.
//! 3. **Recheck** (GPU, in the same frame). The depth just drawn is reduced to the farthest depth of small blocks,
//!    and every removed entity, where it stands *now*, is tested against it from where the camera stands *now*.
//!    What is not hidden behind what was just drawn is drawn too, before anything that reads the picture.
//! 4. **Read back**, some frames late and never waited for: the reduced depth, the camera that made it, and what
//!    the recheck had to rescue.
//!
//! # Why nothing visible goes missing
//! A removed entity is left out of a frame's picture only if its volume lies, from that frame's camera, strictly
//! behind that frame's depth at every pixel it could cover. That depth was drawn from that frame's entities at
//! that frame's places. Nothing in this depends on the frame that the prediction came from: camera cuts, fast
//! flight, moving occluders and occludees, changed lenses and viewports can make a prediction wrong, and then the
//! recheck pays for it by drawing late; they cannot make the picture wrong.

pub(crate) mod camera;
pub mod depth;
pub mod meshes;
pub mod obb;
pub mod pace;
pub mod proxy;
pub mod verdict;

use bevy::{
    diagnostic::{Diagnostic, RegisterDiagnostic},
    prelude::*,
};

pub use camera::{OcclusionCamera, OcclusionCounts};

use crate::{
    culling::{CullSteps, CulledEntities},
    effects::{Effect, is_called_for},
    systems::{candidates, occlusion as systems},
};

/// On a camera: what its own depth buffer hides is not drawn.
///
/// Occluders are whatever the camera draws opaque, terrain included. Candidates are entities with `Mesh3d` and an
/// opaque or alpha-masked material; see [`NoOcclusionCulling`] for how to leave one out.
///
/// ```
/// # mod headless { include!(concat!(env!("CARGO_MANIFEST_DIR"), "/src/doc_app.rs")); }
/// # let mut app = headless::app();
/// # let target = headless::target();
/// use bevy::prelude::*;
/// use bevy_skyline::prelude::*;
///
/// # let world = app.world_mut();
/// let camera = world
///     .spawn((Camera3d::default(), Msaa::Off, target, ZBufferOcclusion::default()))
///     .id();
/// # app.update();
///
/// // What became of it, for a game to show:
/// let counts = app.world().get::<OcclusionCounts>(camera).expect("required by the culling");
/// assert_eq!(counts.removed, 0);
/// // and why: here there is no GPU, whose depth could tell.
/// let effects = app.world().resource::<Effects>();
/// assert!(matches!(effects.occlusion(), EffectState::Unsupported(_)));
/// ```
#[derive(Component, Reflect, Clone, Debug, PartialEq)]
#[reflect(Component, Default, Clone, Debug, PartialEq)]
#[require(OcclusionCamera, CulledEntities, OcclusionCounts)]
pub struct ZBufferOcclusion {
    /// What stands for an object when it is tested.
    pub volume: OccludeeVolume,
    /// How the depth buffer is read.
    pub sampling: DepthSampling,
    /// Whether each removed object is tested again against the frame's own depth.
    pub recheck: Recheck,
    /// From so many meshes in view on, the prediction is made by the GPU. The verdicts are the same.
    /// default: 50,000
    pub gpu_from: usize,
    /// Whether culling rests while it costs more than it saves. default: true
    pub rests: bool,
}

impl Default for ZBufferOcclusion {
    fn default() -> Self {
        Self {
            volume: OccludeeVolume::default(),
            sampling: DepthSampling::default(),
            recheck: Recheck::default(),
            gpu_from: 50_000,
            rests: true,
        }
    }
}

/// What stands for an object when it is tested. All of them enclose the object.
#[derive(Reflect, Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[reflect(Default, Clone, Debug, PartialEq, Hash)]
pub enum OccludeeVolume {
    /// The entity's `Aabb`, a box along its mesh's axes.
    Aabb,
    /// That box, and where it is not hidden the one along the axes of the covariance of the mesh's vertices (P2, §3.2),
    /// if that is the smaller one.
    #[default]
    Obb,
    /// Both boxes, and where neither is hidden a simplified mesh (P2, §4.4) whose triangles are thickened until they
    /// enclose the object.
    Proxy {
        /// Most triangles of the simplified mesh. P2 uses about 100.
        triangles: u32,
    },
}

/// How the depth buffer is read.
#[derive(Reflect, Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[reflect(Default, Clone, Debug, PartialEq, Hash)]
pub enum DepthSampling {
    /// The farthest depth of every block of `block` × `block` pixels: no pixel goes unread, so that nothing
    /// visible is taken for hidden.
    Conservative {
        /// Side of a block; 0 stands for the smallest that leaves at most a million blocks: 1 up to 1280×720, 2 at
        /// 1920×1080, 3 at 3840×2160. units: px, range: 0..=64, default: 0
        block: u32,
    },
    /// One pixel in every `x` columns and `y` rows, and nothing else (P2, §4.3: its "5×4 mode"). What is seen
    /// only between these pixels is wrongly taken for hidden.
    Strided {
        /// Columns from one pixel read to the next. range: 1..=64
        x: u32,
        /// Rows from one pixel read to the next. range: 1..=64
        y: u32,
    },
}

impl Default for DepthSampling {
    fn default() -> Self {
        Self::Conservative { block: 0 }
    }
}

/// Whether each removed object is tested again against the frame's own depth.
#[derive(Reflect, Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[reflect(Default, Clone, Debug, PartialEq, Hash)]
pub enum Recheck {
    /// In the same frame, on the GPU; what turns out visible is drawn in that frame.
    #[default]
    SameFrame,
    /// Not: the prediction, some frames old, is final. Cheaper, runs on GPUs that cannot draw indirectly, and
    /// shows what comes into view a frame or more late.
    Never,
}

/// On an entity with a mesh: it is never removed by [`ZBufferOcclusion`]. It still hides others.
///
/// ```
/// # mod headless { include!(concat!(env!("CARGO_MANIFEST_DIR"), "/src/doc_app.rs")); }
/// # let mut app = headless::app();
/// # let target = headless::target();
/// use bevy::prelude::*;
/// use bevy_skyline::prelude::*;
///
/// # let world = app.world_mut();
/// # let cube = world.resource_mut::<Assets<Mesh>>().add(Cuboid::from_length(1.0));
/// world.spawn((Camera3d::default(), Msaa::Off, target, ZBufferOcclusion::default()));
/// let ahead = Transform::from_xyz(0.0, 0.0, -10.0);
/// let crate_ = world.spawn((Mesh3d(cube.clone()), ahead)).id();
/// // Its vertex shader makes it larger than its bound.
/// let flag = world.spawn((Mesh3d(cube), ahead, NoOcclusionCulling)).id();
/// # app.update();
///
/// // A game can ask whether anybody sees it.
/// app.add_systems(Update, move |culling: Culling| {
///     assert!(culling.is_seen(crate_) && culling.is_seen(flag));
/// });
/// # app.update();
/// ```
#[derive(Component, Reflect, Clone, Copy, Debug, Default, PartialEq, Eq)]
#[reflect(Component, Default, Clone, Debug, PartialEq)]
pub struct NoOcclusionCulling;

/// Registers types, resources and main-world systems.
pub(crate) fn register(app: &mut App) {
    candidates::register(app);
    app.register_type::<ZBufferOcclusion>()
        .register_type::<NoOcclusionCulling>()
        .register_type::<OcclusionCounts>()
        .init_resource::<systems::OcclusionDiagnosticPaths>()
        .add_systems(
            PostUpdate,
            (systems::cull_occluded, systems::forget_occluded)
                .chain()
                .run_if(is_called_for::<ZBufferOcclusion>(Effect::ZBufferOcclusion))
                .in_set(CullSteps::Occlusion),
        );
    for path in [systems::CANDIDATES, systems::REMOVED, systems::RESCUED] {
        app.register_diagnostic(Diagnostic::new(path));
    }
    app.register_diagnostic(Diagnostic::new(systems::CPU_MS).with_suffix(" ms"));
}
