//! Robots that are part of the program: those whose models are found on this machine, and short names.

use super::source;
use crate::error::{Error, Result};

/// A robot that is part of the program.
#[derive(Debug, Clone, serde::Serialize)]
pub struct Listed {
    /// Name of the robot.
    pub name: &'static str,
    /// Origin of its model on this machine: a file, or "part of the program"; None if it is not found.
    pub found: Option<String>,
    /// Model that the robot's file names, and where it is to be had.
    pub source: String,
}

/// Lists all robots that are part of the program, with the models found in the present environment.
///
/// # Errors
/// If a robot's file can't be read.
pub fn list() -> Result<Vec<Listed>> {
    source::names()
        .map(|name| Ok(Listed { name, found: source::find_model(name)?, source: source::describe(name)? }))
        .collect()
}

/// Completes the name of a robot: the start of a name up to an underscore stands for the one robot that begins so, or for the
/// only one of these whose model is found. Other names and paths are returned as they are.
///
/// # Errors
/// If several robots begin so; the error lists them.
pub fn complete(robot: &str) -> Result<String> {
    let prefix = format!("{robot}_");
    let candidates: Vec<&'static str> = source::names().filter(|name| name.starts_with(&prefix)).collect();
    if candidates.is_empty() || source::names().any(|name| name == robot) || std::path::Path::new(robot).exists() {
        return Ok(robot.to_owned());
    }
    if let [only] = candidates[..] {
        return Ok(only.to_owned());
    }
    let is_found = |name: &&'static str| matches!(source::find_model(name), Ok(Some(_)));
    let (found, missing): (Vec<&str>, Vec<&str>) = candidates.into_iter().partition(is_found);
    if let [only] = found[..] {
        return Ok(only.to_owned());
    }
    let missing: Vec<String> =
        missing.into_iter().map(|name| format!("{name} (its model is not found here)")).collect();
    Err(Error::unknown("robot", robot, found.into_iter().chain(missing.iter().map(String::as_str))))
}
