//! Elevation files: every format there and back, every error by its words, and the asset server.

use std::io::Cursor;
use std::path::{Path, PathBuf};

use bevy::{
    asset::{AssetPlugin, LoadState},
    image::ImageLoader,
    prelude::*,
};
use bevy_skyline::terrain::{
    HeightField, HeightFieldError, HeightFieldLoadError, HeightFieldNote, HeightFieldPlugin,
    HeightFieldSettings, HeightSamples, VoidHandling, decode_height_field, read_height_field,
};
use image::{ExtendedColorType, ImageEncoder, codecs::png::PngEncoder};
use tiff::{
    encoder::{Compression, TiffEncoder, colortype},
    tags::Tag,
};

use crate::height_field::hash;

// ---------------------------------------------------------------------------------------------
// Files made in memory

pub fn noise(count: u32) -> Vec<u16> {
    (0..count).map(|i| hash(i) as u16).collect()
}

pub fn png(width: u32, height: u32, color: ExtendedColorType, pixels: &[u8]) -> Vec<u8> {
    let mut file = Vec::new();
    PngEncoder::new(&mut file)
        .write_image(pixels, width, height, color)
        .unwrap();
    file
}

pub fn png16(width: u32, height: u32, codes: &[u16]) -> Vec<u8> {
    png(
        width,
        height,
        ExtendedColorType::L16,
        bytemuck::cast_slice(codes),
    )
}

pub fn tiff<C: colortype::ColorType>(
    width: u32,
    height: u32,
    pixels: &[C::Inner],
    compression: Compression,
    no_data: Option<&str>,
) -> Vec<u8>
where
    [C::Inner]: tiff::encoder::TiffValue,
{
    let mut file = Cursor::new(Vec::new());
    let mut encoder = TiffEncoder::new(&mut file)
        .unwrap()
        .with_compression(compression);
    let mut image = encoder.new_image::<C>(width, height).unwrap();
    if let Some(text) = no_data {
        image.encoder().write_tag(Tag::GdalNodata, text).unwrap();
    }
    image.write_data(pixels).unwrap();
    file.into_inner()
}

/// A tiled TIFF of 16-bit grey, which the encoder cannot write: little-endian, uncompressed.
pub fn tiled_tiff16(width: u32, height: u32, tile: u32, codes: &[u16]) -> Vec<u8> {
    let (across, down) = (width.div_ceil(tile), height.div_ceil(tile));
    let mut data = Vec::new();
    let mut offsets = Vec::new();
    for tile_z in 0..down {
        for tile_x in 0..across {
            offsets.push(8 + data.len() as u32);
            for z in 0..tile {
                for x in 0..tile {
                    let (x, z) = (tile_x * tile + x, tile_z * tile + z);
                    let inside = x < width && z < height;
                    let code = if inside {
                        codes[(z * width + x) as usize]
                    } else {
                        0xdead
                    };
                    data.extend(code.to_le_bytes());
                }
            }
        }
    }
    let offsets_at = 8 + data.len() as u32;
    let counts_at = offsets_at + 4 * offsets.len() as u32;
    let directory_at = counts_at + 4 * offsets.len() as u32;
    let mut file = b"II*\0".to_vec();
    file.extend(directory_at.to_le_bytes());
    file.extend(data);
    for offset in &offsets {
        file.extend(offset.to_le_bytes());
    }
    for _ in &offsets {
        file.extend((tile * tile * 2).to_le_bytes());
    }
    let many = offsets.len() as u32;
    // A single value stands in the entry itself.
    let (offsets_at, counts_at) = match offsets[..] {
        [only] => (only, tile * tile * 2),
        _ => (offsets_at, counts_at),
    };
    let entries: [(u16, u16, u32, u32); 11] = [
        (256, 4, 1, width),
        (257, 4, 1, height),
        (258, 3, 1, 16),
        (259, 3, 1, 1),
        (262, 3, 1, 1),
        (277, 3, 1, 1),
        (322, 4, 1, tile),
        (323, 4, 1, tile),
        (324, 4, many, offsets_at),
        (325, 4, many, counts_at),
        (339, 3, 1, 1),
    ];
    file.extend((entries.len() as u16).to_le_bytes());
    for (tag, kind, count, value) in entries {
        file.extend(tag.to_le_bytes());
        file.extend(kind.to_le_bytes());
        file.extend(count.to_le_bytes());
        file.extend(value.to_le_bytes());
    }
    file.extend(0u32.to_le_bytes());
    file
}

pub fn hgt(metres: &[i16]) -> Vec<u8> {
    metres.iter().flat_map(|m| m.to_be_bytes()).collect()
}

fn scaled(texel_m: f32, height_range_m: (f32, f32)) -> HeightFieldSettings {
    HeightFieldSettings {
        texel_m: Some(texel_m),
        height_range_m: Some(height_range_m),
        ..default()
    }
}

fn codes(field: &HeightField) -> &[u16] {
    match field.samples() {
        HeightSamples::U16(codes) => codes,
        HeightSamples::F32(_) => panic!("floats where codes were expected"),
    }
}

