//! `egotac bench train`.

use anyhow::ensure;
use egotac::cli::progress;
use egotac::model::{Config, Precision};

use crate::cli::output::Output;
use crate::train::{self, Plan};

/// Arguments of `egotac bench train`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Presets, comma separated.
    #[arg(long, value_delimiter = ',', default_value = "tiny,small")]
    preset: Vec<String>,
    /// Number formats of forward and backward pass, comma separated: f32, bf16.
    #[arg(long, value_delimiter = ',', default_value = "f32,bf16")]
    precision: Vec<Precision>,
    /// Threads.
    #[arg(long, default_value_t = 2, value_parser = clap::value_parser!(u64).range(1..=1024))]
    threads: u64,
    /// Timed steps of each form.
    #[arg(long, default_value_t = 3, value_parser = clap::value_parser!(u64).range(1..=100_000))]
    runs: u64,
    /// Also run this command with --train, --preset, --precision, --threads, --runs and --batch, in turn with ours (crates/bench/benches/peer.py
    /// prints what is expected).
    #[arg(long, value_name = "COMMAND")]
    peer: Option<String>,
    /// Rounds beside the peer.
    #[arg(long, default_value_t = 3)]
    rounds: usize,
    #[command(flatten)]
    output: Output,
}

pub fn run(args: &Args) -> anyhow::Result<()> {
    args.preset.iter().try_for_each(|preset| Config::preset(preset).map(drop))?;
    ensure!(!args.precision.contains(&Precision::Int8), "--precision: expected f32 or bf16, got int8");
    ensure!(args.rounds > 0, "--rounds: expected at least 1");
    rayon::ThreadPoolBuilder::new().num_threads(args.threads as usize).build_global()?;
    let precisions: Vec<&str> = args.precision.iter().map(|precision| precision.name()).collect();
    let mut command = format!(
        "egotac bench train --preset {} --precision {} --threads {} --runs {}",
        args.preset.join(","),
        precisions.join(","),
        args.threads,
        args.runs
    );
    if let Some(peer) = &args.peer {
        command += &format!(" --peer \"{peer}\" --rounds {}", args.rounds);
    }
    command += &args.output.words();
    let bar = progress::told_bar("measurements");
    let plan = Plan {
        presets: &args.preset,
        precisions: &args.precision,
        threads: args.threads as usize,
        runs: args.runs as usize,
        peer: args.peer.as_deref().map(|peer| (peer, args.rounds)),
    };
    let report = train::measure(command, plan, |what| {
        bar.set_message(what.to_owned());
        bar.inc(1);
    })?;
    bar.finish_and_clear();
    args.output.write("train", &report, &report.markdown())
}
