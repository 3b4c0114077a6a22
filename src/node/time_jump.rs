//! Detection of a restarted time source, such as a bag that is played again.

use crate::message::Time;

/// Largest step back of a stamp that counts as reordering, nanoseconds. Topics reorder messages by far less than one
/// second; a larger step back means that time restarted.
const MAX_REORDERING_NANOS: i64 = 1_000_000_000;

/// Returns true if `stamp` lies so far before the `newest` stamp of its topic that time must have restarted.
pub(crate) fn jumps_back(newest: Option<Time>, stamp: Time) -> bool {
    newest.is_some_and(|newest| newest.nanos() - stamp.nanos() > MAX_REORDERING_NANOS)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reordered_stamps_within_one_second_are_no_jump() {
        let at = |sec| Time { sec, nanosec: 0 };
        assert!(!jumps_back(None, at(1)));
        assert!(!jumps_back(Some(at(10)), at(9)));
        assert!(jumps_back(Some(at(10)), at(8)));
        assert!(!jumps_back(Some(at(10)), at(100)));
    }
}
