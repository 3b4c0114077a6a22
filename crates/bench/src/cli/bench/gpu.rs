//! `egotac bench gpu`.

use anyhow::ensure;
use egotac::cli::progress;
use egotac::model::{Config, Precision};

use crate::cli::output::Output;
use crate::gpu::{self, Plan};

/// Arguments of `egotac bench gpu`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Presets, comma separated.
    #[arg(long, value_delimiter = ',', default_value = "tiny,base")]
    preset: Vec<String>,
    /// Number formats, comma separated: f32, bf16.
    #[arg(long, value_delimiter = ',', default_value = "f32,bf16")]
    precision: Vec<Precision>,
    /// Windows of a training step, comma separated.
    #[arg(long, value_delimiter = ',', default_value = "4,16")]
    windows: Vec<usize>,
    /// Timed runs of each kind.
    #[arg(long, default_value_t = 50, value_parser = clap::value_parser!(u64).range(1..=100_000))]
    runs: u64,
    /// Index of the CUDA device.
    #[arg(long, value_name = "INDEX", default_value_t = 0)]
    cuda: usize,
    /// Also run this command with --cuda, --precision, --preset, --threads and --runs, and with --train and --batch, in turn with ours
    /// (crates/bench/benches/peer.py prints what is expected).
    #[arg(long, value_name = "COMMAND")]
    peer: Option<String>,
    /// Rounds beside the peer.
    #[arg(long, default_value_t = 2)]
    rounds: usize,
    #[command(flatten)]
    output: Output,
}

pub fn run(args: &Args) -> anyhow::Result<()> {
    args.preset.iter().try_for_each(|preset| Config::preset(preset).map(drop))?;
    ensure!(args.rounds > 0, "--rounds: expected at least 1");
    ensure!(args.windows.iter().all(|windows| (1..=4096).contains(windows)), "--windows: expected 1 to 4096");
    ensure!(
        args.precision.iter().all(|precision| *precision != Precision::Int8),
        "--precision: expected f32 or bf16, got int8"
    );
    egotac::cli::device(Some(args.cuda))?;
    let list = |values: Vec<String>| values.join(",");
    let mut command = format!(
        "egotac bench gpu --preset {} --precision {} --windows {} --runs {}",
        args.preset.join(","),
        list(args.precision.iter().map(Precision::to_string).collect()),
        list(args.windows.iter().map(usize::to_string).collect()),
        args.runs
    );
    if let Some(peer) = &args.peer {
        command += &format!(" --peer \"{peer}\"");
    }
    command += &format!(" --rounds {}", args.rounds);
    command += &args.output.words();
    let plan = Plan {
        command,
        presets: args.preset.clone(),
        precisions: args.precision.clone(),
        windows: args.windows.clone(),
        runs: args.runs as usize,
        cuda: args.cuda,
        peer: args.peer.clone(),
        rounds: args.rounds,
    };
    let bar = progress::told_bar("measurements");
    let report = gpu::measure(&plan, |what| {
        bar.set_message(what.to_owned());
        bar.inc(1);
    })?;
    bar.finish_and_clear();
    args.output.write("gpu", &report, &report.markdown())
}
