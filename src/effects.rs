//! Which effects a scene calls for, what they are doing, and why: in words a user can read.

use core::mem::{Discriminant, discriminant};

use bevy::{platform::collections::HashMap, prelude::*};

/// Every effect of the suite and the state it is in, updated each frame after rendering was set up. It counts as changed
/// when a state becomes one of another kind: `resource_changed::<Effects>` tells what begins, rests and ends.
///
/// ```
/// # use bevy::prelude::*;
/// # use bevy_skyline::prelude::*;
/// fn report(effects: Res<Effects>) {
///     info!("{}", effects.terrain());
/// }
/// ```
#[derive(Resource, Reflect, Clone, Debug)]
#[reflect(Resource, Default, Clone, Debug)]
pub struct Effects {
    states: HashMap<Effect, EffectState>,
    /// GPU memory held, whatever the state. units: bytes
    held: HashMap<Effect, u64>,
}

/// The effects of the suite that this version has, whatever of them is built.
#[derive(Reflect, Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[reflect(Clone, Debug, PartialEq, Hash)]
pub enum Effect {
    /// Terrain ray casting (P1).
    Terrain,
    /// Terrain shadow maps (P5b).
    TerrainShadow,
    /// Z-buffer occlusion culling (P2).
    ZBufferOcclusion,
    /// Contribution culling (P4).
    ContributionCulling,
    /// Interior culling (P5a).
    InteriorCulling,
    /// Spherical index of meshes (P3).
    SphericalIndex,
    /// Resolution scale of the main passes.
    ResolutionScale,
    /// The frame budget that moves the others' knobs (P4 and beyond).
    FrameBudget,
}

impl Effect {
    /// All of them.
    pub const ALL: [Self; 8] = [
        Self::Terrain,
        Self::TerrainShadow,
        Self::ZBufferOcclusion,
        Self::ContributionCulling,
        Self::InteriorCulling,
        Self::SphericalIndex,
        Self::ResolutionScale,
        Self::FrameBudget,
    ];

    /// The feature of this crate that the effect comes with, and whether the crate was built with it.
    const fn feature(self) -> (&'static str, bool) {
        match self {
            Self::Terrain | Self::TerrainShadow => ("terrain", cfg!(feature = "terrain")),
            Self::ZBufferOcclusion | Self::ContributionCulling => {
                ("culling", cfg!(feature = "culling"))
            }
            Self::InteriorCulling => ("interior", cfg!(feature = "interior")),
            Self::SphericalIndex => ("spherical", cfg!(feature = "spherical")),
            Self::ResolutionScale | Self::FrameBudget => ("budget", cfg!(feature = "budget")),
        }
    }

    /// Whether the crate was built with it.
    pub const fn is_built(self) -> bool {
        self.feature().1
    }
}

/// What is not built is unsupported, and what is built is dormant until it reports.
impl Default for Effects {
    fn default() -> Self {
        let missing = Effect::ALL.into_iter().filter(|effect| !effect.is_built());
        let states = missing.map(|effect| {
            let why = format!(
                "not built: enable bevy_skyline's feature `{}`",
                effect.feature().0
            );
            (effect, EffectState::Unsupported(why))
        });
        Self {
            states: states.collect(),
            held: HashMap::default(),
        }
    }
}

/// What an effect is doing.
#[derive(Reflect, Clone, Debug, Default, PartialEq)]
#[reflect(Default, Clone, Debug, PartialEq)]
pub enum EffectState {
    /// It cannot run here, and why.
    Unsupported(String),
    /// Nothing in the scene asks for it: no GPU memory, no pipeline, no pass, no work per entity.
    #[default]
    Dormant,
    /// Asked for, with nothing to do this frame, and why.
    Idle(String),
    /// At work.
    Active(Activity),
}

/// What an effect at work has done.
#[derive(Reflect, Clone, Debug, Default, PartialEq)]
#[reflect(Default, Clone, Debug, PartialEq)]
pub struct Activity {
    /// What ran, in words; warnings included.
    pub what: String,
    /// Time spent on the CPU. units: ms
    pub cpu_ms: f32,
    /// Time spent on the GPU, where it is measured (`RenderDiagnosticsPlugin`, on Vulkan and DirectX 12).
    /// units: ms
    pub gpu_ms: Option<f32>,
    /// GPU memory held; see [`Effects::bytes`], which tells it of effects that idle, too. units: bytes
    pub bytes: u64,
}

impl Effects {
    /// State of an effect: dormant if its plugin was not added; unsupported, with the feature of this crate that it lacks,
    /// if it [is not built](Effect::is_built).
    pub fn state(&self, effect: Effect) -> &EffectState {
        self.states.get(&effect).unwrap_or(&EffectState::Dormant)
    }

    /// GPU memory that an effect holds: at work, idle, or for one more frame after its last component has gone. units:
    /// bytes
    pub fn bytes(&self, effect: Effect) -> u64 {
        self.held.get(&effect).copied().unwrap_or(0)
    }

    /// State of terrain ray casting.
    pub fn terrain(&self) -> &EffectState {
        self.state(Effect::Terrain)
    }

    /// State of terrain shadow maps.
    pub fn terrain_shadow(&self) -> &EffectState {
        self.state(Effect::TerrainShadow)
    }

