//! Batches made ahead of the step that needs them, by several threads, in an order that does not depend on them.

use std::sync::mpsc::{Receiver, sync_channel};
use std::thread::Scope;

use super::batch::{Batch, Collate, Dataset};
use super::config::Config;
use super::sampler::{self, Sampler};
use crate::error::{Error, Result};

/// Batches that each thread keeps ready.
const AHEAD: usize = 2;

/// Hands out batch after batch.
pub struct Loader {
    receivers: Vec<Receiver<Result<Batch>>>,
    next: usize,
}

impl Loader {
    /// Starts the threads of `config`; the first batch handed out is number `first` of the run.
    pub fn start<'scope>(
        scope: &'scope Scope<'scope, '_>,
        data: &'scope Dataset,
        collate: &'scope Collate,
        config: &Config,
        first: usize,
    ) -> Self {
        let episodes = data
            .episodes()
            .into_iter()
            .map(|(store, episode)| {
                let stride = sampler::stride(data.timestamps(store), &episode, config.frame_dt);
                (store, episode, stride)
            })
            .collect();
        let sampler = Sampler::new(episodes, config.batch.windows, config.batch.clips, config.seed);
        let receivers = (0..config.threads)
            .map(|thread| {
                let (sender, receiver) = sync_channel(AHEAD);
                let batches = sampler.clone().enumerate().skip(first + thread).step_by(config.threads);
                scope.spawn(move || {
                    for (index, clips) in batches {
                        // A closed channel means that the run is over.
                        if sender.send(data.batch(collate, index, &clips)).is_err() {
                            break;
                        }
                    }
                });
                receiver
            })
            .collect();
        Self { receivers, next: 0 }
    }

    /// The next batch.
    ///
    /// # Errors
    /// If the batch could not be made.
    pub fn next(&mut self) -> Result<Batch> {
        let receiver = &self.receivers[self.next % self.receivers.len()];
        self.next += 1;
        receiver.recv().map_err(|_| Error::value("loader", "a running thread", "one that died"))?
    }
}
