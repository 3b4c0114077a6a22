//! Threads that work together on one frame.
//!
//! A frame is some sixty short steps, each over in a fraction of a millisecond: threads that go to sleep between them, as
//! those of a pool do, come back too late. Here helpers wait awake while a frame is under way. They only help: whoever
//! leads gets everything done even if none of them comes.

use std::any::Any;
use std::cell::{Cell, UnsafeCell};
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering};

/// Looks for work before a waiting thread lets others run.
const SPINS: usize = 4_000;
/// Bits of the word that counts tasks: the number of a step, how many tasks it has, the next one.
const BITS: u32 = 16;
const MASK: u64 = (1 << BITS) - 1;

type Task = *const (dyn Fn(usize) + Sync);

/// One frame's threads.
struct Team {
    /// Number of the step, tasks, next task: one word, so that no task is taken from a step that is over.
    work: AtomicU64,
    /// What the step's tasks are; written before `work` says that there are any.
    task: UnsafeCell<Option<Task>>,
    done: AtomicUsize,
    over: AtomicBool,
}

#[allow(unsafe_code)]
// SAFETY: `task` is written by the leader alone, while `work` has no task left to take; it is read by who has taken one.
unsafe impl Sync for Team {}

thread_local! {
    /// The team that this thread leads.
    static LEADS: Cell<*const Team> = const { Cell::new(std::ptr::null()) };
}

/// Runs `lead` inside rayon's pool, the pool's other threads helping with each [`run`] that it calls.
pub fn lead<R: Send>(lead: impl FnOnce() -> R + Send) -> R {
    let team = Team {
        work: AtomicU64::new(0),
        task: UnsafeCell::new(None),
        done: AtomicUsize::new(0),
        over: AtomicBool::new(false),
    };
    rayon::scope(|scope| {
        let team = &team;
        for _ in 1..rayon::current_num_threads() {
            scope.spawn(move |_| team.help());
        }
        // Also if `lead` panics: helpers must not wait for ever.
        let _end = End(team, LEADS.replace(team));
        lead()
    })
}

/// Ends a team's work.
struct End<'a>(&'a Team, *const Team);

impl Drop for End<'_> {
    fn drop(&mut self) {
        LEADS.set(self.1);
        self.0.over.store(true, Ordering::Release);
    }
}

/// Runs `task(0)` to `task(count - 1)`, in any order, on the team that this thread leads; alone if it leads none.
pub fn run(count: usize, task: impl Fn(usize) + Sync) {
    let team = LEADS.get();
    if team.is_null() || count <= 1 || count as u64 > MASK {
        return (0..count).for_each(task);
    }
    // A step inside a step is done by whoever meets it.
    let before = LEADS.replace(std::ptr::null());
    // SAFETY: set by `lead`, whose team lives until it has been taken away again.
    #[allow(unsafe_code)]
    let result = unsafe { &*team }.run(count, &task);
    LEADS.set(before);
    if let Err(panic) = result {
        resume_unwind(panic);
    }
}

/// Runs `task` on each piece of `size` values of `out`, the last one perhaps shorter.
pub fn chunks<T: Send>(out: &mut [T], size: usize, task: impl Fn(usize, &mut [T]) + Sync) {
    let (length, out) = (out.len(), Pointer(out.as_mut_ptr()));
    run(length.div_ceil(size.max(1)), |i| {
        let first = i * size;
        // SAFETY: pieces of one slice that don't overlap, each taken once.
        #[allow(unsafe_code)]
        let piece = unsafe { std::slice::from_raw_parts_mut(out.at(first), size.min(length - first)) };
        task(i, piece);
    });
}

/// As [`chunks`] on two slices with as many pieces.
pub fn chunks2<T: Send, U: Send>(
    (a, a_size): (&mut [T], usize),
    (b, b_size): (&mut [U], usize),
    task: impl Fn(usize, &mut [T], &mut [U]) + Sync,
) {
    assert_eq!(a.len().div_ceil(a_size), b.len().div_ceil(b_size), "pieces of two slices");
    let (length, b) = (b.len(), Pointer(b.as_mut_ptr()));
    chunks(a, a_size, |i, a| {
        let first = i * b_size;
        // SAFETY: as above.
        #[allow(unsafe_code)]
        let piece = unsafe { std::slice::from_raw_parts_mut(b.at(first), b_size.min(length - first)) };
        task(i, a, piece);
    });
}

