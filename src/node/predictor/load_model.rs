//! Service `~/load_model`: loads another network on its own thread; the inference takes it over between two images.

use std::path::{Path, PathBuf};
use std::sync::mpsc::{RecvTimeoutError, TrySendError, sync_channel};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use anyhow::{Context as _, bail};
use r2r::ServiceRequest;
use r2r::egotac_msgs::srv::LoadModel;

use super::load::{load_file, measure_inference, model_info, on_mano};
use crate::hand::{FieldMap, Topology};
use crate::message::HandModelInfo;
use crate::model::predictor::{Options, Predictor};
use crate::node::allowed_folder::AllowedFolder;
use crate::node::clock::RosClock;
use crate::node::lock::lock;
use crate::node::log::Log;
use crate::node::runtime::Runtime;
use crate::node::shutdown::Shutdown;
use crate::node::threads::Threads;
use crate::node::worker_thread::WorkerThread;
use crate::text::error_chain;

/// Most requests that wait while a network is loaded.
const MAX_WAITING_REQUESTS: usize = 4;
/// Longest wait of the thread for a request; bounds the delay of shutdown.
const REQUEST_TIMEOUT: Duration = Duration::from_millis(100);

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
    /// Folder in which files of requests must lie.
    pub(super) allowed: AllowedFolder,
    /// MANO files whose vertices the fields are on.
    pub(super) mano: Option<Arc<FieldMap>>,
    /// Threads that compute.
    pub(super) threads: Threads,
}

/// Offers `~/load_model`; `model_id` names the network in use. Returns the thread that loads networks, which ends at `shutdown`.
///
/// # Errors
/// If ROS refuses the service name, or the system a thread.
pub(super) fn serve(
    runtime: &mut Runtime,
    shutdown: &Shutdown,
    pending: PendingModel,
    requirements: ModelRequirements,
    model_id: String,
) -> anyhow::Result<WorkerThread> {
    let (clock, log) = (runtime.clock().clone(), runtime.log().clone());
    let mut loader = Loader { pending, requirements, model_id, clock, log: log.clone() };
    let (requests, received) = sync_channel(MAX_WAITING_REQUESTS);
    runtime.deferred_service("~/load_model", move |request| {
        if let Err(TrySendError::Full(request) | TrySendError::Disconnected(request)) = requests.try_send(request) {
            let message = format!("{MAX_WAITING_REQUESTS} other requests wait");
            respond(request, LoadModel::Response { success: false, message, model_id: String::new() }, &log);
        }
    })?;
    WorkerThread::spawn("loading", shutdown, move |shutdown| {
        while !shutdown.requested() {
            match received.recv_timeout(REQUEST_TIMEOUT) {
                Ok(request) => loader.serve(request),
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => break,
            }
        }
        Ok(())
    })
}

type Request = ServiceRequest<LoadModel::Service>;

struct Loader {
    pending: PendingModel,
    requirements: ModelRequirements,
    /// Id of the network in use.
    model_id: String,
    clock: RosClock,
    log: Log,
}

impl Loader {
    fn serve(&mut self, request: Request) {
        let (success, message) = match self.load(&request.message.model) {
            Ok(loaded) => {
                self.log.info(format!("model {} replaces {}", loaded.info.model_id, self.model_id));
                self.model_id.clone_from(&loaded.info.model_id);
                self.pending.put(loaded);
                (true, String::new())
            }
            Err(error) => {
                let reason = error_chain(error.as_ref());
                self.log.warn(format!("the model is not replaced: {reason}"));
                (false, reason)
            }
        };
        respond(request, LoadModel::Response { success, message, model_id: self.model_id.clone() }, &self.log);
    }

    /// Loads and runs a checkpoint once, so that an unusable one is refused before it replaces the network in use.
    fn load(&self, path: &str) -> anyhow::Result<LoadedModel> {
        let ModelRequirements { default_path, options, topology, allowed, mano, threads } = &self.requirements;
        if !path.is_empty() {
            allowed.check("model", Path::new(path))?;
        }
        let path = if path.is_empty() { default_path } else { Path::new(path) };
        let predictor = on_mano(load_file(path, options.clone())?, mano.as_ref());
        let loaded = predictor.topology();
        if loaded != *topology {
            bail!("{}: expected topology {}, got {}", path.display(), topology.id(), loaded.id());
        }
        threads.run(|| measure_inference(&predictor)).with_context(|| path.display().to_string())?;
        let info = model_info(&predictor, self.clock.now())?;
        Ok(LoadedModel { predictor, info })
    }
}

fn respond(request: Request, response: LoadModel::Response, log: &Log) {
    if let Err(error) = request.respond(response) {
        log.warn_throttled("load_model", format!("~/load_model: cannot send the response: {error}"));
    }
}
