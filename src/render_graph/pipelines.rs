//! Bind group layouts and pipelines of the terrain's passes. A pipeline is queued when a view first needs it,
//! so an app without terrain compiles none.

use bevy::{
    asset::AssetServer,
    core_pipeline::{
        core_3d::CORE_3D_DEPTH_FORMAT,
        prepass::{MOTION_VECTOR_PREPASS_FORMAT, NORMAL_PREPASS_FORMAT},
    },
    pbr::{MeshPipeline, MeshPipelineKey},
    platform::collections::HashMap,
    prelude::*,
    render::render_resource::{
        binding_types::{
            sampler, storage_buffer_read_only_sized, storage_buffer_sized, texture_2d,
            texture_depth_2d, texture_storage_2d, uniform_buffer,
        },
        *,
    },
    shader::ShaderDefVal,
};

use super::{
    cascades::{GpuCascadeErosion, GpuCascadeWrite},
    height_mips::{GpuField, GpuMipLevel},
    shaders::terrain::Shaders,
    subdivide::GpuSubdividePass,
    terrain_shadow::{
        gpu::{GpuShadowLight, GpuSweep},
        maps::GpuLightMaps,
    },
    view::{GpuPlacement, GpuTerrainLook, GpuTerrainView},
};

/// Format of the nearest box's entry.
pub const BOX_ENTRY_FORMAT: TextureFormat = TextureFormat::R32Float;
/// Depth format while the nearest box is found.
pub const BOX_DEPTH_FORMAT: TextureFormat = TextureFormat::Depth32Float;

/// What distinguishes one pipeline of a pass from another.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum PipelineKey {
    HeightMips {
        float: bool,
    },
    Subdivide {
        float: bool,
    },
    BoxEntry {
        float: bool,
    },
    Beam {
        float: bool,
        fine: bool,
    },
    RayCast {
        float: bool,
        stop_at_depth: bool,
    },
    TerrainDepth {
        float: bool,
        samples: u32,
        normal: bool,
        motion: bool,
    },
    TerrainShade {
        float: bool,
        mesh: MeshPipelineKey,
        /// Whether the terrain has shadow maps.
        shadowed: bool,
    },
    TerrainShadow {
        float: bool,
        per_texel: bool,
        coarse: bool,
        penumbra: bool,
    },
    ShadowSweep {
        float: bool,
        penumbra: bool,
    },
    ShadowMips {
        float: bool,
    },
    /// `dips`, else `rows`, else columns.
    TerrainCascadeErode {
        dips: bool,
        rows: bool,
    },
    TerrainCascade,
}

/// A queued pipeline of either kind.
#[derive(Clone, Copy, Debug)]
pub enum PipelineId {
    Compute(CachedComputePipelineId),
    Render(CachedRenderPipelineId),
}

/// Layouts, shaders, and every pipeline queued so far.
#[derive(Resource)]
pub struct TerrainPipelines {
    pub height_mips: BindGroupLayoutDescriptor,
    field: [BindGroupLayoutDescriptor; 2],
    pub subdivide: BindGroupLayoutDescriptor,
    pub box_entry: BindGroupLayoutDescriptor,
    pub beam: BindGroupLayoutDescriptor,
    ray_cast: [BindGroupLayoutDescriptor; 2],
    pub terrain_depth: BindGroupLayoutDescriptor,
    terrain_shade: [BindGroupLayoutDescriptor; 2],
    shadow_field: [BindGroupLayoutDescriptor; 2],
    pub terrain_shadow: BindGroupLayoutDescriptor,
    pub shadow_sweep: BindGroupLayoutDescriptor,
    pub terrain_cascade_erode: BindGroupLayoutDescriptor,
    pub terrain_cascade: BindGroupLayoutDescriptor,
    height_mips_float: BindGroupLayoutDescriptor,
    shaders: Shaders,
    mesh_pipeline: MeshPipeline,
    queued: HashMap<PipelineKey, PipelineId>,
}

/// Builds [`TerrainPipelines`]; runs again after the device was lost.
pub fn init_terrain_pipelines(
    mut commands: Commands,
    assets: Res<AssetServer>,
    mesh_pipeline: Res<MeshPipeline>,
) {
    commands.insert_resource(TerrainPipelines::new(&assets, mesh_pipeline.clone()));
}

