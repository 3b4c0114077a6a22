//! Threads of a team in every order of their steps, and with every value that the memory model lets them read, by loom.
//!
//! The protocol is the code of `src/team/step.rs` itself, on loom's primitives in place of those of `src/team/sync.rs`.
#![allow(unsafe_code)] // that of the protocol, and cells that loom guards

#[path = "../src/team/step.rs"]
mod step;

/// Loom's primitives.
mod sync {
    pub use loom::cell::UnsafeCell;
    pub use loom::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering};

    /// Waits in vain of a thread after which loom tries no further orders of the execution: two helpers could let each other
    /// run for ever.
    const PATIENCE: usize = 6;

    /// Lets another thread run: loom has no time that passes.
    pub fn wait(waits: &mut usize) {
        *waits += 1;
        if *waits > PATIENCE {
            loom::skip_branch();
        }
        loom::thread::yield_now();
    }
}

use std::panic::resume_unwind;

use loom::model::Builder;
use loom::sync::Arc;
use loom::thread;
use step::Team;
use sync::UnsafeCell;

/// Plain numbers that tasks write without a lock. Loom fails the test if two accesses have no order, also the leader's
/// reading after a step and a task that runs too late.
struct Numbers(Vec<UnsafeCell<u32>>);

// SAFETY: loom refuses two accesses at the same time, of which one writes.
unsafe impl Sync for Numbers {}

impl Numbers {
    fn new(count: usize) -> Self {
        Self((0..count).map(|_| UnsafeCell::new(0)).collect())
    }

    fn add_one(&self, index: usize) {
        self.0[index].with_mut(|number| {
            // SAFETY: loom gives the address of a living number, and refuses other accesses meanwhile.
            unsafe { *number += 1 }
        });
    }

    /// Takes the numbers, as their one owner: a write, so that it needs an order with every access.
    fn take(&self) -> Vec<u32> {
        let take = |cell: &UnsafeCell<u32>| {
            cell.with_mut(|number| {
                // SAFETY: as in `add_one`.
                unsafe { std::mem::take(&mut *number) }
            })
        };
        self.0.iter().map(take).collect()
    }
}

/// Checks `lead` as the leader of `helpers` threads, with at most `preemptions` threads stopped amid their work.
fn check(helpers: usize, preemptions: usize, lead: impl Fn(&Team) + Sync + Send + 'static) {
    let mut model = Builder::new();
    model.preemption_bound = Some(preemptions);
    model.check(move || {
        let team = Arc::new(Team::new());
        let help = |team: Arc<Team>| thread::spawn(move || team.help());
        let threads: Vec<_> = (0..helpers).map(|_| help(Arc::clone(&team))).collect();
        lead(&team);
        team.end();
        threads.into_iter().for_each(|thread| thread.join().expect("a helper returns"));
    });
}

fn each_task_runs_once(team: &Team, tasks: usize) {
    let numbers = Numbers::new(tasks);
    assert!(team.run(tasks, &|i| numbers.add_one(i)).is_ok());
    assert_eq!(numbers.take(), vec![1; tasks]);
}

#[test]
fn each_task_of_two_steps_runs_once_and_the_leader_sees_its_result() {
    check(1, 3, |team| {
        each_task_runs_once(team, 2);
        each_task_runs_once(team, 2);
    });
}

#[test]
fn two_helpers_share_a_step_without_taking_a_task_twice() {
    check(2, 2, |team| each_task_runs_once(team, 2));
}

#[test]
fn after_a_panic_of_the_leader_no_task_runs_any_more() {
    check(1, 3, |team| {
        let leader = thread::current().id();
        let numbers = Numbers::new(3);
        let result = team.run(3, &|i| {
            numbers.add_one(i);
            if i == 0 && thread::current().id() == leader {
                // A panic without its message.
                resume_unwind(Box::new("a task of the leader"));
            }
        });
        let ran = numbers.take();
        assert!(ran.iter().all(|&times| times <= 1), "{ran:?}");
        assert!(result.is_err() || ran == [1, 1, 1], "{ran:?}");
        // The team is ready for the next step.
        each_task_runs_once(team, 2);
    });
}
