//! Faults at numbered system calls: a library that the program under test is started with.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use egotac::error::{Error, Result};

/// Source of the library.
const SOURCE: &str = include_str!("inject.c");
/// Size of `struct counts` of the library, bytes.
const COUNTS: usize = 32;
/// Kinds of calls, as the library names and orders them.
const KINDS: [&str; 6] = ["write", "sync", "rename", "create", "remove", "read"];
/// Calls that change files.
pub const CHANGES: &str = "write,sync,rename,create,remove";

/// Fault at one of the numbered calls.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Injection {
    /// Kinds of calls that are numbered together, comma separated.
    pub calls: &'static str,
    /// Number of the first call that fails, from 1; 0 = only count.
    pub number: u32,
    /// `kill`, or the number of an error.
    pub action: String,
    /// True if later calls fail too.
    pub goes_on: bool,
}

impl Injection {
    /// Counts calls and disturbs nothing.
    pub fn count() -> Self {
        Self { calls: CHANGES, number: 0, action: "0".into(), goes_on: false }
    }
}

/// Numbers of calls that a program made.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct CallCounts {
    calls: [u32; KINDS.len()],
    /// Calls that the fault hit.
    pub hits: u32,
}

impl CallCounts {
    /// Reads the file that the library counts in.
    pub fn read(path: &Path) -> Result<Self> {
        let bytes = fs::read(path).map_err(Error::io(path))?;
        let mut numbers = bytes.as_chunks::<4>().0.iter().map(|bytes| u32::from_le_bytes(*bytes));
        let calls = std::array::from_fn(|_| numbers.next().unwrap_or_default());
        Ok(Self { calls, hits: numbers.nth(1).unwrap_or_default() })
    }

    /// Returns the number of calls of these kinds, comma separated.
    pub fn of(&self, kinds: &str) -> u32 {
        kinds.split(',').filter_map(|kind| KINDS.iter().position(|known| *known == kind)).map(|at| self.calls[at]).sum()
    }
}

/// The compiled library.
#[derive(Debug)]
pub struct Library(PathBuf);

impl Library {
    /// Compiles the library in `folder`.
    ///
    /// # Errors
    /// If there is no C compiler, or it fails.
    pub fn compile(folder: &Path) -> Result<Self> {
        let [source, library] = ["inject.c", "inject.so"].map(|name| folder.join(name));
        egotac::file::write(&source, SOURCE.as_bytes())?;
        let mut compiler = Command::new("cc");
        compiler.args(["-shared", "-fPIC", "-O1", "-Wall", "-Werror", "-o"]).arg(&library).arg(&source).arg("-ldl");
        let output = compiler.output().map_err(Error::io("cc"))?;
        match output.status.success() {
            true => Ok(Self(library)),
            false => Err(Error::file(&source, String::from_utf8_lossy(&output.stderr))),
        }
    }

    /// Lets `command` run with a fault at calls on files below `below`, an absolute path; counts in the file `counts`.
    ///
    /// # Errors
    /// If the file can't be written.
    pub fn load(&self, command: &mut Command, injection: &Injection, below: &Path, counts: &Path) -> Result<()> {
        fs::write(counts, [0; COUNTS]).map_err(Error::io(counts))?;
        let Injection { calls, number, action, goes_on } = injection;
        let span = if *goes_on { "on" } else { "once" };
        command
            .env("LD_PRELOAD", &self.0)
            .env("EGOTAC_FAULT", format!("{calls}:{number}:{action}:{span}"))
            .env("EGOTAC_FAULT_BELOW", below)
            .env("EGOTAC_FAULT_COUNTS", counts);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn calls_of_all_processes_are_numbered_and_the_chosen_one_fails() {
        let folder = tempfile::tempdir().unwrap();
        let library = Library::compile(folder.path()).unwrap();
        let [below, counts] = ["below", "counts"].map(|name| folder.path().join(name));
        // `mv` renames, in a process of its own and by another call than `rename`.
        let script = "echo one > a; mv a b; cat b; mv b c";
        let run = |injection: Injection| {
            fs::create_dir(&below).unwrap();
            let mut command = Command::new("sh");
            command.args(["-c", script]).current_dir(&below);
            library.load(&mut command, &injection, &below, &counts).unwrap();
            let output = command.output().unwrap();
            let there = ["a", "b", "c"].map(|name| below.join(name).exists());
            fs::remove_dir_all(&below).unwrap();
            (output.status.success(), there, CallCounts::read(&counts).unwrap())
        };
        let (success, there, counted) = run(Injection::count());
        assert!(success && there == [false, false, true] && counted.of("rename") == 2, "{counted:?}");
        let at = |number, action: &str| Injection { calls: "rename", number, action: action.into(), goes_on: false };
        let (success, there, counted) = run(at(2, "5"));
        assert!(!success && there == [false, true, false] && counted.hits == 1, "{counted:?}");
        let (_, there, counted) = run(at(1, "kill"));
        assert!(there == [true, false, false] && counted.hits == 1, "{counted:?}");
    }
}
