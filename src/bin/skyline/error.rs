//! Why the command fails, and how it says so.

use std::path::{Path, PathBuf};

use bevy_skyline::{
    offline::{
        accuracy::AccuracyError, interior::TrimError, render::RenderError, shadow_map::MapError,
        workload::WorkloadError,
    },
    terrain::HeightFieldLoadError,
};

/// Why the command failed; says itself in one line.
#[derive(thiserror::Error, Debug)]
pub(crate) enum CliError {
    #[error("{0}")]
    Usage(String),
    #[error("{}: {source}", path.display())]
    HeightMap {
        path: PathBuf,
        source: HeightFieldLoadError,
    },
    #[error("cannot write {}: there is no directory {}; create it first", path.display(), parent.display())]
    NoDirectory { path: PathBuf, parent: PathBuf },
    #[error("cannot write {}: it is a directory; name a file in it", .0.display())]
    IsDirectory(PathBuf),
    #[error("cannot write {}: {reason}", path.display())]
    Write { path: PathBuf, reason: String },
    #[error(transparent)]
    Render(#[from] RenderError),
    #[error(transparent)]
    Map(#[from] MapError),
    #[error(transparent)]
    Interior(#[from] TrimError),
    #[error(transparent)]
    Accuracy(#[from] AccuracyError),
    #[error(transparent)]
    Workload(#[from] WorkloadError),
}

impl CliError {
    /// 2: other input would have helped; 1: another machine would.
    pub(crate) fn exit_code(&self) -> u8 {
        match self {
            Self::Render(error) if !error.is_input() => 1,
            Self::Map(error) if !error.is_input() => 1,
            Self::Accuracy(error) if !error.is_input() => 1,
            Self::Workload(error) if !error.is_input() => 1,
            _ => 2,
        }
    }
}

/// Whether a file can be made there, as far as can be told without making it.
pub(crate) fn check_writable(path: &Path) -> Result<(), CliError> {
    if path.is_dir() {
        return Err(CliError::IsDirectory(path.to_owned()));
    }
    match path.parent() {
        Some(parent) if !parent.as_os_str().is_empty() && !parent.is_dir() => {
            Err(CliError::NoDirectory {
                path: path.to_owned(),
                parent: parent.to_owned(),
            })
        }
        _ => Ok(()),
    }
}

/// The first paragraph of clap's message, without its label.
pub(crate) fn usage_line(error: &clap::Error) -> String {
    let text = error.to_string();
    let first = text.split("\n\n").next().unwrap_or(&text);
    let first = first.strip_prefix("error: ").unwrap_or(first);
    let line: Vec<_> = first.split_whitespace().collect();
    format!("{}; see `skyline --help`", line.join(" "))
}
