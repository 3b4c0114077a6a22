//! Message counts of a node, and its report on `/diagnostics`.

use std::collections::{BTreeMap, VecDeque};
use std::sync::{Arc, Mutex, MutexGuard};
use std::time::{Duration, Instant};

use super::lock::lock;
use super::qos;
use super::runtime::Runtime;
use crate::message::{DiagnosticArray, DiagnosticStatus, Header, KeyValue};
use crate::statistics::percentile;

/// Number of newest latencies that percentiles are computed over.
const LATENCY_WINDOW: usize = 500;
/// Time between two reports.
const REPORT_PERIOD: Duration = Duration::from_secs(1);

/// Level of `diagnostic_msgs/DiagnosticStatus`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
pub(crate) enum Level {
    /// Works.
    Ok = 0,
    /// Works, but with losses.
    Warn = 1,
    /// Does not work.
    Error = 2,
    /// No input since the last report.
    Stale = 3,
}

/// State of one task of a node.
#[derive(Debug)]
pub(crate) struct TaskReport {
    /// Name of the task.
    pub(crate) task: String,
    /// State of the task.
    pub(crate) level: Level,
    /// State in words.
    pub(crate) message: String,
    /// Names and values of the counts.
    pub(crate) values: Vec<(String, String)>,
}

/// Publishes the results of `report` once a second as `<full name of the node>: <task>`, with `hardware_id` in the field of this
/// name. An input that a publisher can't reach makes them errors.
///
/// # Errors
/// If ROS refuses the topic.
pub(crate) fn publish(
    runtime: &mut Runtime,
    hardware_id: impl Fn() -> String + 'static,
    mut report: impl FnMut(&mut Runtime) -> Vec<TaskReport> + 'static,
) -> anyhow::Result<()> {
    let publisher = runtime.publisher("/diagnostics", qos::output())?;
    let node = runtime.full_name()?;
    runtime.every(REPORT_PERIOD, move |runtime| {
        let status = report(runtime).into_iter().map(|TaskReport { task, level, message, values }| {
            let (level, message) = match runtime.input_fault() {
                Some(fault) => (Level::Error, fault),
                None => (level, message),
            };
            DiagnosticStatus {
                level: level as u8,
                name: format!("{node}: {task}"),
                message,
                hardware_id: hardware_id(),
                values: values.into_iter().map(|(key, value)| KeyValue { key, value }).collect(),
            }
        });
        let status = status.collect();
        let header = Header { stamp: runtime.clock().now(), frame_id: String::new() };
        if let Err(error) = publisher.publish(&DiagnosticArray { header, status }) {
            runtime.log().warn_throttled("diagnostics", format!("/diagnostics: {error:#}"));
        }
    });
    Ok(())
}

/// Counts of a stream of messages: received, processed and dropped by cause, with latencies. Clones share the counts.
#[derive(Debug, Clone)]
pub(crate) struct Tally(Arc<Mutex<TallyCounts>>);

/// Counts of a [`Tally`].
#[derive(Debug)]
pub(crate) struct TallyCounts {
    /// Messages received.
    pub(crate) received: u64,
    /// Messages that led to a result.
    pub(crate) processed: u64,
    /// Messages dropped, by cause.
    pub(crate) drops: BTreeMap<&'static str, u64>,
    /// Newest latencies, s.
    latencies: VecDeque<f64>,
    since: Instant,
    received_before: u64,
    processed_before: u64,
}

impl Default for Tally {
    fn default() -> Self {
        Self(Arc::new(Mutex::new(TallyCounts {
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
    /// Counts a received message.
    pub(crate) fn received(&self) {
        self.counts().received += 1;
    }

    /// Counts a message that led to a result; `latency` is the time from its stamp to the result, s, None if unknown.
    pub(crate) fn processed(&self, latency: Option<f64>) {
        let mut counts = self.counts();
        counts.processed += 1;
        if let Some(latency) = latency {
            if counts.latencies.len() == LATENCY_WINDOW {
                counts.latencies.pop_front();
            }
            counts.latencies.push_back(latency);
        }
    }

    /// Counts a message that was dropped for `cause`.
    pub(crate) fn dropped(&self, cause: &'static str) {
        *self.counts().drops.entry(cause).or_default() += 1;
    }

    /// Sets the number of messages dropped for `cause`, which another object counts.
    pub(crate) fn set_dropped(&self, cause: &'static str, count: u64) {
        self.counts().drops.insert(cause, count);
    }

    /// Locks the counts.
    pub(crate) fn counts(&self) -> MutexGuard<'_, TallyCounts> {
        lock(&self.0)
    }
}

/// Rates of messages, Hz.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Rates {
    pub(crate) received: f64,
    pub(crate) processed: f64,
}

impl TallyCounts {
    /// Returns the rates since the last call, or since the start.
    pub(crate) fn rates(&mut self) -> Rates {
        let secs = self.since.elapsed().as_secs_f64().max(1e-9);
        let received = (self.received - self.received_before) as f64 / secs;
        let processed = (self.processed - self.processed_before) as f64 / secs;
        (self.since, self.received_before, self.processed_before) = (Instant::now(), self.received, self.processed);
        Rates { received, processed }
    }

    /// Returns percentile `q` (0 to 1) of the newest latencies, s; NaN if there are none.
    pub(crate) fn latency(&self, q: f64) -> f64 {
        percentile(self.latencies.iter().copied(), q)
    }

    /// Returns the counts and the given rates as names and values of a report.
    pub(crate) fn values(&self, Rates { received, processed }: Rates) -> Vec<(String, String)> {
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
    fn dropped_messages_are_counted_by_cause() {
        let tally = Tally::default();
        (0..3).for_each(|_| tally.received());
        tally.processed(Some(0.010));
        tally.dropped("malformed");
        tally.set_dropped("superseded", 1);
        let counts = tally.counts();
        assert_eq!((counts.received, counts.processed, counts.drops["superseded"]), (3, 1, 1));
        assert!(
            counts.values(Rates { received: 1.0, processed: 1.0 }).contains(&("dropped_malformed".into(), "1".into()))
        );
        assert_eq!(counts.latency(0.95), 0.010);
    }
}
