//! Height-field files damaged at random, and height fields made of hostile numbers: a field that is whole or an error
//! of one line, never a panic and never a vast allocation.

use bevy::math::{URect, UVec2, Vec2, Vec3};
use bevy_skyline::terrain::{
    HeightField, HeightFieldNote, HeightFieldSettings, HeightSamples, VoidHandling,
    decode_height_field,
};
use tiff::encoder::{Compression, colortype};

use crate::{
    fuzz::{Lot, Verdict, holds, one_line, refused, run},
    loader::{crc32, hgt, noise, palette_png, png, png16, tiff, tiled_tiff16},
};

/// Files here are below 4 KiB, and a header is believed up to 4096 times the file's length: 16 MiB of samples, and as
/// many again where they are widened.
const MOST_BYTES: usize = 40 << 20;

/// Settings that are nobody's, now and then.
fn settings(lot: &mut Lot) -> HeightFieldSettings {
    let some = |lot: &mut Lot| lot.one_in(4).then(|| lot.f32());
    HeightFieldSettings {
        texel_m: some(lot),
        height_range_m: some(lot).map(|least| {
            let span = if lot.one_in(2) {
                lot.f32()
            } else {
                lot.unit() as f32
            };
            (least, least + span)
        }),
        raw_size: lot.one_in(4).then(|| UVec2::new(lot.u32(), lot.u32())),
        raw_big_endian: lot.one_in(2),
        voids: match lot.below(4) {
            0 => VoidHandling::Refuse,
            1 => VoidHandling::Height(lot.f32()),
            _ => VoidHandling::Fill,
        },
    }
}

/// What holds of every field, wherever it came from.
fn check(field: &HeightField, lot: &mut Lot) -> Result<(), String> {
    let size = field.size();
    let samples = field.samples();
    holds(
        size.min_element() >= 2 && samples.len() as u64 == u64::from(size.x) * u64::from(size.y),
        || format!("{size} samples, and {} are there", samples.len()),
    )?;
    let (texel, extent) = (field.texel_m(), field.extent_m());
    holds(texel > 0.0 && extent.is_finite(), || {
        format!("{texel} m a texel, {extent} m")
    })?;
    if let HeightSamples::F32(heights) = samples {
        holds(heights.iter().all(|height| height.is_finite()), || {
            "a height is not finite".into()
        })?;
    }
    let (least, most) = field.height_range_m();
    let (low, high) = field.data_range_m();
    holds(
        least.is_finite() && most.is_finite() && least <= most,
        || format!("heights from {least} to {most}"),
    )?;
    holds(low.is_finite() && high.is_finite() && low <= high, || {
        format!("data from {low} to {high}")
    })?;
    // A few samples and places stand for all: the pyramid's bounds hold of them, and queries stay within.
    // Rounded to `f32`, subnormal ones by more than their share.
    let slack = 1e-6 * low.abs().max(high.abs()) + 1e-44;
    let within = |height: f64| height >= low - slack && height <= high + slack;
    for _ in 0..8 {
        let at = UVec2::new(
            lot.below(size.x as usize) as u32,
            lot.below(size.y as usize) as u32,
        );
        let height = field.sample_m(at.x, at.y);
        holds(within(height), || {
            format!("{height} m at {at}, outside {low} to {high}")
        })?;
        let place = extent * Vec2::new(lot.unit() as f32, lot.unit() as f32);
        let found = field.height_at(place);
        holds(
            found.is_some_and(|height| within(f64::from(height))),
            || format!("{found:?} m at {place}, outside {low} to {high}"),
        )?;
    }
    // Hostile questions have answers or none.
    let origin = Vec3::from_array([(); 3].map(|()| lot.mostly(f64::from(extent.x), 3) as f32));
    let way = Vec3::from_array([(); 3].map(|()| lot.mostly(-1.0, 3) as f32));
    if let Some(hit) = field.ray_cast(origin, way, lot.f32()) {
        holds(
            hit.distance >= 0.0 && hit.cell.cmplt(field.cells()).all(),
            || format!("{hit:?} from {origin} along {way}"),
        )?;
    }
    let place = Vec2::new(lot.f32(), lot.f32());
    let _ = (field.height_at(place), field.normal_at(place));
    Ok(())
}

