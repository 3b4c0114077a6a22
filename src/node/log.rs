//! A node's log: the console and log file through ROS, and `/rosout`, which r2r leaves to its user.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use r2r::LogSeverity;

use super::runtime::{Publisher, RosClock};
use crate::message;

/// Between two lines of one kind that repeats per frame.
const THROTTLE: Duration = Duration::from_secs(5);

/// A node's log; clones write to the same one.
#[derive(Debug, Clone)]
pub struct Log(Arc<Inner>);

#[derive(Debug)]
struct Inner {
    name: String,
    clock: RosClock,
    rosout: Mutex<Publisher<message::Log>>,
    throttled: Mutex<HashMap<String, Throttled>>,
}

#[derive(Debug)]
struct Throttled {
    said: Instant,
    unsaid: u64,
}

impl Log {
    pub(super) fn new(name: String, clock: RosClock, rosout: Publisher<message::Log>) -> Self {
        let throttled = Mutex::default();
        Self(Arc::new(Inner { name, clock, rosout: Mutex::new(rosout), throttled }))
    }

    /// For those who look for a fault; not on `/rosout`.
    pub fn debug(&self, line: impl AsRef<str>) {
        self.say(LogSeverity::Debug, None, line.as_ref());
    }

    /// What happens rarely and is good to know.
    pub fn info(&self, line: impl AsRef<str>) {
        self.say(LogSeverity::Info, Some(20), line.as_ref());
    }

    /// What went wrong and was dealt with.
    pub fn warn(&self, line: impl AsRef<str>) {
        self.say(LogSeverity::Warn, Some(30), line.as_ref());
    }

    /// What is lost.
    pub fn error(&self, line: impl AsRef<str>) {
        self.say(LogSeverity::Error, Some(40), line.as_ref());
    }

    /// A warning of a kind that may come with every frame: said at once, then at most every five seconds with the
    /// number of those left out.
    pub fn warn_throttled(&self, kind: &str, line: impl AsRef<str>) {
        let left_out = {
            let mut kinds = self.0.throttled.lock().unwrap_or_else(PoisonError::into_inner);
            let now = Instant::now();
            match kinds.get_mut(kind) {
                Some(last) if now.duration_since(last.said) < THROTTLE => {
                    last.unsaid += 1;
                    return;
                }
                Some(last) => std::mem::replace(last, Throttled { said: now, unsaid: 0 }).unsaid,
                None => {
                    kinds.insert(kind.to_owned(), Throttled { said: now, unsaid: 0 });
                    0
                }
            }
        };
        match left_out {
            0 => self.warn(line),
            n => self.warn(format!("{} ({n} more like it before)", line.as_ref())),
        }
    }

    fn say(&self, severity: LogSeverity, rosout_level: Option<u8>, line: &str) {
        // ROS takes C strings; text from outside may hold what they can't.
        let line = line.replace('\0', "\\0");
        r2r::log(&line, &self.0.name, file!(), line!(), severity);
        let Some(level) = rosout_level else { return };
        let log = message::Log {
            stamp: self.0.clock.now(),
            level,
            name: self.0.name.clone(),
            msg: line,
            file: String::new(),
            function: String::new(),
            line: 0,
        };
        // The console already has the line, and there is nowhere else to complain.
        let _ = self.0.rosout.lock().unwrap_or_else(PoisonError::into_inner).publish(&log);
    }
}
