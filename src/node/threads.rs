//! Threads of a node's computation, and the cores that they run on.

use std::sync::Arc;

use anyhow::{Context as _, bail};
use nix::sched::{CpuSet, sched_setaffinity};
use nix::unistd::Pid;
use rayon::{ThreadPool, ThreadPoolBuilder};

use super::log::Log;
use super::params::{Allowed, Parameter, Parameters};

/// Most threads; far above the cores that one inference can use.
const MAX_THREADS: i64 = 256;

/// Threads that compute; clones share them.
#[derive(Clone)]
pub(crate) struct Threads(Option<Arc<ThreadPool>>);

impl Threads {
    /// Declares the parameters `threads` and `pin_cores`.
    pub(crate) fn parameters() -> [Parameter; 2] {
        [
            Parameter::fixed(
                "threads",
                0,
                Allowed::Integers(0, MAX_THREADS),
                "Number of threads that compute; 0 = one per core, or per entry of pin_cores.",
            ),
            Parameter::fixed(
                "pin_cores",
                Vec::<i64>::new(),
                Allowed::Integers(0, 4095),
                "Cores, counted from 0, that the computing threads are bound to in turn; empty = not bound.",
            ),
        ]
    }

    /// Starts the threads that the parameters ask for.
    ///
    /// # Errors
    /// If the system has no such core, or cannot start a thread.
    pub(crate) fn of(parameters: &Parameters, log: &Log) -> anyhow::Result<Self> {
        let cores = parameters.get::<Vec<i64>>("pin_cores");
        let cores: Vec<usize> = cores.into_iter().map(usize::try_from).collect::<Result<_, _>>()?;
        let wanted = usize::try_from(parameters.get::<i64>("threads"))?;
        if wanted == 0 && cores.is_empty() {
            return Ok(Self(None));
        }
        for core in &cores {
            check(*core)?;
        }
        let count = if wanted == 0 { cores.len() } else { wanted };
        let bound = cores.clone();
        let pool = ThreadPoolBuilder::new()
            .num_threads(count)
            .thread_name(|index| format!("compute-{index}"))
            .start_handler(move |index| {
                if let Some(core) = bound.get(index % bound.len().max(1)) {
                    // The core was checked; a thread that the system leaves unbound computes the same.
                    let _ = bind(*core);
                }
            })
            .build()
            .context("cannot start the computing threads")?;
        match cores.is_empty() {
            true => log.info(format!("{count} computing threads")),
            false => log.info(format!("{count} computing threads on the cores {cores:?}")),
        }
        Ok(Self(Some(Arc::new(pool))))
    }

    /// Runs `work` on one of the threads, with the others as its helpers.
    pub(crate) fn run<R: Send>(&self, work: impl FnOnce() -> R + Send) -> R {
        match &self.0 {
            Some(pool) => pool.install(work),
            None => work(),
        }
    }
}

/// Binds this thread to a core.
fn bind(core: usize) -> nix::Result<()> {
    let mut set = CpuSet::new();
    set.set(core)?;
    sched_setaffinity(Pid::from_raw(0), &set)
}

/// Returns an error if no thread can be bound to a core; tries it on a thread that ends at once.
fn check(core: usize) -> anyhow::Result<()> {
    match std::thread::spawn(move || bind(core)).join() {
        Ok(Ok(())) => Ok(()),
        Ok(Err(reason)) => {
            bail!("parameter pin_cores: expected cores that this process may use, got {core} ({reason})")
        }
        Err(_) => bail!("parameter pin_cores: core {core} could not be tried"),
    }
}
