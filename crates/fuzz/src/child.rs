//! The process that reads hostile inputs. It writes each to disk before it reads it, so that the input survives it.

use std::fs;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use anyhow::Context;
use rand::SeedableRng;

use crate::case::Case;
use crate::limits;
use crate::mutate::Rng;
use crate::targets::Target;

/// File with the number of the input being read.
pub const NUMBER: &str = "number";
/// File with the counts of a child that came to its end.
pub const COUNTS: &str = "counts";

/// Inputs of a child.
#[derive(Debug, Clone)]
pub struct Span {
    /// Seed of all inputs of a run.
    pub seed: u64,
    /// Number of the first input.
    pub first: u64,
    /// Number behind that of the last input.
    pub end: u64,
    /// Time after which no further input is read.
    pub time: Duration,
}

/// Returns the path of the present input in the child's folder.
pub fn input(target: &Target, folder: &Path) -> PathBuf {
    folder.join("input").join(target.file)
}

/// Reads inputs until the last one, or until the time is over.
pub fn run(target: &Target, folder: &Path, span: &Span) -> anyhow::Result<()> {
    prepare(folder)?;
    let begun = Instant::now();
    let (mut number, mut accepted) = (span.first, 0u64);
    while number < span.end && begun.elapsed() < span.time {
        let mut rng = Rng::seed_from_u64(span.seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) ^ number);
        let case = (target.make)(&mut rng);
        fs::write(folder.join(NUMBER), number.to_string())?;
        case.write(&input(target, folder))?;
        accepted += u64::from(read(target, folder, &input(target, folder))?);
        number += 1;
    }
    fs::write(folder.join(COUNTS), format!("{} {accepted}", number - span.first))?;
    Ok(())
}

/// Reads one input, a file or folder.
pub fn replay(target: &Target, folder: &Path, case: &Path) -> anyhow::Result<()> {
    prepare(folder)?;
    let path = input(target, folder);
    Case::read(case)?.write(&path)?;
    read(target, folder, &path).map(drop)
}

fn prepare(folder: &Path) -> anyhow::Result<()> {
    fs::create_dir_all(folder.join("input")).with_context(|| folder.display().to_string())?;
    limits::limit_memory()?;
    let report = std::panic::take_hook();
    // A panic is a finding in any thread, also where a caller catches it.
    std::panic::set_hook(Box::new(move |panic| {
        report(panic);
        std::process::abort();
    }));
    Ok(())
}

/// Reads the input under the limit of time. Returns true if the target accepted it.
fn read(target: &Target, folder: &Path, path: &Path) -> anyhow::Result<bool> {
    let scratch = folder.join("scratch");
    if scratch.exists() {
        fs::remove_dir_all(&scratch)?;
    }
    fs::create_dir_all(&scratch)?;
    limits::start_time();
    Ok((target.read)(path, &scratch).is_ok())
}
