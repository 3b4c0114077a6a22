//! Shutdown flag that all threads of a node share.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::Context as _;
use signal_hook::consts::{SIGINT, SIGTERM};
use signal_hook::flag;

/// Shutdown flag; clones share it. A signal, a worker that ends, or a test sets it; nothing clears it.
#[derive(Debug, Clone, Default)]
pub(crate) struct Shutdown(Arc<AtomicBool>);

impl Shutdown {
    /// Requests shutdown.
    pub(crate) fn request(&self) {
        self.0.store(true, Ordering::SeqCst);
    }

    /// Returns true if shutdown was requested.
    pub(crate) fn requested(&self) -> bool {
        self.0.load(Ordering::SeqCst)
    }

    /// Requests shutdown on SIGINT and SIGTERM; a second signal ends the process at once, in case the node hangs.
    ///
    /// # Errors
    /// If the system refuses the signal handlers.
    pub(crate) fn request_on_signals(&self) -> anyhow::Result<()> {
        for signal in [SIGINT, SIGTERM] {
            // The handlers run in this order, so that the first signal finds the flag still unset.
            flag::register_conditional_shutdown(signal, 1, Arc::clone(&self.0))
                .and_then(|_| flag::register(signal, Arc::clone(&self.0)))
                .context("cannot handle SIGINT and SIGTERM")?;
        }
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
