//! The mailbox of a node in every interleaving of its threads, by loom.

#[path = "../../src/node/mailbox.rs"]
mod mailbox;

/// Loom's locks in place of those of `src/node/lock.rs`. A wait of loom never times out, so that a lost notice is a deadlock,
/// which loom reports.
mod lock {
    use std::sync::PoisonError;
    use std::sync::atomic::{AtomicU64, Ordering};
    use std::time::Duration;

    use loom::sync::MutexGuard;
    pub(crate) use loom::sync::{Condvar, Mutex};

    pub(crate) fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
        mutex.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// A clock that ticks a nanosecond when it is looked at.
    #[derive(Debug, Clone, Copy)]
    pub(crate) struct Instant(u64);

    impl Instant {
        pub(crate) fn now() -> Self {
            static TICKS: AtomicU64 = AtomicU64::new(0);
            Self(TICKS.fetch_add(1, Ordering::Relaxed))
        }

        pub(crate) fn checked_duration_since(&self, earlier: Self) -> Option<Duration> {
            self.0.checked_sub(earlier.0).map(Duration::from_nanos)
        }
    }

    impl std::ops::Add<Duration> for Instant {
        type Output = Self;

        fn add(self, time: Duration) -> Self {
            Self(self.0 + time.as_nanos() as u64)
        }
    }
}

use std::time::Duration;

use loom::sync::Arc;
use mailbox::Mailbox;

/// Longer than any number of ticks.
const LONG: Duration = Duration::from_secs(60);

/// Puts 1 to `last` on `producers` threads each, in turn for `sources` sources, and takes values as soon as they come. `check` gets
/// them and the number of displaced values of each source once all threads have ended.
fn interleave(
    (producers, sources): (usize, usize),
    last: u32,
    check: impl Fn(Vec<(usize, u32)>, Vec<u64>) + Sync + Send + 'static,
) {
    loom::model(move || {
        let mailbox = Arc::new(Mailbox::new(sources));
        let put = |producer: usize, mailbox: Arc<Mailbox<u32>>| {
            move || (1..=last).for_each(|value| mailbox.put(producer % sources, value))
        };
        let threads: Vec<_> = (0..producers).map(|p| loom::thread::spawn(put(p, Arc::clone(&mailbox)))).collect();
        // The first value is waited for; a wait for the others might be for ever, if they were displaced.
        let mut taken = mailbox.take(LONG);
        assert!(!taken.is_empty(), "a value comes");
        taken.extend(mailbox.take(Duration::ZERO));
        threads.into_iter().for_each(|thread| thread.join().expect("a producer returns"));
        taken.extend(mailbox.take(Duration::ZERO));
        assert_eq!(mailbox.take(Duration::ZERO), []);
        check(taken, (0..sources).map(|source| mailbox.superseded(source)).collect());
    });
}

#[test]
fn in_every_interleaving_the_last_value_is_taken_and_each_other_one_taken_or_counted() {
    interleave((1, 1), 3, |taken, superseded| {
        assert!(taken.is_sorted_by(|a, b| a < b), "{taken:?}");
        assert_eq!(taken.last(), Some(&(0, 3)));
        assert_eq!(taken.len() as u64 + superseded[0], 3, "{taken:?}");
    });
}

#[test]
fn in_every_interleaving_of_two_producers_each_value_is_taken_or_counted() {
    interleave((2, 1), 1, |taken, superseded| {
        assert_eq!(taken.len() as u64 + superseded[0], 2, "{taken:?}");
    });
}

#[test]
fn in_every_interleaving_of_two_sources_the_last_value_of_each_is_taken() {
    interleave((2, 2), 2, |taken, superseded| {
        for (source, displaced) in superseded.into_iter().enumerate() {
            let of_source: Vec<u32> = taken.iter().filter(|(of, _)| *of == source).map(|(_, value)| *value).collect();
            assert_eq!(of_source.last(), Some(&2), "{taken:?}");
            assert_eq!(of_source.len() as u64 + displaced, 2, "{taken:?}");
        }
    });
}
