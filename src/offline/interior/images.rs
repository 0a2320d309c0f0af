//! Pictures in files beside a model, when the model goes elsewhere.

use std::path::Path;

use serde_json::Value;

use super::{
    container::read_file,
    fresh::{Fresh, FreshView},
    json::list_mut,
    uri::{Uri, directory},
};

/// Takes pictures that lie beside the model into it, unless what is written lies there, too. Gives the addresses of
/// those that could not be taken, and of those that were the bytes.
pub(super) fn take_along(
    json: &mut Value,
    from: &Path,
    to: &Path,
    fresh: &mut Fresh,
) -> (Vec<String>, u64) {
    let place = |path: &Path| directory(path).canonicalize().ok();
    let (mut left, mut bytes) = (Vec::new(), 0);
    if place(from) == place(to) {
        return (left, bytes);
    }
    for image in list_mut(json, "images") {
        let Some(uri) = image.get("uri").and_then(Value::as_str).map(str::to_owned) else {
            continue;
        };
        let picture = match Uri::of(&uri) {
            Uri::Data(_) => continue,
            Uri::File(file) => read_file(&directory(from).join(file)).ok(),
            Uri::Remote | Uri::Undecodable => None,
        };
        let kind = picture.as_deref().and_then(mime_type);
        match (picture, kind, image.as_object_mut()) {
            (Some(picture), Some(kind), Some(image)) => {
                bytes += picture.len() as u64;
                let view = fresh.add(FreshView {
                    bytes: picture,
                    ..Default::default()
                });
                image.remove("uri");
                image.insert("bufferView".into(), view.into());
                image.insert("mimeType".into(), kind.into());
            }
            _ => left.push(uri),
        }
    }
    (left, bytes)
}

/// What a picture's first bytes say that it is.
fn mime_type(bytes: &[u8]) -> Option<&'static str> {
    let is = |at: usize, magic: &[u8]| bytes.get(at..).is_some_and(|rest| rest.starts_with(magic));
    match () {
        _ if is(0, b"\x89PNG") => Some("image/png"),
        _ if is(0, b"\xff\xd8\xff") => Some("image/jpeg"),
        _ if is(0, b"RIFF") && is(8, b"WEBP") => Some("image/webp"),
        _ if is(0, b"\xabKTX 20\xbb") => Some("image/ktx2"),
        _ if is(4, b"ftypavif") => Some("image/avif"),
        _ if is(0, b"DDS ") => Some("image/vnd-ms.dds"),
        _ => None,
    }
}
