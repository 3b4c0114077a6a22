//! Other programs (peers) that are measured in turn with ours.

use std::ffi::OsString;
use std::process::Command;

use egotac::error::{Error, Result};
use serde::de::DeserializeOwned;

/// Runs `command` with further arguments on `threads` threads and reads the JSON value on the last line of its output.
///
/// # Errors
/// If the peer can't be started, fails, or prints something else.
pub fn ask<T: DeserializeOwned>(command: &str, arguments: &[OsString], threads: usize) -> Result<T> {
    let mut words = command.split_whitespace();
    let program = words.next().ok_or_else(|| Error::value("peer", "a command", "nothing"))?;
    let output = Command::new(program)
        .args(words)
        .args(arguments)
        .env("OMP_NUM_THREADS", threads.to_string())
        .output()
        .map_err(Error::io(program))?;
    if !output.status.success() {
        let said = String::from_utf8_lossy(&output.stderr);
        let said = said.trim().lines().last().unwrap_or_default().to_owned();
        return Err(Error::value(format!("peer {command:?}"), "success", format!("{}: {said}", output.status)));
    }
    let text = String::from_utf8_lossy(&output.stdout);
    let last = text.trim().lines().last().unwrap_or_default();
    serde_json::from_str(last).map_err(|error| Error::value(format!("peer {command:?}"), "timings in JSON", error))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_last_line_is_read_and_failures_name_the_peer() {
        let numbers: Vec<u32> = ask("printf", &["hello\n[1, 2]\n".into()], 1).unwrap();
        assert_eq!(numbers, [1, 2]);
        let told = |command: &str| ask::<Vec<u32>>(command, &[], 1).unwrap_err().to_string();
        assert!(told("false").contains("peer \"false\"") && told("echo soon").contains("timings in JSON"));
        assert!(told("no-such-program-here").contains("no-such-program-here") && told("").contains("a command"));
    }
}
