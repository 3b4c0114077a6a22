//! The library's one error type: what was looked at, what was expected, what came.

use std::path::{Path, PathBuf};

/// `Result` with the library's [`Error`].
pub type Result<T> = std::result::Result<T, Error>;

/// Everything that can go wrong in the library.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// A file or folder could not be read or written.
    #[error("{path}: {source}")]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// What the operating system said.
        source: std::io::Error,
    },

    /// A file was read, but its content is not what it should be.
    #[error("{path}: {message}")]
    File {
        /// The file.
        path: PathBuf,
        /// What was expected and what came.
        message: String,
    },

    /// An array, tensor or message field has another shape than needed.
    #[error("{name}: expected shape {expected}, got {got}")]
    Shape {
        /// The array's name.
        name: String,
        /// The shape that would have worked.
        expected: String,
        /// The shape that came.
        got: String,
    },

    /// A named array, tensor, key or field is absent.
    #[error("{name} is missing from {place}; there: {present}")]
    Missing {
        /// What was looked for.
        name: String,
        /// The file, message or table it was looked for in.
        place: String,
        /// What is there instead, comma separated.
        present: String,
    },

    /// A name that is not among the known ones.
    #[error("{kind} {name:?} is unknown; known: {known}")]
    Unknown {
        /// Kind of thing, e.g. `preset`.
        kind: &'static str,
        /// The name that came.
        name: String,
        /// The valid names, comma separated.
        known: String,
    },

    /// A value outside its allowed range or set.
    #[error("{name}: expected {expected}, got {got}")]
    Value {
        /// The field, option or parameter.
        name: String,
        /// What is allowed.
        expected: String,
        /// What came.
        got: String,
    },

    /// Two fields that name their vertices differently.
    #[error("topology mismatch: {left} and {right}; `egotac hand map` converts fields")]
    Topology {
        /// Topology id of one side.
        left: String,
        /// Topology id of the other side.
        right: String,
    },

    /// A tensor operation failed.
    #[error("network: {0}")]
    Candle(#[from] candle_core::Error),

    /// The physics engine or its renderer refused something.
    #[error("mujoco: {0}")]
    Engine(String),
}

impl Error {
    /// Wraps an I/O error with the path it happened at.
    pub fn io(path: impl AsRef<Path>) -> impl FnOnce(std::io::Error) -> Self {
        let path = path.as_ref().to_path_buf();
        move |source| Self::Io { path, source }
    }

    /// A file whose content is not what it should be.
    pub fn file(path: impl AsRef<Path>, message: impl ToString) -> Self {
        Self::File { path: path.as_ref().to_path_buf(), message: message.to_string() }
    }

    /// A shape other than the one needed.
    pub fn shape(name: impl ToString, expected: impl ToString, got: impl std::fmt::Debug) -> Self {
        Self::Shape { name: name.to_string(), expected: expected.to_string(), got: format!("{got:?}") }
    }

    /// A value outside its allowed range or set.
    pub fn value(name: impl ToString, expected: impl ToString, got: impl ToString) -> Self {
        Self::Value { name: name.to_string(), expected: expected.to_string(), got: got.to_string() }
    }

    /// A name that is not among the known ones.
    pub fn unknown<'a>(kind: &'static str, name: impl ToString, known: impl IntoIterator<Item = &'a str>) -> Self {
        let known = known.into_iter().collect::<Vec<_>>().join(", ");
        Self::Unknown { kind, name: name.to_string(), known }
    }
}
