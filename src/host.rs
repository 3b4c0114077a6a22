//! Program and shipped files of a process that is not a program of egotac, such as a Python interpreter with the package.

use std::path::{Path, PathBuf};
use std::sync::OnceLock;

static HOST: OnceLock<Host> = OnceLock::new();

/// Places of egotac's files for a process of another program.
#[derive(Debug, Clone)]
pub struct Host {
    /// Folder of the shipped files: `models/`, `sensors/`.
    pub share: PathBuf,
    /// Program that runs the commands of `egotac`; None = there is none, and nothing runs in child processes.
    pub program: Option<PathBuf>,
}

/// Sets the places for this process; the first call counts.
pub fn set(host: Host) {
    HOST.get_or_init(|| host);
}

/// Returns the folder of the shipped files; None if [`set`] was not called.
pub(crate) fn share() -> Option<&'static Path> {
    HOST.get().map(|host| host.share.as_path())
}

/// Returns the program that runs the commands of `egotac`: that of [`set`], else this process's own.
///
/// # Errors
/// If there is none.
#[cfg(feature = "sim")]
pub(crate) fn program() -> std::io::Result<PathBuf> {
    let Some(host) = HOST.get() else { return std::env::current_exe() };
    let missing = || std::io::Error::new(std::io::ErrorKind::NotFound, "the command `egotac` is not installed");
    host.program.clone().ok_or_else(missing)
}

/// Returns the program of [`set`]; the outer None if it was not called.
#[cfg(feature = "sim")]
pub(crate) fn set_program() -> Option<Option<PathBuf>> {
    HOST.get().map(|host| host.program.clone())
}
