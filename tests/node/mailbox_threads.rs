//! The mailbox of a node with the system's threads; `mailbox_interleavings` has every order of their steps.

#[path = "../../src/node/lock.rs"]
mod lock;
#[path = "../../src/node/mailbox.rs"]
mod mailbox;

use std::time::Duration;

use mailbox::Mailbox;

#[test]
fn take_returns_the_newest_value_and_displaced_ones_are_counted() {
    let mailbox = Mailbox::new(1);
    (0..5).for_each(|value| mailbox.put(0, value));
    assert_eq!(mailbox.take(Duration::ZERO), [(0, 4)]);
    assert_eq!(mailbox.take(Duration::ZERO), []);
    assert_eq!(mailbox.superseded(0), 4);
}

#[test]
fn sources_displace_their_own_values_only_and_are_taken_together() {
    let mailbox = Mailbox::new(3);
    for (source, value) in [(2, 20), (0, 1), (2, 21), (2, 22)] {
        mailbox.put(source, value);
    }
    assert_eq!(mailbox.take(Duration::ZERO), [(0, 1), (2, 22)]);
    assert_eq!([0, 1, 2].map(|source| mailbox.superseded(source)), [0, 0, 2]);
    mailbox.put(1, 10);
    assert_eq!(mailbox.take(Duration::ZERO), [(1, 10)]);
}

#[test]
fn put_wakes_the_waiting_thread() {
    let mailbox = Mailbox::new(2);
    let taken = std::thread::scope(|scope| {
        let waiting = scope.spawn(|| mailbox.take(Duration::from_secs(60)));
        mailbox.put(1, "here");
        waiting.join()
    });
    assert_eq!(taken.unwrap(), [(1, "here")]);
}
