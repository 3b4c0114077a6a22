//! Loading and description of the node's network.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;

use ::image::RgbImage;
use anyhow::{Context as _, bail};

use crate::hand::{FieldMap, HandModel, N_VERTICES, Region, Side, Topology};
use crate::message::{HandModelInfo, Header, Time};
use crate::model::budget::{self, Tried};
use crate::model::predictor::{Options, Predictor};
use crate::model::{Unknown, shipped};
use crate::node::device;
use crate::node::log::Log;
use crate::node::params::Parameters;

/// A network with its file and options.
pub(crate) struct LoadedNetwork {
    pub(crate) predictor: Predictor,
    pub(crate) path: PathBuf,
    pub(crate) options: Options,
    /// MANO files whose vertices the fields are on; None = the checkpoint's topology.
    pub(crate) mano: Option<Arc<FieldMap>>,
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
        view: parameters.get::<String>("view").parse()?,
        locator: Some(parameters.get::<String>("locator")).filter(|path| !path.is_empty()).map(PathBuf::from),
        unknown: parameters.get::<String>("unknown").parse()?,
        familiarity_threshold: threshold("familiarity_threshold"),
        presence_threshold: threshold("presence_threshold"),
        reuse_below: parameters.get::<f64>("reuse_below") as f32,
        ..Options::default()
    };
    let mano = load_mano(parameters)?;
    let budget_ms = parameters.get::<f64>("latency_budget_ms");
    let network = match budget_ms > 0.0 {
        true => load_within_budget(&path, budget_ms, options, log)?,
        false => {
            let predictor = load_file(&path, options.clone())?;
            log.info(format!("model {} in {precision}", path.display()));
            LoadedNetwork { predictor, path, options, mano: None }
        }
    };
    let predictor = on_mano(network.predictor, mano.as_ref());
    Ok(LoadedNetwork { predictor, mano, ..network })
}

/// Loads and registers the MANO files that the parameters name; None without files.
fn load_mano(parameters: &Parameters) -> anyhow::Result<Option<Arc<FieldMap>>> {
    let [left, right] = ["mano_left", "mano_right"].map(|name| parameters.get::<String>(name));
    match (left.as_str(), right.as_str()) {
        ("", "") => Ok(None),
        ("", _) | (_, "") => bail!("parameters mano_left and mano_right: expected both files or neither, got one"),
        (left, right) => Ok(Some(Arc::new(FieldMap::load(Path::new(left), Path::new(right))?))),
    }
}

/// Returns the predictor with fields on MANO's vertices if there are MANO files.
pub(super) fn on_mano(predictor: Predictor, mano: Option<&Arc<FieldMap>>) -> Predictor {
    match mano {
        Some(mano) => predictor.with_mano(Arc::clone(mano)),
        None => predictor,
    }
}

/// Loads the best network of the file or folder `path` that takes at most `budget_ms` per image on this machine.
fn load_within_budget(path: &Path, budget_ms: f64, options: Options, log: &Log) -> anyhow::Result<LoadedNetwork> {
    let (predictor, choice) = budget::pick(&budget::candidates(path)?, budget_ms, &options)?;
    match choice.fits {
        true => log.info(format!("model {choice}")),
        false => log.warn(format!("model: {choice}")),
    }
    let Tried { path, precision, .. } = choice.chosen;
    Ok(LoadedNetwork { predictor, path, options: Options { precision, ..options }, mano: None })
}

/// Loads a checkpoint file.
///
/// # Errors
/// If the file is missing or is not a usable checkpoint.
pub(super) fn load_file(path: &Path, options: Options) -> anyhow::Result<Predictor> {
    if !path.is_file() {
        bail!("model {}: no such file; give a checkpoint with -p model:=PATH", path.display());
    }
    // On a GPU, a network is recorded when it is loaded, and another one may run meanwhile.
    let device = egotac_kernels::gpu::another(&options.device)?;
    Ok(Predictor::load(path, Options { device, ..options })?)
}

/// Runs the network on a black image; returns the seconds of the second run, because the first one also allocates.
///
/// # Errors
/// If the network cannot process an image.
pub(super) fn measure_inference(predictor: &Predictor) -> anyhow::Result<f64> {
    // A copy that looks for the hands whatever the picture shows.
    let mut copy = predictor.another_stream().with_unknown(Unknown::Guess);
    let black = RgbImage::new(64, 48);
    copy.push(&black, 0.0).context("the model can't process an image")?;
    let started = Instant::now();
    copy.push(&black, 1.0)?;
    Ok(started.elapsed().as_secs_f64())
}

/// Describes a network for subscribers of its results.
///
/// # Errors
/// If a number of its configuration does not fit the message.
pub(super) fn model_info(predictor: &Predictor, now: Time) -> anyhow::Result<HandModelInfo> {
    let (metadata, config) = (predictor.metadata(), predictor.config());
    let hash = predictor.sha256();
    let topology = predictor.topology();
    // The right hand's regions stand for both hands. MANO's need a MANO file.
    let regions = match (predictor.mano(), topology) {
        (Some(mano), _) => mano.mano()[Side::Right as usize].regions(),
        (None, Topology::EgotacHand1) => HandModel::builtin(Side::Right).regions(),
        (None, Topology::Mano) => Vec::new(),
    };
    let vertex_region: Vec<String> = regions.into_iter().map(|region| region.name().to_owned()).collect();
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
        hand_model: topology.hand_model().to_owned(),
        topology: topology.id().to_owned(),
        vertex_count: N_VERTICES as u32,
        vertex_region,
        region_names,
        horizon: u32::try_from(config.horizon)?,
        frame_dt: metadata.frame_dt,
        input_size: u32::try_from(config.image)?,
        force_scale: if metadata.has_force { metadata.force_scale } else { f32::NAN },
    })
}
