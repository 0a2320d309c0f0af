//! The one integration-test binary. It needs the features `cli`, `panel` and `window`, as `scripts/test.sh` sets them; tests
//! that draw need a Vulkan device, a software one will do.

#[path = "it/accuracy_all.rs"]
mod accuracy_all;
#[path = "it/accuracy_interior.rs"]
mod accuracy_interior;
#[path = "it/accuracy_spherical.rs"]
mod accuracy_spherical;
#[path = "it/allocations.rs"]
mod allocations;
#[path = "it/architecture.rs"]
mod architecture;
#[path = "it/budget_app.rs"]
mod budget_app;
#[path = "it/budget_controller.rs"]
mod budget_controller;
#[path = "it/budget_model.rs"]
mod budget_model;
#[path = "it/cause.rs"]
mod cause;
#[path = "it/cli.rs"]
mod cli;
#[path = "it/cli_interior.rs"]
mod cli_interior;
#[path = "it/cli_interior_errors.rs"]
mod cli_interior_errors;
#[path = "it/cli_occlusion.rs"]
mod cli_occlusion;
#[path = "it/cli_shadow.rs"]
mod cli_shadow;
#[path = "it/cli_workload.rs"]
mod cli_workload;
#[path = "it/contribution.rs"]
mod contribution;
#[path = "it/contribution_app.rs"]
mod contribution_app;
#[path = "it/data.rs"]
mod data;
#[path = "it/documents.rs"]
mod documents;
#[path = "it/effect_scene.rs"]
mod effect_scene;
#[path = "it/effect_toggling.rs"]
mod effect_toggling;
#[path = "it/examples.rs"]
mod examples;
#[path = "it/fits_in.rs"]
mod fits_in;
#[path = "it/fuzz.rs"]
mod fuzz;
#[path = "it/glb.rs"]
mod glb;
#[path = "it/hard_cases/mod.rs"]
mod hard_cases;
#[path = "it/height_field.rs"]
mod height_field;
#[path = "it/interior.rs"]
mod interior;
#[path = "it/interior_app.rs"]
mod interior_app;
#[path = "it/interior_field.rs"]
mod interior_field;
#[path = "it/interior_gltf.rs"]
mod interior_gltf;
#[path = "it/life_stage.rs"]
mod life_stage;
#[path = "it/loader.rs"]
mod loader;
#[path = "it/occludee_meshes.rs"]
mod occludee_meshes;
#[path = "it/occludee_obb.rs"]
mod occludee_obb;
#[path = "it/occludee_proxy.rs"]
mod occludee_proxy;
#[path = "it/occlusion_app.rs"]
mod occlusion_app;
#[path = "it/occlusion_cases.rs"]
mod occlusion_cases;
#[path = "it/occlusion_life.rs"]
mod occlusion_life;
#[path = "it/occlusion_motion.rs"]
mod occlusion_motion;
#[path = "it/occlusion_scenes.rs"]
mod occlusion_scenes;
#[path = "it/occlusion_twin.rs"]
mod occlusion_twin;
#[path = "it/panel.rs"]
mod panel;
#[path = "it/panel_window.rs"]
mod panel_window;
#[path = "it/query.rs"]
mod query;
#[path = "it/ray_cast.rs"]
mod ray_cast;
#[path = "it/registry.rs"]
mod registry;
#[path = "it/resolution.rs"]
mod resolution;
#[path = "it/robust_device.rs"]
mod robust_device;
#[path = "it/robust_found.rs"]
mod robust_found;
#[path = "it/robust_fuzz_heights.rs"]
mod robust_fuzz_heights;
#[path = "it/robust_fuzz_models.rs"]
mod robust_fuzz_models;
#[path = "it/robust_fuzz_settings.rs"]
mod robust_fuzz_settings;
#[path = "it/robust_fuzz_words.rs"]
mod robust_fuzz_words;
#[path = "it/robust_life.rs"]
mod robust_life;
#[path = "it/robust_settings.rs"]
mod robust_settings;
#[path = "it/robust_soak.rs"]
mod robust_soak;
#[path = "it/spherical.rs"]
mod spherical;
#[path = "it/spherical_app.rs"]
mod spherical_app;
#[path = "it/spherical_bunny.rs"]
mod spherical_bunny;
#[path = "it/spherical_check.rs"]
mod spherical_check;
#[path = "it/spherical_properties.rs"]
mod spherical_properties;
#[path = "it/spherical_published.rs"]
mod spherical_published;
#[path = "it/terrain_app.rs"]
mod terrain_app;
#[path = "it/terrain_cascades.rs"]
mod terrain_cascades;
#[path = "it/terrain_scenes.rs"]
mod terrain_scenes;
#[path = "it/terrain_shadow.rs"]
mod terrain_shadow;
#[path = "it/terrain_shadow_app.rs"]
mod terrain_shadow_app;
#[path = "it/terrain_shadow_twin.rs"]
mod terrain_shadow_twin;
#[path = "it/twin.rs"]
mod twin;
#[path = "it/workload.rs"]
mod workload;

/// A headless app, or `None` with the reason printed where this machine has no device at all.
fn device() -> Option<bevy_skyline::offline::Offline> {
    device_with(|_| {})
}

/// The same, with more in the app.
fn device_with(
    configure: impl FnOnce(&mut bevy::app::App),
) -> Option<bevy_skyline::offline::Offline> {
    match bevy_skyline::offline::Offline::with(configure) {
        Ok(offline) => Some(offline),
        Err(reason) => {
            println!("skipped: {reason}");
            None
        }
    }
}
