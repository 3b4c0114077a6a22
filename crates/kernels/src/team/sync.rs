//! Primitives that threads of a team share; `tests/team_interleavings.rs` puts those of loom in their place.

use std::cell;
pub use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering};

/// Times that a waiting thread looks for work before it yields its processor. A helper that
/// yields at once misses the next step; one that never yields takes time from others on a busy machine.
const SPINS: usize = 4_000;

/// A cell whose users keep each other away, with the interface of loom's.
pub struct UnsafeCell<T>(cell::UnsafeCell<T>);

impl<T> UnsafeCell<T> {
    /// Creates a cell.
    pub fn new(value: T) -> Self {
        Self(cell::UnsafeCell::new(value))
    }

    /// Gives `read` the address of the value, to read from.
    pub fn with<R>(&self, read: impl FnOnce(*const T) -> R) -> R {
        read(self.0.get())
    }

    /// Gives `write` the address of the value, to write to.
    pub fn with_mut<R>(&self, write: impl FnOnce(*mut T) -> R) -> R {
        write(self.0.get())
    }
}

/// Spins, and after [`SPINS`] calls yields.
pub fn wait(spins: &mut usize) {
    *spins += 1;
    match *spins < SPINS {
        true => std::hint::spin_loop(),
        false => std::thread::yield_now(),
    }
}
