//! Service `~/load_model`: loads another network on its own thread; the inference takes it over between two images.

use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};

use anyhow::{Context as _, bail};
use r2r::ServiceRequest;
use r2r::egotac_msgs::srv::LoadModel;

use super::load::{load_file, measure_inference, model_info};
use crate::hand::Topology;
use crate::message::HandModelInfo;
use crate::model::predictor::{Options, Predictor};
use crate::node::clock::RosClock;
use crate::node::lock::lock;
use crate::node::log::Log;
use crate::node::runtime::Runtime;
use crate::text::error_chain;

/// A network with its description.
pub(super) struct LoadedModel {
    /// Network that has seen no image yet.
    pub(super) predictor: Predictor,
    /// Description of the network.
    pub(super) info: HandModelInfo,
}

/// Place where a loaded network waits for the inference; clones share it.
#[derive(Clone, Default)]
pub(super) struct PendingModel(Arc<Mutex<Option<LoadedModel>>>);

impl PendingModel {
    /// Takes the waiting network, if there is one.
    pub(super) fn take(&self) -> Option<LoadedModel> {
        lock(&self.0).take()
    }

    fn put(&self, loaded: LoadedModel) {
        *lock(&self.0) = Some(loaded);
    }
}

/// Requirements on another network.
#[derive(Clone)]
pub(super) struct ModelRequirements {
    /// File that a request without a file loads.
    pub(super) default_path: PathBuf,
    /// Device and precision.
    pub(super) options: Options,
    /// Vertex numbering; subscribers rely on it.
    pub(super) topology: Topology,
}

/// Offers `~/load_model`; `model_id` names the network in use.
///
/// # Errors
/// If ROS refuses the service name.
pub(super) fn serve(
    runtime: &mut Runtime,
    pending: PendingModel,
    requirements: ModelRequirements,
    model_id: String,
) -> anyhow::Result<()> {
    let loader = Loader {
        pending,
        requirements,
        model_id: Arc::new(Mutex::new(model_id)),
        clock: runtime.clock().clone(),
        log: runtime.log().clone(),
    };
    runtime.deferred_service("~/load_model", move |request| {
        let loader = loader.clone();
        // Ignore the error: without a thread there is no response, and the caller's timeout ends.
        drop(std::thread::Builder::new().name("loading".into()).spawn(move || loader.respond(request)));
    })
}

#[derive(Clone)]
struct Loader {
    pending: PendingModel,
    requirements: ModelRequirements,
    /// Id of the network in use; locked while a network is loaded, so that requests are served one by one.
    model_id: Arc<Mutex<String>>,
    clock: RosClock,
    log: Log,
}

impl Loader {
    fn respond(&self, request: ServiceRequest<LoadModel::Service>) {
        let mut model_id = lock(&self.model_id);
        let (success, message) = match self.load(&request.message.model) {
            Ok(loaded) => {
                self.log.info(format!("model {} replaces {model_id}", loaded.info.model_id));
                model_id.clone_from(&loaded.info.model_id);
                self.pending.put(loaded);
                (true, String::new())
            }
            Err(error) => {
                let reason = error_chain(error.as_ref());
                self.log.warn(format!("the model is not replaced: {reason}"));
                (false, reason)
            }
        };
        let response = LoadModel::Response { success, message, model_id: model_id.clone() };
        if let Err(error) = request.respond(response) {
            self.log.warn_throttled("load_model", format!("~/load_model: cannot send the response: {error}"));
        }
    }

    /// Loads and runs a checkpoint once, so that an unusable one is refused before it replaces the network in use.
    fn load(&self, path: &str) -> anyhow::Result<LoadedModel> {
        let ModelRequirements { default_path, options, topology } = &self.requirements;
        let path = if path.is_empty() { default_path } else { Path::new(path) };
        let mut predictor = load_file(path, options.clone())?;
        let loaded = predictor.metadata().topology;
        if loaded != *topology {
            bail!("{}: expected topology {}, got {}", path.display(), topology.id(), loaded.id());
        }
        measure_inference(&mut predictor).with_context(|| path.display().to_string())?;
        let info = model_info(&predictor, self.clock.now())?;
        Ok(LoadedModel { predictor, info })
    }
}
