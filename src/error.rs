//! The error type of the library.

use std::path::{Path, PathBuf};

/// `Result` with the library's [`Error`].
pub type Result<T> = std::result::Result<T, Error>;

/// Everything that can go wrong in the library. Each variant carries the name of the thing, the expected value and the
/// value that came.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A file or folder could not be read or written.
    #[error("{path}: {source}")]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// Error of the operating system.
        source: std::io::Error,
    },

    /// A file was read, but its content is not as expected.
    #[error("{path}: {message}")]
    File {
        /// The file.
        path: PathBuf,
        /// Expected and found content.
        message: String,
    },

    /// An array, tensor or message field has a wrong shape.
    #[error("{name}: expected shape {expected}, got {got}")]
    Shape {
        /// Name of the array.
        name: String,
        /// Expected shape.
        expected: String,
        /// Shape that came.
        got: String,
    },

    /// A named array, tensor, key or field is absent.
    #[error("{name} is missing from {place}; there: {present}")]
    Missing {
        /// Name of the absent thing.
        name: String,
        /// File, message or table that lacks it.
        place: String,
        /// Names that are present, comma separated.
        present: String,
    },

    /// A name that is not among the known ones.
    #[error("{kind} {name:?} is unknown; known: {known}")]
    Unknown {
        /// Kind of thing, e.g. `preset`.
        kind: &'static str,
        /// The unknown name.
        name: String,
        /// The known names, comma separated.
        known: String,
    },

    /// A value outside its allowed range or set.
    #[error("{name}: expected {expected}, got {got}")]
    Value {
        /// Field, option or parameter.
        name: String,
        /// Allowed values.
        expected: String,
        /// Value that came.
        got: String,
    },

    /// A number that the network computed is not finite: its input or weights exceed the range of f32.
    #[error("network, {tensor}: expected finite numbers, got {value} at {index}")]
    NotFinite {
        /// Step of the network, by the name of its tensors in a checkpoint; `images` is the input.
        tensor: String,
        /// Place of the first such number in the step's output.
        index: usize,
        /// The number.
        value: f32,
    },

    /// Attention weights were asked of a network that does not keep them.
    #[error("attention weights need the trainable form of the network; load the checkpoint without compiling it")]
    CompiledNetwork,

    /// Two fields whose vertices are numbered differently.
    #[error("topology mismatch: {left} and {right}; `egotac hand map` converts fields")]
    Topology {
        /// Topology id of one side.
        left: String,
        /// Topology id of the other side.
        right: String,
    },

    /// A tensor operation or its device failed.
    #[error("network: {0}")]
    Candle(#[from] candle_core::Error),

    /// The physics engine or its renderer reported an error.
    #[error("mujoco: {0}")]
    Engine(String),
}

impl Error {
    /// Wraps an I/O error with the path it happened at.
    pub fn io(path: impl AsRef<Path>) -> impl FnOnce(std::io::Error) -> Self {
        let path = path.as_ref().to_path_buf();
        move |source| Self::Io { path, source }
    }

    /// Creates an error about the content of a file.
    pub fn file(path: impl AsRef<Path>, message: impl ToString) -> Self {
        Self::File { path: path.as_ref().to_path_buf(), message: message.to_string() }
    }

    /// Creates an error about a shape.
    pub fn shape(name: impl ToString, expected: impl ToString, got: impl std::fmt::Debug) -> Self {
        Self::Shape { name: name.to_string(), expected: expected.to_string(), got: format!("{got:?}") }
    }

    /// Creates an error about a value outside its allowed range or set.
    pub fn value(name: impl ToString, expected: impl ToString, got: impl ToString) -> Self {
        Self::Value { name: name.to_string(), expected: expected.to_string(), got: got.to_string() }
    }

    /// Creates an error about a name that is not among the known ones.
    pub fn unknown<'a>(kind: &'static str, name: impl ToString, known: impl IntoIterator<Item = &'a str>) -> Self {
        let known = known.into_iter().collect::<Vec<_>>().join(", ");
        Self::Unknown { kind, name: name.to_string(), known }
    }

    /// True if the error concerns one input alone (a value, a shape, numbers that overflow), so that the next input may
    /// succeed; false if a file, a device or an engine failed.
    pub fn is_recoverable(&self) -> bool {
        matches!(self, Self::Value { .. } | Self::Shape { .. } | Self::NotFinite { .. })
    }
}
