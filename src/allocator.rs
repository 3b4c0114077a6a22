//! The allocator of the programs, mimalloc. It is not a module of the library: a Python extension that contains mimalloc can't be loaded.

use libmimalloc_sys::{mi_option_set, mi_option_t};

// Training allocates and frees many large tensors per step, which mimalloc does faster than the system's allocator.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

/// Option `mi_option_purge_delay` of mimalloc, which the bindings do not name.
const PURGE_DELAY: mi_option_t = 15;
/// Time for which freed memory is kept, longer than most steps take. `bench train --preset tiny --runs 5` had 136,000 page faults with
/// mimalloc's usual second, and 9,000 with ten.
const KEPT_MS: std::ffi::c_long = 10_000;

/// Lets trainings decide how long freed memory is kept.
pub fn install() {
    egotac::train::memory::on_keep(keep);
}

/// Keeps freed memory for some seconds and in huge pages, or returns it to the system at once and in small pages: a huge one stays
/// for a single block that is in use.
fn keep(keep: bool) {
    let delay_ms = if keep { KEPT_MS } else { 0 };
    // SAFETY: `mi_option_set` stores one aligned machine word, and threads that free memory read the old or the new delay; an unknown
    // option is ignored. This `prctl` takes numbers alone, and only chooses the size of pages.
    #[allow(unsafe_code)]
    unsafe {
        mi_option_set(PURGE_DELAY, delay_ms);
        libc::prctl(libc::PR_SET_THP_DISABLE, libc::c_ulong::from(!keep), 0, 0, 0);
    }
}

#[cfg(test)]
mod tests {
    use libmimalloc_sys::mi_option_get;

    use super::*;

    #[test]
    fn the_number_of_the_option_is_that_of_the_purge_delay() {
        #[allow(unsafe_code)]
        let delay_ms = || {
            // SAFETY: `mi_option_get` reads one aligned machine word; an unknown option is 0.
            unsafe { mi_option_get(PURGE_DELAY) }
        };
        // Mimalloc's own default, which no other option has.
        assert_eq!(delay_ms(), 1000);
        install();
        egotac::train::memory::keep(false);
        assert_eq!(delay_ms(), 0);
        egotac::train::memory::keep(true);
        assert_eq!(delay_ms(), KEPT_MS);
    }
}
