//! `egotac bench label`.

use std::path::PathBuf;

use crate::bench::label::{ALLOWED, markdown, run as measure};
use crate::file;
use crate::model::predictor::Options;
use crate::model::{Predictor, shipped};

/// Arguments of `egotac bench label`.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "The exit status is 1 if the rest takes more than 10 % of the network's time in one of the formats."
)]
pub struct Args {
    /// Checkpoint to run; the one that comes with egotac if absent.
    #[arg(long, value_name = "FILE")]
    checkpoint: Option<PathBuf>,
    /// Images of each recording.
    #[arg(long, value_name = "N", default_value_t = 500, value_parser = clap::value_parser!(u64).range(1..=1_000_000))]
    frames: u64,
    /// Labellings of each recording, of which the best counts.
    #[arg(long, value_name = "N", default_value_t = 3, value_parser = clap::value_parser!(u64).range(1..=100))]
    repetitions: u64,
    /// Folder for label.md and label.json; without it they are only printed.
    #[arg(long, value_name = "FOLDER")]
    out: Option<PathBuf>,
}

/// Runs the command; false if the rest takes more than it may.
pub fn run(args: &Args) -> anyhow::Result<bool> {
    let path = args.checkpoint.clone().map_or_else(shipped::path, Ok)?;
    let mut predictor = Predictor::load(&path, Options::default())?;
    let folder = tempfile::tempdir()?;
    let words: Vec<String> = std::env::args().skip(1).collect();
    let command = format!("egotac {}", words.join(" "));
    let report = measure(&mut predictor, args.frames as usize, args.repetitions as usize, folder.path(), command)?;
    let table = markdown(&report);
    print!("{table}");
    if let Some(folder) = &args.out {
        file::write(&folder.join("label.md"), table.as_bytes())?;
        file::write(&folder.join("label.json"), format!("{:#}\n", serde_json::to_value(&report)?).as_bytes())?;
    }
    Ok(report.rows.iter().all(|row| row.share <= ALLOWED))
}