fn heights(float: bool) -> BindGroupLayoutEntryBuilder {
    texture_2d(if float {
        TextureSampleType::Float { filterable: false }
    } else {
        TextureSampleType::Uint
    })
}

impl TerrainPipelines {
    fn new(assets: &AssetServer, mesh_pipeline: MeshPipeline) -> Self {
        let unfiltered = || texture_2d(TextureSampleType::Float { filterable: false });
        let compute = ShaderStages::COMPUTE;
        let draw = ShaderStages::VERTEX_FRAGMENT;
        let all = ShaderStages::VERTEX_FRAGMENT | ShaderStages::COMPUTE;
        let mips = |label, float| {
            BindGroupLayoutDescriptor::new(
                label,
                &BindGroupLayoutEntries::sequential(
                    compute,
                    (
                        uniform_buffer::<GpuMipLevel>(true),
                        heights(float),
                        storage_buffer_sized(false, None),
                    ),
                ),
            )
        };
        let field = |label, float| {
            BindGroupLayoutDescriptor::new(
                label,
                &BindGroupLayoutEntries::sequential(
                    all,
                    (
                        uniform_buffer::<GpuField>(false),
                        heights(float),
                        storage_buffer_read_only_sized(false, None),
                        sampler(SamplerBindingType::NonFiltering),
                        uniform_buffer::<GpuTerrainView>(false),
                    ),
                ),
            )
        };
        Self {
            height_mips: mips("skyline_height_mips_u16", false),
            height_mips_float: mips("skyline_height_mips_f32", true),
            field: [
                field("skyline_field_u16", false),
                field("skyline_field_f32", true),
            ],
            subdivide: BindGroupLayoutDescriptor::new(
                "skyline_subdivide",
                &BindGroupLayoutEntries::sequential(
                    compute,
                    (
                        uniform_buffer::<GpuSubdividePass>(true),
                        storage_buffer_read_only_sized(false, None),
                        storage_buffer_sized(false, None),
                        storage_buffer_sized(false, None),
                        storage_buffer_sized(false, None),
                    ),
                ),
            ),
            box_entry: BindGroupLayoutDescriptor::new(
                "skyline_box_entry",
                &BindGroupLayoutEntries::single(
                    ShaderStages::VERTEX,
                    storage_buffer_read_only_sized(false, None),
                ),
            ),
            beam: BindGroupLayoutDescriptor::new(
                "skyline_beam",
                &BindGroupLayoutEntries::sequential(
                    compute,
                    (
                        storage_buffer_sized(false, None),
                        unfiltered(),
                        storage_buffer_read_only_sized(false, None),
                        storage_buffer_read_only_sized(false, None),
                    ),
                ),
            ),
            ray_cast: [false, true].map(|stop| {
                let entries = BindGroupLayoutEntries::sequential(
                    compute,
                    (
                        texture_storage_2d(
                            TextureFormat::R32Float,
                            StorageTextureAccess::ReadWrite,
                        ),
                        texture_storage_2d(TextureFormat::R32Uint, StorageTextureAccess::ReadWrite),
                        storage_buffer_read_only_sized(false, None),
                        unfiltered(),
                        storage_buffer_read_only_sized(false, None),
                    ),
                );
                let mut entries = entries.to_vec();
                if stop {
                    entries.push(texture_depth_2d().build(5, compute));
                }
                BindGroupLayoutDescriptor::new("skyline_ray_cast", &entries)
            }),
            terrain_depth: BindGroupLayoutDescriptor::new(
                "skyline_terrain_depth",
                &BindGroupLayoutEntries::sequential(
                    draw,
                    (
                        unfiltered(),
                        texture_2d(TextureSampleType::Uint),
                        uniform_buffer::<GpuPlacement>(false),
                    ),
                ),
            ),
            terrain_shade: [false, true].map(|shadowed| {
                let mut entries = BindGroupLayoutEntries::sequential(
                    draw,
                    (
                        unfiltered(),
                        texture_2d(TextureSampleType::Uint),
                        uniform_buffer::<GpuPlacement>(false),
                        uniform_buffer::<GpuTerrainLook>(false),
                        texture_2d(TextureSampleType::Float { filterable: true }),
                        sampler(SamplerBindingType::Filtering),
                    ),
                )
                .to_vec();
                if shadowed {
                    let fragment = ShaderStages::FRAGMENT;
                    entries.push(uniform_buffer::<GpuLightMaps>(false).build(6, fragment));
                    entries.push(storage_buffer_read_only_sized(false, None).build(7, fragment));
                }
                BindGroupLayoutDescriptor::new("skyline_terrain_shade", &entries)
            }),
            shadow_field: [false, true].map(|float| {
                BindGroupLayoutDescriptor::new(
                    "skyline_shadow_field",
                    &BindGroupLayoutEntries::sequential(
                        compute,
                        (
                            uniform_buffer::<GpuField>(false),
                            heights(float),
                            storage_buffer_read_only_sized(false, None),
                            sampler(SamplerBindingType::NonFiltering),
                        ),
                    ),
                )
            }),
            terrain_shadow: BindGroupLayoutDescriptor::new(
                "skyline_terrain_shadow",
                &BindGroupLayoutEntries::sequential(
                    compute,
                    (
                        uniform_buffer::<GpuShadowLight>(false),
                        storage_buffer_read_only_sized(false, None),
                        storage_buffer_sized(false, None),
                    ),
                ),
            ),
            shadow_sweep: BindGroupLayoutDescriptor::new(
                "skyline_shadow_sweep",
                &BindGroupLayoutEntries::sequential(
                    compute,
                    (
                        uniform_buffer::<GpuShadowLight>(false),
                        uniform_buffer::<GpuSweep>(false),
                        storage_buffer_sized(false, None),
                    ),
                ),
            ),
            terrain_cascade_erode: BindGroupLayoutDescriptor::new(
                "skyline_terrain_cascade_erode",
                &BindGroupLayoutEntries::sequential(
                    compute,
                    (
                        uniform_buffer::<GpuCascadeErosion>(false),
                        unfiltered(),
                        texture_storage_2d(
                            TextureFormat::R32Float,
                            StorageTextureAccess::WriteOnly,
                        ),
                    ),
                ),
            ),
            terrain_cascade: BindGroupLayoutDescriptor::new(
                "skyline_terrain_cascade",
                &BindGroupLayoutEntries::sequential(
                    draw,
                    (uniform_buffer::<GpuCascadeWrite>(false), unfiltered()),
                ),
            ),
            shaders: Shaders::load(assets),
            mesh_pipeline,
            queued: HashMap::default(),
        }
    }

