//! Worker thread of a node.

use std::thread::JoinHandle;

use anyhow::anyhow;

use super::shutdown::Shutdown;

/// Thread that does the slow work of a node. It requests shutdown when it ends, also by a panic, so that the node does not
/// outlive it.
#[derive(Debug)]
pub(crate) struct WorkerThread {
    name: &'static str,
    handle: JoinHandle<anyhow::Result<()>>,
}

impl WorkerThread {
    /// Runs `work` on a thread named `name`; `work` must return soon after `shutdown` is requested.
    ///
    /// # Errors
    /// If the system cannot start a thread.
    pub(crate) fn spawn(
        name: &'static str,
        shutdown: &Shutdown,
        work: impl FnOnce(&Shutdown) -> anyhow::Result<()> + Send + 'static,
    ) -> anyhow::Result<Self> {
        let shutdown = shutdown.clone();
        let handle = std::thread::Builder::new().name(name.into()).spawn(move || {
            let _guard = shutdown.request_when_dropped();
            work(&shutdown)
        })?;
        Ok(Self { name, handle })
    }

    /// Returns true if the thread has ended.
    pub(crate) fn is_finished(&self) -> bool {
        self.handle.is_finished()
    }

    /// Waits for the end of the thread.
    ///
    /// # Errors
    /// If the work failed or panicked.
    pub(crate) fn join(self) -> anyhow::Result<()> {
        self.handle.join().map_err(|_| anyhow!("the {} thread panicked", self.name))?
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_failed_worker_requests_shutdown_and_returns_its_error() {
        let shutdown = Shutdown::default();
        let worker = WorkerThread::spawn("test", &shutdown, |_| Err(anyhow!("no disk"))).unwrap();
        assert_eq!(worker.join().unwrap_err().to_string(), "no disk");
        assert!(shutdown.requested());
    }

    #[test]
    fn a_panic_of_the_worker_requests_shutdown_and_becomes_an_error() {
        let shutdown = Shutdown::default();
        let worker = WorkerThread::spawn("test", &shutdown, |_| panic!("expected by the test")).unwrap();
        assert_eq!(worker.join().unwrap_err().to_string(), "the test thread panicked");
        assert!(shutdown.requested());
    }
}
