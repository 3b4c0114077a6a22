//! `egotac bench layers`.

use egotac::cli::progress;
use egotac::model::{Config, Precision};

use crate::cli::output::Output;
use crate::layers;

/// Arguments of `egotac bench layers`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Presets, comma separated.
    #[arg(long, value_delimiter = ',', default_value = "tiny,base")]
    preset: Vec<String>,
    /// Number formats, comma separated: f32, bf16, int8.
    #[arg(long, value_delimiter = ',', default_value = "f32,bf16,int8")]
    precision: Vec<Precision>,
    /// Threads.
    #[arg(long, default_value_t = 2, value_parser = clap::value_parser!(u64).range(1..=1024))]
    threads: u64,
    /// Timed frames.
    #[arg(long, default_value_t = 10, value_parser = clap::value_parser!(u64).range(1..=100_000))]
    runs: u64,
    #[command(flatten)]
    output: Output,
}

pub fn run(args: &Args) -> anyhow::Result<()> {
    args.preset.iter().try_for_each(|preset| Config::preset(preset).map(drop))?;
    let precisions: Vec<&str> = args.precision.iter().map(|precision| precision.name()).collect();
    let mut command = format!(
        "egotac bench layers --preset {} --precision {} --threads {} --runs {}",
        args.preset.join(","),
        precisions.join(","),
        args.threads,
        args.runs
    );
    command += &args.output.words();
    let bar = progress::told_bar("encoders");
    let sizes = (args.threads as usize, args.runs as usize);
    let report = layers::measure(command, &args.preset, &args.precision, sizes, |preset, precision| {
        bar.set_message(format!("{preset} {precision}"));
        bar.inc(1);
    })?;
    bar.finish_and_clear();
    args.output.write("layers", &report, &report.markdown())
}