    /// Layout of the group every view's pass has: field, heights, pyramid, sampler, view.
    pub fn field(&self, float: bool) -> &BindGroupLayoutDescriptor {
        &self.field[usize::from(float)]
    }

    pub fn height_mips(&self, float: bool) -> &BindGroupLayoutDescriptor {
        if float {
            &self.height_mips_float
        } else {
            &self.height_mips
        }
    }

    /// Layout of the field for rays to lights: field, heights, pyramid, sampler.
    pub fn shadow_field(&self, float: bool) -> &BindGroupLayoutDescriptor {
        &self.shadow_field[usize::from(float)]
    }

    pub fn terrain_shade(&self, shadowed: bool) -> &BindGroupLayoutDescriptor {
        &self.terrain_shade[usize::from(shadowed)]
    }

    pub fn ray_cast(&self, stop_at_depth: bool) -> &BindGroupLayoutDescriptor {
        &self.ray_cast[usize::from(stop_at_depth)]
    }

    /// The pipeline of a key, queued if it is the first time.
    pub fn get(&mut self, cache: &PipelineCache, key: PipelineKey) -> PipelineId {
        if let Some(id) = self.queued.get(&key) {
            return *id;
        }
        let id = self.queue(cache, key);
        self.queued.insert(key, id);
        id
    }

    /// How many pipelines have been queued.
    pub fn count(&self) -> usize {
        self.queued.len()
    }

