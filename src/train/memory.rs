//! Memory that training frees and takes again, in programs whose allocator is mimalloc.

use libmimalloc_sys::{mi_option_set, mi_option_t};

/// Option `mi_option_purge_delay` of mimalloc, which the bindings do not name.
const PURGE_DELAY: mi_option_t = 15;
/// Time for which freed memory is kept, longer than most steps take. With mimalloc's usual second, a step faulted in a tenth of its
/// pages again.
const KEPT_MS: std::ffi::c_long = 10_000;

/// Keeps freed memory for some seconds and in huge pages (`true`, while a network trains: each step takes and frees the same large
/// tensors), or returns it to the system at once and in small pages (`false`): a huge page stays for a single block that is in use.
///
/// Another allocator than mimalloc keeps its own ways.
pub fn keep(keep: bool) {
    let delay_ms = if keep { KEPT_MS } else { 0 };
    // SAFETY: `mi_option_set` stores one aligned machine word, and threads that free memory read the old or the new delay; an unknown
    // option is ignored.
    #[allow(unsafe_code)]
    unsafe {
        mi_option_set(PURGE_DELAY, delay_ms);
    }
    #[cfg(target_os = "linux")]
    // SAFETY: this `prctl` takes numbers alone, and only chooses the size of pages.
    #[allow(unsafe_code)]
    unsafe {
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
        // Mimalloc's own default, which no other option has; a training in another test of this process may have changed it.
        assert!([1000, KEPT_MS].contains(&delay_ms()), "{}", delay_ms());
        keep(false);
        assert_eq!(delay_ms(), 0);
        keep(true);
        assert_eq!(delay_ms(), KEPT_MS);
    }
}
