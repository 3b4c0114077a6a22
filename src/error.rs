//! The library's error type: names the input, the expected value and the actual value.

use std::path::{Path, PathBuf};

/// `Result` with the library's [`Error`].
pub type Result<T> = std::result::Result<T, Error>;

/// Error of the library.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A file or directory could not be read or written.
    #[error("{path}: {source}")]
    Io {
        /// Path of the file or directory.
        path: PathBuf,
        /// Error of the operating system.
        source: std::io::Error,
    },

    /// Labelling stopped where an input could not be read further.
    #[error("{cause}; {frames} images of {unit} are labelled, and the same command goes on there")]
    Stopped {
        /// Name of the episode or file.
        unit: String,
        /// Number of its images that are labelled.
        frames: usize,
        /// Reason of the stop.
        cause: Box<Error>,
    },

    /// A file has invalid content.
    #[error("{path}: {message}")]
    File {
        /// Path of the file.
        path: PathBuf,
        /// Expected and actual content.
        message: String,
    },

    /// An array, tensor or message field has the wrong shape.
    #[error("{name}: expected shape {expected}, got {got}")]
    Shape {
        /// Name of the array.
        name: String,
        /// Expected shape.
        expected: String,
        /// Actual shape.
        got: String,
    },

    /// A named array, tensor, key or field is absent.
    #[error("{name} is missing from {place}; there: {present}")]
    Missing {
        /// Name of the absent element.
        name: String,
        /// File, message or table that was searched.
        place: String,
        /// Names that are present, comma separated.
        present: String,
    },

    /// A name is not among the valid ones.
    #[error("{kind} {name:?} is unknown; known: {known}")]
    Unknown {
        /// Kind of element, e.g. `preset`.
        kind: &'static str,
        /// Unknown name.
        name: String,
        /// Valid names, comma separated.
        known: String,
    },

    /// A value is outside of its range or set.
    #[error("{name}: expected {expected}, got {got}")]
    Value {
        /// Name of the field, option or parameter.
        name: String,
        /// Valid values.
        expected: String,
        /// Actual value.
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

    /// Two fields have different topologies.
    #[error("topology mismatch: {left} and {right}; `egotac hand map` converts fields")]
    Topology {
        /// Topology id of the first field.
        left: String,
        /// Topology id of the second field.
        right: String,
    },

    /// A tensor operation or its device failed.
    #[error("network: {0}")]
    Candle(#[from] candle_core::Error),

    /// The physics engine or its renderer reported an error.
    #[error("mujoco: {0}")]
    Engine(String),

    /// A child process reported an error; the text is its own.
    #[error("{0}")]
    Child(String),
}

impl Error {
    /// Returns a function that adds a path to an I/O error.
    pub fn io(path: impl AsRef<Path>) -> impl FnOnce(std::io::Error) -> Self {
        let path = path.as_ref().to_path_buf();
        move |source| Self::Io { path, source }
    }

    /// Creates the error of a library that read `path`: [`Error::Io`] if an error of the operating system caused it, else
    /// [`Error::File`]. Libraries pass errors of the operating system on as text, which always holds the number.
    pub fn library(path: impl AsRef<Path>, error: impl ToString) -> Self {
        let message = error.to_string();
        match os_error(&message) {
            Some(number) => Self::io(path)(std::io::Error::from_raw_os_error(number)),
            None => Self::file(path, message),
        }
    }

    /// Creates [`Error::File`].
    pub fn file(path: impl AsRef<Path>, message: impl ToString) -> Self {
        Self::File { path: path.as_ref().to_path_buf(), message: message.to_string() }
    }

    /// Creates [`Error::Shape`].
    pub fn shape(name: impl ToString, expected: impl ToString, got: impl std::fmt::Debug) -> Self {
        Self::Shape { name: name.to_string(), expected: expected.to_string(), got: format!("{got:?}") }
    }

    /// Creates [`Error::Value`].
    pub fn value(name: impl ToString, expected: impl ToString, got: impl ToString) -> Self {
        Self::Value { name: name.to_string(), expected: expected.to_string(), got: got.to_string() }
    }

    /// Creates [`Error::Unknown`].
    pub fn unknown<'a>(kind: &'static str, name: impl ToString, known: impl IntoIterator<Item = &'a str>) -> Self {
        let known = known.into_iter().collect::<Vec<_>>().join(", ");
        Self::Unknown { kind, name: name.to_string(), known }
    }

    /// True if the operating system could not read or write: the medium failed, and the content is not known to be damaged.
    pub fn is_of_medium(&self) -> bool {
        matches!(self, Self::Io { .. })
    }

    /// True if the error concerns one input alone (a value, a shape, numbers that overflow), so that the next input may
    /// succeed; false if a file, a device or an engine failed.
    pub fn is_recoverable(&self) -> bool {
        matches!(self, Self::Value { .. } | Self::Shape { .. } | Self::NotFinite { .. })
    }
}

/// Returns the number of the operating system's error that a text quotes, as in `Input/output error (os error 5)`.
fn os_error(text: &str) -> Option<i32> {
    text.split_once("(os error ")?.1.split_once(')')?.0.parse().ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_error_of_the_operating_system_is_recognised_behind_a_library() {
        let quoted = format!("External: {}", std::io::Error::from_raw_os_error(libc::EIO));
        assert_eq!(Error::library("a", quoted).to_string(), "a: Input/output error (os error 5)");
        assert!(Error::library("a", "os error (os error 5)").is_of_medium());
        assert!(!Error::library("a", "invalid magic (os error x)").is_of_medium());
    }
}
