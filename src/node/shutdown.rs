//! Shutdown flag that all threads of a node share.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use anyhow::Context as _;
use signal_hook::consts::{SIGINT, SIGTERM};
use signal_hook::flag;

/// Number of signals that a node takes without ending at once.
const PATIENT_SIGNALS: u32 = 5;
/// Time in which several signals count as one.
const SIGNAL_INTERVAL: Duration = Duration::from_millis(50);

/// Shutdown flag; clones share it. A signal, a worker that ends, or a test sets it; nothing clears it.
#[derive(Debug, Clone, Default)]
pub(crate) struct Shutdown {
    flag: Arc<AtomicBool>,
    /// Flag that requests the same, if there is one.
    parent: Option<Arc<AtomicBool>>,
}

impl Shutdown {
    /// Requests shutdown.
    pub(crate) fn request(&self) {
        self.flag.store(true, Ordering::SeqCst);
    }

    /// Returns true if shutdown was requested.
    pub(crate) fn requested(&self) -> bool {
        let is_set = |flag: &Arc<AtomicBool>| flag.load(Ordering::SeqCst);
        is_set(&self.flag) || self.parent.as_ref().is_some_and(is_set)
    }

    /// Returns a flag for a part of the program: it is set with this one, and this one not with it.
    pub(crate) fn child(&self) -> Self {
        Self { flag: Arc::default(), parent: Some(Arc::clone(&self.flag)) }
    }

    /// Requests shutdown on SIGINT and SIGTERM. Further signals do not interrupt it, because a terminal and a launch program
    /// each send one while a node saves its work; the sixth ends the process at once, in case the node hangs.
    ///
    /// # Errors
    /// If the system refuses the signal handlers or a thread.
    pub(crate) fn request_on_signals(&self) -> anyhow::Result<()> {
        let (arrived, must_exit) = (Arc::new(AtomicBool::new(false)), Arc::new(AtomicBool::new(false)));
        for signal in [SIGINT, SIGTERM] {
            flag::register_conditional_shutdown(signal, 1, Arc::clone(&must_exit))
                .and_then(|_| flag::register(signal, Arc::clone(&self.flag)))
                .and_then(|_| flag::register(signal, Arc::clone(&arrived)))
                .context("cannot handle SIGINT and SIGTERM")?;
        }
        let count = move || {
            let mut left = PATIENT_SIGNALS;
            while left > 0 {
                std::thread::sleep(SIGNAL_INTERVAL);
                left -= u32::from(arrived.swap(false, Ordering::SeqCst));
            }
            must_exit.store(true, Ordering::SeqCst);
        };
        std::thread::Builder::new().name("signals".into()).spawn(count).context("cannot count signals")?;
        Ok(())
    }

    /// Returns a guard that requests shutdown when it is dropped.
    pub(crate) fn request_when_dropped(&self) -> RequestOnDrop {
        RequestOnDrop(self.clone())
    }
}

/// Guard made by [`Shutdown::request_when_dropped`].
#[derive(Debug)]
pub(crate) struct RequestOnDrop(Shutdown);

impl Drop for RequestOnDrop {
    fn drop(&mut self) {
        self.0.request();
    }
}