    fn queue(&self, cache: &PipelineCache, key: PipelineKey) -> PipelineId {
        let compute = |label: &'static str, shader: &Handle<Shader>, layout, defs| {
            PipelineId::Compute(cache.queue_compute_pipeline(ComputePipelineDescriptor {
                label: Some(label.into()),
                layout,
                shader: shader.clone(),
                shader_defs: defs,
                entry_point: Some(label.into()),
                ..default()
            }))
        };
        let shaders = &self.shaders;
        match key {
            PipelineKey::HeightMips { float } => compute(
                "height_mips",
                &shaders.height_mips,
                vec![self.height_mips(float).clone()],
                field_defs(float, 0),
            ),
            PipelineKey::Subdivide { float } => compute(
                "subdivide",
                &shaders.subdivide,
                vec![self.field(float).clone(), self.subdivide.clone()],
                field_defs(float, 0),
            ),
            PipelineKey::Beam { float, fine } => {
                let mut defs = field_defs(float, 0);
                if fine {
                    defs.push("FINE".into());
                }
                compute(
                    "beam",
                    &shaders.beam,
                    vec![self.field(float).clone(), self.beam.clone()],
                    defs,
                )
            }
            PipelineKey::RayCast {
                float,
                stop_at_depth,
            } => {
                let mut defs = field_defs(float, 0);
                if stop_at_depth {
                    defs.push("STOP_AT_DEPTH".into());
                }
                compute(
                    "ray_cast",
                    &shaders.ray_cast,
                    vec![
                        self.field(float).clone(),
                        self.ray_cast(stop_at_depth).clone(),
                    ],
                    defs,
                )
            }
            PipelineKey::BoxEntry { float } => {
                PipelineId::Render(cache.queue_render_pipeline(RenderPipelineDescriptor {
                    label: Some("box_entry".into()),
                    layout: vec![self.field(float).clone(), self.box_entry.clone()],
                    vertex: VertexState {
                        shader: shaders.box_entry.clone(),
                        shader_defs: field_defs(float, 0),
                        ..default()
                    },
                    primitive: PrimitiveState {
                        // Back faces: they are there even with the camera inside the box.
                        cull_mode: Some(Face::Front),
                        ..default()
                    },
                    fragment: Some(FragmentState {
                        shader: shaders.box_entry.clone(),
                        shader_defs: field_defs(float, 0),
                        targets: vec![Some(BOX_ENTRY_FORMAT.into())],
                        ..default()
                    }),
                    depth_stencil: Some(depth_state(
                        BOX_DEPTH_FORMAT,
                        CompareFunction::GreaterEqual,
                        true,
                    )),
                    ..default()
                }))
            }
            PipelineKey::TerrainDepth {
                float,
                samples,
                normal,
                motion,
            } => {
                let mut defs = field_defs(float, 0);
                let mut targets = Vec::new();
                if normal || motion {
                    targets.resize(2, None);
                }
                if normal {
                    defs.push("NORMAL_PREPASS".into());
                    targets[0] = Some(NORMAL_PREPASS_FORMAT.into());
                }
                if motion {
                    defs.push("MOTION_VECTOR_PREPASS".into());
                    targets[1] = Some(MOTION_VECTOR_PREPASS_FORMAT.into());
                }
                PipelineId::Render(cache.queue_render_pipeline(RenderPipelineDescriptor {
                    label: Some("terrain_depth".into()),
                    layout: vec![self.field(float).clone(), self.terrain_depth.clone()],
                    vertex: VertexState {
                        shader: shaders.terrain_depth.clone(),
                        shader_defs: defs.clone(),
                        ..default()
                    },
                    fragment: Some(FragmentState {
                        shader: shaders.terrain_depth.clone(),
                        shader_defs: defs,
                        targets,
                        ..default()
                    }),
                    depth_stencil: Some(depth_state(
                        CORE_3D_DEPTH_FORMAT,
                        CompareFunction::GreaterEqual,
                        true,
                    )),
                    multisample: MultisampleState {
                        count: samples,
                        ..default()
                    },
                    ..default()
                }))
            }
            PipelineKey::TerrainShadow {
                float,
                per_texel,
                coarse,
                penumbra,
            } => {
                let mut defs = field_defs(float, 0);
                let flags = [
                    ("PER_TEXEL", per_texel),
                    ("COARSE", coarse),
                    ("PENUMBRA", penumbra),
                ];
                defs.extend(flags.iter().filter(|f| f.1).map(|f| f.0.into()));
                compute(
                    "terrain_shadow",
                    &shaders.terrain_shadow,
                    vec![
                        self.shadow_field(float).clone(),
                        self.terrain_shadow.clone(),
                    ],
                    defs,
                )
            }
            PipelineKey::ShadowMips { float } => compute(
                "shadow_mips",
                &shaders.shadow_mips,
                vec![
                    self.shadow_field(float).clone(),
                    self.terrain_shadow.clone(),
                ],
                field_defs(float, 0),
            ),
            PipelineKey::ShadowSweep { float, penumbra } => {
                let mut defs = field_defs(float, 0);
                if penumbra {
                    defs.push("PENUMBRA".into());
                }
                compute(
                    "shadow_sweep",
                    &shaders.shadow_sweep,
                    vec![self.shadow_field(float).clone(), self.shadow_sweep.clone()],
                    defs,
                )
            }
            PipelineKey::TerrainShade {
                float,
                mesh,
                shadowed,
            } => {
                let mut defs = shade_defs(&self.mesh_pipeline, mesh);
                if shadowed {
                    defs.push("TERRAIN_SHADOW".into());
                }
                defs.extend(field_defs(float, 2));
                let view = self.mesh_pipeline.get_view_layout(mesh.into());
                PipelineId::Render(cache.queue_render_pipeline(RenderPipelineDescriptor {
                    label: Some("terrain_shade".into()),
                    layout: vec![
                        view.main_layout.clone(),
                        view.binding_array_layout.clone(),
                        self.field(float).clone(),
                        self.terrain_shade(shadowed).clone(),
                    ],
                    vertex: VertexState {
                        shader: shaders.terrain_shade.clone(),
                        shader_defs: defs.clone(),
                        ..default()
                    },
                    fragment: Some(FragmentState {
                        shader: shaders.terrain_shade.clone(),
                        shader_defs: defs,
                        targets: vec![Some(mesh.target_format().into())],
                        ..default()
                    }),
                    depth_stencil: Some(depth_state(
                        CORE_3D_DEPTH_FORMAT,
                        CompareFunction::Equal,
                        false,
                    )),
                    multisample: MultisampleState {
                        count: mesh.msaa_samples(),
                        ..default()
                    },
                    ..default()
                }))
            }
            PipelineKey::TerrainCascadeErode { dips, rows } => {
                let steps = [(dips, "DIPS"), (rows, "ROWS")];
                let defs = steps.iter().filter(|(on, _)| *on);
                compute(
                    "terrain_cascade_erode",
                    &shaders.terrain_cascade_erode,
                    vec![self.terrain_cascade_erode.clone()],
                    defs.map(|(_, name)| (*name).into()).collect(),
                )
            }
            PipelineKey::TerrainCascade => {
                PipelineId::Render(cache.queue_render_pipeline(RenderPipelineDescriptor {
                    label: Some("terrain_cascade".into()),
                    layout: vec![self.terrain_cascade.clone()],
                    vertex: VertexState {
                        shader: shaders.terrain_cascade.clone(),
                        ..default()
                    },
                    fragment: Some(FragmentState {
                        shader: shaders.terrain_cascade.clone(),
                        ..default()
                    }),
                    depth_stencil: Some(depth_state(
                        CORE_3D_DEPTH_FORMAT,
                        CompareFunction::GreaterEqual,
                        true,
                    )),
                    ..default()
                }))
            }
        }
    }
}

