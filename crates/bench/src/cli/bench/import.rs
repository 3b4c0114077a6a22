//! `egotac bench import`.

use std::path::PathBuf;

use crate::cli::output::Output;
use crate::import::{ALLOWED_MS, markdown, run as measure};

/// Arguments of `egotac bench import`.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "The exit status is 1 if contact labels against the largest object take longer than 2 ms per frame and hand."
)]
pub struct Args {
    /// Data set whose reader is measured: its kind and its folder; without it, small data sets that the command writes.
    #[arg(long, value_name = "KIND=FOLDER", value_parser = set)]
    set: Vec<(String, PathBuf)>,
    #[command(flatten)]
    output: Output,
}

/// Runs the subject; false if contact labels take longer than allowed.
pub fn run(args: &Args) -> anyhow::Result<bool> {
    let folder = tempfile::tempdir()?;
    // Folders of data sets say nothing about the measurement.
    let sets = if args.set.is_empty() { "" } else { " --set KIND=FOLDER ..." };
    let command = format!("egotac bench import{sets}{}", args.output.words());
    let report = measure(&args.set, folder.path(), command)?;
    args.output.write("import", &report, &markdown(&report))?;
    Ok(report.contact.last().is_none_or(|row| row.label_ms <= ALLOWED_MS))
}

fn set(text: &str) -> Result<(String, PathBuf), String> {
    let (kind, folder) = text.split_once('=').ok_or("expected KIND=FOLDER")?;
    Ok((kind.into(), folder.into()))
}
