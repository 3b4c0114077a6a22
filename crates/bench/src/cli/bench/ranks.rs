//! `egotac bench ranks`.

use std::path::PathBuf;

use anyhow::{Context, ensure};
use egotac::cli::progress;
use egotac::model::Config;

use crate::cli::output::Output;
use crate::ranks::{self, Options};

/// Arguments of `egotac bench ranks`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Presets, comma separated.
    #[arg(long, value_delimiter = ',', default_value = "tiny,small")]
    preset: Vec<String>,
    /// Ranks, with one thread each; the process beside them has as many threads.
    #[arg(long, default_value_t = 2, value_parser = clap::value_parser!(u64).range(2..=1024))]
    ranks: u64,
    /// Timed steps of each run.
    #[arg(long, default_value_t = 5, value_parser = clap::value_parser!(u64).range(1..=100_000))]
    steps: u64,
    /// Runs of each kind, in turn.
    #[arg(long, default_value_t = 3)]
    rounds: usize,
    /// The program egotac, built with the feature `mpi`; by default the one beside this program.
    #[arg(long, value_name = "FILE")]
    program: Option<PathBuf>,
    /// Command that starts several processes; their number and the program are added.
    #[arg(long, value_name = "COMMAND", default_value = "mpirun --bind-to none -n")]
    launcher: String,
    #[command(flatten)]
    output: Output,
}

pub fn run(args: &Args) -> anyhow::Result<()> {
    args.preset.iter().try_for_each(|preset| Config::preset(preset).map(drop))?;
    ensure!(args.rounds > 0, "--rounds: expected at least 1");
    let program = match &args.program {
        Some(program) => program.clone(),
        None => std::env::current_exe().context("this program's own path")?.with_file_name("egotac"),
    };
    let mut command = format!(
        "egotac bench ranks --preset {} --ranks {} --steps {} --rounds {}",
        args.preset.join(","),
        args.ranks,
        args.steps,
        args.rounds
    );
    if let Some(program) = &args.program {
        command += &format!(" --program {}", program.display());
    }
    command += &args.output.words();
    let options = Options {
        presets: args.preset.clone(),
        ranks: args.ranks as usize,
        steps: args.steps as usize,
        rounds: args.rounds,
        program,
        launcher: args.launcher.clone(),
    };
    let bar = progress::told_bar("measurements");
    let report = ranks::measure(command, &options, |preset| {
        bar.set_message(preset.to_owned());
        bar.inc(1);
    })?;
    bar.finish_and_clear();
    args.output.write("ranks", &report, &report.markdown())
}
