//! Which objects a picture shows: each drawn in a colour that its number can be read from.

use bevy::{
    asset::uuid_handle,
    prelude::*,
    render::render_resource::AsBindGroup,
    shader::{Shader, ShaderRef},
};

/// Holds `object_id.wgsl`.
const SHADER: Handle<Shader> = uuid_handle!("6b0c0d1e-53a5-4c0f-8f0e-7d0b5a6f2c11");
/// Objects that can be told apart: six bits a channel, and 0 is no object.
pub const MOST_OBJECTS: usize = (1 << 18) - 1;

/// Shows an entity's [`MeshTag`](bevy::mesh::MeshTag) as a colour, unlit.
#[derive(Asset, TypePath, AsBindGroup, Clone, Debug)]
pub struct ObjectIdMaterial {}

impl Material for ObjectIdMaterial {
    fn fragment_shader() -> ShaderRef {
        SHADER.into()
    }

    fn enable_prepass() -> bool {
        false
    }

    fn enable_shadows() -> bool {
        false
    }
}

/// Adds the material.
pub struct ObjectIdPlugin;

impl Plugin for ObjectIdPlugin {
    fn build(&self, app: &mut App) {
        let shader = Shader::from_wgsl(
            include_str!("../../../assets/shaders/object_id.wgsl"),
            "object_id.wgsl",
        );
        if let Some(mut shaders) = app.world_mut().get_resource_mut::<Assets<Shader>>()
            && let Err(error) = shaders.insert(SHADER.id(), shader)
        {
            error!("object_id.wgsl could not be added: {error}");
        }
        app.add_plugins(MaterialPlugin::<ObjectIdMaterial>::default());
    }
}

/// The tag of an object by its index.
pub(super) fn tag_of(index: usize) -> u32 {
    (index % MOST_OBJECTS + 1) as u32
}

/// The object a pixel shows, if any: the inverse of the shader. A colour between two objects' is none's.
fn object_of(pixel: &image::Rgba<u8>) -> Option<usize> {
    let [r, g, b, _] = pixel.0.map(|code| usize::from(code) >> 2);
    (r | g << 6 | b << 12).checked_sub(1)
}

/// How many pixels each of `objects` objects shows in a picture drawn in [`Look::Ids`](super::Look::Ids).
///
/// # Errors
/// The number of pixels that show an object there is none of: then the picture is not one of numbers.
pub fn seen(picture: &image::RgbaImage, objects: usize) -> Result<Vec<u32>, usize> {
    let mut seen = vec![0; objects];
    let mut strangers = 0;
    for pixel in picture.pixels() {
        match object_of(pixel) {
            Some(index) if index < objects => seen[index] += 1,
            Some(_) => strangers += 1,
            None => {}
        }
    }
    if strangers > 0 {
        return Err(strangers);
    }
    Ok(seen)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn colours_survive_an_error_of_one_code_either_way() {
        for index in [0, 1, 62, 63, 64, 4_095, 4_096, 99_999, MOST_OBJECTS - 1] {
            let tag = tag_of(index);
            for off in [-1i32, 0, 1] {
                let code = |shift: u32| (4 * (tag >> shift & 63) as i32 + 2 + off) as u8;
                let pixel = image::Rgba([code(0), code(6), code(12), 255]);
                assert_eq!(object_of(&pixel), Some(index));
            }
        }
        assert_eq!(object_of(&image::Rgba([0, 0, 0, 255])), None);
    }

    #[test]
    fn strangers_are_told() {
        let mut picture = image::RgbaImage::from_pixel(2, 1, image::Rgba([6, 2, 2, 255]));
        assert_eq!(seen(&picture, 2), Ok(vec![2, 0]));
        picture.put_pixel(0, 0, image::Rgba([250, 2, 2, 255]));
        assert_eq!(seen(&picture, 2), Err(1));
    }
}
