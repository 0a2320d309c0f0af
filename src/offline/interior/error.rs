//! Why a model's file cannot be trimmed, and what would help.

use std::path::{Path, PathBuf};

use crate::interior::InteriorError;

/// Says itself in one line, with the remedy.
#[derive(thiserror::Error, Debug)]
#[non_exhaustive]
pub enum TrimError {
    /// What was given cannot be used.
    #[error("{}: {source}", path.display())]
    Input {
        /// The model.
        path: PathBuf,
        /// What is wrong with it.
        source: ModelFileError,
    },
    /// What was found could not be written.
    #[error("cannot write {}: {reason}", path.display())]
    Write {
        /// What was to be written.
        path: PathBuf,
        /// Why not, and what to do.
        reason: String,
    },
}

impl TrimError {
    pub(super) fn input(path: &Path) -> impl Fn(ModelFileError) -> Self {
        |source| Self::Input {
            path: path.to_owned(),
            source,
        }
    }

    pub(super) fn write(path: &Path, reason: impl ToString) -> Self {
        Self::Write {
            path: path.to_owned(),
            reason: reason.to_string(),
        }
    }
}

/// What is wrong with a model's file.
#[derive(thiserror::Error, Debug)]
#[non_exhaustive]
pub enum ModelFileError {
    /// It could not be read at all.
    #[error("it cannot be read: {0}; name a .glb or .gltf file")]
    Read(String),
    /// It is something else.
    #[error(
        "it is no glTF: it begins neither with \"glTF\" nor with \"{{\"; name a .glb or .gltf file"
    )]
    NotGltf,
    /// Its JSON is none.
    #[error("its JSON cannot be read ({0}); export the model again")]
    Json(String),
    /// Another version of the format.
    #[error(
        "it is glTF {0}, and 2.0 is what is understood; convert it first, in Blender for instance"
    )]
    Version(String),
    /// It ends too early.
    #[error(
        "it is cut off: {needs} bytes are announced and {has} are there; copy or export it again"
    )]
    Truncated {
        /// How many bytes there should be.
        needs: u64,
        /// How many there are.
        has: u64,
    },
    /// A file beside it is not there.
    #[error(
        "its buffer {buffer} lies in {file}, which cannot be read ({reason}); put that file where the model looks for it"
    )]
    Beside {
        /// Which buffer.
        buffer: usize,
        /// Where it should lie.
        file: String,
        /// Why it could not be read.
        reason: String,
    },
    /// It breaks a rule of the format.
    #[error(
        "{0}: this is against the rules of glTF; export the model again, or see what gltf-validator says"
    )]
    Broken(String),
    /// Its vertices are compressed.
    #[error("it is compressed with {0}; decompress it first: gltf-transform copy IN.glb OUT.glb")]
    Compressed(String),
    /// It requires what is not known here.
    #[error(
        "it requires the extension {0}, which is not understood here; export the model without it"
    )]
    Extension(String),
    /// A vertex is nowhere.
    #[error(
        "node {node} has a vertex that is not finite, or farther away than f32 can say; repair its mesh or the transforms above it"
    )]
    NotFinite {
        /// Number and name.
        node: String,
    },
    /// Its size is next to nothing.
    #[error("the whole of it is {0:e} long; scale it up")]
    Small(f64),
    /// Everything can move.
    #[error(
        "every node that has triangles can move or be switched ({0}), so that nothing is sure to be hidden: there is nothing to cull"
    )]
    AllMove(String),
    /// It would take too much memory.
    #[error(
        "its vertices and triangles take more than the {allowed_mib} MiB that are allowed; allow more with --memory-mib"
    )]
    Memory {
        /// What is allowed. units: MiB
        allowed_mib: u32,
    },
    /// What is written has to be addressable with 32 bits.
    #[error(
        "what is left of it takes {0} bytes, and a .glb holds less than 4294967296; split the model first"
    )]
    TooLong(u64),
    /// It cannot be culled so.
    #[error(transparent)]
    Cull(#[from] InteriorError),
}

impl ModelFileError {
    pub(super) fn broken(what: impl Into<String>) -> Self {
        Self::Broken(what.into())
    }
}

/// Memory that may still be taken for decoded vertices and triangles. A small file can ask for any number of views of
/// the same bytes.
#[derive(Clone, Copy, Debug)]
pub(super) struct Budget {
    left: u64,
    allowed_mib: u32,
}

impl Budget {
    pub(super) fn new(allowed_mib: u32) -> Self {
        Self {
            left: u64::from(allowed_mib) << 20,
            allowed_mib,
        }
    }

    /// Takes as much for so many pieces of so many bytes.
    pub(super) fn take(&mut self, pieces: usize, bytes: usize) -> Result<(), ModelFileError> {
        let bytes = (pieces as u64).checked_mul(bytes as u64);
        match bytes.and_then(|bytes| self.left.checked_sub(bytes)) {
            Some(left) => {
                self.left = left;
                Ok(())
            }
            None => Err(self.exceeded()),
        }
    }

    /// It was not enough.
    pub(super) fn exceeded(&self) -> ModelFileError {
        ModelFileError::Memory {
            allowed_mib: self.allowed_mib,
        }
    }
}
