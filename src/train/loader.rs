//! Batches made ahead of the step that needs them, by several threads, in an order that does not depend on them.

use std::sync::mpsc::{Receiver, sync_channel};
use std::thread::Scope;

use super::batch::{Batch, Collate};
use super::config::Config;
use super::data::Dataset;
use super::mixture;
use super::sampler::{self, Pool, Sampler};
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
    ///
    /// # Errors
    /// If the sources can't be mixed as the configuration asks.
    pub fn start<'scope>(
        scope: &'scope Scope<'scope, '_>,
        data: &'scope Dataset,
        collate: &'scope Collate,
        config: &Config,
        first: usize,
    ) -> Result<Self> {
        let sampler = Sampler::new(pools(data, config)?, config.batch.windows, config.batch.clips, config.seed);
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
        Ok(Self { receivers, next: 0 })
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

/// What an epoch takes from each source of `config`.
///
/// # Errors
/// As [`mixture::counts`].
pub fn pools(data: &Dataset, config: &Config) -> Result<Vec<Pool>> {
    let mut pools: Vec<Pool> = config.data.iter().map(|_| Pool { episodes: Vec::new(), count: 0 }).collect();
    for (store, episode) in data.episodes() {
        let stride = sampler::stride(data.timestamps(store), &episode, config.frame_dt);
        pools[data.source(store)].episodes.push((store, episode, stride));
    }
    let size = |pool: &Pool| pool.episodes.iter().map(|(_, frames, _)| frames.len()).sum();
    let sizes: Vec<usize> = pools.iter().map(size).collect();
    let epoch = config.sampling.epoch.unwrap_or(sizes.iter().sum());
    let quotas: Vec<usize> = config.data.iter().map(|source| (source.quota * epoch as f64) as usize).collect();
    let counts = mixture::counts(&sizes, &quotas, epoch, config.sampling.temperature)?;
    for (pool, count) in pools.iter_mut().zip(counts) {
        pool.count = count;
    }
    Ok(pools)
}