fn floats(field: &HeightField) -> &[f32] {
    match field.samples() {
        HeightSamples::F32(heights) => heights,
        HeightSamples::U16(_) => panic!("codes where floats were expected"),
    }
}

fn decode(
    extension: &str,
    bytes: &[u8],
    settings: &HeightFieldSettings,
) -> (HeightField, Vec<HeightFieldNote>) {
    decode_height_field(extension, bytes, settings, None).unwrap()
}

fn error(extension: &str, bytes: &[u8], settings: &HeightFieldSettings) -> HeightFieldLoadError {
    decode_height_field(extension, bytes, settings, None).unwrap_err()
}

fn says(error: &HeightFieldLoadError, words: &[&str]) {
    let text = error.to_string();
    for word in words {
        assert!(text.contains(word), "`{word}` is missing in: {text}");
    }
}

// ---------------------------------------------------------------------------------------------
// There and back

#[test]
fn png_of_16_bits_loses_none() {
    let samples = noise(7 * 5);
    let (field, notes) = decode(
        "alps.PNG",
        &png16(7, 5, &samples),
        &scaled(30.0, (-100.0, 900.0)),
    );
    assert_eq!(codes(&field), samples);
    assert_eq!(field.size(), UVec2::new(7, 5));
    assert_eq!(
        (field.texel_m(), field.height_range_m()),
        (30.0, (-100.0, 900.0))
    );
    assert_eq!(notes, []);
}

#[test]
fn png_of_8_bits_is_widened_with_a_note() {
    let grey: Vec<u8> = (0..=255).collect();
    let file = png(16, 16, ExtendedColorType::L8, &grey);
    let (field, notes) = decode("png", &file, &scaled(1.0, (0.0, 255.0)));
    assert_eq!(notes, [HeightFieldNote::EightBit]);
    assert!(notes[0].to_string().contains("terrace"));
    for (i, &code) in codes(&field).iter().enumerate() {
        assert_eq!(usize::from(code), i * 257);
    }
    assert_eq!(field.sample_m(15, 15), 255.0);
}

#[test]
fn tiff_of_16_bits_in_strips_and_tiles_and_compressions() {
    let samples = noise(37 * 21);
    let settings = scaled(2.0, (0.0, 50.0));
    for compression in [
        Compression::Uncompressed,
        Compression::Lzw,
        Compression::Deflate(default()),
        Compression::Packbits,
    ] {
        let file = tiff::<colortype::Gray16>(37, 21, &samples, compression, None);
        let (field, notes) = decode("tif", &file, &settings);
        assert_eq!(codes(&field), samples);
        assert_eq!(field.size(), UVec2::new(37, 21));
        assert_eq!(notes, []);
    }
    let (field, _) = decode("tiff", &tiled_tiff16(37, 21, 16, &samples), &settings);
    assert_eq!(codes(&field), samples);

    let grey: Vec<u8> = samples.iter().map(|&s| s as u8).collect();
    let file = tiff::<colortype::Gray8>(37, 21, &grey, Compression::Lzw, None);
    let (field, notes) = decode("tif", &file, &settings);
    assert_eq!(notes, [HeightFieldNote::EightBit]);
    assert_eq!(codes(&field)[5], u16::from(grey[5]) * 257);
}

#[test]
fn tiff_of_signed_metres_is_metres() {
    let samples: Vec<i16> = noise(12).iter().map(|&c| c as i16).collect();
    let file = tiff::<colortype::GrayI16>(4, 3, &samples, Compression::Lzw, None);
    let settings = HeightFieldSettings {
        texel_m: Some(1.0),
        ..default()
    };
    let (field, notes) = decode("tif", &file, &settings);
    assert_eq!(notes, []);
    for (i, &metres) in samples.iter().enumerate() {
        assert_eq!(
            field.sample_m(i as u32 % 4, i as u32 / 4),
            f64::from(metres)
        );
    }
}

#[test]
fn float_tiff_is_metres_or_fractions() {
    let metres: Vec<f32> = noise(12)
        .iter()
        .map(|&c| f32::from(c) * 0.1 - 1000.0)
        .collect();
    let spacing = HeightFieldSettings {
        texel_m: Some(5.0),
        ..default()
    };
    let file = tiff::<colortype::Gray32Float>(4, 3, &metres, Compression::Deflate(default()), None);
    let (field, notes) = decode("tif", &file, &spacing);
    assert_eq!((floats(&field), notes), (&metres[..], vec![]));

    let doubles: Vec<f64> = metres.iter().map(|&m| f64::from(m)).collect();
    let file = tiff::<colortype::Gray64Float>(4, 3, &doubles, Compression::Lzw, None);
    assert_eq!(floats(&decode("tif", &file, &spacing).0), metres);

    let fractions: Vec<f32> = (0..12).map(|i| i as f32 / 11.0).collect();
    let file = tiff::<colortype::Gray32Float>(4, 3, &fractions, Compression::Uncompressed, None);
    let (field, _) = decode("tif", &file, &scaled(5.0, (100.0, 210.0)));
    assert_eq!(field.height_range_m(), (100.0, 210.0));
    assert!((field.sample_m(1, 0) - 110.0).abs() < 1e-4);

    // Metres with a range would be absurd mountains: refused.
    let file = tiff::<colortype::Gray32Float>(4, 3, &metres, Compression::Uncompressed, None);
    says(
        &error("tif", &file, &scaled(5.0, (0.0, 210.0))),
        &["column 0, row 0", "leave the height range out"],
    );
}

