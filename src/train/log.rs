//! Log of a run: a CSV file with one line per step.

use std::fs::{File, OpenOptions};
use std::io::Write;
use std::path::{Path, PathBuf};

use super::Step;
use super::pass::Losses;
use crate::error::{Error, Result};
use crate::file::{self, input, limits};

/// Columns after the step and the losses.
const COLUMNS: &str = "learning_rate,grad_norm,windows,frames,secs,wait_secs,exchange_secs,exchange_bytes";

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
        let before = match step > 0 && path.exists() {
            true => input::read_text(path, limits::FILE)?,
            false => String::new(),
        };
        let header = format!("step,{},{COLUMNS}", Losses::NAMES.join(","));
        // A line that was cut off by a kill may read as that of an earlier step. Logs of older versions have fewer columns.
        let commas = |line: &str| line.matches(',').count();
        let written = before.lines().next().map_or(0, commas);
        let is_whole = |line: &&str| commas(line) == written;
        let missing = ",0".repeat(commas(&header).saturating_sub(written));
        let is_before = |line: &&str| {
            line.split(',').next().and_then(|text| text.parse::<usize>().ok()).is_some_and(|at| at <= step)
        };
        let lines = before.split_inclusive('\n').filter_map(|line| line.strip_suffix('\n'));
        let kept: String = lines.filter(is_whole).filter(is_before).map(|line| format!("{line}{missing}\n")).collect();
        file::write(path, format!("{header}\n{kept}").as_bytes())?;
        let file = OpenOptions::new().append(true).open(path).map_err(Error::io(path))?;
        Ok(Self { path: path.to_path_buf(), file })
    }

    /// Appends the line of one step.
    ///
    /// # Errors
    /// If the file can't be written.
    pub fn push(&mut self, s: &Step) -> Result<()> {
        let Step {
            step,
            losses,
            learning_rate,
            grad_norm,
            windows,
            frames,
            secs,
            wait_secs,
            exchange_secs,
            exchange_bytes,
        } = s;
        let losses: Vec<String> = losses.values().iter().map(|value| format!("{value:.6}")).collect();
        let line = format!(
            "{step},{},{learning_rate:.3e},{grad_norm:.4},{windows},{frames},{secs:.4},{wait_secs:.4},{exchange_secs:.4},{exchange_bytes}\n",
            losses.join(",")
        );
        self.file.write_all(line.as_bytes()).map_err(Error::io(&self.path))
    }

    /// Writes all lines to disk: a state that is saved afterwards has its log.
    ///
    /// # Errors
    /// If the file can't be written.
    pub fn sync(&self) -> Result<()> {
        self.file.sync_data().map_err(Error::io(&self.path))
    }
}
