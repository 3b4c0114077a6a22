//! Pace of the simulated frames.

use std::time::{Duration, Instant};

use crate::message::Time;
use crate::node::clock::RosClock;
use crate::node::params::Parameters;
use crate::node::shutdown::Shutdown;

/// Tolerance for comparing times, s: far below a frame interval, far above the rounding error of a sum of intervals.
pub(super) const TIME_TOLERANCE_SECS: f64 = 1e-6;
/// Delay after which a frame counts as late; below it, the delay is the scheduler's.
const LATE_AFTER: Duration = Duration::from_millis(5);
/// Longest sleep between two looks at the shutdown flag.
const MAX_SLEEP: Duration = Duration::from_millis(50);
/// Time between two looks at `/clock`; far below a frame interval.
const CLOCK_POLL_INTERVAL: Duration = Duration::from_millis(2);
/// Stamp of the first frame in simulated time, s; not zero, because a stamp of zero means "not set".
const FIRST_STAMP_SECS: f64 = 1.0;

/// Time at which each frame is published, and the stamp that it carries.
pub(super) enum Pace {
    /// At the scene's rate by the wall clock.
    Wall { schedule: WallSchedule, stamps: Stamps },
    /// At the scene's rate by `/clock`, which another node publishes.
    ExternalClock(ClockFollower),
    /// Without waiting, in simulated time.
    Fast,
}

/// Stamps of frames that the wall clock paces.
pub(super) enum Stamps {
    /// Time of the node at publication.
    Node(RosClock),
    /// Simulated time.
    Simulated,
}

impl Pace {
    /// Reads the parameters `pace` and `use_sim_time`.
    pub(super) fn new(parameters: &Parameters, clock: RosClock) -> Self {
        let schedule = WallSchedule::default();
        match parameters.get::<String>("pace").as_str() {
            "fast" => Self::Fast,
            "clock" => Self::Wall { schedule, stamps: Stamps::Simulated },
            _ if parameters.get("use_sim_time") => {
                Self::ExternalClock(ClockFollower { clock, start: None, newest: 0.0 })
            }
            _ => Self::Wall { schedule, stamps: Stamps::Node(clock) },
        }
    }

    /// Waits until the frame `simulated` seconds after the first one is due; returns its stamp.
    pub(super) fn wait(&mut self, simulated: f64, shutdown: &Shutdown) -> Time {
        match self {
            Self::ExternalClock(follower) => follower.wait(simulated, shutdown),
            Self::Fast => simulated_stamp(simulated),
            Self::Wall { schedule, stamps } => {
                schedule.wait(simulated, shutdown);
                match stamps {
                    Stamps::Node(clock) => clock.now(),
                    Stamps::Simulated => simulated_stamp(simulated),
                }
            }
        }
    }

    /// Continues after a pause of the player.
    pub(super) fn resume(&mut self, pause: Duration) {
        match self {
            Self::Wall { schedule, .. } => schedule.start = schedule.start.map(|start| start + pause),
            Self::ExternalClock(follower) => follower.start = None,
            Self::Fast => {}
        }
    }

    /// Returns the number of frames that came too late for their time on the wall clock.
    pub(super) fn late_frames(&self) -> u64 {
        match self {
            Self::Wall { schedule, .. } => schedule.late_frames,
            Self::ExternalClock(_) | Self::Fast => 0,
        }
    }
}

fn simulated_stamp(simulated: f64) -> Time {
    Time::from_nanos(((simulated + FIRST_STAMP_SECS) * 1e9).round() as i64)
}

/// Schedule of frames on the wall clock.
#[derive(Default)]
pub(super) struct WallSchedule {
    /// Wall time of the first frame; later if frames were late.
    start: Option<Instant>,
    late_frames: u64,
}

impl WallSchedule {
    fn wait(&mut self, simulated: f64, shutdown: &Shutdown) {
        let offset = Duration::from_secs_f64(simulated);
        let now = Instant::now();
        let start = *self.start.get_or_insert_with(|| now.checked_sub(offset).unwrap_or(now));
        let due = start + offset;
        if now > due + LATE_AFTER {
            // The machine is too slow for real time: shift the schedule instead of publishing faster than real time.
            self.late_frames += 1;
            self.start = now.checked_sub(offset);
        }
        while let Some(left) = due.checked_duration_since(Instant::now()) {
            if shutdown.requested() {
                break;
            }
            std::thread::sleep(left.min(MAX_SLEEP));
        }
    }
}

/// Follows a `/clock` that another node publishes.
pub(super) struct ClockFollower {
    clock: RosClock,
    /// Clock time of the first frame, s.
    start: Option<f64>,
    /// Newest clock time, s; an earlier one means that the clock jumped back.
    newest: f64,
}

impl ClockFollower {
    /// Waits until `/clock` reaches the time of the frame; returns the clock's time. A clock that stands still holds the
    /// frames back; after a clock jumped back, the present frame is due at once.
    fn wait(&mut self, simulated: f64, shutdown: &Shutdown) -> Time {
        loop {
            let now = self.clock.now();
            let secs = now.secs();
            if secs < self.newest {
                self.start = None;
            }
            self.newest = secs;
            // The time is zero before the first message on /clock.
            if !now.is_zero() {
                let start = *self.start.get_or_insert(secs - simulated);
                if secs >= start + simulated - TIME_TOLERANCE_SECS {
                    return now;
                }
            }
            if shutdown.requested() {
                return now;
            }
            std::thread::sleep(CLOCK_POLL_INTERVAL);
        }
    }
}
