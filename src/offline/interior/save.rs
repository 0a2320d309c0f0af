//! Writing a glTF, so that whatever goes wrong, what was there before is still there.

use std::{
    ffi::OsString,
    fs::{self, File},
    io::Write,
    path::{Path, PathBuf},
};

use serde_json::Value;

use super::{
    container::{BIN_CHUNK, JSON_CHUNK, MAGIC},
    error::{ModelFileError, TrimError},
    uri::encode,
};

/// Whether a file's name says that its JSON and its buffer lie apart.
fn is_apart(out: &Path) -> bool {
    out.extension()
        .is_some_and(|extension| extension.eq_ignore_ascii_case("gltf"))
}

/// Where a file really is: a link stays one. Not a device, that would be replaced.
///
/// # Errors
/// It cannot be written to.
pub(super) fn destination(out: &Path) -> Result<PathBuf, TrimError> {
    match fs::metadata(out) {
        Ok(metadata) if metadata.is_file() => out
            .canonicalize()
            .map_err(|error| TrimError::write(out, error)),
        Ok(_) => Err(TrimError::write(out, "it is no file; name one")),
        Err(_) => Ok(out.to_owned()),
    }
}

/// Writes a glTF to a [`destination`]; gives its bytes. `beside`: files that a model that may be the same names.
pub(super) fn save(
    json: &mut Value,
    bin: &[u8],
    input: &Path,
    out: &Path,
    beside: &[PathBuf],
) -> Result<u64, TrimError> {
    let failed = |error: std::io::Error| TrimError::write(out, error);
    if !is_apart(out) {
        let bytes = glb(json, bin).map_err(TrimError::input(input))?;
        Draft::new(out, &[&bytes])
            .and_then(Draft::publish)
            .map_err(failed)?;
        return Ok(bytes.len() as u64);
    }
    let buffer = buffer_file(out, beside);
    let name = buffer.file_name().unwrap_or_default();
    if let Some(entry) = json
        .pointer_mut("/buffers/0")
        .and_then(Value::as_object_mut)
    {
        entry.insert("uri".into(), encode(&name.to_string_lossy()).into());
    }
    let text = serde_json::to_vec_pretty(json).map_err(|error| failed(error.into()))?;
    // The model last: until then, what it was stays whole.
    let model = Draft::new(out, &[&text, b"\n"]).map_err(failed)?;
    Draft::new(&buffer, &[bin])
        .and_then(Draft::publish)
        .map_err(failed)?;
    model.publish().map_err(failed)?;
    Ok((text.len() + 1 + bin.len()) as u64)
}

/// A `.bin` of the model's name; another if the model that was read has that one.
fn buffer_file(model: &Path, beside: &[PathBuf]) -> PathBuf {
    let taken: Vec<_> = beside.iter().map(|file| file.canonicalize().ok()).collect();
    let stem = model.file_stem().unwrap_or_default();
    let name = |number: u32| {
        let mut name = OsString::from(stem);
        if number > 0 {
            name.push(format!(".{number}"));
        }
        name.push(".bin");
        model.with_file_name(name)
    };
    let is_free = |file: &PathBuf| {
        let found = file.canonicalize().ok();
        found.is_none() || !taken.contains(&found)
    };
    (0..).map(name).find(is_free).unwrap_or_else(|| name(0))
}

fn glb(json: &Value, bin: &[u8]) -> Result<Vec<u8>, ModelFileError> {
    let text = serde_json::to_vec(json).map_err(|error| ModelFileError::Json(error.to_string()))?;
    let chunks = [(JSON_CHUNK, text.as_slice(), b' '), (BIN_CHUNK, bin, 0)];
    let chunks = chunks
        .iter()
        .filter(|(kind, body, _)| *kind == JSON_CHUNK || !body.is_empty());
    let padded = |body: &[u8]| body.len().next_multiple_of(4);
    let length = 12
        + chunks
            .clone()
            .map(|(_, body, _)| 8 + padded(body))
            .sum::<usize>();
    let word = |length: usize| match u32::try_from(length) {
        Ok(length) => Ok(length.to_le_bytes()),
        Err(_) => Err(ModelFileError::TooLong(length as u64)),
    };
    let mut bytes = Vec::with_capacity(length);
    bytes.extend_from_slice(MAGIC);
    bytes.extend_from_slice(&2u32.to_le_bytes());
    bytes.extend_from_slice(&word(length)?);
    for (kind, body, filler) in chunks {
        bytes.extend_from_slice(&word(padded(body))?);
        bytes.extend_from_slice(&kind.to_le_bytes());
        bytes.extend_from_slice(body);
        bytes.resize(bytes.len().next_multiple_of(4), *filler);
    }
    Ok(bytes)
}

/// A file that takes its name once it is whole.
struct Draft {
    draft: PathBuf,
    to: PathBuf,
    is_published: bool,
}

impl Draft {
    fn new(to: &Path, parts: &[&[u8]]) -> std::io::Result<Self> {
        let mut name = OsString::from(".");
        name.push(to.file_name().unwrap_or_default());
        name.push(format!(".{}.part", std::process::id()));
        let draft = Self {
            draft: to.with_file_name(name),
            to: to.to_owned(),
            is_published: false,
        };
        let mut file = File::create(&draft.draft)?;
        for part in parts {
            file.write_all(part)?;
        }
        file.sync_all()?;
        Ok(draft)
    }

    fn publish(mut self) -> std::io::Result<()> {
        fs::rename(&self.draft, &self.to)?;
        self.is_published = true;
        Ok(())
    }
}

impl Drop for Draft {
    fn drop(&mut self) {
        if !self.is_published {
            let _ = fs::remove_file(&self.draft);
        }
    }
}