/// A file as the loader takes it.
fn decode(
    lot: &mut Lot,
    extension: &str,
    bytes: &[u8],
    settings: &HeightFieldSettings,
    sidecar: Option<&[u8]>,
) -> Verdict {
    match decode_height_field(extension, bytes, settings, sidecar) {
        Ok((field, notes)) => {
            for note in &notes {
                one_line(&HeightFieldNote::to_string(note))?;
            }
            check(&field, lot).map(|()| true)
        }
        Err(error) => refused(&error),
    }
}

/// A PNG's chunks.
type Chunks = Vec<([u8; 4], Vec<u8>)>;

fn chunks(png: &[u8]) -> Chunks {
    let mut rest = &png[8..];
    let mut chunks = Vec::new();
    while let Some((length, more)) = rest.split_first_chunk::<4>() {
        let (kind, more) = more.split_first_chunk().expect("a kind");
        let (data, more) = more.split_at(u32::from_be_bytes(*length) as usize);
        chunks.push((*kind, data.to_vec()));
        rest = &more[4..];
    }
    chunks
}

/// The same with its lengths and checksums right, so that what is wrong lies deeper.
fn png_of(chunks: &Chunks) -> Vec<u8> {
    let mut file = b"\x89PNG\r\n\x1a\n".to_vec();
    for (kind, data) in chunks {
        file.extend((data.len() as u32).to_be_bytes());
        let start = file.len();
        file.extend(kind);
        file.extend(data);
        let crc = crc32(&file[start..]);
        file.extend(crc.to_be_bytes());
    }
    file
}

fn change_chunks(lot: &mut Lot, chunks: &mut Chunks) {
    const KINDS: [&[u8; 4]; 12] = [
        b"IHDR", b"PLTE", b"IDAT", b"IEND", b"tRNS", b"gAMA", b"iCCP", b"sBIT", b"acTL", b"fcTL",
        b"fdAT", b"zTXt",
    ];
    let at = lot.below(chunks.len());
    match lot.below(7) {
        0 | 1 => {
            // The header: width and height, or depth, colours, interlacing.
            let header = &mut chunks[0].1;
            if lot.one_in(2) && header.len() >= 8 {
                let side = 4 * lot.below(2);
                header[side..side + 4].copy_from_slice(&lot.u32().to_be_bytes());
            } else if header.len() == 13 {
                header[8 + lot.below(5)] = lot.pick(&[0, 1, 2, 3, 4, 6, 8, 16, 255]);
            }
        }
        2 => chunks[at].0 = *lot.pick(&KINDS),
        3 => {
            let chunk = chunks[at].clone();
            chunks.push(chunk);
        }
        4 if chunks.len() > 1 => drop(chunks.remove(at)),
        5 => {
            let data = lot.many(20, |lot| lot.draw() as u8);
            chunks.insert(at, (*lot.pick(&KINDS), data));
        }
        _ => {
            let other = chunks[0].1.clone();
            lot.mutate(&mut chunks[at].1, &other);
        }
    }
}

#[test]
fn no_png_makes_the_loader_panic() {
    let grey: Vec<u8> = noise(40).iter().map(|code| *code as u8).collect();
    let seeds = [
        png16(9, 7, &noise(63)),
        png(8, 5, image::ExtendedColorType::L8, &grey),
        png(5, 2, image::ExtendedColorType::Rgba8, &grey),
        palette_png(),
    ];
    let tally = run("png", MOST_BYTES, move |lot| {
        let seed = &seeds[[0, 0, 0, 1, 1, 2, 3][lot.below(7)]];
        let mut bytes = seed.clone();
        if lot.one_in(2) {
            let mut chunks = chunks(seed);
            for _ in 0..=lot.below(3) {
                if !chunks.is_empty() {
                    change_chunks(lot, &mut chunks);
                }
            }
            bytes = png_of(&chunks);
        }
        if lot.one_in(2) {
            lot.mutate(&mut bytes, &seeds[1]);
        }
        let settings = settings(lot);
        decode(lot, "png", &bytes, &settings, None)
    });
    tally.expect_both(40);
}

