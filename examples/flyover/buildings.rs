//! Kinds of buildings: houses, walk-ups, slabs and towers, as meshes in metres that stand on height 0 and reach a little
//! into the ground; and the façades they share.

use bevy::prelude::*;

use super::{
    shape::{Shape, WINDOW_M, WINDOWS, ring},
    texture::{Texels, bytes, image, unit},
};

/// How deep walls reach below the ground they stand on. units: m
const FOOTING_M: f32 = -5.0;
/// Texels a side of a façade's texture.
const FACADE: u32 = 256;

/// What is built where.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Class {
    House,
    WalkUp,
    Slab,
    Tower,
}

/// A façade's style.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Style {
    /// Windows in walls.
    Punched,
    /// Bands of windows.
    Ribbon,
    /// Glass between thin posts.
    Curtain,
}

/// All styles, by their numbers.
pub const STYLES: [Style; 3] = [Style::Punched, Style::Ribbon, Style::Curtain];

/// One kind of building.
pub struct Kind {
    pub class: Class,
    pub style: Style,
    pub mesh: Mesh,
    /// Half its size across and along the street. units: m
    pub half: Vec2,
    /// Of its roof. units: m
    pub height: f32,
}

/// A colour by its sRGB numbers.
fn rgb(r: f32, g: f32, b: f32) -> LinearRgba {
    Srgba::rgb(r, g, b).into()
}

/// All kinds, the same on every machine; those of a class from the lowest to the highest.
pub fn kinds() -> Vec<Kind> {
    let mut kinds = Vec::new();
    for (class, count) in [
        (Class::House, 10),
        (Class::WalkUp, 18),
        (Class::Slab, 12),
        (Class::Tower, 30),
    ] {
        for index in 0..count {
            let draw = |salt: u32| unit(index, class as i32, 100 + salt);
            kinds.push(match class {
                Class::House => house(&draw),
                Class::WalkUp => walk_up(&draw),
                Class::Slab => slab(&draw),
                Class::Tower => tower(&draw),
            });
        }
    }
    kinds.sort_by(|a, b| {
        let by_height = || a.height.total_cmp(&b.height);
        (a.class as u8).cmp(&(b.class as u8)).then_with(by_height)
    });
    kinds
}

/// Windows of whole widths that are about so long. units: m
fn whole(length_m: f32, size_m: f32) -> f32 {
    (length_m / size_m).round().max(1.0) * size_m
}

fn pick<const N: usize>(of: [LinearRgba; N], draw: f32) -> LinearRgba {
    of[((draw * N as f32) as usize).min(N - 1)]
}

fn plaster(draw: f32) -> LinearRgba {
    pick(
        [
            rgb(0.93, 0.90, 0.84),
            rgb(0.90, 0.82, 0.70),
            rgb(0.86, 0.74, 0.62),
            rgb(0.82, 0.80, 0.78),
            rgb(0.88, 0.78, 0.72),
            rgb(0.70, 0.50, 0.42),
        ],
        draw,
    )
}

fn flat_roof(draw: f32) -> LinearRgba {
    pick(
        [
            rgb(0.46, 0.46, 0.47),
            rgb(0.56, 0.54, 0.52),
            rgb(0.38, 0.39, 0.41),
            rgb(0.62, 0.60, 0.56),
        ],
        draw,
    )
}

fn house(draw: &impl Fn(u32) -> f32) -> Kind {
    let half = Vec2::new(4.8 + 1.6 * draw(0), 3.8 + 1.0 * draw(1));
    let eaves = WINDOW_M.y * if draw(2) > 0.5 { 2.0 } else { 1.0 } + 0.4;
    let wall = plaster(draw(3));
    let roof = pick(
        [
            rgb(0.62, 0.30, 0.22),
            rgb(0.56, 0.26, 0.20),
            rgb(0.45, 0.28, 0.24),
            rgb(0.36, 0.36, 0.38),
        ],
        draw(4),
    );
    let mut shape = Shape::default();
    shape.block(Vec2::ZERO, half, FOOTING_M, eaves, wall, roof);
    shape.gable(half, eaves, eaves + 0.75 * half.y, wall, roof);
    Kind {
        class: Class::House,
        style: Style::Punched,
        mesh: shape.mesh(),
        half,
        height: eaves,
    }
}

