//! Command `egotac model calibrate`.

use std::path::PathBuf;

use anyhow::Context;

use crate::cli::predict;
use crate::dataset::tensors;
use crate::dataset::zarr::{self, read_truth};
use crate::model::predictor::Options;
use crate::model::{Checkpoint, Precision, Predictor, checkpoint};
use crate::score::metrics;
use crate::tactile::TactileSequence;
use crate::train::calibration;

/// Arguments of `egotac model calibrate`.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Contact is sigmoid(logit / temperature). A temperature is above 0, so that a contact above 0.5 stays one, and F1 \
    with it. `egotac eval --checkpoint FILE --data STORE` shows calibration error, reliability diagram, and the share of forces \
    within the intervals; take other stores for it."
)]
pub struct Args {
    /// Checkpoint to start from. The weights stay as they are.
    #[arg(long, value_name = "FILE|shipped", value_parser = crate::cli::options::checkpoint())]
    checkpoint: PathBuf,
    /// Zarr stores with truth that training has not seen, or folders of them.
    #[arg(long, value_name = "STORE", num_args = 1.., required = true)]
    data: Vec<PathBuf>,
    /// Checkpoint to write.
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
}

/// Runs the command.
pub fn run(args: &Args) -> anyhow::Result<()> {
    let stored = checkpoint::stored(&args.checkpoint)?;
    let (config, mut metadata, mut tensors) = checkpoint::load_tensors(&args.checkpoint)?;
    let mut network = Checkpoint::load(&args.checkpoint, &Options::default().device)?;
    network.metadata.contact_temperature = 1.0;
    let (topology, has_force) = (metadata.topology, metadata.has_force);
    let mut target = TactileSequence::default();
    for store in zarr::open_all(&args.data)? {
        let mut own = read_truth(&store)?;
        own.topology.unwrap_or_default().must_match(topology).with_context(|| store.path().display().to_string())?;
        if own.episode_ends.is_empty() {
            own.episode_ends = vec![own.n_frames()];
        }
        target.append(&own)?;
    }
    let mut predictor = Predictor::new(network, predict::stream())?;
    let folder = tempfile::tempdir()?;
    let file = folder.path().join("fields.safetensors");
    predict::predict_stores(&args.data, &mut predictor, Precision::F32, &file)?;
    let pred = tensors::read(&file)?;
    let Some(temperature) = calibration::temperature(&pred, &target) else {
        anyhow::bail!(
            "the stores have no vertex in contact whose touch is known, or only such: nothing to calibrate by"
        );
    };
    metadata.contact_temperature = temperature;
    if has_force {
        tensors.extend(metrics::fit_spread(&pred, &target)?.tensors()?);
    }
    let sha256 = Checkpoint::save_as(&args.out, &config, &metadata, &tensors, stored)?;
    println!(
        "{}: temperature {temperature:.4} and intervals of forces from {} frames, sha256 {sha256}",
        args.out.display(),
        target.n_frames()
    );
    Ok(())
}