    /// State of Z-buffer occlusion culling.
    pub fn occlusion(&self) -> &EffectState {
        self.state(Effect::ZBufferOcclusion)
    }

    /// State of contribution culling.
    pub fn contribution(&self) -> &EffectState {
        self.state(Effect::ContributionCulling)
    }

    /// State of interior culling.
    pub fn interior(&self) -> &EffectState {
        self.state(Effect::InteriorCulling)
    }

    /// State of the spherical indices of meshes.
    pub fn spherical(&self) -> &EffectState {
        self.state(Effect::SphericalIndex)
    }

    /// State of resolution scale.
    pub fn resolution_scale(&self) -> &EffectState {
        self.state(Effect::ResolutionScale)
    }

    /// State of the frame budget.
    pub fn frame_budget(&self) -> &EffectState {
        self.state(Effect::FrameBudget)
    }

    /// Every effect that has reported, and every one that is not built.
    pub fn iter(&self) -> impl Iterator<Item = (Effect, &EffectState)> {
        self.states.iter().map(|(effect, state)| (*effect, state))
    }

    pub(crate) fn entry(&mut self, effect: Effect) -> &mut EffectState {
        self.states.entry(effect).or_default()
    }

    pub(crate) fn hold(&mut self, effect: Effect, bytes: u64) {
        self.held.insert(effect, bytes);
    }
}

/// Marks [`Effects`] as changed where a state is of another kind than in the last frame; what writes them does not.
pub(crate) fn note_changes(
    mut effects: ResMut<Effects>,
    mut known: Local<[Option<Discriminant<EffectState>>; Effect::ALL.len()]>,
) {
    let now = Effect::ALL.map(|effect| Some(discriminant(effects.state(effect))));
    if core::mem::replace(&mut *known, now) != now {
        effects.set_changed();
    }
}

/// Run condition: an entity has the component that asks for an effect, or had it until now, or the effect is not dormant yet
/// or still holds something.
///
/// What it guards does nothing in a scene that doesn't call for it, and is run once more when the last component is gone.
#[expect(
    clippy::type_complexity,
    reason = "a condition's type is what it looks at"
)]
pub(crate) fn is_called_for<C: Component>(
    effect: Effect,
) -> impl FnMut(Query<(), With<C>>, RemovedComponents<C>, Option<Res<Effects>>) -> bool + Clone {
    move |asking, mut removed, effects| {
        let was_removed = removed.read().count() > 0;
        let is_awake = effects.is_none_or(|effects| {
            *effects.state(effect) != EffectState::Dormant || effects.bytes(effect) > 0
        });
        !asking.is_empty() || was_removed || is_awake
    }
}

impl EffectState {
    /// Makes this [`EffectState::Active`] and returns its activity, keeping the text's memory.
    pub(crate) fn activity(&mut self) -> &mut Activity {
        if !matches!(self, Self::Active(_)) {
            *self = Self::Active(Activity::default());
        }
        match self {
            Self::Active(activity) => activity,
            _ => unreachable!("it was just made active"),
        }
    }

    /// Makes this [`EffectState::Idle`] for a reason; does nothing if it already is for that reason.
    pub(crate) fn idle(&mut self, why: &str) {
        if !matches!(self, Self::Idle(reason) if reason == why) {
            *self = Self::Idle(why.to_owned());
        }
    }
}

impl core::fmt::Display for EffectState {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Unsupported(why) => write!(f, "unsupported: {why}"),
            Self::Dormant => f.write_str("dormant: nothing in the scene asks for it"),
            Self::Idle(why) => write!(f, "idle: {why}"),
            Self::Active(activity) => {
                write!(
                    f,
                    "active: {}; CPU {:.2} ms",
                    activity.what, activity.cpu_ms
                )?;
                if let Some(gpu_ms) = activity.gpu_ms {
                    write!(f, ", GPU {gpu_ms:.2} ms")?;
                }
                write!(f, ", {:.1} MB", activity.bytes as f64 / 1e6)
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Resource, Default)]
    struct Heard(u32);

    #[test]
    fn only_a_state_of_another_kind_counts_as_changed() {
        let mut app = App::new();
        app.init_resource::<Effects>()
            .init_resource::<Heard>()
            .add_systems(
                Update,
                (|mut heard: ResMut<Heard>| heard.0 += 1).run_if(resource_changed::<Effects>),
            )
            .add_systems(Last, note_changes);
        // Written in one frame, heard of in the next.
        let mut heard_of = |write: &dyn Fn(&mut EffectState)| {
            let before = app.world().resource::<Heard>().0;
            let mut effects = app.world_mut().resource_mut::<Effects>();
            write(effects.bypass_change_detection().entry(Effect::FrameBudget));
            for _ in 0..3 {
                app.update();
            }
            app.world().resource::<Heard>().0 - before
        };
        heard_of(&|_| {});
        assert_eq!(heard_of(&|_| {}), 0);
        assert_eq!(heard_of(&|state| state.idle("nothing to do")), 1);
        assert_eq!(heard_of(&|state| state.idle("nothing else to do")), 0);
        assert_eq!(heard_of(&|state| state.activity().cpu_ms = 1.0), 1);
        assert_eq!(heard_of(&|state| state.activity().cpu_ms = 2.0), 0);
        assert_eq!(heard_of(&|state| *state = EffectState::Dormant), 1);
    }
}
