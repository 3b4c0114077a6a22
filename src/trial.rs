//! Trial of a load in a child process: a model of others that crashes, hangs or fills the memory ends the child alone.
//!
//! The child is the program `egotac`. It does what the caller is about to do, with limits of memory and processor time
//! ([`limits::MODEL_MEMORY`], [`limits::MODEL_SECONDS`]); the caller loads a model itself only after the trial succeeded.
//! A program that is not `egotac` uses the one beside it, as the nodes do. If there is none, as beside a program of
//! somebody who uses the library, nothing is tried: such a program loads models in its own process.

mod child;

use std::collections::HashSet;
use std::path::{Path, PathBuf};
use std::process::ExitStatus;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{LazyLock, Mutex, OnceLock, PoisonError};

use serde::{Deserialize, Serialize};

use self::child::{Ending, run};
pub use self::child::{end_with_parent, serve};
use crate::error::{Error, Result};
use crate::file;
use crate::file::limits::{self, Limit};
use crate::host;

/// Name of the program that serves trials.
const PROGRAM: &str = "egotac";
/// Folders of a build in which cargo puts tests and examples, one below the programs.
const BUILD_FOLDERS: [&str; 2] = ["deps", "examples"];

/// True in a process whose parent has tried the same loads, and in the child of a trial.
static TRIED_BY_PARENT: AtomicBool = AtomicBool::new(false);
/// Keys of the trials of this process that succeeded.
static SUCCEEDED: LazyLock<Mutex<HashSet<String>>> = LazyLock::new(Mutex::default);

/// A load to try.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub enum Trial {
    /// A robot, as [`crate::retarget::Robot::load`] takes it.
    Robot {
        /// Name, YAML file or model.
        robot: String,
        /// Model that replaces the one of the YAML file.
        model: Option<PathBuf>,
    },
    /// An object beside a robot: model or mesh.
    Object(PathBuf),
    /// An object of a scene from a mesh file.
    Mesh {
        /// OBJ or STL file.
        file: PathBuf,
        /// Metres per unit of the file.
        scale: f64,
    },
}

/// Program that [`serve_by_this_program`] chose.
static THIS_PROGRAM: OnceLock<PathBuf> = OnceLock::new();

/// Serves the trials of this process by its own program, whatever its name; its `main` must hand the command `sim` to
/// [`crate::cli::main`].
///
/// # Errors
/// If the path of the program is unknown.
pub fn serve_by_this_program() -> Result<()> {
    let own = std::env::current_exe().map_err(Error::io("the path of this program"))?;
    THIS_PROGRAM.get_or_init(|| own);
    Ok(())
}

/// Skips all further trials of this process, because its parent has tried the same files.
pub fn trust_parent() {
    TRIED_BY_PARENT.store(true, Ordering::Relaxed);
}

impl Trial {
    /// Tries the load in a child process. A load that succeeded is not tried again while its files stay the same.
    ///
    /// # Errors
    /// If the load fails, ends its process, or exceeds a limit; the error then names the file and the limit.
    pub fn run(&self) -> Result<()> {
        if TRIED_BY_PARENT.load(Ordering::Relaxed) {
            return Ok(());
        }
        let Some(program) = program() else { return Ok(()) };
        let request = serde_json::to_string(self).map_err(|error| Error::file(self.path(), error))?;
        let key = self.key(&request)?;
        let succeeded = || SUCCEEDED.lock().unwrap_or_else(PoisonError::into_inner);
        if succeeded().contains(&key) {
            return Ok(());
        }
        self.judge(run(&program, &request)?)?;
        succeeded().insert(key);
        Ok(())
    }

    /// Turns the end of the child into an error.
    fn judge(&self, ending: Ending) -> Result<()> {
        let limit = |limit: Limit, what: &str| {
            let (most, unit, variable) = (limit.value(), limit.unit, limit.variable());
            let expected =
                format!("expected a model that loads within {most} {unit} of {what}, got one that needs more");
            Err(Error::file(self.path(), format!("{expected}; {variable} raises the limit")))
        };
        match ending {
            Ending::Loaded => Ok(()),
            // An older program, or one without simulation: no trial is possible.
            Ending::NotServed => {
                tracing::warn!(
                    "{} is loaded without a trial: the program {PROGRAM} is of another build",
                    self.path().display()
                );
                Ok(())
            }
            Ending::Refused(text) if is_about_memory(&text) => {
                let variable = limits::MODEL_MEMORY.variable();
                Err(Error::Child(format!("{text}; {variable} raises the limit of memory")))
            }
            Ending::Refused(text) => Err(Error::Child(text)),
            Ending::TimedOut => limit(limits::MODEL_SECONDS, "processor time"),
            Ending::Ended(_, text) if is_about_memory(&text) => limit(limits::MODEL_MEMORY, "memory"),
            Ending::Ended(status, _) => Err(Error::file(self.path(), crash(status))),
        }
    }

    /// File or name for errors.
    fn path(&self) -> &Path {
        match self {
            Self::Robot { robot, model } => model.as_deref().unwrap_or(Path::new(robot)),
            Self::Object(file) | Self::Mesh { file, .. } => file,
        }
    }

    /// Returns the request with the checksums of the files that it names.
    fn key(&self, request: &str) -> Result<String> {
        let (files, with) = match self {
            Self::Robot { robot, model } => (vec![Some(Path::new(robot)), model.as_deref()], request),
            // The decomposition of a mesh does not depend on its scale.
            Self::Object(file) | Self::Mesh { file, .. } => (vec![Some(file.as_path())], ""),
        };
        let mut key = with.to_owned();
        for file in files.into_iter().flatten().filter(|file| file.is_file()) {
            let bytes = file::input::read(file, limits::FILE)?;
            key += &format!(" {} {}", file.display(), file::sha256(&bytes));
        }
        Ok(key)
    }
}

/// Text for a child that ended without an answer.
fn crash(status: ExitStatus) -> String {
    format!("expected a model that can be loaded, got one that ends its process with {status}; repair or replace it")
}

/// True if a message of an allocator or of the engine says that memory ran out.
fn is_about_memory(text: &str) -> bool {
    ["alloc", "out of memory"].iter().any(|word| text.to_lowercase().contains(word))
}

/// Returns the program that serves trials: this one, or the one beside it.
fn program() -> Option<PathBuf> {
    if let Some(own) = THIS_PROGRAM.get() {
        return Some(own.clone());
    }
    if let Some(program) = host::set_program() {
        return program;
    }
    let own = std::env::current_exe().ok()?;
    if own.file_name()? == PROGRAM {
        return Some(own);
    }
    let folder = own.parent()?;
    let folder = match folder.file_name().is_some_and(|name| BUILD_FOLDERS.iter().any(|known| name == *known)) {
        true => folder.parent()?,
        false => folder,
    };
    Some(folder.join(PROGRAM)).filter(|program| program.is_file())
}