#[test]
fn hgt_is_exact_metres_at_its_own_spacing() {
    let mut metres: Vec<i16> = noise(1201 * 1201)
        .iter()
        .map(|&c| (c % 4000) as i16 - 20)
        .collect();
    metres[7] = i16::MIN + 1;
    let (field, notes) = decode("N23E121.hgt", &hgt(&metres), &default());
    assert_eq!(notes, []);
    assert_eq!(field.size(), UVec2::splat(1201));
    assert!((field.texel_m() - 92.61).abs() < 1e-3);
    for (i, &m) in metres.iter().enumerate() {
        assert_eq!(
            field.sample_m(i as u32 % 1201, i as u32 / 1201),
            f64::from(m)
        );
    }
    // Any square, and a stated size that is none.
    let small = hgt(&[1, 2, 3, 4]);
    assert_eq!(decode("hgt", &small, &default()).0.size(), UVec2::splat(2));
    let settings = HeightFieldSettings {
        raw_size: Some(UVec2::new(3, 2)),
        ..default()
    };
    assert_eq!(
        decode("hgt", &hgt(&[1; 6]), &settings).0.size(),
        UVec2::new(3, 2)
    );
}

#[test]
fn raw_samples_of_either_byte_order() {
    let samples = noise(6);
    let mut settings = HeightFieldSettings {
        raw_size: Some(UVec2::new(3, 2)),
        ..scaled(1.0, (0.0, 1.0))
    };
    let little: Vec<u8> = samples.iter().flat_map(|s| s.to_le_bytes()).collect();
    assert_eq!(codes(&decode("raw", &little, &settings).0), samples);
    assert_eq!(codes(&decode("r16", &little, &settings).0), samples);
    settings.raw_big_endian = true;
    let big: Vec<u8> = samples.iter().flat_map(|s| s.to_be_bytes()).collect();
    assert_eq!(codes(&decode("raw", &big, &settings).0), samples);
    // Square without being told.
    let square: Vec<u8> = noise(16).iter().flat_map(|s| s.to_le_bytes()).collect();
    assert_eq!(decode("raw", &square, &default()).0.size(), UVec2::splat(4));
}

// ---------------------------------------------------------------------------------------------
// Spacing, range, sidecar

#[test]
fn what_is_assumed_is_said() {
    let file = png16(3, 3, &noise(9));
    let (field, notes) = decode("png", &file, &default());
    assert_eq!(
        (field.texel_m(), field.height_range_m()),
        (1.0, (0.0, 1000.0))
    );
    assert_eq!(notes.len(), 1);
    let text = notes[0].to_string();
    for word in [
        "1 m",
        "0 m to 1000 m",
        "texel_m",
        "height_range_m",
        "metres_per_texel",
    ] {
        assert!(text.contains(word), "{text}");
    }
    let settings = HeightFieldSettings {
        texel_m: Some(3.0),
        ..default()
    };
    assert_eq!(
        decode("png", &file, &settings).1,
        [HeightFieldNote::Assumed {
            texel_m: None,
            height_range_m: Some((0.0, 1000.0))
        }]
    );
    // Floats are metres: nothing to assume about their range.
    let file = tiff::<colortype::Gray32Float>(2, 2, &[0.0; 4], Compression::Uncompressed, None);
    assert_eq!(
        decode("tif", &file, &default()).1,
        [HeightFieldNote::Assumed {
            texel_m: Some(1.0),
            height_range_m: None
        }]
    );
}

