//! `egotac experiment policy`.

use std::path::PathBuf;
use std::process::ExitCode;

use egotac::cli::options::Json;

use crate::cli::output::write_report;
use crate::policy::{self, Size, plot};

/// Arguments of `egotac experiment policy`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Trainings of each arm.
    #[arg(long, default_value_t = 3, value_parser = clap::value_parser!(u64).range(1..=100))]
    seeds: u64,
    /// Demonstrations that all arms learn from.
    #[arg(long, default_value_t = 240, value_parser = clap::value_parser!(u64).range(1..=10_000))]
    demonstrations: u64,
    /// Optimisation steps of a training.
    #[arg(long, default_value_t = 4000, value_parser = clap::value_parser!(u64).range(1..=1_000_000))]
    steps: u64,
    /// Trials of each trained policy.
    #[arg(long, default_value_t = 120, value_parser = clap::value_parser!(u64).range(1..=10_000))]
    trials: u64,
    /// Run the whole chain in seconds, too small to tell anything: 4 demonstrations, 10 steps, 3 trials, 1 training.
    #[arg(long, conflicts_with_all = ["seeds", "demonstrations", "steps", "trials"])]
    quick: bool,
    /// Folder for demonstrations, weights and trials.
    #[arg(long, value_name = "FOLDER", default_value = "out/experiments")]
    work: PathBuf,
    /// Folder for policy.md, policy.json, policy.png and policy.svg.
    #[arg(long, value_name = "FOLDER", default_value = "out/results")]
    out: PathBuf,
    #[command(flatten)]
    json: Json,
}

/// Runs the command.
pub fn run(args: Args) -> anyhow::Result<ExitCode> {
    let size = match args.quick {
        true => Size { demonstrations: 4, steps: 10, trials: 3, seeds: 1 },
        false => Size {
            demonstrations: args.demonstrations as usize,
            steps: args.steps as usize,
            trials: args.trials as usize,
            seeds: args.seeds,
        },
    };
    let Size { demonstrations, steps, trials, seeds } = size;
    let command = format!(
        "egotac experiment policy --seeds {seeds} --demonstrations {demonstrations} --steps {steps} --trials {trials}"
    );
    let bar = egotac::cli::progress::told_bar("parts");
    let report = policy::run(&size, &args.work, command, &mut |what, done, all| {
        bar.set_length(all as u64);
        bar.set_position(done as u64);
        bar.set_message(what.to_owned());
    })?;
    bar.finish_and_clear();
    write_report(&args.out, "policy", &report, &report.markdown())?;
    plot::write(&args.out, &report)?;
    args.json.show(&serde_json::to_value(&report)?, || report.markdown())?;
    Ok(ExitCode::SUCCESS)
}
