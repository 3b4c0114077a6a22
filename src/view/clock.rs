//! Time of what is written of a recording.

/// Time from the last image of an episode to the first one of the next, s, where stamps begin anew.
const PAUSE_SECS: f64 = 1.0;

/// A time that never goes back: stamps of a recording may begin anew in each episode.
#[derive(Debug, Default)]
pub(super) struct Clock {
    /// Time that is added to stamps, s.
    shift: f64,
    /// Time of the last image, s.
    last: Option<f64>,
}

impl Clock {
    /// Returns the time of an image with this stamp, ns.
    pub(super) fn nanos(&mut self, stamp_secs: f64) -> i64 {
        let stamp = if stamp_secs.is_finite() { stamp_secs } else { 0.0 };
        match self.last {
            None => self.shift = (-stamp).max(0.0),
            Some(last) if stamp + self.shift <= last => self.shift = last + PAUSE_SECS - stamp,
            Some(_) => {}
        }
        self.last = Some(stamp + self.shift);
        ((stamp + self.shift) * 1e9).round() as i64
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn time_goes_on_where_stamps_begin_anew() {
        let mut clock = Clock::default();
        let stamps = [0.0, 0.5, 0.0, 0.5, 7.0, 1.0].map(|stamp| clock.nanos(stamp));
        assert_eq!(stamps.map(|nanos| nanos / 100_000_000), [0, 5, 15, 20, 85, 95]);
        let mut clock = Clock::default();
        assert_eq!([-3.0, -2.5].map(|stamp| clock.nanos(stamp)), [0, 500_000_000]);
    }
}
