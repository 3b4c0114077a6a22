//! The mailbox of a node with the system's threads; `mailbox_interleavings` has every order of their steps.

#[path = "../../src/node/lock.rs"]
mod lock;
#[path = "../../src/node/mailbox.rs"]
mod mailbox;

use std::time::Duration;

use mailbox::Mailbox;

#[test]
fn take_returns_the_newest_value_and_displaced_ones_are_counted() {
    let mailbox = Mailbox::default();
    (0..5).for_each(|value| mailbox.put(value));
    assert_eq!(mailbox.take(Duration::ZERO), Some(4));
    assert_eq!(mailbox.take(Duration::ZERO), None);
    assert_eq!(mailbox.superseded(), 4);
}

#[test]
fn put_wakes_the_waiting_thread() {
    let mailbox = Mailbox::default();
    let taken = std::thread::scope(|scope| {
        let waiting = scope.spawn(|| mailbox.take(Duration::from_secs(60)));
        mailbox.put("here");
        waiting.join()
    });
    assert_eq!(taken.unwrap(), Some("here"));
}
