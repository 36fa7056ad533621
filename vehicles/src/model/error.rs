//! Why a model cannot be used.

use super::MOST_TRIANGLES;
use std::path::PathBuf;

/// Why a model cannot be used, in a sentence.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ModelError {
    /// A file cannot be read.
    #[error("the model {} cannot be read: {}: {source}", path.display(), file.display())]
    Read {
        /// The model.
        path: PathBuf,
        /// The file: the model itself, or one that it refers to.
        file: PathBuf,
        /// Why.
        #[source]
        source: std::io::Error,
    },
    /// It is not glTF 2.0.
    #[error("{} is not a model: expected glTF 2.0 (.gltf or .glb): {reason}", path.display())]
    Malformed {
        /// The model.
        path: PathBuf,
        /// Why.
        reason: String,
    },
    /// It needs what is not read.
    #[error(
        "the model {} needs {what}, which is not read: expected core glTF 2.0, with triangles of float positions, without \
         compression", path.display()
    )]
    Unsupported {
        /// The model.
        path: PathBuf,
        /// What it needs.
        what: String,
    },
    /// It has too many triangles.
    #[error(
        "the model {} has more than {MOST_TRIANGLES} triangles: expected at most so many; make a simpler one of it, e.g. by \
         gltfpack -si 0.1", path.display()
    )]
    TooManyTriangles {
        /// The model.
        path: PathBuf,
    },
    /// There is nothing to draw in it.
    #[error("the model {} has no triangles in its scene: expected at least one", path.display())]
    Empty {
        /// The model.
        path: PathBuf,
    },
}
