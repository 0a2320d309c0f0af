//! What a user asks of interior culling.

use bevy::prelude::*;

/// On the root of a model, a spawned glTF scene for instance: what cannot be seen from anywhere outside it is taken out.
/// See [what is guaranteed](super#what-is-guaranteed) of what is seen.
///
/// Once everything below it has loaded and is still, what is hidden is found in the background, on a thread of the lowest
/// priority; then hidden entities are hidden, and hidden triangles left out of meshes. A mesh that several of its
/// entities share is trimmed to what is seen in any of them, and still shared. How it stands is said by
/// [`Effects::interior`](crate::effects::Effects::interior), what it took out by [`InteriorCounts`](super::InteriorCounts).
/// With the component gone, everything is as it was, and nothing is held.
///
/// # What it takes for a wall
/// Entities with a `StandardMaterial` of [`AlphaMode::Opaque`] that transmits no light; from its front alone if it has a
/// `cull_mode`. Other materials of its kind are taken out where they cannot be seen, and hide nothing. Left alone, and no
/// walls either, is what may be drawn elsewhere than its triangles say or not from everywhere: other materials, skins,
/// morph targets, a `depth_bias`, a `VisibilityRange`, other `RenderLayers` than the root's, what `Visibility` hides, and
/// [`NoInteriorCulling`](super::NoInteriorCulling). Left alone for another reason are meshes that cannot be read, as they
/// are in the render world only. [`Effects`](crate::effects::Effects) counts them.
///
/// # When something changes
/// A part that moves, comes, goes, is hidden or shown, or gets another mesh or material can uncover what is hidden: then
/// all is restored in that very frame, and done again when the model has been left alone for eight frames; for twice as
/// many each time it was in vain, up to 256. What was found is remembered for models that are the same. The root itself
/// may move, and be hidden and shown, as it likes. Parts that move all the time are to have
/// [`NoInteriorCulling`](super::NoInteriorCulling).
///
/// # Limits
/// - It is for eyes *outside*: a camera that goes into the model finds holes. So does a light in it: what it shines at
///   from behind walls may be lit, as the walls' inner sides are taken out.
/// - What moves parts in `PostUpdate` after `TransformSystems::Propagate` is answered a frame late.
/// - `Mesh3d` of a part is another handle while the part is trimmed: whoever takes a part's mesh for a collider takes it
///   before, and a clone of a trimmed part stays trimmed. Original meshes are kept for when they are wanted again, so
///   that GPU memory grows by the trimmed ones. Meshes of triangle strips are not trimmed.
/// - A mesh is handed to the renderer whole: a trimmed one of millions of triangles holds up the frame in which Bevy
///   uploads it, as the original did.
/// - A model within another, with its own `InteriorCulling`, is not part of the outer one.
///
/// ```
/// # mod headless { include!(concat!(env!("CARGO_MANIFEST_DIR"), "/src/doc_app.rs")); }
/// # let mut app = headless::app();
/// use bevy::prelude::*;
/// use bevy_skyline::prelude::*;
///
/// # let world = app.world_mut();
/// # let [housing, gear] = [2.0, 1.0].map(|side| {
/// #     let mesh = Mesh3d(world.resource_mut::<Assets<Mesh>>().add(Cuboid::from_length(side)));
/// #     let paint = world.resource_mut::<Assets<StandardMaterial>>().add(StandardMaterial::default());
/// #     (mesh, MeshMaterial3d(paint))
/// # });
/// // A box with a smaller one in it; a game would have `WorldAssetRoot(assets.load("engine.glb#Scene0"))` here.
/// let culling = InteriorCulling { grid: InteriorGrid::Resolution(16), ..default() };
/// let engine = world.spawn((Transform::default(), Visibility::default(), culling)).id();
/// world.spawn((housing, ChildOf(engine)));
/// let gear = world.spawn((gear, ChildOf(engine))).id();
///
/// // It is worked out in the background.
/// while app.world().get::<InteriorCounts>(engine).is_none() {
///     app.update();
/// }
/// let hidden = app.world().get::<InheritedVisibility>(gear).expect("a mesh has it");
/// assert!(!hidden.get());
/// ```
#[derive(Component, Reflect, Clone, Debug, PartialEq)]
#[reflect(Component, Default, Clone, Debug, PartialEq)]
pub struct InteriorCulling {
    /// How fine it looks.
    pub grid: InteriorGrid,
    /// What is taken out.
    pub level: InteriorLevel,
    /// Which surfaces count as seen.
    pub mode: InteriorMode,
    /// Whether what is behind transparent materials is seen.
    pub transparent: InteriorTransparent,
    /// Whether one-sided materials are seen through from behind.
    pub faces: InteriorFaces,
    /// Where the directed distance field is made; what is found is the same.
    pub field: FieldBy,
    /// How much memory lattice, field and snapped vertices may take. In an app the meshes' copies come to that, with
    /// [`InteriorMode::Sampled`] a record for each step at which a surface is met. default: 1024, units: MiB
    pub memory_mib: u32,
}

impl Default for InteriorCulling {
    fn default() -> Self {
        Self {
            grid: InteriorGrid::default(),
            level: InteriorLevel::default(),
            mode: InteriorMode::default(),
            transparent: InteriorTransparent::default(),
            faces: InteriorFaces::default(),
            field: FieldBy::default(),
            memory_mib: 1024,
        }
    }
}

/// How fine interior culling looks; see [what is guaranteed](super#what-is-guaranteed).
#[derive(Reflect, Clone, Copy, Debug, PartialEq)]
#[reflect(Default, Clone, Debug, PartialEq)]
pub enum InteriorGrid {
    /// So many cells on the model's longest side. default: 256
    Resolution(u32),
    /// What a ball so wide can touch from outside stays. units: of the model's frame, in Bevy m
    Gap(f32),
}

impl Default for InteriorGrid {
    fn default() -> Self {
        Self::Resolution(256)
    }
}

/// What is taken out.
#[derive(Reflect, Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[reflect(Default, Clone, Debug, PartialEq, Hash)]
pub enum InteriorLevel {
    /// Nodes of which no triangle is seen.
    Node,
    /// Triangles that are not seen.
    #[default]
    Triangle,
}

/// Which surfaces count as seen.
#[derive(Reflect, Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[reflect(Default, Clone, Debug, PartialEq, Hash)]
pub enum InteriorMode {
    /// What is met first on a step from a point outside to one that is not (P5a): with a coarse grid, much that is seen
    /// is missed.
    Sampled,
    /// All that is within 1½ spacings of a point outside.
    #[default]
    Conservative,
}

/// Whether what is behind transparent materials is seen.
#[derive(Reflect, Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[reflect(Default, Clone, Debug, PartialEq, Hash)]
pub enum InteriorTransparent {
    /// It is.
    #[default]
    Open,
    /// They hide like all others (P5a).
    Closed,
}

/// Whether one-sided materials are seen through from behind.
#[derive(Reflect, Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[reflect(Default, Clone, Debug, PartialEq, Hash)]
pub enum InteriorFaces {
    /// They are, as they are not drawn.
    #[default]
    AsDrawn,
    /// They hide from both sides (P5a).
    TwoSided,
}

/// Where the directed distance field is made; see [`gpu`](super::gpu).
#[derive(Reflect, Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[reflect(Default, Clone, Debug, PartialEq, Hash)]
pub enum FieldBy {
    /// On threads of the lowest priority, which frames do not wait for.
    #[default]
    Cpu,
    /// On the app's GPU, beside its frames; on the CPU if that fails.
    Gpu,
}
