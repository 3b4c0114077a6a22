//! `egotac bench label`.

use std::path::PathBuf;

use candle_core::Device;
use candle_nn::VarMap;
use egotac::model::predictor::Options;
use egotac::model::{Checkpoint, Config, EgoTac, Metadata, Predictor, init, shipped};

use crate::cli::output::Output;
use crate::label::{ALLOWED, markdown, run as measure};

/// Arguments of `egotac bench label`.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "The exit status is 1 if the stages beside the network take more than 10 % of a preset's time in one of the formats."
)]
pub struct Args {
    /// Checkpoint to run; by default the one shipped with egotac.
    #[arg(long, value_name = "FILE|shipped", value_parser = egotac::cli::options::checkpoint())]
    checkpoint: Option<PathBuf>,
    /// Presets to run beside it, with random weights.
    #[arg(long, value_name = "NAME", value_delimiter = ',', default_value = "tiny")]
    preset: Vec<String>,
    /// Images of each recording.
    #[arg(long, value_name = "N", default_value_t = 500, value_parser = clap::value_parser!(u64).range(1..=1_000_000))]
    frames: u64,
    /// Repetitions for each recording; the best counts.
    #[arg(long, value_name = "N", default_value_t = 3, value_parser = clap::value_parser!(u64).range(1..=100))]
    repetitions: u64,
    #[command(flatten)]
    output: Output,
}

/// Runs the subject; false if the stages beside the network take more than [`ALLOWED`] of the time of a preset.
pub fn run(args: &Args) -> anyhow::Result<bool> {
    let path = args.checkpoint.clone().map_or_else(shipped::path, Ok)?;
    let folder = tempfile::tempdir()?;
    let mut predictors = vec![Predictor::load(&path, Options::default())?];
    for name in &args.preset {
        let (path, config, vars) = (folder.path().join("random.safetensors"), Config::preset(name)?, VarMap::new());
        EgoTac::new(&config, init::var_builder(&vars, 0, &Device::Cpu))?;
        Checkpoint::save(&path, &config, &Metadata::new(name, 1.0, 0.04), &vars)?;
        predictors.push(Predictor::load(&path, Options::default())?);
    }
    let words: Vec<String> = std::env::args().skip(1).collect();
    let command = format!("egotac {}", words.join(" "));
    let report = measure(&mut predictors, args.frames as usize, args.repetitions as usize, folder.path(), command)?;
    args.output.write("label", &report, &markdown(&report))?;
    let of_presets = report.rows.iter().filter(|row| args.preset.contains(&row.network));
    Ok(of_presets.map(|row| row.share).all(|share| share <= ALLOWED))
}
