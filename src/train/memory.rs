//! Memory that training frees and takes again.

use std::sync::OnceLock;

static ON_KEEP: OnceLock<fn(bool)> = OnceLock::new();

/// Sets the function by which [`keep`] speaks to the program's allocator; the first one stays.
pub fn on_keep(keep: fn(bool)) {
    let _ = ON_KEEP.set(keep);
}

/// Tells the program's allocator to keep freed memory (`true`, while a network trains: each step takes and frees the same large
/// tensors), or to return it to the system at once (`false`). Does nothing in programs that have not called [`on_keep`].
pub fn keep(keep: bool) {
    if let Some(on_keep) = ON_KEEP.get() {
        on_keep(keep);
    }
}