/// Changes entries of a little-endian TIFF's first directory: tags, types, counts, values.
fn change_entries(lot: &mut Lot, file: &mut [u8]) {
    const TAGS: [u16; 16] = [
        256, 257, 258, 259, 262, 273, 277, 278, 279, 284, 317, 322, 323, 324, 339, 42113,
    ];
    let word = |file: &[u8], at: usize| {
        file.get(at..at + 4)
            .and_then(|word| word.try_into().ok())
            .map(u32::from_le_bytes)
    };
    let directory = word(file, 4).unwrap_or(0) as usize;
    let entries = word(file, directory).map_or(0, |word| word as u16);
    for _ in 0..=lot.below(2) {
        let at = directory + 2 + 12 * lot.below(usize::from(entries));
        if at + 12 > file.len() {
            return;
        }
        match lot.below(4) {
            0 => file[at..at + 2].copy_from_slice(&lot.pick(&TAGS).to_le_bytes()),
            1 => file[at + 2] = lot.below(19) as u8,
            2 => file[at + 4..at + 8].copy_from_slice(&lot.u32().to_le_bytes()),
            _ => file[at + 8..at + 12].copy_from_slice(&lot.u32().to_le_bytes()),
        }
    }
}

#[test]
fn no_tiff_makes_the_loader_panic() {
    let codes = noise(63);
    let signed: Vec<i16> = codes.iter().map(|code| *code as i16).collect();
    let floats: Vec<f32> = codes
        .iter()
        .map(|code| f32::from(*code) / 65_535.0)
        .collect();
    let doubles: Vec<f64> = floats.iter().map(|height| f64::from(*height)).collect();
    let seeds = [
        tiff::<colortype::Gray16>(9, 7, &codes, Compression::Uncompressed, None),
        tiff::<colortype::Gray16>(9, 7, &codes, Compression::Lzw, Some("17")),
        tiff::<colortype::Gray16>(9, 7, &codes, Compression::Deflate(Default::default()), None),
        tiff::<colortype::Gray16>(9, 7, &codes, Compression::Packbits, None),
        tiff::<colortype::GrayI16>(9, 7, &signed, Compression::Uncompressed, Some("-32768")),
        tiff::<colortype::Gray32Float>(9, 7, &floats, Compression::Lzw, Some("nan")),
        tiff::<colortype::Gray64Float>(9, 7, &doubles, Compression::Uncompressed, None),
        tiled_tiff16(9, 7, 16, &codes),
        tiled_tiff16(9, 7, 4, &codes),
    ];
    let tally = run("tiff", MOST_BYTES, move |lot| {
        let mut bytes = seeds[lot.below(seeds.len())].clone();
        if lot.one_in(2) {
            change_entries(lot, &mut bytes);
        } else {
            let other = lot.below(seeds.len());
            lot.mutate(&mut bytes, &seeds[other]);
        }
        let settings = settings(lot);
        decode(lot, lot_extension(bytes.len()), &bytes, &settings, None)
    });
    tally.expect_both(40);
}

fn lot_extension(length: usize) -> &'static str {
    ["tif", "map.TIFF"][length % 2]
}

#[test]
fn no_file_without_a_header_makes_the_loader_panic() {
    let tally = run("raw", 1 << 20, |lot| {
        let (columns, rows) = (lot.below(20), lot.below(20));
        let mut bytes = match lot.below(3) {
            0 => hgt(&vec![i16::MIN; columns * columns]),
            1 => hgt(&lot.many(columns * columns, |lot| {
                if lot.one_in(4) {
                    i16::MIN
                } else {
                    lot.draw() as i16
                }
            })),
            _ => lot.many(2 * columns * rows, |lot| lot.draw() as u8),
        };
        let mut settings = settings(lot);
        if lot.one_in(3) {
            settings.raw_size = Some(UVec2::new(columns as u32, rows as u32));
        }
        if lot.one_in(4) {
            lot.mutate(&mut bytes, b"II*\0");
        }
        let extension = lot.pick(&["hgt", "raw", "r16", "N46E007.HGT", "", "json", "png"]);
        decode(lot, extension, &bytes, &settings, None)
    });
    tally.expect_both(20);
}

/// A sidecar of the fields there are, with values that are nobody's.
fn sidecar(lot: &mut Lot) -> Vec<u8> {
    const FIELDS: [&str; 7] = [
        "width",
        "height",
        "metres_per_texel",
        "height_min_m",
        "height_max_m",
        "Width",
        "a\nb",
    ];
    let fields = lot.many(6, |lot| {
        let field = serde_json::Value::from(lot.pick(&FIELDS));
        let value = match lot.below(12) {
            0 => "null".into(),
            1 => "[9, 7]".into(),
            2 => format!("{{\"width\": {}}}", lot.u32()),
            3 => "\"nine\\n\"".into(),
            4 => format!("{}e{}", lot.below(1000), lot.below(700) as i32 - 350),
            5 => format!("-{}", lot.u32()),
            6 => format!("{:e}", lot.pick(&[0.0, 1e-45, 3.4e38, 1e39, 1e308])),
            7 => lot.u32().to_string(),
            _ => lot.pick(&["9", "7", "9.0", "1.5", "0", "100"]).into(),
        };
        format!("{field}: {value}")
    });
    format!("{{ {} }}", fields[..lot.below(7)].join(", ")).into_bytes()
}

