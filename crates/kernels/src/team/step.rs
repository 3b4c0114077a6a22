//! The protocol by which the threads of a team share the tasks of a step.

use std::any::Any;
use std::panic::{AssertUnwindSafe, catch_unwind};

use super::sync::{AtomicBool, AtomicU64, AtomicUsize, Ordering, UnsafeCell, wait};

/// Bits of each of the two low fields of [`Team::work`]: number of tasks, and next task. The step takes the rest.
const BITS: u32 = 16;
/// Mask of one field, also the largest number of tasks of a step.
pub const MASK: u64 = (1 << BITS) - 1;

type Task = *const (dyn Fn(usize) + Sync);

/// The state that the threads of one frame share.
pub struct Team {
    /// Step, number of tasks and next task, in one word: taking a task is one atomic exchange, and fails if the step is
    /// over.
    work: AtomicU64,
    /// The function of the current step; written before `work` announces the step.
    task: UnsafeCell<Option<Task>>,
    /// Finished tasks of the current step.
    done: AtomicUsize,
    /// True once the frame is finished.
    over: AtomicBool,
}

// SAFETY: `task` is the only field that is not atomic. The leader alone writes it, at the start of a step, when every
// task of the step before is done and `work` offers none; a thread reads it only after it took a task of the current
// step from `work`, whose release and acquire order the write before the read.
unsafe impl Sync for Team {}

impl Team {
    /// Creates the state of a frame without steps.
    pub fn new() -> Self {
        Self {
            work: AtomicU64::new(0),
            task: UnsafeCell::new(None),
            done: AtomicUsize::new(0),
            over: AtomicBool::new(false),
        }
    }

    /// Runs `task(0)` to `task(count - 1)`, each once, together with the threads that [`help`](Self::help); only the leader
    /// calls it. `count`: 1 to [`MASK`].
    ///
    /// # Errors
    /// If a task that this thread took panics: with the panic's value. Tasks that no thread took yet are then left out.
    pub fn run(&self, count: usize, task: &(dyn Fn(usize) + Sync)) -> Result<(), Box<dyn Any + Send>> {
        // SAFETY: only the lifetime changes. This function returns only when `done` has reached `count`: all taken tasks
        // have returned and `work` offers no more, so the reference is not used after the borrow ends.
        let task: Task =
            unsafe { std::mem::transmute::<&(dyn Fn(usize) + Sync), &'static (dyn Fn(usize) + Sync)>(task) };
        self.task.with_mut(|cell| {
            // SAFETY: the previous step is over (`done` reached its count), so no thread reads the cell; see `Sync`.
            unsafe { *cell = Some(task) }
        });
        self.done.store(0, Ordering::Relaxed);
        let step = (self.work.load(Ordering::Relaxed) >> (2 * BITS)) + 1;
        self.work.store(step << (2 * BITS) | (count as u64) << BITS, Ordering::Release);
        let result = catch_unwind(AssertUnwindSafe(|| while self.take() {}));
        if result.is_err() {
            // The remaining tasks are withdrawn, and count as done for the wait below.
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

    /// Takes a task of the current step and runs it. Returns false if there is none.
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
                    let task = self.task.with(|cell| {
                        // SAFETY: this thread took a task of the current step, so the leader waits for it in `run` and does
                        // not write the cell; see `Sync`.
                        unsafe { *cell }
                    });
                    if let Some(task) = task {
                        // SAFETY: as above; the leader keeps the function alive until this task is done.
                        unsafe { (*task)(next as usize) };
                    }
                    return true;
                }
            }
        }
    }

    /// Takes tasks until the frame is finished.
    pub fn help(&self) {
        let mut spins = 0;
        while !self.over.load(Ordering::Acquire) {
            match self.take() {
                true => spins = 0,
                false => wait(&mut spins),
            }
        }
    }

    /// Finishes the frame: helpers return.
    pub fn end(&self) {
        self.over.store(true, Ordering::Release);
    }
}

/// Counts a task as done when dropped, also if the task panics.
struct Done<'a>(&'a AtomicUsize);

impl Drop for Done<'_> {
    fn drop(&mut self) {
        self.0.fetch_add(1, Ordering::Release);
    }
}
