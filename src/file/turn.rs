//! Turns of processes that share files: points at which a test lets another process go on.
//!
//! In programs nothing happens there. A test that takes the threads of [`loom`] for processes makes each point an access to
//! one common value, so that loom tries every order of the file operations between them.

use std::time::Duration;

/// Ends the turn of this process: another one may now change the files.
#[inline]
pub(crate) fn turn() {
    #[cfg(test)]
    model::turn();
}

/// Waits for `time`; in a test with processes by turns, until another one has had its turn.
pub(crate) fn pause(time: Duration) {
    #[cfg(test)]
    if model::pause() {
        return;
    }
    std::thread::sleep(time);
}

/// Processes by turns, as threads of loom.
#[cfg(test)]
pub(crate) mod model {
    use std::cell::{Cell, RefCell};
    use std::panic::resume_unwind;

    use loom::sync::Arc;
    use loom::sync::atomic::{AtomicUsize, Ordering};
    use loom::thread;

    thread_local! {
        /// The files, as one value that every operation changes; None outside a test by turns. All of loom's threads are
        /// one thread of the system.
        static FILES: RefCell<Option<Arc<AtomicUsize>>> = const { RefCell::new(None) };
        /// Turns left to the process that is to be killed; it is the first that runs out of them.
        static VICTIM: Cell<Option<(thread::ThreadId, usize)>> = const { Cell::new(None) };
    }

    /// Content of the panic by which a process is killed. Unlike SIGKILL, it runs destructors on its way.
    pub struct Killed;

    /// Begins an execution of loom's model.
    pub fn begin() {
        FILES.set(Some(Arc::new(AtomicUsize::new(0))));
        VICTIM.set(None);
    }

    /// Ends the execution: files are used as they are.
    pub fn end() {
        FILES.set(None);
        VICTIM.set(None);
    }

    /// Kills the calling process after `turns` further turns.
    pub fn kill_after(turns: usize) {
        VICTIM.set(Some((thread::current().id(), turns)));
    }

    pub(super) fn turn() {
        let files = FILES.with_borrow(Clone::clone);
        let Some(files) = files else { return };
        files.fetch_add(1, Ordering::SeqCst);
        if let Some((victim, left)) = VICTIM.get()
            && victim == thread::current().id()
        {
            if left == 0 {
                VICTIM.set(None);
                resume_unwind(Box::new(Killed));
            }
            VICTIM.set(Some((victim, left - 1)));
        }
    }

    /// Lets another process have its turn. Returns false outside a test by turns.
    pub(super) fn pause() -> bool {
        let by_turns = FILES.with_borrow(Option::is_some);
        if by_turns {
            thread::yield_now();
        }
        by_turns
    }
}