/// A slice's beginning, for tasks that have pieces of their own.
struct Pointer<T>(*mut T);

impl<T> Pointer<T> {
    fn at(&self, index: usize) -> *mut T {
        self.0.wrapping_add(index)
    }
}

#[allow(unsafe_code)]
// SAFETY: whoever goes through it says which places are its own.
unsafe impl<T: Send> Sync for Pointer<T> {}

impl Team {
    fn run(&self, count: usize, task: &(dyn Fn(usize) + Sync)) -> Result<(), Box<dyn Any + Send>> {
        // SAFETY: only the lifetime changes. Nobody calls it after this function: it returns when every task that was
        // taken is done, and none can be taken any more.
        #[allow(unsafe_code)]
        let task: Task =
            unsafe { std::mem::transmute::<&(dyn Fn(usize) + Sync), &'static (dyn Fn(usize) + Sync)>(task) };
        // SAFETY: the step before is over, so nobody reads.
        #[allow(unsafe_code)]
        unsafe {
            *self.task.get() = Some(task);
        }
        self.done.store(0, Ordering::Relaxed);
        let step = (self.work.load(Ordering::Relaxed) >> (2 * BITS)) + 1;
        self.work.store(step << (2 * BITS) | (count as u64) << BITS, Ordering::Release);
        let result = catch_unwind(AssertUnwindSafe(|| while self.take() {}));
        if result.is_err() {
            // What nobody has taken yet stays undone; it counts as done for the wait below.
            let word = self.work.fetch_or(MASK, Ordering::AcqRel);
            let taken = (word & MASK).min(count as u64) as usize;
            self.done.fetch_add(count - taken, Ordering::Release);
        }
        let mut spins = 0;
        while self.done.load(Ordering::Acquire) < count {
            wait(&mut spins);
        }
        result
    }

    /// Takes a task and does it; false if there is none.
    fn take(&self) -> bool {
        let mut word = self.work.load(Ordering::Acquire);
        loop {
            let (count, next) = (word >> BITS & MASK, word & MASK);
            if next >= count {
                return false;
            }
            match self.work.compare_exchange_weak(word, word + 1, Ordering::AcqRel, Ordering::Acquire) {
                Err(now) => word = now,
                Ok(_) => {
                    let _done = Done(&self.done);
                    // SAFETY: the task was taken from the current step, which is not over until it is done; what it
                    // points to lives as long.
                    #[allow(unsafe_code)]
                    if let Some(task) = unsafe { *self.task.get() } {
                        unsafe { (*task)(next as usize) };
                    }
                    return true;
                }
            }
        }
    }

    fn help(&self) {
        let mut spins = 0;
        while !self.over.load(Ordering::Acquire) {
            match self.take() {
                true => spins = 0,
                false => wait(&mut spins),
            }
        }
    }
}

/// Counts a task as done, also if it panics.
struct Done<'a>(&'a AtomicUsize);

impl Drop for Done<'_> {
    fn drop(&mut self) {
        self.0.fetch_add(1, Ordering::Release);
    }
}

fn wait(spins: &mut usize) {
    *spins += 1;
    match *spins < SPINS {
        true => std::hint::spin_loop(),
        false => std::thread::yield_now(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_task_of_every_step_runs_once_with_any_number_of_threads() {
        for threads in [1, 2, 3, 8] {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| {
                let mut values = vec![0usize; 1000];
                lead(|| {
                    for step in 0..2000 {
                        let size = 1 + step % 97;
                        chunks(&mut values, size, |i, piece| {
                            piece.iter_mut().enumerate().for_each(|(j, value)| *value += i * size + j);
                        });
                    }
                });
                assert!(values.iter().enumerate().all(|(i, value)| *value == 2000 * i), "{threads} threads");
            });
        }
    }

    #[test]
    fn several_teams_and_steps_inside_steps_don_t_wait_for_each_other() {
        let total = AtomicUsize::new(0);
        std::thread::scope(|scope| {
            for _ in 0..4 {
                scope.spawn(|| {
                    lead(|| {
                        for _ in 0..100 {
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
        assert_eq!(total.into_inner(), 4 * 100 * 30);
    }

    #[test]
    fn a_panic_reaches_the_leader() {
        for bad in [0, 7, 63] {
            let result = catch_unwind(|| lead(|| run(64, |i| assert_ne!(i, bad, "task"))));
            assert!(result.is_err());
        }
    }
}
