//! What a frame budget can move: the registry, and how values get to components and back.
//!
//! # What is the user's stays the user's
//! The value that a component has when the budget takes its knob is kept as the best one, whatever the knob's first
//! step says: steps that are no cheaper do nothing. A value that someone else writes meanwhile is the new best. When
//! the budget, its camera or the component goes, what was found is put back, unless it was overwritten since.

use bevy::{
    ecs::{component::Mutable, entity::EntityHashMap},
    prelude::*,
};

pub use super::knob::{Knob, KnobCost, KnobError, KnobStep};
use super::{BudgetSystems, FrameBudget, is_awake};

/// Everything that a [`FrameBudget`] may move. Knobs of what is not in the scene are not listed.
///
/// Another plugin adds its own with [`AppKnobs`].
#[derive(Resource, Default)]
pub struct Knobs {
    /// Those in the scene first, each part in the order of registration.
    list: Vec<Knob>,
    present: usize,
}

impl Knobs {
    /// Every knob in the scene.
    pub fn iter(&self) -> impl ExactSizeIterator<Item = &Knob> {
        self.list[..self.present].iter()
    }

    /// A knob, in the scene or not.
    pub fn get(&self, name: &str) -> Option<&Knob> {
        self.list.iter().find(|knob| knob.name == name)
    }

    /// Adds a knob. It is in the scene until [`set_present`](Self::set_present) says otherwise; whoever adds it reads
    /// its [`value`](Knob::value) each frame and applies it.
    ///
    /// # Errors
    /// [`KnobError::Known`] if there is one of that name.
    pub fn register(&mut self, knob: Knob) -> Result<(), KnobError> {
        let name = knob.name;
        self.register_absent(knob)?;
        self.set_present(name, true);
        Ok(())
    }

    /// All that are in the scene go back to their best.
    pub(crate) fn rest(&mut self) {
        for knob in &mut self.list[..self.present] {
            knob.rest();
        }
    }

    pub(crate) fn register_absent(&mut self, mut knob: Knob) -> Result<(), KnobError> {
        if self.get(knob.name).is_some() {
            return Err(KnobError::Known(knob.name));
        }
        knob.is_present = false;
        knob.order = self.list.len();
        self.list.push(knob);
        Ok(())
    }

    /// Takes a knob out of the budget's hand, or gives it back. Says whether there is such a knob and step.
    pub fn set_manual(&mut self, name: &str, step: Option<usize>) -> bool {
        match self.get_mut(name) {
            Some(knob) if step.is_none_or(|step| step < knob.steps.len()) => {
                knob.manual = step;
                true
            }
            _ => false,
        }
    }

    /// Says whether what a knob moves is in the scene. Says whether there is such a knob.
    pub fn set_present(&mut self, name: &str, is_present: bool) -> bool {
        let Some(knob) = self.get_mut(name) else {
            return false;
        };
        if knob.is_present != is_present {
            knob.is_present = is_present;
            if !is_present {
                knob.rest();
            }
            self.list.sort_by_key(|knob| (!knob.is_present, knob.order));
            self.present = self.list.iter().filter(|knob| knob.is_present).count();
        }
        true
    }

    /// Those in the scene.
    pub(crate) fn present_mut(&mut self) -> &mut [Knob] {
        &mut self.list[..self.present]
    }

    pub(crate) fn get_mut(&mut self, name: &str) -> Option<&mut Knob> {
        self.list.iter_mut().find(|knob| knob.name == name)
    }
}

/// Which entities a knob moves the component of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum KnobOn {
    /// Active cameras with a [`FrameBudget`].
    Cameras,
    /// All, while there is such a camera.
    Everything,
}

/// How an app gets knobs of its own.
///
/// ```
/// # use bevy::prelude::*;
/// # use bevy_skyline::budget::knobs::*;
/// #[derive(Component)]
/// struct Grass {
///     blades_per_m2: f32,
/// }
///
/// fn plugin(app: &mut App) {
///     // From the best to the cheapest, with the share of the picture that each step costs.
///     let steps = [(400.0, 0.0), (200.0, 0.004), (100.0, 0.012)];
///     match Knob::new("grass_density", "1/m²", &steps, KnobCost::Measured) {
///         Ok(knob) => app
///             .register_component_knob::<Grass>(
///                 knob,
///                 KnobOn::Everything,
///                 |grass| grass.blades_per_m2,
///                 |grass, value| grass.blades_per_m2 = value,
///             )
///             .unwrap_or_else(|problem| error!("{problem}")),
///         Err(problem) => error!("{problem}"),
///     }
/// }
/// ```
pub trait AppKnobs {
    /// Adds a knob that whoever adds it applies.
    ///
    /// # Errors
    /// [`KnobError::Known`] if there is one of that name.
    fn register_knob(&mut self, knob: Knob) -> Result<(), KnobError>;

