//! Loading and description of the node's network.

use std::path::{Path, PathBuf};
use std::time::Instant;

use ::image::RgbImage;
use anyhow::{Context as _, bail};

use crate::hand::{HandModel, N_VERTICES, Region, Side, Topology};
use crate::message::{HandModelInfo, Header, Time};
use crate::model::budget::{self, Tried};
use crate::model::predictor::{Options, Predictor};
use crate::model::shipped;
use crate::node::device;
use crate::node::log::Log;
use crate::node::params::Parameters;

/// A network with its file and options.
pub(crate) struct LoadedNetwork {
    pub(crate) predictor: Predictor,
    pub(crate) path: PathBuf,
    pub(crate) options: Options,
}

/// Loads the network that the parameters name.
///
/// # Errors
/// If there is no usable checkpoint or device.
pub(super) fn load(parameters: &Parameters, log: &Log) -> anyhow::Result<LoadedNetwork> {
    let path = match parameters.get::<String>("model") {
        path if path.is_empty() => {
            shipped::path().context("without `-p model:=PATH` the predictor takes the shipped checkpoint")?
        }
        path => PathBuf::from(path),
    };
    let precision = parameters.get::<String>("precision").parse()?;
    // Below 0: the checkpoint's own threshold.
    let threshold = |name| Some(parameters.get::<f64>(name) as f32).filter(|threshold| *threshold >= 0.0);
    let options = Options {
        device: device::open(parameters)?,
        precision,
        unknown: parameters.get::<String>("unknown").parse()?,
        familiarity_threshold: threshold("familiarity_threshold"),
        presence_threshold: threshold("presence_threshold"),
        ..Options::default()
    };
    let budget_ms = parameters.get::<f64>("latency_budget_ms");
    if budget_ms > 0.0 {
        return load_within_budget(&path, budget_ms, options, log);
    }
    let predictor = load_file(&path, options.clone())?;
    log.info(format!("model {} in {precision}", path.display()));
    Ok(LoadedNetwork { predictor, path, options })
}

/// Loads the best network of the file or folder `path` that takes at most `budget_ms` per image on this machine.
fn load_within_budget(path: &Path, budget_ms: f64, options: Options, log: &Log) -> anyhow::Result<LoadedNetwork> {
    let (predictor, choice) = budget::pick(&budget::candidates(path)?, budget_ms, &options)?;
    match choice.fits {
        true => log.info(format!("model {choice}")),
        false => log.warn(format!("model: {choice}")),
    }
    let Tried { path, precision, .. } = choice.chosen;
    Ok(LoadedNetwork { predictor, path, options: Options { precision, ..options } })
}

/// Loads a checkpoint file.
///
/// # Errors
/// If the file is missing or is no usable checkpoint.
pub(super) fn load_file(path: &Path, options: Options) -> anyhow::Result<Predictor> {
    if !path.is_file() {
        bail!("model {}: no such file; give a checkpoint with -p model:=PATH", path.display());
    }
    Ok(Predictor::load(path, options)?)
}

/// Runs the network on a black image; returns the seconds of the second run, because the first one also allocates.
///
/// # Errors
/// If the network cannot process an image.
pub(super) fn measure_inference(predictor: &mut Predictor) -> anyhow::Result<f64> {
    let black = RgbImage::new(64, 48);
    predictor.push(&black, 0.0).context("the model can't process an image")?;
    let started = Instant::now();
    predictor.push(&black, 1.0)?;
    predictor.reset();
    Ok(started.elapsed().as_secs_f64())
}

/// Describes a network for subscribers of its results.
///
/// # Errors
/// If a number of its configuration does not fit the message.
pub(super) fn model_info(predictor: &Predictor, now: Time) -> anyhow::Result<HandModelInfo> {
    let (metadata, config) = (predictor.metadata(), predictor.config());
    let hash = predictor.sha256();
    // Both built-in hands have the same regions. MANO's regions need a MANO file, which the predictor does not read.
    let (hand_model, vertex_region): (_, Vec<String>) = match metadata.topology {
        Topology::EgotacHand1 => {
            let regions = HandModel::builtin(Side::Right).regions();
            ("egotac built-in hand", regions.into_iter().map(|region| region.name().to_owned()).collect())
        }
        Topology::Mano => ("MANO", Vec::new()),
    };
    let region_names = match vertex_region.is_empty() {
        true => Vec::new(),
        false => Region::names_of_both_hands(),
    };
    Ok(HandModelInfo {
        interface_version: HandModelInfo::INTERFACE_VERSION,
        header: Header { stamp: now, frame_id: String::new() },
        model_id: format!("{}/{}", metadata.name, hash.get(..12).unwrap_or(hash)),
        model_name: metadata.name.clone(),
        weights_sha256: hash.to_owned(),
        hand_model: hand_model.to_owned(),
        topology: metadata.topology.id().to_owned(),
        vertex_count: N_VERTICES as u32,
        vertex_region,
        region_names,
        horizon: u32::try_from(config.horizon)?,
        frame_dt: metadata.frame_dt,
        input_size: u32::try_from(config.image)?,
        force_scale: if metadata.has_force { metadata.force_scale } else { f32::NAN },
    })
}
