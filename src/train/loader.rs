//! Prefetching of batches by several threads, in an order that does not depend on the threads.

use std::sync::mpsc::{Receiver, sync_channel};
use std::thread::{Builder, Scope};

use super::batch::{Batch, Collate};
use super::config::Config;
use super::data::Dataset;
use super::mixture;
use super::sampler::{self, Pool, Sampler, Share};
use crate::error::{Error, Result};

/// Batches that each thread prepares ahead of the step that needs them.
const PREFETCH_PER_THREAD: usize = 2;

/// Source of a run's batches.
pub struct Loader {
    receivers: Vec<Receiver<Result<Batch>>>,
    next: usize,
}

impl Loader {
    /// Starts the threads of `config`, which make the rank's `share` of each batch; batch `first` of the run comes first.
    ///
    /// # Errors
    /// If the sources can't be mixed as the configuration asks, or a thread can't be started.
    pub fn start<'scope>(
        scope: &'scope Scope<'scope, '_>,
        data: &'scope Dataset,
        collate: &'scope Collate,
        config: &Config,
        first: usize,
        share: Share,
    ) -> Result<Self> {
        let sampler = Sampler::new(pools(data, config)?, config.batch.windows, config.batch.clips, config.seed);
        let receivers = (0..config.threads)
            .map(|thread| {
                let (sender, receiver) = sync_channel(PREFETCH_PER_THREAD);
                let batches = sampler.clone().enumerate().skip(first + thread).step_by(config.threads);
                let work = move || {
                    for (index, clips) in batches {
                        // The receiver is dropped when the run ends.
                        if sender.send(data.batch_of(share, collate, index, &clips)).is_err() {
                            break;
                        }
                    }
                };
                let started = Builder::new().spawn_scoped(scope, work);
                started.map_err(|error| Error::value("threads", "a number that the system starts", error))?;
                Ok(receiver)
            })
            .collect::<Result<_>>()?;
        Ok(Self { receivers, next: 0 })
    }

    /// Returns the next batch.
    ///
    /// # Errors
    /// If the batch could not be made.
    pub fn next(&mut self) -> Result<Batch> {
        let receiver = &self.receivers[self.next % self.receivers.len()];
        self.next += 1;
        receiver.recv().map_err(|_| Error::value("loader", "a running thread", "one that died"))?
    }
}

/// Returns the episodes of each source of `config` and its number of windows per epoch.
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
