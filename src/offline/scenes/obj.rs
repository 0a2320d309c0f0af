//! A small reader of Wavefront OBJ: positions and faces, nothing else.

use std::path::Path;

use super::SceneError;

/// Positions and the triangles between them.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ObjMesh {
    /// In the file's own unit.
    pub positions: Vec<[f32; 3]>,
    /// Three a triangle; each below the number of positions.
    pub indices: Vec<u32>,
}

/// Reads the `v` and `f` lines of a file; polygons become fans, all other lines are passed over.
///
/// # Errors
/// [`SceneError::Read`], [`SceneError::Obj`] with the line, [`SceneError::NoFaces`].
pub fn read(path: &Path) -> Result<ObjMesh, SceneError> {
    let text = std::fs::read_to_string(path).map_err(|error| SceneError::read(path, &error))?;
    let mut mesh = ObjMesh::default();
    for (index, text) in text.lines().enumerate() {
        let wrong = |what| SceneError::Obj {
            path: path.to_owned(),
            line: index + 1,
            what,
        };
        let mut words = text.split_whitespace();
        match words.next() {
            Some("v") => {
                let mut number = || {
                    let number = words.next()?.parse::<f32>().ok()?;
                    number.is_finite().then_some(number)
                };
                let (Some(x), Some(y), Some(z)) = (number(), number(), number()) else {
                    return Err(wrong("a vertex needs three finite numbers"));
                };
                mesh.positions.push([x, y, z]);
            }
            Some("f") => {
                let count = mesh.positions.len();
                let corners: Option<Vec<u32>> = words.map(|word| corner(word, count)).collect();
                let corners =
                    corners.ok_or_else(|| wrong("a face names a vertex that is not above it"))?;
                if corners.len() < 3 {
                    return Err(wrong("a face needs three vertices"));
                }
                for pair in corners[1..].windows(2) {
                    mesh.indices.extend([corners[0], pair[0], pair[1]]);
                }
            }
            _ => {}
        }
    }
    if mesh.indices.is_empty() {
        return Err(SceneError::NoFaces {
            path: path.to_owned(),
        });
    }
    Ok(mesh)
}

/// The vertex of `3`, `3/1`, `3//2` or `-1`, counted from 0.
fn corner(word: &str, count: usize) -> Option<u32> {
    let number: i64 = word.split('/').next()?.parse().ok()?;
    let index = if number < 0 {
        count as i64 + number
    } else {
        number - 1
    };
    ((0..count as i64).contains(&index)).then(|| u32::try_from(index).ok())?
}
