//! An iterator whose next items are made on another thread.

use std::sync::mpsc::sync_channel;

/// Items that may wait to be taken; this bounds the memory.
const DEPTH: usize = 2;

/// Gives `take` the items of `items`, of which another thread makes the next ones meanwhile.
pub(super) fn ahead<T: Send, R>(
    items: impl Iterator<Item = T> + Send,
    take: impl FnOnce(&mut dyn Iterator<Item = T>) -> R,
) -> R {
    std::thread::scope(|scope| {
        let (sender, receiver) = sync_channel(DEPTH);
        scope.spawn(move || {
            for item in items {
                // Nobody takes what is left.
                if sender.send(item).is_err() {
                    return;
                }
            }
        });
        take(&mut receiver.into_iter())
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn items_come_in_order_and_nobody_waits_for_those_that_are_not_taken() {
        assert_eq!(ahead(0..100, |items| items.collect::<Vec<_>>()), (0..100).collect::<Vec<_>>());
        assert_eq!(ahead(0.., |items| items.next()), Some(0));
    }

    #[test]
    #[should_panic(expected = "a scoped thread panicked")]
    fn a_dead_thread_is_not_the_end_of_the_items() {
        ahead((0..3).map(|item| if item == 2 { panic!("dead") } else { item }), |items| items.count());
    }
}