#[test]
fn sidecar_speaks_where_settings_are_silent() {
    let file = png16(3, 2, &noise(6));
    let sidecar = br#"{ "width": 3, "height": 2, "metres_per_texel": 20.031, "height_min_m": -5,
        "height_max_m": 4095.9375, "source": "somewhere", "extra": [1, null] }"#;
    let read = |settings: &HeightFieldSettings, sidecar: &[u8]| {
        decode_height_field("png", &file, settings, Some(sidecar))
    };
    let (field, notes) = read(&default(), sidecar).unwrap();
    assert_eq!(
        (field.texel_m(), field.height_range_m()),
        (20.031, (-5.0, 4095.9375))
    );
    assert_eq!(notes, []);

    let settings = HeightFieldSettings {
        texel_m: Some(7.0),
        ..default()
    };
    let (field, _) = read(&settings, sidecar).unwrap();
    assert_eq!(
        (field.texel_m(), field.height_range_m()),
        (7.0, (-5.0, 4095.9375))
    );

    // Fields may be missing or null.
    let (field, notes) = read(
        &default(),
        br#"{"metres_per_texel": 4, "height_min_m": null}"#,
    )
    .unwrap();
    assert_eq!((field.texel_m(), notes.len()), (4.0, 1));

    // The size of raw samples.
    let raw: Vec<u8> = noise(6).iter().flat_map(|s| s.to_le_bytes()).collect();
    let (field, _) = decode_height_field("raw", &raw, &default(), Some(sidecar)).unwrap();
    assert_eq!(field.size(), UVec2::new(3, 2));

    for bad in [
        &b"not json"[..],
        b"",
        b"[3, 2, 1.0]",
        b"{\"metres_per_texel\": \"20 m\"}",
        b"{\"width\": -3, \"height\": 2}",
        b"{\"height_min_m\": 3}",
        b"{\"width\": 3}",
        b"\xff\xfe",
    ] {
        let error = read(&default(), bad).unwrap_err();
        says(
            &error,
            &["sidecar", "metres_per_texel", "correct or remove"],
        );
    }
    let error = read(&default(), br#"{"width": 30, "height": 20}"#).unwrap_err();
    says(&error, &["[30, 20]", "[3, 2]", "another file"]);
    // What it says is checked like what settings say.
    let error = read(&default(), br#"{"metres_per_texel": 0}"#).unwrap_err();
    assert!(matches!(
        error,
        HeightFieldLoadError::HeightField(HeightFieldError::Spacing { .. })
    ));
    let error = read(&default(), br#"{"height_min_m": 9, "height_max_m": 1}"#).unwrap_err();
    assert!(matches!(
        error,
        HeightFieldLoadError::HeightField(HeightFieldError::HeightRange { .. })
    ));
}

// ---------------------------------------------------------------------------------------------
// Missing samples

#[test]
fn voids_are_filled_from_their_rim() {
    // A slope with a wide and a one-sample hole and one in a corner.
    let n = 61usize;
    let height = |x: usize, z: usize| 500 + 10 * x as i16 + 3 * z as i16;
    let is_void = |x: usize, z: usize| {
        (15..40).contains(&x) && (20..45).contains(&z) || (x, z) == (50, 5) || (x < 4 && z < 4)
    };
    let metres: Vec<i16> = (0..n * n)
        .map(|i| {
            if is_void(i % n, i / n) {
                i16::MIN
            } else {
                height(i % n, i / n)
            }
        })
        .collect();
    let (field, notes) = decode("hgt", &hgt(&metres), &default());
    let count = metres.iter().filter(|&&m| m == i16::MIN).count();
    assert_eq!(
        notes,
        [HeightFieldNote::VoidsFilled {
            count,
            height_m: None
        }]
    );
    assert!(notes[0].to_string().contains(&count.to_string()));

    let mut worst = 0.0f64;
    for z in 0..n {
        for x in 0..n {
            let filled = field.sample_m(x as u32, z as u32);
            let truth = f64::from(height(x, z));
            if is_void(x, z) {
                // Inside the rim's range, and near the slope that the hole hides.
                assert!((500.0..=1280.0).contains(&filled), "{x},{z}: {filled}");
                worst = worst.max((filled - truth).abs());
            } else {
                assert_eq!(filled, truth);
            }
        }
    }
    assert!(worst < 60.0, "{worst}");
    // Smooth: no step between neighbours much steeper than the slope.
    for z in 0..n as u32 {
        for x in 1..n as u32 {
            let step = (field.sample_m(x, z) - field.sample_m(x - 1, z)).abs();
            assert!(step < 40.0, "{x},{z}: {step}");
        }
    }
    // The same file always gives the same heights.
    assert_eq!(
        decode("hgt", &hgt(&metres), &default()).0.samples(),
        field.samples()
    );
}

#[test]
fn voids_can_be_given_a_height_or_refused() {
    let file = hgt(&[5, i16::MIN, 7, 8]);
    let settings = HeightFieldSettings {
        voids: VoidHandling::Height(-2.0),
        ..default()
    };
    let (field, notes) = decode("hgt", &file, &settings);
    assert_eq!(field.sample_m(1, 0), -2.0);
    assert_eq!(
        notes,
        [HeightFieldNote::VoidsFilled {
            count: 1,
            height_m: Some(-2.0)
        }]
    );

    let settings = HeightFieldSettings {
        voids: VoidHandling::Refuse,
        ..default()
    };
    says(
        &error("hgt", &file, &settings),
        &["1 samples", "column 1, row 0", "`Fill`"],
    );
    says(
        &error("hgt", &hgt(&[i16::MIN; 9]), &default()),
        &["every sample"],
    );
}

#[test]
fn gdal_no_data_is_a_void() {
    let spacing = HeightFieldSettings {
        texel_m: Some(1.0),
        ..default()
    };
    let filled = HeightFieldNote::VoidsFilled {
        count: 1,
        height_m: None,
    };

    // More digits in the tag than the sample has.
    let lowest = "-3.4028234663852886e+38";
    let file = tiff::<colortype::Gray32Float>(
        3,
        2,
        &[1.0, 2.0, 3.0, 1.0, f32::MIN, 3.0],
        Compression::Lzw,
        Some(lowest),
    );
    let (field, notes) = decode("tif", &file, &spacing);
    assert_eq!(notes, core::slice::from_ref(&filled));
    assert!((1.0..=3.0).contains(&field.sample_m(1, 1)));

    let file = tiff::<colortype::Gray32Float>(
        2,
        2,
        &[1.0, f32::NAN, 3.0, 1.0],
        Compression::Lzw,
        Some("nan"),
    );
    assert_eq!(
        decode("tif", &file, &spacing).1,
        core::slice::from_ref(&filled)
    );

    let file = tiff::<colortype::GrayI16>(2, 2, &[1, 2, -9999, 4], Compression::Lzw, Some("-9999"));
    let (field, notes) = decode("tif", &file, &spacing);
    assert_eq!(notes, [filled]);
    assert!((1.0..=4.0).contains(&field.sample_m(0, 1)));

    // A tag that marks nothing, or no number.
    for tag in ["-9999", "none"] {
        let file = tiff::<colortype::Gray32Float>(2, 2, &[1.0; 4], Compression::Lzw, Some(tag));
        assert_eq!(decode("tif", &file, &spacing).1, []);
    }
}

// ---------------------------------------------------------------------------------------------
// Errors

#[test]
fn colour_and_transparency_are_refused_with_a_remedy() {
    let pixels = [77u8; 4 * 4 * 8];
    for (color, bytes, words) in [
        (ExtendedColorType::Rgb8, 3, "colour"),
        (ExtendedColorType::Rgba8, 4, "transparency"),
        (ExtendedColorType::La8, 2, "transparency"),
        (ExtendedColorType::Rgb16, 6, "colour"),
        (ExtendedColorType::La16, 4, "transparency"),
    ] {
        let file = png(4, 4, color, &pixels[..16 * bytes]);
        says(
            &error("png", &file, &default()),
            &[words, "magick", "16-bit grey"],
        );
    }
    // A palette, even of greys: patched into a grey file, since the encoder writes none.
    let palette = palette_png();
    says(&error("png", &palette, &default()), &["colour", "magick"]);

    let file = tiff::<colortype::RGB8>(4, 4, &pixels[..48], Compression::Lzw, None);
    says(&error("tif", &file, &default()), &["colour", "magick"]);
    let file = tiff::<colortype::RGBA8>(4, 4, &pixels[..64], Compression::Lzw, None);
    says(
        &error("tif", &file, &default()),
        &["transparency", "magick"],
    );
    let file = tiff::<colortype::Gray32>(2, 2, &[1, 2, 3, 4], Compression::Lzw, None);
    says(&error("tif", &file, &default()), &["32 bits", "Float32"]);
}

/// A 2×2 PNG with a palette of two greys, byte by byte.
pub fn palette_png() -> Vec<u8> {
    let mut file = b"\x89PNG\r\n\x1a\n".to_vec();
    let mut chunk = |kind: &[u8; 4], data: &[u8]| {
        file.extend((data.len() as u32).to_be_bytes());
        let start = file.len();
        file.extend(kind);
        file.extend(data);
        let crc = crc32(&file[start..]);
        file.extend(crc.to_be_bytes());
    };
    chunk(b"IHDR", &[0, 0, 0, 2, 0, 0, 0, 2, 8, 3, 0, 0, 0]);
    chunk(b"PLTE", &[0, 0, 0, 255, 255, 255]);
    // One stored deflate block of two rows: filter 0, indices 0 and 1.
    let rows = [0, 0, 1, 0, 1, 0];
    let mut stream = vec![
        0x78,
        0x01,
        0x01,
        rows.len() as u8,
        0,
        !(rows.len() as u8),
        0xff,
    ];
    stream.extend(rows);
    stream.extend(adler32(&rows).to_be_bytes());
    chunk(b"IDAT", &stream);
    chunk(b"IEND", &[]);
    file
}

pub fn crc32(bytes: &[u8]) -> u32 {
    !bytes.iter().fold(!0u32, |crc, &byte| {
        (0..8).fold(crc ^ u32::from(byte), |c, _| {
            if c & 1 == 1 {
                c >> 1 ^ 0xedb8_8320
            } else {
                c >> 1
            }
        })
    })
}

fn adler32(bytes: &[u8]) -> u32 {
    let (a, b) = bytes.iter().fold((1u32, 0u32), |(a, b), &byte| {
        let a = (a + u32::from(byte)) % 65521;
        (a, (b + a) % 65521)
    });
    b << 16 | a
}

#[test]
fn other_files_are_refused() {
    says(&error("jpg", b"", &default()), &["`jpg`", ".png", ".hgt"]);
    says(&error("dem/alps", b"", &default()), &["no height format"]);
    says(
        &error("png", b"\xff\xd8\xff\xe0 a JPEG in disguise", &default()),
        &["no PNG file"],
    );
    says(&error("png", b"", &default()), &["no PNG file"]);
    says(
        &error("tif", &png16(2, 2, &[0; 4]), &default()),
        &["no TIFF file"],
    );
}

#[test]
fn one_row_or_column_is_refused() {
    let words = &["at least 2×2 samples"];
    says(&error("png", &png16(5, 1, &[0; 5]), &default()), words);
    says(&error("png", &png16(1, 5, &[0; 5]), &default()), words);
    let file = tiff::<colortype::Gray16>(1, 5, &[0; 5], Compression::Lzw, None);
    says(&error("tif", &file, &default()), words);
    says(&error("hgt", &hgt(&[3]), &default()), words);
    says(&error("hgt", b"", &default()), words);
    says(&error("raw", b"", &default()), words);
    let settings = HeightFieldSettings {
        raw_size: Some(UVec2::new(0, 4)),
        ..default()
    };
    says(&error("raw", b"", &settings), words);
}

#[test]
fn lengths_that_fit_no_size_are_refused() {
    says(
        &error("hgt", &[0; 1201 * 1201 * 2 - 2], &default()),
        &["2884800 bytes", "1201×1201 would be 2884802"],
    );
    says(&error("raw", &[0; 9], &default()), &["9 bytes", "raw_size"]);
    let settings = HeightFieldSettings {
        raw_size: Some(UVec2::new(3, 5)),
        ..default()
    };
    says(
        &error("raw", &[0; 31], &settings),
        &["[3, 5]", "30 bytes", "31"],
    );
    let settings = HeightFieldSettings {
        raw_size: Some(UVec2::MAX),
        ..default()
    };
    says(&error("raw", &[0; 31], &settings), &["raw_size"]);
}

#[test]
fn nan_and_infinity_are_named() {
    for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
        let file = tiff::<colortype::Gray32Float>(
            3,
            2,
            &[0.1, 0.2, 0.3, 0.4, bad, 0.6],
            Compression::Lzw,
            None,
        );
        says(
            &error("tif", &file, &default()),
            &["column 1, row 1", "finite"],
        );
        if bad.is_nan() {
            says(
                &error("tif", &file, &scaled(1.0, (0.0, 9.0))),
                &["column 1, row 1", "finite"],
            );
        }
    }
    // A double that no float holds.
    let file =
        tiff::<colortype::Gray64Float>(2, 2, &[0.0, 1e300, 0.0, 0.0], Compression::Lzw, None);
    says(&error("tif", &file, &default()), &["column 1, row 0"]);
    // Settings that make no sense.
    let file = tiff::<colortype::Gray32Float>(2, 2, &[0.0; 4], Compression::Lzw, None);
    let settings = scaled(1.0, (f32::NAN, 9.0));
    assert!(matches!(
        error("tif", &file, &settings),
        HeightFieldLoadError::HeightField(HeightFieldError::HeightRange { .. })
    ));
}

#[test]
fn truncated_and_damaged_files_are_errors_at_every_byte() {
    let samples = noise(9 * 7);
    let settings = scaled(1.0, (0.0, 1.0));
    let files = [
        ("png", png16(9, 7, &samples)),
        (
            "tif",
            tiff::<colortype::Gray16>(9, 7, &samples, Compression::Lzw, None),
        ),
        (
            "tif",
            tiff::<colortype::Gray16>(9, 7, &samples, Compression::Deflate(default()), None),
        ),
        ("tif", tiled_tiff16(9, 7, 16, &samples)),
    ];
    for (extension, file) in &files {
        let (whole, _) = decode(extension, file, &settings);
        let mut refused = 0;
        for end in 0..file.len() {
            match decode_height_field(extension, &file[..end], &settings, None) {
                Err(error) => {
                    refused += 1;
                    assert!(!error.to_string().is_empty());
                }
                // What is cut off after the last sample is no loss.
                Ok((field, _)) => assert_eq!(codes(&field), codes(&whole), "{extension} to {end}"),
            }
        }
        assert!(
            refused > file.len() / 2,
            "{extension}: {refused} of {}",
            file.len()
        );
        // Any byte changed: an error or a field, but no panic and no vast allocation.
        for at in 0..file.len() {
            for flip in [0x01, 0x80, 0xff] {
                let mut damaged = file.clone();
                damaged[at] ^= flip;
                let _ = decode_height_field(extension, &damaged, &settings, None);
            }
        }
    }
    let cut = &files[0].1[..files[0].1.len() / 2];
    says(&error("png", cut, &settings), &["truncated or damaged"]);
}

#[test]
fn a_header_that_promises_too_much_is_not_believed() {
    // 65535 × 65535 samples in a file of a hundred bytes.
    let mut file = png16(4, 4, &[0; 16]);
    file[16..24].copy_from_slice(&[0, 0, 0xff, 0xff, 0, 0, 0xff, 0xff]);
    let crc = crc32(&file[12..29]);
    file[29..33].copy_from_slice(&crc.to_be_bytes());
    says(&error("png", &file, &default()), &["truncated or damaged"]);
}

#[test]
fn settings_survive_a_meta_file() {
    let settings = HeightFieldSettings {
        texel_m: Some(2.5),
        height_range_m: Some((-1.0, 8.0)),
        raw_size: Some(UVec2::new(7, 9)),
        raw_big_endian: true,
        voids: VoidHandling::Height(3.0),
    };
    let json = serde_json::to_string(&settings).unwrap();
    assert_eq!(
        serde_json::from_str::<HeightFieldSettings>(&json).unwrap(),
        settings
    );
    // What is left out is at its default.
    let partial: HeightFieldSettings = serde_json::from_str(r#"{"texel_m": 4.0}"#).unwrap();
    assert_eq!(
        partial,
        HeightFieldSettings {
            texel_m: Some(4.0),
            ..default()
        }
    );
}

// ---------------------------------------------------------------------------------------------
// Files

#[test]
fn files_are_read_with_their_sidecar() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("hills.png");
    std::fs::write(&path, png16(3, 3, &noise(9))).unwrap();
    let field = HeightField::from_file(&path, &default()).unwrap();
    assert_eq!(field.texel_m(), 1.0);

    std::fs::write(
        folder.path().join("hills.json"),
        br#"{"metres_per_texel": 12.5}"#,
    )
    .unwrap();
    let (field, notes) = read_height_field(&path, &default()).unwrap();
    assert_eq!(field.texel_m(), 12.5);
    assert_eq!(notes.len(), 1, "the range is still assumed");
    let settings = scaled(3.0, (0.0, 9.0));
    assert_eq!(
        HeightField::from_file(&path, &settings).unwrap().texel_m(),
        3.0
    );
    let bytes = std::fs::read(&path).unwrap();
    assert_eq!(
        HeightField::from_bytes("png", &bytes, &settings)
            .unwrap()
            .texel_m(),
        3.0
    );

    let missing = folder.path().join("missing.png");
    says(
        &HeightField::from_file(&missing, &default()).unwrap_err(),
        &["missing.png", "cannot read"],
    );
    says(
        &HeightField::from_file(folder.path().join("x.obj"), &default()).unwrap_err(),
        &["`obj`"],
    );
}

#[test]
fn real_elevation_data_loads_as_described() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data/dem");
    let path = folder.join("taiwan_central_range_1024.png");
    if !path.exists() {
        println!("skipped: {} is not here", path.display());
        return;
    }
    let (field, notes) = read_height_field(&path, &default()).unwrap();
    assert_eq!(notes, []);
    assert_eq!(field.size(), UVec2::splat(1024));
    assert_eq!(field.texel_m(), 80.123);
    assert_eq!(field.height_range_m(), (0.0, 4095.9375));
    assert_eq!(field.data_range_m(), (0.0, 3866.5));
    let mut distinct = codes(&field).to_vec();
    distinct.sort_unstable();
    distinct.dedup();
    assert_eq!(distinct.len(), 56113);
    let middle = field.extent_m() * 0.5;
    let down = field
        .ray_cast(Vec3::new(middle.x, 9000.0, middle.y), Vec3::NEG_Y, 1e5)
        .unwrap();
    let height = field.height_at_f64(middle.as_dvec2()).unwrap();
    assert!((f64::from(down.point.y) - height).abs() < 1e-3);
}

