//! Id of the network in use.

use std::sync::{Arc, Mutex, MutexGuard};

use crate::node::lock::lock;

/// Id of the network in use, for frames and diagnostics; clones share it.
#[derive(Clone)]
pub(super) struct ModelId(Arc<Mutex<String>>);

impl ModelId {
    /// Starts with the id of the first network.
    pub(super) fn new(model_id: String) -> Self {
        Self(Arc::new(Mutex::new(model_id)))
    }

    /// Locks the id.
    pub(super) fn get(&self) -> MutexGuard<'_, String> {
        lock(&self.0)
    }
}