/// A flat roof with a rim, and a hut for the stairs.
fn top(shape: &mut Shape, half: Vec2, at: f32, wall: LinearRgba, draw: &impl Fn(u32) -> f32) {
    let roof = flat_roof(draw(20));
    for (centre, size) in [
        (Vec2::new(0.0, half.y - 0.2), Vec2::new(half.x, 0.2)),
        (Vec2::new(0.0, 0.2 - half.y), Vec2::new(half.x, 0.2)),
        (Vec2::new(half.x - 0.2, 0.0), Vec2::new(0.2, half.y - 0.4)),
        (Vec2::new(0.2 - half.x, 0.0), Vec2::new(0.2, half.y - 0.4)),
    ] {
        let [low, high] = [centre - size, centre + size];
        shape.solid(
            Vec3::new(low.x, at - 0.1, low.y),
            Vec3::new(high.x, at + 0.9, high.y),
            wall,
        );
    }
    let centre = half * (Vec2::new(draw(21), draw(22)) - 0.5);
    let hut = Vec2::new(1.6 + draw(23), 1.4 + draw(24));
    shape.solid(
        Vec3::new(centre.x - hut.x, at, centre.y - hut.y),
        Vec3::new(centre.x + hut.x, at + 2.6, centre.y + hut.y),
        roof,
    );
}

fn walk_up(draw: &impl Fn(u32) -> f32) -> Kind {
    let half = Vec2::new(
        0.5 * whole(18.0 + 5.0 * draw(0), WINDOW_M.x),
        0.5 * whole(13.0 + 8.0 * draw(1), WINDOW_M.x),
    );
    let height = WINDOW_M.y * (3.0 + 4.99 * draw(2)).floor() + 0.4;
    let wall = plaster(draw(3));
    let mut shape = Shape::default();
    shape.block(
        Vec2::ZERO,
        half,
        FOOTING_M,
        height,
        wall,
        flat_roof(draw(20)),
    );
    top(&mut shape, half, height, wall, draw);
    Kind {
        class: Class::WalkUp,
        style: Style::Punched,
        mesh: shape.mesh(),
        half,
        height,
    }
}

fn slab(draw: &impl Fn(u32) -> f32) -> Kind {
    let half = Vec2::new(
        0.5 * whole(20.0 + 3.0 * draw(0), WINDOW_M.x),
        0.5 * whole(12.0 + 6.0 * draw(1), WINDOW_M.x),
    );
    let height = WINDOW_M.y * (8.0 + 9.0 * draw(2)).floor() + 0.4;
    let wall = pick(
        [
            rgb(0.80, 0.79, 0.77),
            rgb(0.72, 0.70, 0.68),
            rgb(0.86, 0.84, 0.80),
            rgb(0.66, 0.60, 0.54),
        ],
        draw(3),
    );
    let mut shape = Shape::default();
    shape.block(
        Vec2::ZERO,
        half,
        FOOTING_M,
        height,
        wall,
        flat_roof(draw(20)),
    );
    top(&mut shape, half, height, wall, draw);
    Kind {
        class: Class::Slab,
        style: if draw(5) > 0.4 {
            Style::Ribbon
        } else {
            Style::Punched
        },
        mesh: shape.mesh(),
        half,
        height,
    }
}