// ---------------------------------------------------------------------------------------------
// The asset server

fn app(folder: &Path) -> App {
    let mut app = App::new();
    app.add_plugins((
        MinimalPlugins,
        AssetPlugin {
            file_path: folder.to_string_lossy().into_owned(),
            ..default()
        },
    ));
    app
}

fn settle<A: Asset>(app: &mut App, handle: &Handle<A>) -> LoadState {
    for _ in 0..5000 {
        app.update();
        let state = app.world().resource::<AssetServer>().load_state(handle);
        if !matches!(state, LoadState::Loading | LoadState::NotLoaded) {
            // One more for the asset itself to arrive.
            app.update();
            return state;
        }
        std::thread::sleep(std::time::Duration::from_millis(1));
    }
    panic!("the asset server is stuck");
}

fn get<'a>(app: &'a App, handle: &Handle<HeightField>) -> &'a HeightField {
    app.world()
        .resource::<Assets<HeightField>>()
        .get(handle)
        .unwrap()
}

fn write(folder: &Path, name: &str, bytes: &[u8]) -> PathBuf {
    let path = folder.join(name);
    std::fs::create_dir_all(path.parent().unwrap()).unwrap();
    std::fs::write(&path, bytes).unwrap();
    path
}

#[test]
fn the_asset_server_finds_sidecar_and_settings() {
    let folder = tempfile::tempdir().unwrap();
    write(folder.path(), "dem/alps.png", &png16(3, 2, &noise(6)));
    write(
        folder.path(),
        "dem/alps.json",
        br#"{"metres_per_texel": 20.5, "height_min_m": 1, "height_max_m": 2}"#,
    );
    write(
        folder.path(),
        "hills.tif",
        &tiff::<colortype::Gray16>(2, 2, &[1, 2, 3, 4], Compression::Lzw, None),
    );
    write(folder.path(), "tile.hgt", &hgt(&[1, 2, 3, 4]));
    let mut app = app(folder.path());
    app.add_plugins(HeightFieldPlugin);
    let server = app.world().resource::<AssetServer>().clone();

    let alps: Handle<HeightField> = server.load("dem/alps.png");
    assert!(settle(&mut app, &alps).is_loaded());
    assert_eq!(get(&app, &alps).texel_m(), 20.5);
    assert_eq!(get(&app, &alps).height_range_m(), (1.0, 2.0));
    assert_eq!(codes(get(&app, &alps)), noise(6));

    let hills: Handle<HeightField> = server
        .load_builder()
        .with_settings(|s: &mut HeightFieldSettings| {
            s.texel_m = Some(2.0);
            s.height_range_m = Some((0.0, 350.0));
        })
        .load("hills.tif");
    assert!(settle(&mut app, &hills).is_loaded());
    assert_eq!(get(&app, &hills).texel_m(), 2.0);
    assert_eq!(get(&app, &hills).height_range_m(), (0.0, 350.0));

    // Settings in a .meta file, as the asset server writes them.
    let tile: Handle<HeightField> = server.load("tile.hgt");
    assert!(settle(&mut app, &tile).is_loaded());
    assert_eq!(get(&app, &tile).sample_m(1, 1), 4.0);
}

