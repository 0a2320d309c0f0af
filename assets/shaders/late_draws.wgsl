// Readies for drawing, of the meshes that were predicted hidden, those that are not.
//
// One invocation a mesh instance of the late view, as Bevy's `mesh_preprocess.wgsl` has for its views; what is
// written is the same, but the instances that the recheck found hidden are left out.
//
// Contribution culling does the same with the instances of the camera's own view, after `forget_draws`, with the bits
// of those that are too small.

#import bevy_pbr::mesh_preprocess_types::{
    IndirectParametersCpuMetadata, IndirectParametersGpuMetadata, MeshInput, PreprocessWorkItem,
}
#import bevy_pbr::mesh_types::Mesh
#import bevy_render::maths

struct LateDraws {
    /// Number of the frame, as in `MeshInput::timestamp`.
    frame: u32,
};

const NO_SLOT: u32 = 0xffffffffu;

/// Which occludee a `MeshInput` is.
@group(0) @binding(0) var<storage, read> slot_of_input: array<u32>;
/// A bit each occludee: hidden behind this frame's depth.
@group(0) @binding(1) var<storage, read> hidden: array<u32>;
@group(0) @binding(2) var<storage, read> late: LateDraws;
@group(0) @binding(3) var<storage, read> current_input: array<MeshInput>;
@group(0) @binding(4) var<storage, read> previous_input: array<MeshInput>;
@group(0) @binding(5) var<storage, read> work_items: array<PreprocessWorkItem>;
@group(0) @binding(6) var<storage, read_write> output: array<Mesh>;
@group(0) @binding(7) var<storage, read> cpu_metadata: array<IndirectParametersCpuMetadata>;
@group(0) @binding(8) var<storage, read_write> gpu_metadata: array<IndirectParametersGpuMetadata>;

/// Forgets the instances that draws have had so far. Once for each mesh instance, all of a draw's alike.
@compute @workgroup_size(64)
fn forget_draws(@builtin(global_invocation_id) id: vec3<u32>) {
    if id.x < arrayLength(&work_items) {
        let draw = work_items[id.x].output_or_indirect_parameters_index;
        atomicStore(&gpu_metadata[draw].early_instance_count, 0u);
    }
}

@compute @workgroup_size(64)
fn late_draws(@builtin(global_invocation_id) id: vec3<u32>) {
    if id.x >= arrayLength(&work_items) {
        return;
    }
    let input_index = work_items[id.x].input_index;
    let draw = work_items[id.x].output_or_indirect_parameters_index;
    // The first instance of each draw says which mesh it is.
    if id.x == 0u || work_items[id.x - 1u].output_or_indirect_parameters_index != draw {
        gpu_metadata[draw].mesh_index = input_index;
    }
    // What has no slot was not tested, and is drawn.
    if input_index < arrayLength(&slot_of_input) {
        let slot = slot_of_input[input_index];
        if slot != NO_SLOT && (hidden[slot >> 5u] & (1u << (slot & 31u))) != 0u {
            return;
        }
    }

    let input = current_input[input_index];
    var previous_world_from_local = input.world_from_local;
    if input.timestamp == late.frame && input.previous_input_index != 0xffffffffu {
        previous_world_from_local = previous_input[input.previous_input_index].world_from_local;
    }
    let local_from_world_transpose =
        transpose(maths::inverse_affine3(transpose(input.world_from_local)));

    let place = cpu_metadata[draw].base_output_index
        + atomicAdd(&gpu_metadata[draw].early_instance_count, 1u);
    output[place].world_from_local = input.world_from_local;
    output[place].previous_world_from_local = previous_world_from_local;
    output[place].local_from_world_transpose_a = mat2x4<f32>(
        vec4<f32>(local_from_world_transpose[0].xyz, local_from_world_transpose[1].x),
        vec4<f32>(local_from_world_transpose[1].yz, local_from_world_transpose[2].xy),
    );
    output[place].local_from_world_transpose_b = local_from_world_transpose[2].z;
    output[place].flags = input.flags;
    output[place].lightmap_uv_rect = input.lightmap_uv_rect;
    output[place].first_vertex_index = input.first_vertex_index;
    output[place].current_skin_index = input.current_skin_index;
    output[place].material_and_lightmap_bind_group_slot =
        input.material_and_lightmap_bind_group_slot;
    output[place].tag = input.tag;
    output[place].morph_descriptor_index = input.morph_descriptor_index;
}
