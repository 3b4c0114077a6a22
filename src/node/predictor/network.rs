//! The network that the node runs.

use std::path::{Path, PathBuf};
use std::time::Instant;

use ::image::RgbImage;
use anyhow::{Context as _, bail};
use candle_core::Device;

use crate::hand::{HandModel, N_VERTICES, Side, Topology};
use crate::message::{HandModelInfo, Header, Time};
use crate::model::budget::{self, Tried};
use crate::model::predictor::{Options, Predictor};
use crate::model::shipped;
use crate::node::log::Log;
use crate::node::params::Parameters;

/// The network that the parameters ask for, its file, and how it is run.
///
/// # Errors
/// If there is none that can be used.
pub fn load(parameters: &Parameters, log: &Log) -> anyhow::Result<(Predictor, PathBuf, Options)> {
    let path = match parameters.get::<String>("model") {
        path if path.is_empty() => {
            shipped::path().context("without `-p model:=PATH` the predictor takes the shipped checkpoint")?
        }
        path => PathBuf::from(path),
    };
    let device = match parameters.get::<String>("device").as_str() {
        "cuda" => Device::new_cuda(0).context("device cuda")?,
        _ => Device::Cpu,
    };
    let precision = parameters.get::<String>("precision").parse()?;
    let options = Options { device, precision, ..Options::default() };
    let budget_ms = parameters.get::<f64>("latency_budget_ms");
    if budget_ms > 0.0 {
        let (predictor, choice) = budget::pick(&budget::candidates(&path)?, budget_ms, &options)?;
        match choice.fits {
            true => log.info(format!("model {choice}")),
            false => log.warn(format!("model: {choice}")),
        }
        let Tried { path, precision, .. } = choice.chosen;
        return Ok((predictor, path, Options { precision, ..options }));
    }
    let predictor = load_file(&path, options.clone())?;
    log.info(format!("model {} in {precision}", path.display()));
    Ok((predictor, path, options))
}

/// Loads a checkpoint file.
///
/// # Errors
/// If there is none, or it can't be used.
pub fn load_file(path: &Path, options: Options) -> anyhow::Result<Predictor> {
    if !path.is_file() {
        bail!("model {}: no such file; give a checkpoint with -p model:=PATH", path.display());
    }
    Ok(Predictor::load(path, options)?)
}

/// Seconds that one image takes; the first one, which takes longer, goes before.
///
/// # Errors
/// If the network can't process an image.
pub fn try_out(predictor: &mut Predictor) -> anyhow::Result<f64> {
    let black = RgbImage::new(64, 48);
    predictor.push(&black, 0.0).context("the model can't process an image")?;
    let started = Instant::now();
    predictor.push(&black, 1.0)?;
    predictor.reset();
    Ok(started.elapsed().as_secs_f64())
}

/// What a network is, for those who listen.
///
/// # Errors
/// If its geometry does not fit the message.
pub fn info(predictor: &Predictor, now: Time) -> anyhow::Result<HandModelInfo> {
    let (metadata, config) = (predictor.metadata(), predictor.config());
    let hash = predictor.sha256();
    // The built-in hand's regions are those of both sides; MANO's need a file that predicting does not.
    let (hand_model, vertex_region) = match metadata.topology {
        Topology::EgotacHand1 => {
            let regions = HandModel::builtin(Side::Right).regions();
            ("egotac built-in hand", regions.into_iter().map(|region| region.name().to_owned()).collect())
        }
        Topology::Mano => ("MANO", Vec::new()),
    };
    Ok(HandModelInfo {
        header: Header { stamp: now, frame_id: String::new() },
        model_id: format!("{}/{}", metadata.name, hash.get(..12).unwrap_or(hash)),
        model_name: metadata.name.clone(),
        weights_sha256: hash.to_owned(),
        hand_model: hand_model.to_owned(),
        topology: metadata.topology.id().to_owned(),
        vertex_count: N_VERTICES as u32,
        vertex_region,
        horizon: u32::try_from(config.horizon)?,
        frame_dt: metadata.frame_dt,
        input_size: u32::try_from(config.image)?,
        force_scale: if metadata.has_force { metadata.force_scale } else { f32::NAN },
    })
}
