//! `egotac bench faults`.

use anyhow::{Context, ensure};
use egotac::text::tell;

use crate::cli::output::Output;
use crate::faults::{self, Options};

/// Arguments of `egotac bench faults`.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "The exit status is 1 if a run loses, mixes up, doubles or half-writes anything, ends with a wrong \
    status or leaves something behind. It needs a C compiler, and writes only below the temporary folder (TMPDIR)."
)]
pub struct Args {
    /// Run a few cases of each command but the experiment, as CI does.
    #[arg(long)]
    short: bool,
    /// Only commands whose name contains one of these, comma separated.
    #[arg(long, value_name = "PART", value_delimiter = ',')]
    only: Vec<String>,
    /// Runs of each command with a fault that may hit any moment; the other faults get a quarter, the experiment an eighth.
    #[arg(long, default_value_t = 24, value_parser = clap::value_parser!(u16).range(1..))]
    runs: u16,
    /// Seed of the times at which faults happen.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    #[command(flatten)]
    output: Output,
}

/// Runs the subject; false if a run found anything.
pub fn run(args: &Args) -> anyhow::Result<bool> {
    let folder = tempfile::tempdir()?;
    let options = Options {
        short: args.short,
        runs: args.runs.into(),
        seed: args.seed,
        only: args.only.clone(),
        program: std::env::current_exe().context("path of this program")?,
        folder: folder.path().to_path_buf(),
    };
    let words: Vec<String> = std::env::args().skip(1).collect();
    let report = faults::run(&options, format!("egotac {}", words.join(" ")), |row| {
        tell(format_args!("{}, {}: {} runs", row.command, row.fault, row.runs));
        for (run, finding) in &row.findings {
            tell(format_args!("{}, {}, run {run}: {finding}", row.command, row.fault));
        }
    })?;
    ensure!(!report.rows.is_empty(), "--only: expected a part of a command's name; no command has this in its name");
    args.output.write("faults", &report, &report.markdown())?;
    Ok(report.is_clean())
}
