//! An iterator whose items are produced ahead of time on another thread.

use std::sync::mpsc::sync_channel;

/// Number of finished items that may wait in the queue; bounds the memory.
const DEPTH: usize = 2;

/// Runs `consume` with the items of `items`, while another thread produces the next ones.
pub(super) fn prefetch<T: Send, R>(
    items: impl Iterator<Item = T> + Send,
    consume: impl FnOnce(&mut dyn Iterator<Item = T>) -> R,
) -> R {
    prefetch_up_to(DEPTH, items, consume)
}

/// As [`prefetch()`], for large items: with depth 0, two of them are in memory, one on each thread.
pub(super) fn prefetch_up_to<T: Send, R>(
    depth: usize,
    items: impl Iterator<Item = T> + Send,
    consume: impl FnOnce(&mut dyn Iterator<Item = T>) -> R,
) -> R {
    std::thread::scope(|scope| {
        let (sender, receiver) = sync_channel(depth);
        scope.spawn(move || {
            for item in items {
                // Receiver gone: the consumer needs no further items.
                if sender.send(item).is_err() {
                    return;
                }
            }
        });
        consume(&mut receiver.into_iter())
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn items_keep_their_order_and_unused_items_do_not_block() {
        assert_eq!(prefetch(0..100, |items| items.collect::<Vec<_>>()), (0..100).collect::<Vec<_>>());
        assert_eq!(prefetch(0.., |items| items.next()), Some(0));
        assert_eq!(prefetch_up_to(0, 0..9, |items| items.sum::<i32>()), 36);
    }

    #[test]
    #[should_panic(expected = "a scoped thread panicked")]
    fn a_panic_of_the_producer_is_not_mistaken_for_the_end() {
        prefetch((0..3).map(|item| if item == 2 { panic!("dead") } else { item }), |items| items.count());
    }
}
