//! Order among passes of Bevy's that cannot be named from outside of it.

use bevy::{
    core_pipeline::{
        core_3d::{main_opaque_pass_3d, main_transparent_pass_3d},
        schedule::{Core3d, Core3dSystems},
    },
    ecs::{
        schedule::{InternedSystemSet, NodeId, ScheduleConfigs},
        system::ScheduleSystem,
    },
    prelude::*,
};

/// What blends over the opaque picture between Bevy's opaque and its transparent pass, without being in
/// [`Core3dSystems::MainPass`]: the sky of its `Atmosphere`, with the air before what was drawn. It is told by its place,
/// as its system is private.
pub(super) fn over_opaque(render_app: &SubApp) -> Vec<InternedSystemSet> {
    let schedules = render_app.world().get_resource::<Schedules>();
    let Some(schedule) = schedules.and_then(|schedules| schedules.get(Core3d)) else {
        return Vec::new();
    };
    let graph = schedule.graph();
    let node = |set: InternedSystemSet| graph.system_sets.get_key(set).map(NodeId::Set);
    let (Some(opaque), Some(transparent)) = (
        node(main_opaque_pass_3d.into_system_set().intern()),
        node(main_transparent_pass_3d.into_system_set().intern()),
    ) else {
        return Vec::new();
    };
    let main_pass = node(Core3dSystems::MainPass.intern());
    let order = graph.dependency().graph();
    let is_over = |of: &NodeId| {
        order.contains_edge(*of, transparent)
            && !main_pass.is_some_and(|set| graph.hierarchy().graph().contains_edge(set, *of))
    };
    let systems = order.neighbors(opaque).filter(is_over);
    let systems = systems.filter_map(|of| graph.systems.get(of.as_system()?));
    let sets = systems.flat_map(|of| of.system().default_system_sets());
    sets.collect()
}

/// Passes that come before all of these.
pub(super) fn before_all(
    passes: ScheduleConfigs<ScheduleSystem>,
    of: &[InternedSystemSet],
) -> ScheduleConfigs<ScheduleSystem> {
    of.iter().fold(passes, |passes, set| passes.before(*set))
}
