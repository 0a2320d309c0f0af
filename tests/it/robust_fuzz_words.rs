//! Words that users type: policies, scales, flags of the command. Each is understood or refused in one line.

use bevy::math::UVec2;
use bevy_skyline::{
    offline::workload::Policy,
    prelude::{Knobs, ResolutionScale},
    spherical::Bins,
};

use crate::{
    cli::skyline,
    fuzz::{Lot, Verdict, holds, one_line, refused, run},
};

/// Words of flags and values, sound ones and others.
const WORDS: [&str; 44] = [
    "render",
    "shadow",
    "interior",
    "workload",
    "accuracy",
    "--heightmap",
    "--eye",
    "--target",
    "--size",
    "--fov",
    "--sun",
    "--traversal",
    "--box-texels",
    "--max-error-px",
    "--out",
    "--spacing",
    "--height-range",
    "--light",
    "--method",
    "--resolution",
    "--gap",
    "--level",
    "--mode",
    "--memory-mib",
    "--scene",
    "--path",
    "--target-ms",
    "--policy",
    "--quick",
    "--frames",
    "city",
    "rotate",
    "hybrid",
    "max-mip",
    "node",
    "64x64",
    "0x0",
    "nan,inf,0",
    "1,2,3",
    "-1",
    "all",
    "terrain",
    "polygons:-3",
    "",
];

/// A number as somebody might write it.
fn number(lot: &mut Lot) -> String {
    let number = lot.f64();
    match lot.below(7) {
        0 => format!("{}", lot.u32()),
        1 => format!("{number:e}"),
        2 => format!("{}e{}", lot.below(20), lot.below(800) as i32 - 400),
        3 => format!("{}{}", lot.draw(), lot.draw()),
        4 => lot
            .pick(&[
                "", " ", "nan", "-inf", "+5", "0x10", "1_000", "٣", "5.", ".5",
            ])
            .into(),
        _ => format!("{number}"),
    }
}

fn policy(lot: &mut Lot) -> String {
    let kind = lot.pick(&[
        "none",
        "frustum",
        "polygons",
        "distance",
        "threshold",
        "budget",
        "all",
        "Ä",
    ]);
    let mut text = match lot.below(5) {
        0 => kind.to_owned(),
        1 => format!("{kind}:{}:{}", number(lot), number(lot)),
        _ => format!("{kind}:{}", number(lot)),
    };
    if lot.one_in(6) {
        let mut bytes = text.into_bytes();
        lot.mutate(&mut bytes, b"threshold:1e39");
        text = String::from_utf8_lossy(&bytes).into_owned();
    }
    text
}

fn texts(lot: &mut Lot) -> Verdict {
    let scale = ResolutionScale(lot.f32());
    let viewport = UVec2::new(lot.u32(), lot.u32());
    let drawn = scale.drawn_size(viewport);
    holds(
        drawn.cmple(viewport).all() && (viewport.min_element() == 0 || drawn.min_element() > 0),
        || format!("{drawn} of {viewport} at {scale:?}"),
    )?;
    let bins = Bins {
        theta: lot.u32() as u16,
        phi: lot.u32() as u16,
    };
    match bins.checked() {
        Ok(bins) => {
            let (theta, phi) = (lot.f64(), lot.f64());
            let (row, column) = (bins.row(theta), bins.column(phi));
            holds(
                row < usize::from(bins.theta) && column < usize::from(bins.phi),
                || format!("bin {row}, {column} of {bins:?} at {theta}, {phi}"),
            )?;
        }
        Err(error) => drop(refused(&error)?),
    }
    let mut knobs = Knobs::default();
    let text = policy(lot);
    knobs.set_manual(&text, Some(lot.u32() as usize));
    match text.parse::<Policy>() {
        Ok(policy) => {
            let is_sound = policy
                .parameter()
                .is_none_or(|parameter| parameter.is_finite() && parameter >= 0.0);
            holds(is_sound, || format!("{text} is {policy:?}")).map(|()| true)
        }
        Err(error) => refused(&error),
    }
}

#[test]
fn no_words_make_settings_panic() {
    run("texts", 1 << 20, texts).expect_both(20);
}

/// The command itself, with files that are not there, so that nothing is drawn or measured.
#[test]
fn no_words_make_the_command_panic() {
    let tally = run("command", 1 << 20, |lot| {
        let words = lot.below(9);
        let mut words = lot.many(words, |lot| match lot.below(4) {
            0 => number(lot),
            1 => policy(lot),
            _ => lot.pick(&WORDS).to_owned(),
        });
        let (command, file) = lot.pick(&[
            ("render", "--heightmap=/nowhere/at/all.png"),
            ("shadow", "--heightmap=/nowhere/at/all.tif"),
            ("interior", "/nowhere/at/all.glb"),
        ]);
        words.insert(0, command.into());
        words.insert(1, file.into());
        words.push("--out=/nowhere/at/all.out".into());
        // A zero cannot be handed to a process.
        words.iter_mut().for_each(|word| word.retain(|c| c != '\0'));
        let words: Vec<&str> = words.iter().map(String::as_str).collect();
        let output = skyline(&words);
        let told = String::from_utf8_lossy(&output.stderr);
        holds(
            output.status.code() == Some(2) && output.stdout.is_empty(),
            || format!("{words:?}: {}: {told}", output.status),
        )?;
        one_line(told.trim_end()).map_err(|wrong| format!("{words:?}: {wrong}"))?;
        Ok(false)
    });
    assert_eq!(tally.taken, 0);
}
