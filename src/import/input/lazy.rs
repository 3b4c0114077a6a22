//! Annotations of a whole recording that are read at their first use and can be freed.

use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

use crate::error::{Error, Result};

/// A value that is read when it is first needed. A failure is kept as well, so that a damaged file is read once.
#[derive(Debug)]
pub struct Lazy<T>(Mutex<Option<std::result::Result<Arc<T>, Fault>>>);

/// Error of a file's content, kept to be returned again.
#[derive(Debug, Clone)]
struct Fault {
    path: PathBuf,
    message: String,
}

impl<T> Default for Lazy<T> {
    fn default() -> Self {
        Self(Mutex::new(None))
    }
}

impl<T> Lazy<T> {
    /// Returns the value, which `load` reads from the file at `path` at the first use.
    ///
    /// # Errors
    /// As `load`. A failure of the medium is not kept.
    pub fn get(&self, path: &Path, load: impl FnOnce() -> Result<T>) -> Result<Arc<T>> {
        let mut slot = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(kept) = &*slot {
            return kept.clone().map_err(|Fault { path, message }| Error::file(path, message));
        }
        let error = match load() {
            Ok(value) => {
                let value = Arc::new(value);
                *slot = Some(Ok(Arc::clone(&value)));
                return Ok(value);
            }
            Err(error) => error,
        };
        *slot = match &error {
            error if error.is_of_medium() => None,
            Error::File { path, message } => Some(Err(Fault { path: path.clone(), message: message.clone() })),
            other => Some(Err(Fault { path: path.to_path_buf(), message: other.to_string() })),
        };
        Err(error)
    }

    /// Frees the value; the next use reads it again.
    pub fn release(&self) {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) = None;
    }
}
