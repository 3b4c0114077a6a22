//! Bound on the memory of the images that wait between reader and network.

use std::sync::{Arc, Condvar, Mutex, PoisonError};

/// Memory of all images that are read and not prepared yet, bytes; one larger image has it to itself.
const MOST: u64 = 512 << 20;

/// Memory in use, shared by the reader and the decoders.
#[derive(Debug, Clone, Default)]
pub(super) struct Budget(Arc<(Mutex<u64>, Condvar)>);

/// A part of the budget, given back when dropped.
#[derive(Debug)]
pub(super) struct Share {
    budget: Budget,
    bytes: u64,
}

impl Budget {
    /// Takes a share; None if other shares leave too little.
    pub fn try_take(&self, bytes: u64) -> Option<Share> {
        let mut used = self.0.0.lock().unwrap_or_else(PoisonError::into_inner);
        self.share(&mut used, bytes)
    }

    /// Takes a share, and waits until others are given back. The caller must hold none itself.
    pub fn take(&self, bytes: u64) -> Share {
        let (used, freed) = &*self.0;
        let mut used = used.lock().unwrap_or_else(PoisonError::into_inner);
        loop {
            if let Some(share) = self.share(&mut used, bytes) {
                return share;
            }
            used = freed.wait(used).unwrap_or_else(PoisonError::into_inner);
        }
    }

    fn share(&self, used: &mut u64, bytes: u64) -> Option<Share> {
        let after = used.saturating_add(bytes);
        if *used > 0 && after > MOST {
            return None;
        }
        *used = after;
        Some(Share { budget: self.clone(), bytes })
    }
}

impl Drop for Share {
    fn drop(&mut self) {
        let (used, freed) = &*self.budget.0;
        let mut used = used.lock().unwrap_or_else(PoisonError::into_inner);
        *used = used.saturating_sub(self.bytes);
        freed.notify_all();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shares_fit_the_budget_and_a_larger_one_waits_for_all_others() {
        let budget = Budget::default();
        let half = budget.try_take(MOST / 2).unwrap();
        let rest = budget.try_take(MOST - MOST / 2).unwrap();
        assert!(budget.try_take(1).is_none());
        let waiting = std::thread::spawn({
            let budget = budget.clone();
            move || drop(budget.take(3 * MOST))
        });
        drop((half, rest));
        waiting.join().unwrap();
        assert!(budget.try_take(1).is_some());
    }
}
