//! A line of text in a picture.

use bevy_skyline::offline::glyphs;
use image::{Rgb, RgbImage};

/// Writes white on a dark ground, from the top left corner on.
pub fn write(picture: &mut RgbImage, [left, top]: [u32; 2], text: &str) {
    let scale = (picture.width() / 640).max(1);
    let mut fill = |x: u32, y: u32, width: u32, height: u32, shade: &dyn Fn(u8) -> u8| {
        for y in y..(y + height).min(picture.height()) {
            for x in x..(x + width).min(picture.width()) {
                let Rgb(colour) = *picture.get_pixel(x, y);
                picture.put_pixel(x, y, Rgb(colour.map(shade)));
            }
        }
    };
    let width = glyphs::width(text).max(0) as u32 + 4;
    let height = glyphs::HEIGHT.max(0) as u32 + 3;
    fill(left, top, width * scale, height * scale, &|v| v / 4);
    glyphs::for_each_dot(text, |x, y| {
        let at = |from: u32, dot: i32| from + (dot.max(0) as u32 + 2) * scale;
        fill(at(left, x), at(top, y), scale, scale, &|_| 240);
    });
}
