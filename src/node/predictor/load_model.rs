//! Another network for a predictor that runs: loaded on a thread of its own, taken between two images.

use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

use anyhow::{Context as _, bail};
use r2r::ServiceRequest;
use r2r::egotac_msgs::srv::LoadModel;

use super::network::{self, load_file, try_out};
use crate::hand::Topology;
use crate::message::HandModelInfo;
use crate::model::predictor::{Options, Predictor};
use crate::node::runtime::{RosClock, Runtime};

/// A network with its description.
pub struct Loaded {
    /// The network, with no image seen yet.
    pub predictor: Predictor,
    /// What it is.
    pub info: HandModelInfo,
}

/// Where a new network waits for the thread that predicts.
#[derive(Clone, Default)]
pub struct Slot(Arc<Mutex<Option<Loaded>>>);

impl Slot {
    /// Takes the network that waits, if one does.
    pub fn take(&self) -> Option<Loaded> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).take()
    }

    fn put(&self, loaded: Loaded) {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) = Some(loaded);
    }
}

/// What a new network must fit.
#[derive(Clone)]
pub struct Terms {
    /// File of a request that names none.
    pub path: PathBuf,
    /// How it is run.
    pub options: Options,
    /// What its vertices must mean: whoever listens relies on it.
    pub topology: Topology,
}

/// Offers `~/load_model`.
///
/// # Errors
/// If ROS refuses the name.
pub fn serve(runtime: &mut Runtime, slot: Slot, terms: Terms, model_id: String) -> anyhow::Result<()> {
    let (clock, log) = (runtime.clock().clone(), runtime.log().clone());
    let in_use = Arc::new(Mutex::new(model_id));
    runtime.service_later::<LoadModel::Service>("~/load_model", move |request: ServiceRequest<LoadModel::Service>| {
        let (slot, terms, clock, log, in_use) =
            (slot.clone(), terms.clone(), clock.clone(), log.clone(), Arc::clone(&in_use));
        let work = move || {
            let mut in_use = in_use.lock().unwrap_or_else(PoisonError::into_inner);
            let (success, message) = match load(&request.message.model, &terms, &clock) {
                Ok(loaded) => {
                    log.info(format!("model {} takes over", loaded.info.model_id));
                    in_use.clone_from(&loaded.info.model_id);
                    slot.put(loaded);
                    (true, String::new())
                }
                Err(error) => {
                    log.warn(format!("the model stays as it is: {error:#}"));
                    (false, format!("{error:#}"))
                }
            };
            let answer = LoadModel::Response { success, message, model_id: in_use.clone() };
            if let Err(error) = request.respond(answer) {
                log.warn_throttled("load_model", format!("~/load_model: the answer could not be sent: {error}"));
            }
        };
        // Without a thread there is no answer, and the caller's patience ends.
        drop(std::thread::Builder::new().name("loading".into()).spawn(work));
    })
}

fn load(path: &str, terms: &Terms, clock: &RosClock) -> anyhow::Result<Loaded> {
    let path = if path.is_empty() { &terms.path } else { Path::new(path) };
    let mut predictor = load_file(path, terms.options.clone())?;
    let topology = predictor.metadata().topology;
    if topology != terms.topology {
        bail!("{}: expected topology {}, got {}", path.display(), terms.topology.id(), topology.id());
    }
    try_out(&mut predictor).with_context(|| path.display().to_string())?;
    let info = network::info(&predictor, clock.now())?;
    Ok(Loaded { predictor, info })
}