/// Whether the image loader is there, and which of the two was registered last, must not matter:
/// the type of the handle chooses.
#[test]
fn pngs_load_as_height_fields_beside_the_image_loader() {
    let folder = tempfile::tempdir().unwrap();
    write(folder.path(), "a.png", &png16(3, 2, &noise(6)));
    write(
        folder.path(),
        "b.png",
        &png(4, 4, ExtendedColorType::Rgb8, &[9; 48]),
    );
    for image_first in [true, false] {
        let mut app = app(folder.path());
        if !image_first {
            app.add_plugins(HeightFieldPlugin);
        }
        app.init_asset::<Image>()
            .register_asset_loader(ImageLoader::new(default()))
            .register_asset_loader(EveryPng);
        if image_first {
            app.add_plugins(HeightFieldPlugin);
        }
        app.init_asset::<Greedy>();
        let server = app.world().resource::<AssetServer>().clone();
        let field: Handle<HeightField> = server.load("a.png");
        assert!(settle(&mut app, &field).is_loaded());
        assert_eq!(codes(get(&app, &field)), noise(6));
        // Asked without a type, a PNG stays with whoever claims the extension.
        let untyped = server.load_builder().load_untyped("b.png");
        assert!(settle(&mut app, &untyped).is_loaded());
        let loaded = app
            .world()
            .resource::<Assets<bevy::asset::LoadedUntypedAsset>>()
            .get(&untyped)
            .unwrap();
        assert_eq!(loaded.handle.type_id(), core::any::TypeId::of::<Greedy>());
    }
}

