//! Whether a scene calls for an effect: asked once a frame, as the scene is extracted. All else that the effect has in the
//! render world asks only what the answer was.

use core::marker::PhantomData;

use bevy::{
    prelude::*,
    render::{Extract, GpuResourceAppExt},
};

/// Whether any entity has a component that asks for an effect.
#[derive(Resource)]
pub struct CalledFor<C: Component> {
    is_asked_for: bool,
    is_called_for: bool,
    of: PhantomData<fn() -> C>,
}

impl<C: Component> Default for CalledFor<C> {
    fn default() -> Self {
        Self {
            // What the last device was told is taken back on the next, should nothing ask any more.
            is_asked_for: true,
            is_called_for: true,
            of: PhantomData,
        }
    }
}

/// Adds the question to the render app; [`ask`] is to be put before what extracts.
pub fn init<C: Component>(render_app: &mut SubApp) {
    render_app.init_gpu_resource::<CalledFor<C>>();
}

/// Asks. What is asked for no more is called for once more, so that all is freed and said to be.
pub fn ask<C: Component>(asking: Extract<Query<(), With<C>>>, mut called: ResMut<CalledFor<C>>) {
    let is_asked_for = !asking.is_empty();
    let called = &mut *called;
    called.is_called_for =
        core::mem::replace(&mut called.is_asked_for, is_asked_for) || is_asked_for;
}

/// Run condition: the answer.
pub fn is_called_for<C: Component>(called: Option<Res<CalledFor<C>>>) -> bool {
    called.is_some_and(|called| called.is_called_for)
}
