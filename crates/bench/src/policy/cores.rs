//! Work that is spread over all cores, with results in order.

use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc;

use egotac::error::{Error, Result};

/// Calls `work` for each item, each thread with a state of its own, and returns the results in the order of the items;
/// `done` is called after each.
///
/// Threads of their own, not a pool's: an OpenGL context belongs to its thread, and a pool's thread may begin another item
/// while it waits inside of one.
///
/// # Errors
/// The first error in the order of the items; the items that were not begun by then are left out.
pub fn on_all_cores<I: Sync, S, T: Send>(
    items: &[I],
    state: impl Fn() -> S + Sync,
    work: impl Fn(&mut S, &I) -> Result<T> + Sync,
    mut done: impl FnMut(),
) -> Result<Vec<T>> {
    let next = AtomicUsize::new(0);
    let threads = std::thread::available_parallelism().map_or(1, usize::from).min(items.len());
    let (sender, results) = mpsc::channel();
    let one = |sender: mpsc::Sender<(usize, Result<T>)>| {
        let mut state = state();
        while let Some((index, item)) = {
            let index = next.fetch_add(1, Ordering::Relaxed);
            items.get(index).map(|item| (index, item))
        } {
            let result = work(&mut state, item);
            if result.is_err() {
                next.store(items.len(), Ordering::Relaxed);
            }
            if sender.send((index, result)).is_err() {
                return;
            }
        }
    };
    let mut all: Vec<(usize, Result<T>)> = std::thread::scope(|scope| {
        for _ in 0..threads {
            let (one, sender) = (&one, sender.clone());
            scope.spawn(move || one(sender));
        }
        drop(sender);
        results.iter().inspect(|_| done()).collect()
    });
    all.sort_by_key(|(index, _)| *index);
    let count = all.len();
    let all = all.into_iter().map(|(_, result)| result).collect::<Result<Vec<T>>>()?;
    match count == items.len() {
        true => Ok(all),
        false => Err(Error::value("results", items.len(), count)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn results_keep_the_order_of_the_items_and_the_first_error_is_returned() {
        let items: Vec<u64> = (0..40).collect();
        let mut count = 0;
        let squares = on_all_cores(&items, || (), |(), item| Ok(item * item), || count += 1).unwrap();
        assert_eq!((squares, count), (items.iter().map(|item| item * item).collect(), 40));
        let fails =
            |(): &mut (), item: &u64| if *item < 3 { Ok(*item) } else { Err(Error::value("item", "< 3", item)) };
        let error = on_all_cores(&items, || (), fails, || ()).unwrap_err().to_string();
        assert!(error.contains('3'), "{error}");
    }
}