#[test]
fn no_sidecar_makes_the_loader_panic() {
    let seed = br#"{ "width": 9, "height": 7, "metres_per_texel": 2.5, "height_min_m": -3, "height_max_m": 40 }"#;
    let codes = noise(63);
    let files = [
        ("png", png16(9, 7, &codes)),
        (
            "raw",
            codes.iter().flat_map(|code| code.to_le_bytes()).collect(),
        ),
        (
            "tif",
            tiff::<colortype::Gray32Float>(9, 7, &[0.5; 63], Compression::Uncompressed, None),
        ),
    ];
    let tally = run("sidecar", 1 << 20, move |lot| {
        let mut bytes = if lot.one_in(2) {
            seed.to_vec()
        } else {
            sidecar(lot)
        };
        if lot.one_in(2) {
            let other = sidecar(lot);
            lot.mutate(&mut bytes, &other);
        }
        let (extension, file) = &files[lot.below(files.len())];
        let settings = if lot.one_in(2) {
            settings(lot)
        } else {
            HeightFieldSettings::default()
        };
        decode(lot, extension, file, &settings, Some(&bytes))
    });
    tally.expect_both(40);
}

#[test]
fn no_numbers_make_a_height_field_panic() {
    let tally = run("heights", 1 << 20, |lot| {
        let side = |lot: &mut Lot| {
            if lot.one_in(9) {
                lot.u32()
            } else {
                2 + lot.below(9) as u32
            }
        };
        let size = UVec2::new(side(lot), side(lot));
        let count = u64::from(size.x) * u64::from(size.y);
        let wrong = usize::from(lot.one_in(9));
        let count = if count < 4096 {
            count as usize + wrong
        } else {
            7
        };
        let texel_m = lot.mostly(20.0, 4) as f32;
        let range_m = (lot.mostly(-50.0, 6) as f32, lot.mostly(50.0, 6) as f32);
        let made = if lot.one_in(2) {
            let codes = lot.many(count, |lot| lot.draw() as u16);
            HeightField::from_u16(size, texel_m, range_m, codes)
        } else {
            let hostile = if lot.one_in(2) { 400 } else { 5 };
            let heights = lot.many(count, |lot| lot.mostly(90.0, hostile) as f32);
            HeightField::from_f32(size, texel_m, heights)
        };
        let mut field = match made {
            Ok(field) => field,
            Err(error) => return refused(&error),
        };
        check(&field, lot)?;
        // Edits are made whole or not at all.
        for _ in 0..3 {
            let before = (field.revision(), field.samples().clone());
            let along = |lot: &mut Lot, side: u32| {
                if lot.one_in(12) {
                    lot.u32()
                } else {
                    lot.below(side as usize + 1) as u32
                }
            };
            let corner = |lot: &mut Lot| UVec2::new(along(lot, size.x), along(lot, size.y));
            let rect = URect {
                min: corner(lot),
                max: corner(lot),
            };
            let area = (u64::from(rect.max.x.saturating_sub(rect.min.x)))
                .saturating_mul(u64::from(rect.max.y.saturating_sub(rect.min.y)))
                .min(500) as usize;
            let edited = match lot.below(3) {
                0 => field.edit(rect, |_, _, old| old + lot.mostly(9.0, 60) as f32),
                1 => field.write_u16(rect, &lot.many(area, |lot| lot.draw() as u16)),
                _ => field.write_f32(rect, &lot.many(area, |lot| lot.mostly(9.0, 60) as f32)),
            };
            if let Err(error) = edited {
                refused(&error)?;
                holds(
                    before == (field.revision(), field.samples().clone()),
                    || format!("a refused edit of {rect:?} changed the field"),
                )?;
            }
            check(&field, lot)?;
        }
        Ok(true)
    });
    tally.expect_both(20);
}
