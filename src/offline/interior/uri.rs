//! Addresses in a glTF: data within, and files beside it.

use std::path::{Path, PathBuf};

/// What an address leads to.
#[derive(Debug, PartialEq)]
pub(super) enum Uri {
    /// The bytes that it holds itself.
    Data(Vec<u8>),
    /// A file, from the model's directory.
    File(PathBuf),
    /// Something that is not on this machine.
    Remote,
    /// Data that cannot be decoded.
    Undecodable,
}

impl Uri {
    pub(super) fn of(text: &str) -> Self {
        if let Some(data) = text.strip_prefix("data:") {
            let decoded = match data.split_once(',') {
                Some((head, body)) if head.ends_with(";base64") => base64(&percent(body)),
                Some((_, body)) => Some(percent(body)),
                None => None,
            };
            return decoded.map_or(Self::Undecodable, Self::Data);
        }
        if text.contains("://") {
            return Self::Remote;
        }
        String::from_utf8(percent(text)).map_or(Self::Undecodable, |path| Self::File(path.into()))
    }
}

/// `%41` is A; what is none of these stays.
fn percent(text: &str) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(text.len());
    let mut rest = text.as_bytes();
    while let Some((first, after)) = rest.split_first() {
        let digit = |at: usize| after.get(at).and_then(|c| char::from(*c).to_digit(16));
        match (first, digit(0), digit(1)) {
            (b'%', Some(high), Some(low)) => {
                bytes.push((high * 16 + low) as u8);
                rest = &after[2..];
            }
            _ => {
                bytes.push(*first);
                rest = after;
            }
        }
    }
    bytes
}

/// A file's name as an address.
pub(super) fn encode(name: &str) -> String {
    let plain = |c: &u8| c.is_ascii_alphanumeric() || b"-._~".contains(c);
    name.bytes()
        .map(|c| {
            if plain(&c) {
                char::from(c).to_string()
            } else {
                format!("%{c:02X}")
            }
        })
        .collect()
}

/// Of RFC 4648, with or without padding, in either alphabet.
fn base64(text: &[u8]) -> Option<Vec<u8>> {
    let mut bytes = Vec::with_capacity(text.len() / 4 * 3 + 3);
    let (mut bits, mut held) = (0u32, 0);
    for c in text.iter().filter(|c| !c.is_ascii_whitespace()) {
        let value = match c {
            b'A'..=b'Z' => c - b'A',
            b'a'..=b'z' => c - b'a' + 26,
            b'0'..=b'9' => c - b'0' + 52,
            b'+' | b'-' => 62,
            b'/' | b'_' => 63,
            b'=' => break,
            _ => return None,
        };
        bits = bits << 6 | u32::from(value);
        held += 6;
        if held >= 8 {
            held -= 8;
            bytes.push((bits >> held) as u8);
        }
    }
    Some(bytes)
}

/// The directory that a model's addresses are relative to.
pub(super) fn directory(model: &Path) -> &Path {
    match model.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses_are_understood() {
        let data = |text: &str| Uri::Data(text.as_bytes().to_vec());
        assert_eq!(
            Uri::of("data:application/octet-stream;base64,aGVsbG8="),
            data("hello")
        );
        assert_eq!(Uri::of("data:;base64,aGVsbG8"), data("hello"));
        assert_eq!(Uri::of("data:,a%20b"), data("a b"));
        assert_eq!(Uri::of("data:;base64,a*"), Uri::Undecodable);
        assert_eq!(Uri::of("data:nothing"), Uri::Undecodable);
        assert_eq!(Uri::of("https://a/b.bin"), Uri::Remote);
        assert_eq!(Uri::of("a%20b%é%.bin"), Uri::File("a b%é%.bin".into()));
        assert_eq!(Uri::of(&encode("ä b/%.bin")), Uri::File("ä b/%.bin".into()));
        assert_eq!(Uri::of("%ff"), Uri::Undecodable);
    }
}
