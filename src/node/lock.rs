//! Locks between the threads of a node, also after a panic; `tests/node/mailbox_interleavings.rs` puts those of loom in their place.

use std::sync::{MutexGuard, PoisonError};

pub(crate) use std::sync::{Condvar, Mutex};
pub(crate) use std::time::Instant;

/// Locks `mutex`, also after a thread panicked while it held the lock: the node reports the panic where it joins the
/// thread, and until then the other threads still need the value.
pub(crate) fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
