//! Threads that share the steps of one frame.
//!
//! A frame is about sixty steps of a fraction of a millisecond each. The threads of a pool go to sleep between steps and
//! wake up too late. The helpers of a team spin while the frame is under way. The leader also takes tasks, and completes
//! every step even if no helper ever arrives.

mod step;
mod sync;

use std::cell::Cell;
use std::panic::resume_unwind;

use step::Team;

thread_local! {
    /// The team that this thread leads; null for none.
    static LEADS: Cell<*const Team> = const { Cell::new(std::ptr::null()) };
}

/// Runs `lead` in rayon's pool; the pool's other threads help with each [`run`] that it calls.
pub fn lead<R: Send>(lead: impl FnOnce() -> R + Send) -> R {
    let team = Team::new();
    rayon::scope(|scope| {
        let team = &team;
        for _ in 1..rayon::current_num_threads() {
            scope.spawn(move |_| team.help());
        }
        // A guard, so that the helpers also stop if `lead` panics.
        let _end = End(team, LEADS.replace(team));
        lead()
    })
}

/// Releases the helpers of a team and restores the thread's previous team.
struct End<'a>(&'a Team, *const Team);

impl Drop for End<'_> {
    fn drop(&mut self) {
        LEADS.set(self.1);
        self.0.end();
    }
}

/// Number of threads that share the steps of [`run`] on this thread.
pub fn threads() -> usize {
    if LEADS.get().is_null() { 1 } else { rayon::current_num_threads() }
}

/// Runs `task(0)` to `task(count - 1)`, each once and in any order, on the team that this thread leads; on this thread
/// alone if it leads none.
pub fn run(count: usize, task: impl Fn(usize) + Sync) {
    let team = LEADS.get();
    if team.is_null() || count <= 1 || count as u64 > step::MASK {
        return (0..count).for_each(task);
    }
    // A nested step runs on the thread that meets it: the team is busy with the outer one.
    let before = LEADS.replace(std::ptr::null());
    // SAFETY: not null, so set by `lead` further up this thread's stack. Its guard `End` resets the pointer before the
    // team is dropped.
    let result = unsafe { &*team }.run(count, &task);
    LEADS.set(before);
    if let Err(panic) = result {
        resume_unwind(panic);
    }
}

/// Splits `out` into pieces of `size` values, the last one perhaps shorter, and runs `task` on each as [`run`] does.
pub fn chunks<T: Send>(out: &mut [T], size: usize, task: impl Fn(usize, &mut [T]) + Sync) {
    let (length, out) = (out.len(), Pointer(out.as_mut_ptr()));
    run(length.div_ceil(size.max(1)), |i| {
        let first = i * size;
        // SAFETY: `run` calls each i < the number of pieces exactly once, so the piece starts inside the slice and is
        // disjoint from all others; `out` stays exclusively borrowed until `run` returns.
        let piece = unsafe { std::slice::from_raw_parts_mut(out.at(first), size.min(length - first)) };
        task(i, piece);
    });
}

/// As [`chunks`], on two slices with the same number of pieces.
///
/// # Panics
/// If the numbers of pieces differ.
pub fn chunks2<T: Send, U: Send>(
    (a, a_size): (&mut [T], usize),
    (b, b_size): (&mut [U], usize),
    task: impl Fn(usize, &mut [T], &mut [U]) + Sync,
) {
    assert_eq!(a.len().div_ceil(a_size), b.len().div_ceil(b_size), "two slices of different numbers of pieces");
    let (length, b) = (b.len(), Pointer(b.as_mut_ptr()));
    chunks(a, a_size, |i, a| {
        let first = i * b_size;
        // SAFETY: as in `chunks`; the assertion makes i a piece of `b` too.
        let piece = unsafe { std::slice::from_raw_parts_mut(b.at(first), b_size.min(length - first)) };
        task(i, a, piece);
    });
}

/// Start of a slice whose tasks write disjoint pieces.
struct Pointer<T>(*mut T);

impl<T> Pointer<T> {
    fn at(&self, index: usize) -> *mut T {
        self.0.wrapping_add(index)
    }
}

// SAFETY: the pointer itself is never changed. `chunks` and `chunks2`, its only users, form disjoint slices from it, one
// per task, so threads never share a value; T: Send lets a value be written by another thread.
unsafe impl<T: Send> Sync for Pointer<T> {}

#[cfg(test)]
mod tests {
    use std::panic::catch_unwind;
    use std::sync::atomic::{AtomicUsize, Ordering};

    use super::*;

    /// Number of steps; fewer in miri, which is slow.
    const STEPS: usize = if cfg!(miri) { 20 } else { 2000 };

    #[test]
    fn every_task_of_every_step_runs_once_with_any_number_of_threads() {
        let (all_threads, n): (&[_], _) = if cfg!(miri) { (&[1, 3], 50) } else { (&[1, 2, 3, 8], 1000) };
        for &threads in all_threads {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| {
                let mut values = vec![0usize; n];
                lead(|| {
                    for step in 0..STEPS {
                        let size = 1 + step % 97;
                        chunks(&mut values, size, |i, piece| {
                            piece.iter_mut().enumerate().for_each(|(j, value)| *value += i * size + j);
                        });
                    }
                });
                assert!(values.iter().enumerate().all(|(i, value)| *value == STEPS * i), "{threads} threads");
            });
        }
    }

    #[test]
    fn several_teams_and_nested_steps_do_not_block_each_other() {
        let total = AtomicUsize::new(0);
        std::thread::scope(|scope| {
            for _ in 0..4 {
                scope.spawn(|| {
                    lead(|| {
                        for _ in 0..STEPS / 20 {
                            run(10, |_| {
                                run(3, |_| {
                                    total.fetch_add(1, Ordering::Relaxed);
                                })
                            });
                        }
                    });
                });
            }
        });
        assert_eq!(total.into_inner(), 4 * (STEPS / 20) * 30);
    }

    #[test]
    fn a_panic_reaches_the_leader() {
        let n = if cfg!(miri) { 16 } else { 64 };
        for bad in [0, 7, n - 1] {
            let result = catch_unwind(|| lead(|| run(n, |i| assert_ne!(i, bad, "task"))));
            assert!(result.is_err());
        }
    }
}
