//! The request to stop that all threads of a node share.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::Context as _;
use signal_hook::consts::{SIGINT, SIGTERM};
use signal_hook::flag;

/// A flag, set once: by a signal, by a thread that ended, or by a test.
#[derive(Debug, Clone, Default)]
pub struct Shutdown(Arc<AtomicBool>);

impl Shutdown {
    /// Asks everybody to stop.
    pub fn request(&self) {
        self.0.store(true, Ordering::SeqCst);
    }

    /// Whether to stop.
    pub fn requested(&self) -> bool {
        self.0.load(Ordering::SeqCst)
    }

    /// Stops on SIGINT and SIGTERM; the second of them ends the process at once, should the first not have helped.
    ///
    /// # Errors
    /// If the system refuses the handlers.
    pub fn on_signals(&self) -> anyhow::Result<()> {
        for signal in [SIGINT, SIGTERM] {
            // In this order: the first signal finds the flag still unset.
            flag::register_conditional_shutdown(signal, 1, Arc::clone(&self.0))
                .and_then(|_| flag::register(signal, Arc::clone(&self.0)))
                .context("cannot handle SIGINT and SIGTERM")?;
        }
        Ok(())
    }

    /// Asks everybody to stop when dropped, so that a node does not outlive its worker.
    pub fn when_dropped(&self) -> RequestOnDrop {
        RequestOnDrop(self.clone())
    }
}

/// See [`Shutdown::when_dropped`].
#[derive(Debug)]
pub struct RequestOnDrop(Shutdown);

impl Drop for RequestOnDrop {
    fn drop(&mut self) {
        self.0.request();
    }
}
