//! Log of a run: a CSV file with one line per step.

use std::fs::{File, OpenOptions};
use std::io::Write;
use std::path::{Path, PathBuf};

use super::Step;
use super::pass::Losses;
use crate::error::{Error, Result};
use crate::file;

/// Columns after the step and the losses.
const COLUMNS: &str = "learning_rate,grad_norm,windows,frames,secs,wait_secs";

/// An open log.
#[derive(Debug)]
pub struct Log {
    path: PathBuf,
    file: File,
}

impl Log {
    /// Opens the log of a run that continues after `step` steps; lines of later steps are dropped.
    ///
    /// # Errors
    /// If the file can't be read or written.
    pub fn open(path: &Path, step: usize) -> Result<Self> {
        let before = if step > 0 { std::fs::read_to_string(path).unwrap_or_default() } else { String::new() };
        let is_before = |line: &&str| {
            line.split(',').next().and_then(|text| text.parse::<usize>().ok()).is_some_and(|at| at <= step)
        };
        let kept: String = before.lines().filter(is_before).map(|line| format!("{line}\n")).collect();
        file::write(path, format!("step,{},{COLUMNS}\n{kept}", Losses::NAMES.join(",")).as_bytes())?;
        let file = OpenOptions::new().append(true).open(path).map_err(Error::io(path))?;
        Ok(Self { path: path.to_path_buf(), file })
    }

    /// Appends the line of one step.
    ///
    /// # Errors
    /// If the file can't be written.
    pub fn push(&mut self, s: &Step) -> Result<()> {
        let Step { step, losses, learning_rate, grad_norm, windows, frames, secs, wait_secs } = s;
        let losses: Vec<String> = losses.values().iter().map(|value| format!("{value:.6}")).collect();
        let line = format!(
            "{step},{},{learning_rate:.3e},{grad_norm:.4},{windows},{frames},{secs:.4},{wait_secs:.4}\n",
            losses.join(",")
        );
        self.file.write_all(line.as_bytes()).map_err(Error::io(&self.path))
    }
}
