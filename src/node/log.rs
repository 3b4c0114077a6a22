//! Log of a node: console and log file through ROS, and the topic `/rosout`, which r2r does not publish itself.

use std::collections::HashMap;
use std::sync::atomic::{AtomicU8, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use r2r::LogSeverity;

use super::clock::RosClock;
use super::lock::lock;
use super::publisher::Publisher;
use crate::message;

/// Shortest time between two throttled warnings of one kind.
const THROTTLE_INTERVAL: Duration = Duration::from_secs(5);

/// Log of a node; clones write to the same log.
#[derive(Clone)]
pub(crate) struct Log(Arc<Inner>);

struct Inner {
    name: String,
    /// Level below which nothing is written.
    level: AtomicU8,
    clock: RosClock,
    rosout: Mutex<Publisher<message::Log>>,
    throttled: Mutex<HashMap<String, Throttled>>,
}

/// State of one kind of throttled warning.
struct Throttled {
    last_written: Instant,
    /// Number of warnings left out since then.
    suppressed: u64,
}

impl Log {
    /// Creates the log of the logger `name`, which writes nothing below `level`.
    pub(crate) fn new(name: String, level: u8, clock: RosClock, rosout: Publisher<message::Log>) -> Self {
        let (throttled, level) = (Mutex::default(), AtomicU8::new(level));
        Self(Arc::new(Inner { name, level, clock, rosout: Mutex::new(rosout), throttled }))
    }

    /// Name of the logger.
    pub(crate) fn name(&self) -> &str {
        &self.0.name
    }

    /// Returns the level below which nothing is written.
    pub(crate) fn level(&self) -> u8 {
        self.0.level.load(Ordering::Relaxed)
    }

    /// Sets the level below which nothing is written.
    pub(crate) fn set_level(&self, level: u8) {
        self.0.level.store(level, Ordering::Relaxed);
    }

    /// Logs a rare event that is worth knowing.
    pub(crate) fn info(&self, line: impl AsRef<str>) {
        self.write(LogSeverity::Info, line.as_ref());
    }

    /// Logs a fault that the node recovered from.
    pub(crate) fn warn(&self, line: impl AsRef<str>) {
        self.write(LogSeverity::Warn, line.as_ref());
    }

    /// Logs a loss of data or a failure.
    pub(crate) fn error(&self, line: impl AsRef<str>) {
        self.write(LogSeverity::Error, line.as_ref());
    }

    /// Logs a warning that may repeat per frame: at most one of each `kind` every five seconds, with the number of
    /// warnings of this kind left out in between.
    pub(crate) fn warn_throttled(&self, kind: &str, line: impl AsRef<str>) {
        let suppressed = {
            let mut kinds = lock(&self.0.throttled);
            let now = Instant::now();
            match kinds.get_mut(kind) {
                Some(state) if now.duration_since(state.last_written) < THROTTLE_INTERVAL => {
                    state.suppressed += 1;
                    return;
                }
                Some(state) => std::mem::replace(state, Throttled { last_written: now, suppressed: 0 }).suppressed,
                None => {
                    kinds.insert(kind.to_owned(), Throttled { last_written: now, suppressed: 0 });
                    0
                }
            }
        };
        match suppressed {
            0 => self.warn(line),
            n => self.warn(format!("{} ({n} similar warnings suppressed)", line.as_ref())),
        }
    }

    fn write(&self, severity: LogSeverity, line: &str) {
        let level = rosout_level(&severity);
        if level < self.level() {
            return;
        }
        // ROS takes C strings; a NUL byte in text from outside would truncate the line.
        let line = line.replace('\0', "\\0");
        r2r::log(&line, &self.0.name, file!(), line!(), severity);
        let log = message::Log {
            stamp: self.0.clock.now(),
            level,
            name: self.0.name.clone(),
            msg: line,
            file: String::new(),
            function: String::new(),
            line: 0,
        };
        // Ignore the error: the console already has the line, and there is no other channel to report it on.
        let _ = lock(&self.0.rosout).publish(&log);
    }
}

/// Returns the level code of `rcl_interfaces/msg/Log`.
fn rosout_level(severity: &LogSeverity) -> u8 {
    match severity {
        LogSeverity::Unset => 0,
        LogSeverity::Debug => 10,
        LogSeverity::Info => 20,
        LogSeverity::Warn => 30,
        LogSeverity::Error => 40,
        LogSeverity::Fatal => 50,
    }
}