fn depth_state(format: TextureFormat, compare: CompareFunction, write: bool) -> DepthStencilState {
    DepthStencilState {
        format,
        depth_write_enabled: Some(write),
        depth_compare: Some(compare),
        stencil: default(),
        bias: default(),
    }
}

/// Which height type, and in which bind group the field lies; its pass's own group is the next one.
fn field_defs(float: bool, group: u32) -> Vec<ShaderDefVal> {
    let mut defs = vec![ShaderDefVal::UInt("FIELD_GROUP".into(), group)];
    if float {
        defs.push("HEIGHT_F32".into());
    }
    defs
}

/// The definitions Bevy's own full-screen PBR pass (deferred lighting) derives from a view's key, so that
/// terrain gets the same lights, shadows, fog and tonemapping as meshes.
fn shade_defs(mesh_pipeline: &MeshPipeline, key: MeshPipelineKey) -> Vec<ShaderDefVal> {
    use bevy::pbr::{TONEMAPPING_LUT_SAMPLER_BINDING_INDEX, TONEMAPPING_LUT_TEXTURE_BINDING_INDEX};
    type Key = MeshPipelineKey;
    let mut defs: Vec<ShaderDefVal> = Vec::new();
    let flags = [
        (
            Key::SCREEN_SPACE_AMBIENT_OCCLUSION,
            "SCREEN_SPACE_AMBIENT_OCCLUSION",
        ),
        (Key::ENVIRONMENT_MAP, "ENVIRONMENT_MAP"),
        (Key::NORMAL_PREPASS, "NORMAL_PREPASS"),
        (Key::DEPTH_PREPASS, "DEPTH_PREPASS"),
        (Key::MOTION_VECTOR_PREPASS, "MOTION_VECTOR_PREPASS"),
        (Key::DEFERRED_PREPASS, "DEFERRED_PREPASS"),
        (Key::SCREEN_SPACE_REFLECTIONS, "SCREEN_SPACE_REFLECTIONS"),
        (Key::CONTACT_SHADOWS, "CONTACT_SHADOWS"),
        (Key::DISTANCE_FOG, "DISTANCE_FOG"),
        (Key::ATMOSPHERE, "ATMOSPHERE"),
    ];
    for (flag, name) in flags {
        if key.contains(flag) {
            defs.push(name.into());
        }
    }
    if key.contains(Key::IRRADIANCE_VOLUME) {
        defs.push("IRRADIANCE_VOLUME".into());
    }
    if key.msaa_samples() > 1 {
        defs.push("MULTISAMPLED".into());
    }
    let filter = match key.intersection(Key::SHADOW_FILTER_METHOD_RESERVED_BITS) {
        f if f == Key::SHADOW_FILTER_METHOD_HARDWARE_2X2 => "SHADOW_FILTER_METHOD_HARDWARE_2X2",
        f if f == Key::SHADOW_FILTER_METHOD_TEMPORAL => "SHADOW_FILTER_METHOD_TEMPORAL",
        _ => "SHADOW_FILTER_METHOD_GAUSSIAN",
    };
    defs.push(filter.into());
    if mesh_pipeline.binding_arrays_are_usable {
        defs.push("MULTIPLE_LIGHT_PROBES_IN_ARRAY".into());
        defs.push("MULTIPLE_LIGHTMAPS_IN_ARRAY".into());
    }
    if mesh_pipeline.clustered_decals_are_usable {
        defs.push("CLUSTERED_DECALS_ARE_USABLE".into());
    }
    defs.push("IRRADIANCE_VOLUMES_ARE_USABLE".into());
    if key.contains(Key::TONEMAP_IN_SHADER) {
        defs.push("TONEMAP_IN_SHADER".into());
        defs.push(ShaderDefVal::UInt(
            "TONEMAPPING_LUT_TEXTURE_BINDING_INDEX".into(),
            TONEMAPPING_LUT_TEXTURE_BINDING_INDEX,
        ));
        defs.push(ShaderDefVal::UInt(
            "TONEMAPPING_LUT_SAMPLER_BINDING_INDEX".into(),
            TONEMAPPING_LUT_SAMPLER_BINDING_INDEX,
        ));
        let method = match key.intersection(Key::TONEMAP_METHOD_RESERVED_BITS) {
            m if m == Key::TONEMAP_METHOD_NONE => "TONEMAP_METHOD_NONE",
            m if m == Key::TONEMAP_METHOD_REINHARD => "TONEMAP_METHOD_REINHARD",
            m if m == Key::TONEMAP_METHOD_REINHARD_LUMINANCE => "TONEMAP_METHOD_REINHARD_LUMINANCE",
            m if m == Key::TONEMAP_METHOD_ACES_FITTED => "TONEMAP_METHOD_ACES_FITTED",
            m if m == Key::TONEMAP_METHOD_AGX => "TONEMAP_METHOD_AGX",
            m if m == Key::TONEMAP_METHOD_SOMEWHAT_BORING_DISPLAY_TRANSFORM => {
                "TONEMAP_METHOD_SOMEWHAT_BORING_DISPLAY_TRANSFORM"
            }
            m if m == Key::TONEMAP_METHOD_BLENDER_FILMIC => "TONEMAP_METHOD_BLENDER_FILMIC",
            m if m == Key::TONEMAP_METHOD_TONY_MC_MAPFACE => "TONEMAP_METHOD_TONY_MC_MAPFACE",
            _ => "TONEMAP_METHOD_PBR_NEUTRAL",
        };
        defs.push(method.into());
        if key.contains(Key::DEBAND_DITHER) {
            defs.push("DEBAND_DITHER".into());
        }
    }
    defs
}
