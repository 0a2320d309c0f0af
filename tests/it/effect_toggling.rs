//! Effects that come and go a thousand times leave nothing behind.

use std::collections::BTreeMap;

use bevy::{
    prelude::*,
    render::{
        render_resource::{BufferDescriptor, BufferUsages},
        renderer::RenderDevice,
    },
};

use crate::{
    allocations,
    effect_scene::{Asked, EFFECTS, Scene},
};

/// How often all effects come and go.
const TIMES: u32 = 1000;

/// The least that an effect has on the heap for a camera or a terrain. units: bytes
const LEAST_LEAK: i64 = 512;

/// They come for a frame, or two at times: what is on its way back from the GPU or in the background is then nobody's any more.
fn toggle(scene: &mut Scene, times: u32) {
    for i in 0..times {
        scene.ask(Asked::ALL);
        scene.steps(if i % 4 == 3 { 2 } else { 1 });
        scene.ask_for_nothing();
        scene.step();
    }
}

/// They come, are all at work, and go.
fn work_once(scene: &mut Scene) -> u64 {
    scene.ask(Asked::ALL);
    scene.settle(Asked::ALL);
    let held = scene.bytes().iter().sum();
    scene.ask_for_nothing();
    scene.steps(12);
    held
}

/// What is there once nothing is on its way any more.
fn at_rest(scene: &mut Scene) -> BTreeMap<&'static str, u64> {
    scene.steps(20);
    assert_eq!(scene.bytes(), [0; EFFECTS.len()]);
    assert!(scene.allocations().is_empty(), "{:?}", scene.allocations());
    scene.holdings()
}

/// What is in one of them otherwise than in the other.
fn changes(
    before: &BTreeMap<&'static str, u64>,
    after: &BTreeMap<&'static str, u64>,
) -> Vec<String> {
    let changed = before
        .iter()
        .filter(|(name, count)| after.get(*name) != Some(*count));
    changed
        .map(|(name, count)| format!("{name}: {count}, then {:?}", after.get(name)))
        .collect()
}

/// Set in a process that runs one test and no other.
const ALONE: &str = "SKYLINE_TEST_ALONE";
const NAME: &str = "effect_toggling::a_thousand_times_on_and_off_leave_nothing_behind";

/// A process of its own: the memory of others' tests is not to be taken for ours.
#[test]
fn a_thousand_times_on_and_off_leave_nothing_behind() {
    if std::env::var_os(ALONE).is_some() {
        come_and_go();
        return;
    }
    let program = std::env::current_exe().expect("it runs");
    let done = std::process::Command::new(program)
        .args([NAME, "--exact", "--nocapture", "--test-threads", "1"])
        .env(ALONE, "1")
        .output()
        .expect("it runs again");
    let said = String::from_utf8_lossy(&done.stdout);
    println!("{said}{}", String::from_utf8_lossy(&done.stderr));
    assert!(done.status.success());
    assert!(said.contains("1 passed"), "it was not run");
}

fn come_and_go() {
    let Some(mut scene) = Scene::new() else {
        return;
    };
    // Shaders are compiled, Bevy's own buffers have grown to their sizes.
    for _ in 0..2 {
        work_once(&mut scene);
        toggle(&mut scene, 10);
    }
    let held = work_once(&mut scene);
    let before = at_rest(&mut scene);
    let live_before = allocations::live();
    let mut grown = Vec::new();
    for _ in 0..4 {
        toggle(&mut scene, TIMES / 4);
        work_once(&mut scene);
        grown.push(allocations::live() - live_before);
    }
    let after = at_rest(&mut scene);
    println!("{after:?}");
    let changed = changes(&before, &after);
    assert!(changed.is_empty(), "after {TIMES} times: {changed:?}");
    println!(
        "{held} bytes on the GPU held each time; more on the heap after each quarter of {TIMES} times: {grown:?}"
    );
    // What Bevy and wgpu keep for themselves may grow a little; no effect keeps as little as this for one time on.
    let grown = allocations::live() - live_before;
    let most = LEAST_LEAK * i64::from(TIMES);
    assert!(grown < most, "{grown} of {most} bytes");
    let leaked = vec![1_u8; most as usize];
    assert!(
        allocations::live() - live_before > most / 2,
        "a leak is not noticed"
    );
    drop(leaked);

    // One buffer left behind is noticed, as is an entity.
    let device = scene.world().resource::<RenderDevice>().clone();
    let kept = device.create_buffer(&BufferDescriptor {
        label: Some("skyline_kept"),
        size: 64,
        usage: BufferUsages::STORAGE,
        mapped_at_creation: false,
    });
    let left = scene.world_mut().spawn_empty().id();
    scene.step();
    let changed = changes(&after, &scene.holdings());
    for name in ["entities", "buffers", "GPU allocations"] {
        assert!(
            changed.iter().any(|of| of.starts_with(name)),
            "{name}: {changed:?}"
        );
    }
    assert_eq!(scene.allocations().len(), 1);
    drop(kept);
    scene.world_mut().despawn(left);
    scene.steps(2);
    assert!(changes(&after, &scene.holdings()).is_empty());
}
