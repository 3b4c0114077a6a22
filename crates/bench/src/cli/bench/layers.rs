//! `egotac bench layers`.

use std::path::PathBuf;

use egotac::cli::options::Json;
use egotac::cli::progress;
use egotac::model::{Config, Precision};

use crate::cli::write_report;
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
    json: Json,
    /// Folder for layers.md and layers.json.
    #[arg(long, value_name = "FOLDER")]
    out: Option<PathBuf>,
}

pub fn run(args: &Args) -> anyhow::Result<()> {
    args.preset.iter().try_for_each(|preset| Config::preset(preset).map(drop))?;
    rayon::ThreadPoolBuilder::new().num_threads(args.threads as usize).build_global()?;
    let precisions: Vec<&str> = args.precision.iter().map(|precision| precision.name()).collect();
    let mut command = format!(
        "egotac bench layers --preset {} --precision {} --threads {} --runs {}",
        args.preset.join(","),
        precisions.join(","),
        args.threads,
        args.runs
    );
    if let Some(out) = &args.out {
        command += &format!(" --out {}", out.display());
    }
    let bar = progress::told_bar("encoders");
    let report = layers::measure(command, &args.preset, &args.precision, args.runs as usize, |preset, precision| {
        bar.set_message(format!("{preset} {precision}"));
        bar.inc(1);
    })?;
    bar.finish_and_clear();
    if let Some(out) = &args.out {
        write_report(out, "layers", &report, &report.markdown())?;
    }
    Ok(args.json.show(&serde_json::to_value(&report)?, || report.markdown())?)
}
