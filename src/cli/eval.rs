//! `egotac eval`.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::{Context, bail};

use crate::dataset::EpisodeReader;
use crate::dataset::tensors::FieldFile;
use crate::dataset::zarr::{self, TIMESTAMPS, ZarrReader};
use crate::metrics::{self, Calibration, Fields, Options, Report};
use crate::model::{Checkpoint, Precision};
use crate::train::baseline;
use crate::train::batch::{Dataset, read_labels};

/// Arguments of `egotac eval`.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Undefined scores (no contact in truth, a constant trace, ...) are null in JSON and `undefined` in the table.\n\
    A contact is predicted where its probability is above 0.5 and true where the force is above 0.05 N."
)]
pub struct Args {
    /// Predicted fields: safetensors with `force` and `contact`, (T, 1556) each.
    #[arg(long, value_name = "FILE", requires = "target", required_unless_present = "checkpoint")]
    pred: Option<PathBuf>,
    /// True fields: safetensors as above (also `mask_force`, `mask_contact`, `episode_ends`), or a Zarr store.
    #[arg(long, value_name = "FILE|STORE", requires = "pred")]
    target: Option<PathBuf>,
    /// Checkpoint to run on `--data` in place of `--pred` and `--target`.
    #[arg(long, value_name = "FILE", requires = "data", conflicts_with = "pred")]
    checkpoint: Option<PathBuf>,
    /// Number format that the checkpoint runs in: f32, bf16 or int8.
    #[arg(long, requires = "checkpoint", default_value = "f32")]
    precision: Precision,
    /// Zarr stores with truth, or folders of them.
    #[arg(long, value_name = "STORE", num_args = 1.., requires = "checkpoint")]
    data: Vec<PathBuf>,
    /// Training stores: score beside the checkpoint three constants, namely zero, and the mean and the median of each
    /// vertex over these stores.
    #[arg(long, value_name = "STORE", num_args = 1.., requires = "checkpoint")]
    baselines_from: Vec<PathBuf>,
    /// Frames per second, for the dominant frequency; by default from the target's timestamps.
    #[arg(long, value_name = "F", value_parser = super::positive)]
    fps: Option<f64>,
    /// JSON file with the range of the total force, N: {"min": .., "max": ..}, or one each under "pred" and "target";
    /// by default the range of the data.
    #[arg(long, value_name = "FILE")]
    calibration: Option<PathBuf>,
    /// Print JSON in place of a table.
    #[arg(long)]
    json: bool,
}

/// Runs the command.
pub fn run(args: Args) -> anyhow::Result<ExitCode> {
    let reports = match (&args.pred, &args.target, &args.checkpoint) {
        (Some(pred), Some(target), None) => vec![("prediction", eval_files(&args, pred, target)?)],
        (None, None, Some(checkpoint)) => eval_checkpoint(&args, checkpoint)?,
        _ => bail!("give --pred and --target, or --checkpoint and --data"),
    };
    let reports: Vec<(&str, &Report)> = reports.iter().map(|(name, report)| (*name, report)).collect();
    print_reports(&reports, args.json)?;
    Ok(ExitCode::SUCCESS)
}

/// The checkpoint's report, then those of the constants.
fn eval_checkpoint(args: &Args, checkpoint: &Path) -> anyhow::Result<Vec<(&'static str, Report)>> {
    let device = candle_core::Device::Cpu;
    let checkpoint = Checkpoint::load_as(checkpoint, &device, args.precision)?;
    let preparation = checkpoint.metadata.preparation(checkpoint.model.config());
    let open = |paths: &[PathBuf]| -> anyhow::Result<Dataset> {
        let data = Dataset::new(zarr::open_all(paths)?, preparation.clone(), false)?;
        data.topology().must_match(checkpoint.metadata.topology)?;
        Ok(data)
    };
    let data = open(&args.data)?;
    let labels = data.labels()?;
    let mut options = labels.options();
    options.fps = args.fps.or(options.fps);
    options.calibration = args.calibration.as_deref().map(read_calibration).transpose()?;
    let predicted = super::predict::predict_stores(&checkpoint, &data, &device)?.fields;
    let mut reports = vec![("model", metrics::evaluate(&predicted, &labels.fields, &options)?)];
    if !args.baselines_from.is_empty() {
        for constant in baseline::constants(&open(&args.baselines_from)?.labels()?) {
            let fields = constant.fields(labels.fields.n_frames());
            reports.push((constant.name, metrics::evaluate(&fields, &labels.fields, &options)?));
        }
    }
    Ok(reports)
}

fn eval_files(args: &Args, pred_path: &Path, target_path: &Path) -> anyhow::Result<Report> {
    let pred = FieldFile::read(pred_path)?;
    let target = read_target(target_path)?;
    if let (Some(pred), Some(target)) = (pred.topology, target.topology) {
        pred.must_match(target)?;
    }
    if pred.fields.n_frames() != target.fields.n_frames() {
        bail!(
            "{} has {} frames, {} has {}",
            pred_path.display(),
            pred.fields.n_frames(),
            target_path.display(),
            target.fields.n_frames()
        );
    }
    let options = options(&target, args.fps, args.calibration.as_deref())?;
    Ok(metrics::evaluate(&pred.fields, &target.fields, &options)?)
}

fn options(target: &FieldFile, fps: Option<f64>, calibration: Option<&Path>) -> anyhow::Result<Options> {
    let calibration = calibration.map(read_calibration).transpose()?;
    Ok(Options {
        mask_force: target.mask_force.clone(),
        mask_contact: target.mask_contact.clone(),
        episode_ends: target.episode_ends.clone(),
        fps: fps.or_else(|| target.fps()),
        calibration,
    })
}

fn read_calibration(path: &Path) -> anyhow::Result<Calibration> {
    let text = std::fs::read_to_string(path).with_context(|| path.display().to_string())?;
    let calibration: Calibration = serde_json::from_str(&text).map_err(|_| {
        let expected = r#"{"min": number, "max": number}, or one each under "pred" and "target""#;
        anyhow::anyhow!("{}: expected {expected}", path.display())
    })?;
    for range in [calibration.pred(), calibration.target()] {
        if !(range.min.is_finite() && range.max.is_finite() && range.min < range.max) {
            bail!("{}: expected min < max, got {} and {}", path.display(), range.min, range.max);
        }
    }
    Ok(calibration)
}

/// A field file, or the labels of a store; frames that a guard refused don't count.
fn read_target(path: &Path) -> anyhow::Result<FieldFile> {
    if !path.is_dir() {
        return Ok(FieldFile::read(path)?);
    }
    let store = ZarrReader::open(path)?;
    let labels = read_labels(&store, 0..store.len())?;
    Ok(FieldFile {
        topology: Some(store.attributes().topology),
        fields: Fields { force: labels.force, contact: labels.contact },
        mask_force: labels.mask_force,
        mask_contact: labels.mask_contact,
        timestamps: store.read(TIMESTAMPS, 0..store.len())?.into_f64(),
        episode_ends: store.episode_ends().to_vec(),
    })
}

fn print_reports(reports: &[(&str, &Report)], json: bool) -> anyhow::Result<()> {
    if !json {
        println!("{}", metrics::table(reports));
        return Ok(());
    }
    // One report is the document itself; several lie under their names.
    let value = match reports {
        [(_, report)] => serde_json::to_value(report)?,
        _ => serde_json::to_value(reports.iter().copied().collect::<std::collections::BTreeMap<_, _>>())?,
    };
    println!("{value:#}");
    Ok(())
}