/// Up to three tiers, the upper ones narrower, some round, some with a mast.
fn tower(draw: &impl Fn(u32) -> f32) -> Kind {
    let floors = 18.0 + 44.0 * draw(2) * draw(6).max(0.3);
    let half = Vec2::new(
        0.5 * whole(17.0 + 5.0 * draw(0), WINDOW_M.x),
        0.5 * whole(17.0 + 6.0 * draw(1), WINDOW_M.x),
    );
    let curtain = draw(5) > 0.5;
    let wall = if curtain {
        pick(
            [
                rgb(0.62, 0.74, 0.84),
                rgb(0.56, 0.68, 0.72),
                rgb(0.72, 0.78, 0.84),
                rgb(0.52, 0.58, 0.68),
            ],
            draw(3),
        )
    } else {
        pick(
            [
                rgb(0.84, 0.81, 0.76),
                rgb(0.74, 0.66, 0.58),
                rgb(0.66, 0.52, 0.46),
                rgb(0.78, 0.79, 0.80),
            ],
            draw(3),
        )
    };
    let tiers = 1 + (2.99 * draw(7)) as u32;
    let round = draw(8) > 0.8;
    let mut shape = Shape::default();
    let (mut bottom, mut width) = (FOOTING_M, half);
    for tier in 0..tiers {
        let share = ((tier + 1) as f32 / tiers as f32).powf(0.7);
        let height = WINDOW_M.y * (floors * share).floor() + 0.4;
        if round {
            let corners = ring(Vec2::ZERO, width.min_element(), 16);
            shape.prism(&corners, bottom, height, wall, flat_roof(draw(20)));
        } else {
            shape.block(Vec2::ZERO, width, bottom, height, wall, flat_roof(draw(20)));
        }
        bottom = height;
        if tier + 1 < tiers {
            width = Vec2::new(
                0.5 * whole(1.55 * width.x, WINDOW_M.x),
                0.5 * whole(1.55 * width.y, WINDOW_M.x),
            );
        }
    }
    if round {
        shape.column(
            Vec2::ZERO,
            [0.5 * width.min_element(); 2],
            12,
            bottom,
            bottom + 3.0,
            flat_roof(draw(9)),
        );
    } else {
        top(&mut shape, width, bottom, wall, draw);
    }
    if draw(10) > 0.6 {
        let mast = 8.0 + 22.0 * draw(11);
        shape.column(
            Vec2::ZERO,
            [0.6, 0.12],
            6,
            bottom,
            bottom + mast,
            rgb(0.75, 0.75, 0.76),
        );
    }
    Kind {
        class: Class::Tower,
        style: if curtain {
            Style::Curtain
        } else if draw(12) > 0.5 {
            Style::Ribbon
        } else {
            Style::Punched
        },
        mesh: shape.mesh(),
        half,
        height: bottom,
    }
}

/// What a façade looks like, and what of it shines at night.
pub fn facade(style: Style) -> [Image; 2] {
    let size = UVec2::splat(FACADE);
    let cell = FACADE as f32 / WINDOWS;
    let mut colours = Vec::new();
    let mut lights = Vec::new();
    for y in 0..FACADE {
        for x in 0..FACADE {
            let (column, row) = ((x as f32 / cell).floor(), (y as f32 / cell).floor());
            // From a window's left edge and from its floor. Height grows against the rows.
            let at = Vec2::new(
                (x as f32 + 0.5) / cell - column,
                1.0 - ((y as f32 + 0.5) / cell - row),
            );
            let window = is_glass(style, at);
            let draw = |salt: u32| unit(column as i32, row as i32, 200 + salt + 10 * style as u32);
            let glass = match style {
                Style::Curtain => 0.19 + 0.06 * draw(0),
                _ => 0.05 + 0.08 * draw(0),
            };
            let colour = if window {
                LinearRgba::rgb(0.75 * glass, 0.92 * glass, 1.1 * glass)
            } else if style == Style::Curtain {
                LinearRgba::gray(0.34)
            } else if at.y < 0.08 {
                LinearRgba::gray(0.72)
            } else {
                LinearRgba::gray(0.92)
            };
            colours.extend(bytes(colour));
            let share = if style == Style::Punched { 0.22 } else { 0.30 };
            let lit = window && draw(1) < share;
            let warm = LinearRgba::rgb(1.0, 0.52, 0.17).mix(
                &LinearRgba::rgb(0.90, 0.92, 1.0),
                if style == Style::Punched {
                    0.1
                } else {
                    0.6 * draw(2)
                },
            );
            let light = if lit {
                warm * (0.35 + 0.65 * draw(3))
            } else {
                LinearRgba::BLACK
            };
            lights.extend(bytes(light.with_alpha(1.0)));
        }
    }
    [
        image(size, Texels::Colour, colours, true),
        image(size, Texels::Colour, lights, true),
    ]
}

fn is_glass(style: Style, at: Vec2) -> bool {
    match style {
        Style::Punched => (0.24..0.76).contains(&at.x) && (0.28..0.82).contains(&at.y),
        Style::Ribbon => at.x > 0.05 && (0.32..0.84).contains(&at.y),
        Style::Curtain => at.x > 0.06 && at.y > 0.12,
    }
}