#[derive(Asset, TypePath)]
struct Greedy;

/// Stands for any loader that claims PNG files.
#[derive(TypePath)]
struct EveryPng;

impl bevy::asset::AssetLoader for EveryPng {
    type Asset = Greedy;
    type Settings = ();
    type Error = std::io::Error;
    async fn load(
        &self,
        _: &mut dyn bevy::asset::io::Reader,
        _: &(),
        _: &mut bevy::asset::LoadContext<'_>,
    ) -> Result<Greedy, std::io::Error> {
        Ok(Greedy)
    }
    fn extensions(&self) -> &[&str] {
        &["png"]
    }
}

#[test]
fn hot_reload_brings_new_heights_and_a_new_revision() {
    let folder = tempfile::tempdir().unwrap();
    let path = write(folder.path(), "alps.png", &png16(3, 2, &noise(6)));
    write(folder.path(), "alps.json", br#"{"metres_per_texel": 2}"#);
    let mut app = app(folder.path());
    app.add_plugins(HeightFieldPlugin);
    let server = app.world().resource::<AssetServer>().clone();
    let handle: Handle<HeightField> = server
        .load_builder()
        .with_settings(|s: &mut HeightFieldSettings| s.height_range_m = Some((0.0, 350.0)))
        .load("alps.png");
    assert!(settle(&mut app, &handle).is_loaded());
    let before = get(&app, &handle).revision();

    std::fs::write(&path, png16(2, 4, &[9; 8])).unwrap();
    write(folder.path(), "alps.json", br#"{"metres_per_texel": 3}"#);
    server.reload("alps.png");
    for _ in 0..5000 {
        app.update();
        if get(&app, &handle).revision() != before {
            break;
        }
        std::thread::sleep(std::time::Duration::from_millis(1));
    }
    let field = get(&app, &handle);
    assert_eq!(codes(field), [9; 8]);
    assert_eq!(field.size(), UVec2::new(2, 4));
    assert_eq!(field.texel_m(), 3.0);
    assert_eq!(
        field.height_range_m(),
        (0.0, 350.0),
        "settings outlive a reload"
    );
    assert_eq!(
        field.changed_since(before),
        bevy_skyline::terrain::HeightFieldChanged::Everything
    );
}

#[test]
fn the_asset_server_reports_what_is_wrong() {
    let folder = tempfile::tempdir().unwrap();
    write(
        folder.path(),
        "colour.png",
        &png(4, 4, ExtendedColorType::Rgb8, &[9; 48]),
    );
    write(folder.path(), "bad.png", &png16(3, 2, &noise(6)));
    write(folder.path(), "bad.json", b"{");
    write(folder.path(), "notes.txt", b"no heights");
    let mut app = app(folder.path());
    app.add_plugins(HeightFieldPlugin);
    let server = app.world().resource::<AssetServer>().clone();
    for (name, words) in [
        ("colour.png", "16-bit grey"),
        ("bad.png", "sidecar"),
        ("notes.txt", "no height format"),
    ] {
        let handle: Handle<HeightField> = server.load(name);
        match settle(&mut app, &handle) {
            LoadState::Failed(error) => {
                let text = error.to_string();
                assert!(text.contains(words), "{text}");
            }
            other => panic!("{name}: {other:?}"),
        }
    }
}
