//! What a node counts, and its report on `/diagnostics` once a second.

use std::collections::{BTreeMap, VecDeque};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use super::{Runtime, qos};
use crate::message::{DiagnosticArray, DiagnosticStatus, Header, KeyValue};
use crate::statistics::percentile;

/// Latencies that percentiles look back on.
const WINDOW: usize = 500;

/// State of a task as monitors colour it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
pub enum Level {
    /// As it should be.
    Ok = 0,
    /// Worse than it should be.
    Warn = 1,
    /// Does not work.
    Error = 2,
    /// Nothing has come for a while.
    Stale = 3,
}

/// One task's report.
#[derive(Debug)]
pub struct Report {
    /// Name of the task.
    pub task: &'static str,
    /// Its state.
    pub level: Level,
    /// Its state in words.
    pub message: String,
    /// Numbers behind it.
    pub values: Vec<(String, String)>,
}

/// Publishes what `report` says as `<node>: <task>`, once a second, about what `hardware_id` names then.
///
/// # Errors
/// If ROS refuses the topic.
pub fn publish(
    runtime: &mut Runtime,
    hardware_id: impl Fn() -> String + 'static,
    mut report: impl FnMut(&mut Runtime) -> Report + 'static,
) -> anyhow::Result<()> {
    let publisher = runtime.publisher("/diagnostics", qos::output())?;
    let node = runtime.name()?;
    runtime.every(Duration::from_secs(1), move |runtime| {
        let Report { task, level, message, values } = report(runtime);
        let status = DiagnosticStatus {
            level: level as u8,
            name: format!("{node}: {task}"),
            message,
            hardware_id: hardware_id(),
            values: values.into_iter().map(|(key, value)| KeyValue { key, value }).collect(),
        };
        let header = Header { stamp: runtime.clock().now(), frame_id: String::new() };
        if let Err(error) = publisher.publish(&DiagnosticArray { header, status: vec![status] }) {
            runtime.log().warn_throttled("diagnostics", format!("/diagnostics: {error:#}"));
        }
    });
    Ok(())
}

/// Counts of a stream of messages: what came, what was done, what was dropped why, and how long it took.
#[derive(Debug, Clone)]
pub struct Tally(Arc<Mutex<Counts>>);

/// See [`Tally`].
#[derive(Debug)]
pub struct Counts {
    /// Messages that came.
    pub received: u64,
    /// Messages that led to a result.
    pub processed: u64,
    /// Messages dropped, by cause.
    pub drops: BTreeMap<&'static str, u64>,
    /// The newest latencies, s.
    latencies: VecDeque<f64>,
    since: Instant,
    received_before: u64,
    processed_before: u64,
}

impl Default for Tally {
    fn default() -> Self {
        Self(Arc::new(Mutex::new(Counts {
            received: 0,
            processed: 0,
            drops: BTreeMap::new(),
            latencies: VecDeque::new(),
            since: Instant::now(),
            received_before: 0,
            processed_before: 0,
        })))
    }
}

impl Tally {
    /// A message came.
    pub fn received(&self) {
        self.counts().received += 1;
    }

    /// A message led to a result, `latency` seconds after it was made if that is known.
    pub fn processed(&self, latency: Option<f64>) {
        let mut counts = self.counts();
        counts.processed += 1;
        if let Some(latency) = latency {
            if counts.latencies.len() == WINDOW {
                counts.latencies.pop_front();
            }
            counts.latencies.push_back(latency);
        }
    }

    /// A message was dropped.
    pub fn dropped(&self, cause: &'static str) {
        *self.counts().drops.entry(cause).or_default() += 1;
    }

    /// Sets how many messages were dropped for a cause that somebody else counts.
    pub fn set_dropped(&self, cause: &'static str, count: u64) {
        self.counts().drops.insert(cause, count);
    }

    /// The counts, locked.
    pub fn counts(&self) -> MutexGuard<'_, Counts> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Counts {
    /// Messages that came and that led to a result per second, since the last call or the start.
    pub fn rates(&mut self) -> (f64, f64) {
        let secs = self.since.elapsed().as_secs_f64().max(1e-9);
        let received = (self.received - self.received_before) as f64 / secs;
        let processed = (self.processed - self.processed_before) as f64 / secs;
        (self.since, self.received_before, self.processed_before) = (Instant::now(), self.received, self.processed);
        (received, processed)
    }

    /// All dropped messages.
    pub fn dropped(&self) -> u64 {
        self.drops.values().sum()
    }

    /// Percentile `q` (0 to 1) of the newest latencies, s; NaN without any.
    pub fn latency(&self, q: f64) -> f64 {
        percentile(self.latencies.iter().copied(), q)
    }

    /// The counts as names and values of a report, with the rates given.
    pub fn values(&self, (received, processed): (f64, f64)) -> Vec<(String, String)> {
        let mut values = vec![
            ("input_rate_hz".to_owned(), format!("{received:.2}")),
            ("output_rate_hz".to_owned(), format!("{processed:.2}")),
            ("received".to_owned(), self.received.to_string()),
            ("processed".to_owned(), self.processed.to_string()),
        ];
        for (name, q) in [("p50", 0.5), ("p95", 0.95), ("max", 1.0)] {
            values.push((format!("latency_{name}_ms"), format!("{:.1}", self.latency(q) * 1e3)));
        }
        values.extend(self.drops.iter().map(|(cause, count)| (format!("dropped_{cause}"), count.to_string())));
        values
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_tally_counts_by_cause() {
        let tally = Tally::default();
        (0..3).for_each(|_| tally.received());
        tally.processed(Some(0.010));
        tally.dropped("malformed");
        tally.set_dropped("superseded", 1);
        let counts = tally.counts();
        assert_eq!((counts.received, counts.processed, counts.dropped()), (3, 1, 2));
        assert!(counts.values((1.0, 1.0)).contains(&("dropped_malformed".into(), "1".into())));
        assert_eq!(counts.latency(0.95), 0.010);
    }
}