    /// Adds a knob that is a number in a component. `read` says what stands there, in the knob's unit, and `write` puts
    /// it; what `write` puts `read` must say. It is in the scene while the component is.
    ///
    /// # Errors
    /// [`KnobError::Known`] if there is one of that name.
    fn register_component_knob<C: Component<Mutability = Mutable>>(
        &mut self,
        knob: Knob,
        on: KnobOn,
        read: fn(&C) -> f32,
        write: fn(&mut C, f32),
    ) -> Result<(), KnobError>;
}

impl AppKnobs for App {
    fn register_knob(&mut self, knob: Knob) -> Result<(), KnobError> {
        let mut knobs = self.world_mut().get_resource_or_init::<Knobs>();
        knobs.register(knob)
    }

    fn register_component_knob<C: Component<Mutability = Mutable>>(
        &mut self,
        knob: Knob,
        on: KnobOn,
        read: fn(&C) -> f32,
        write: fn(&mut C, f32),
    ) -> Result<(), KnobError> {
        let name = knob.name;
        let mut knobs = self.world_mut().get_resource_or_init::<Knobs>();
        knobs.register_absent(knob)?;
        let drive = move |knobs: ResMut<Knobs>,
                          held: Local<EntityHashMap<Held>>,
                          cameras: Query<(Entity, &Camera), With<FrameBudget>>,
                          components: Query<(Entity, &mut C)>| {
            drive(name, on, read, write, knobs, held, cameras, components);
        };
        // Traces and schedules call it so, instead of a closure of this function.
        let drive = IntoSystem::into_system(drive).with_name("bevy_skyline::budget::knobs::drive");
        self.add_systems(
            First,
            drive.in_set(BudgetSystems::ApplyKnobs).run_if(is_awake),
        );
        Ok(())
    }
}

/// A component in the budget's hand.
#[derive(Clone, Copy, Debug)]
pub struct Held {
    /// What the user had there, and what the budget put.
    found: f32,
    put: f32,
    is_there: bool,
}

/// Puts a knob's value into its components, or back what was found there.
#[expect(clippy::too_many_arguments, reason = "a system's parameters")]
fn drive<C: Component<Mutability = Mutable>>(
    name: &'static str,
    on: KnobOn,
    read: fn(&C) -> f32,
    write: fn(&mut C, f32),
    mut knobs: ResMut<Knobs>,
    mut held: Local<EntityHashMap<Held>>,
    cameras: Query<(Entity, &Camera), With<FrameBudget>>,
    mut components: Query<(Entity, &mut C)>,
) {
    let Some(knob) = knobs.get_mut(name) else {
        return;
    };
    let is_asked = cameras.iter().any(|(_, camera)| camera.is_active);
    let is_held = |entity: Entity| match on {
        KnobOn::Everything => is_asked,
        KnobOn::Cameras => cameras
            .get(entity)
            .is_ok_and(|(_, camera)| camera.is_active),
    };
    for entry in held.values_mut() {
        entry.is_there = false;
    }
    for (entity, mut component) in &mut components {
        let current = read(&component);
        let known = held.get(&entity).copied();
        if !is_held(entity) {
            if let Some(entry) = known
                && current == entry.put
                && current != entry.found
            {
                write(&mut component, entry.found);
            }
            continue;
        }
        let mut entry = known.unwrap_or(Held {
            found: current,
            put: current,
            is_there: true,
        });
        if current != entry.put {
            entry.found = current;
        }
        entry.is_there = true;
        let value = knob.value_for(entry.found);
        if value != current {
            write(&mut component, value);
        }
        entry.put = read(&component);
        held.insert(entity, entry);
    }
    held.retain(|_, entry| entry.is_there);
    // Steps up to here are no cheaper than what any of the users' own settings are.
    let is_idle = |value: f32| {
        held.values()
            .all(|entry| knob.cheaper_of(entry.found, value) == entry.found)
    };
    knob.idle_up_to = knob
        .steps
        .iter()
        .skip(1)
        .take_while(|step| is_idle(step.value))
        .count();
    let is_present = !held.is_empty();
    if !is_present {
        *held = EntityHashMap::default();
    }
    knobs.set_present(name, is_present);
}
