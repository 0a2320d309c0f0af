//! A model's file: the JSON and its buffers, from a `.glb` or from a `.gltf` with what lies beside or within it.

use std::{
    fs,
    path::{Path, PathBuf},
};

use serde_json::Value;

use super::{
    error::ModelFileError,
    json::{check, count, list},
    uri::{Uri, directory},
};
use crate::one_line::one_line;

pub(super) const MAGIC: &[u8; 4] = b"glTF";
pub(super) const JSON_CHUNK: u32 = 0x4e4f_534a;
pub(super) const BIN_CHUNK: u32 = 0x004e_4942;

/// A glTF in memory.
#[derive(Debug)]
pub(super) struct Container {
    /// Everything but the buffers' bytes; references in it are checked.
    pub json: Value,
    /// Each as long as the JSON says.
    pub buffers: Vec<Vec<u8>>,
    /// Files beside it that buffers lie in.
    pub beside: Vec<PathBuf>,
    /// Of all files. units: bytes
    pub bytes: u64,
}

impl Container {
    /// Reads a file and the files it names. Which of the two kinds it is its first bytes say.
    pub(super) fn read(path: &Path) -> Result<Self, ModelFileError> {
        let bytes = read_file(path).map_err(ModelFileError::Read)?;
        let length = bytes.len() as u64;
        let start = bytes.iter().find(|c| !c.is_ascii_whitespace());
        let (json, bin) = if bytes.starts_with(MAGIC) {
            chunks(&bytes)?
        } else if start == Some(&b'{') || bytes.starts_with(b"\xef\xbb\xbf{") {
            (bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(&bytes), None)
        } else {
            return Err(ModelFileError::NotGltf);
        };
        let mut json: Value = serde_json::from_slice(json)
            .map_err(|error| ModelFileError::Json(error.to_string()))?;
        check_version(&json)?;
        check(&mut json)?;
        let mut container = Self {
            json,
            buffers: Vec::new(),
            beside: Vec::new(),
            bytes: length,
        };
        for number in 0..list(&container.json, "buffers").len() {
            container.read_buffer(number, path, bin)?;
        }
        Ok(container)
    }

    fn read_buffer(
        &mut self,
        number: usize,
        path: &Path,
        bin: Option<&[u8]>,
    ) -> Result<(), ModelFileError> {
        let buffer = &list(&self.json, "buffers")[number];
        let length = count(buffer, "byteLength")?.ok_or_else(|| {
            ModelFileError::Broken(format!("buffer {number} does not say its length"))
        })?;
        let uri = buffer
            .get("uri")
            .map(|uri| uri.as_str().unwrap_or_default());
        let mut bytes = match uri.map(Uri::of) {
            None if number == 0 => bin.unwrap_or_default().to_vec(),
            None => {
                let what = format!("buffer {number} does not say where it lies");
                return Err(ModelFileError::Broken(what));
            }
            Some(Uri::Data(bytes)) => bytes,
            Some(Uri::Undecodable) => {
                let what = format!("the address of buffer {number} cannot be decoded");
                return Err(ModelFileError::Broken(what));
            }
            Some(uri) => {
                let beside = |file: &Path, reason: String| ModelFileError::Beside {
                    buffer: number,
                    file: one_line(&file.display().to_string()),
                    reason,
                };
                let Uri::File(file) = uri else {
                    let file = Path::new(buffer["uri"].as_str().unwrap_or_default());
                    return Err(beside(file, "it is on another machine".into()));
                };
                let file = directory(path).join(file);
                let bytes = read_file(&file).map_err(|reason| beside(&file, reason))?;
                self.bytes += bytes.len() as u64;
                self.beside.push(file);
                bytes
            }
        };
        if bytes.len() < length {
            return Err(ModelFileError::Truncated {
                needs: length as u64,
                has: bytes.len() as u64,
            });
        }
        bytes.truncate(length);
        self.buffers.push(bytes);
        Ok(())
    }
}

/// All of a file; never of a device or a pipe, that may not end.
pub(super) fn read_file(path: &Path) -> Result<Vec<u8>, String> {
    match fs::metadata(path) {
        Ok(metadata) if metadata.is_file() => fs::read(path).map_err(|error| error.to_string()),
        Ok(_) => Err("it is no file".into()),
        Err(error) => Err(error.to_string()),
    }
}

/// The JSON and the BIN chunk of a `.glb`.
fn chunks(bytes: &[u8]) -> Result<(&[u8], Option<&[u8]>), ModelFileError> {
    let has = bytes.len() as u64;
    let word = |at: usize| {
        let word = bytes.get(at..at + 4).and_then(|word| word.try_into().ok());
        word.map(u32::from_le_bytes)
            .ok_or(ModelFileError::Truncated {
                needs: at as u64 + 4,
                has,
            })
    };
    let version = word(4)?;
    if version != 2 {
        return Err(ModelFileError::Version(version.to_string()));
    }
    let end = word(8)? as usize;
    if end > bytes.len() {
        return Err(ModelFileError::Truncated {
            needs: end as u64,
            has,
        });
    }
    let (mut at, mut json, mut bin) = (12, None, None);
    while at + 8 <= end {
        let (length, kind) = (word(at)? as usize, word(at + 4)?);
        let body = at + 8;
        let chunk = bytes[..end].get(body..body.saturating_add(length)).ok_or(
            ModelFileError::Truncated {
                needs: body as u64 + length as u64,
                has: end as u64,
            },
        )?;
        match kind {
            JSON_CHUNK if json.is_none() => json = Some(chunk),
            BIN_CHUNK if bin.is_none() => bin = Some(chunk),
            // Others are to be passed over.
            _ => {}
        }
        at = body + length;
    }
    match json {
        Some(json) => Ok((json, bin)),
        None => Err(ModelFileError::Json("there is none".into())),
    }
}

fn check_version(json: &Value) -> Result<(), ModelFileError> {
    if !json.is_object() {
        return Err(ModelFileError::Json("it is no object".into()));
    }
    let asset = json.get("asset");
    let version = asset.and_then(|asset| asset.get("version"));
    match version.and_then(Value::as_str) {
        Some(version) if version.starts_with("2.") => Ok(()),
        Some(version) => Err(ModelFileError::Version(one_line(&format!("{version:.20}")))),
        None => Err(ModelFileError::broken("it does not say its version")),
    }
}
