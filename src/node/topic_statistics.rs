//! Topic statistics, as rclcpp's: age and period of the messages of each input, once a second on `/statistics`.

use std::cell::RefCell;
use std::rc::Rc;
use std::time::{Duration, Instant};

use super::clock::RosClock;
use super::params::{Allowed, Parameter};
use super::qos;
use super::runtime::Runtime;
use crate::message::{Header, Message, MetricsMessage, Reader, StatisticDataPoint, Time};

/// Time between two messages about one quantity.
const PERIOD: Duration = Duration::from_secs(1);

/// Declares the parameter `enable_topic_statistics`.
pub(crate) fn parameter() -> Parameter {
    Parameter::fixed(
        "enable_topic_statistics",
        false,
        Allowed::Any,
        "Publish age and period of the messages of each input on /statistics, once a second.",
    )
}

/// Statistics of one input; clones share them.
#[derive(Clone)]
pub(crate) struct TopicStatistics(Rc<RefCell<Window>>);

/// Measurements since the last message on `/statistics`.
struct Window {
    clock: RosClock,
    /// True if the messages begin with a header, whose stamp gives their age.
    has_header: bool,
    started: Time,
    arrived: Option<Instant>,
    ages: Samples,
    periods: Samples,
}

/// Values of one quantity, ms.
#[derive(Default)]
struct Samples {
    count: u64,
    mean: f64,
    /// Sum of the squared differences from the mean.
    squares: f64,
    minimum: f64,
    maximum: f64,
}

impl TopicStatistics {
    /// Starts to publish the statistics of messages `M` on `topic`, which is a full name; None if the parameter asks for none.
    ///
    /// # Errors
    /// If ROS refuses the topic `/statistics`.
    pub(crate) fn start<M: Message>(runtime: &mut Runtime, topic: &str) -> anyhow::Result<Option<Self>> {
        if !runtime.parameters().get::<bool>("enable_topic_statistics") {
            return Ok(None);
        }
        let publisher = runtime.publisher("/statistics", qos::output())?;
        let source = format!("/{}:{topic}", runtime.full_name()?);
        let clock = runtime.clock().clone();
        let window = Window {
            has_header: has_header::<M>(),
            started: clock.now(),
            clock,
            arrived: None,
            ages: Samples::default(),
            periods: Samples::default(),
        };
        let statistics = Self(Rc::new(RefCell::new(window)));
        let shared = statistics.clone();
        runtime.every(PERIOD, move |runtime| {
            for message in shared.0.borrow_mut().messages(&source) {
                if let Err(error) = publisher.publish(&message) {
                    runtime.log().warn_throttled("statistics", format!("/statistics: {error:#}"));
                }
            }
        });
        Ok(Some(statistics))
    }

    /// Counts a message.
    pub(crate) fn received(&self, payload: &[u8]) {
        let mut window = self.0.borrow_mut();
        let now = Instant::now();
        if let Some(before) = window.arrived.replace(now) {
            window.periods.push(1e3 * now.duration_since(before).as_secs_f64());
        }
        let header = window.has_header.then(|| Reader::leading::<Header>("statistics", payload));
        if let Some(Ok(header)) = header
            && let Some(age) = window.clock.secs_since(header.stamp)
        {
            window.ages.push(1e3 * age);
        }
    }
}

impl Window {
    /// Returns the statistics of this window, and starts the next one.
    fn messages(&mut self, source: &str) -> [MetricsMessage; 2] {
        let now = self.clock.now();
        let started = std::mem::replace(&mut self.started, now);
        let of = |metric: &str, samples: &mut Samples| MetricsMessage {
            measurement_source_name: source.to_owned(),
            metrics_source: metric.to_owned(),
            unit: "ms".to_owned(),
            window_start: started,
            window_stop: now,
            statistics: std::mem::take(samples).points(),
        };
        [of("message_age", &mut self.ages), of("message_period", &mut self.periods)]
    }
}

impl Samples {
    /// Adds a value (Welford's algorithm).
    fn push(&mut self, value: f64) {
        if self.count == 0 {
            (self.minimum, self.maximum) = (value, value);
        }
        self.count += 1;
        let before = value - self.mean;
        self.mean += before / self.count as f64;
        self.squares += before * (value - self.mean);
        (self.minimum, self.maximum) = (self.minimum.min(value), self.maximum.max(value));
    }

    /// Returns average, minimum, maximum, standard deviation and number; NaN without values.
    fn points(self) -> Vec<StatisticDataPoint> {
        let count = self.count as f64;
        let known = |value: f64| if self.count == 0 { f64::NAN } else { value };
        let deviation = (self.squares / count).sqrt();
        let values = [known(self.mean), known(self.minimum), known(self.maximum), known(deviation), count];
        (1..).zip(values).map(|(data_type, data)| StatisticDataPoint { data_type, data }).collect()
    }
}

/// True if the first field of a message is a header.
fn has_header<M: Message>() -> bool {
    let definition = M::definition();
    let lines = definition.lines().map(|line| line.split('#').next().unwrap_or_default().trim());
    // Constants have a value.
    let first = lines.filter(|line| !line.is_empty() && !line.contains('=')).map(str::to_owned).next();
    first.is_some_and(|line| line.starts_with("std_msgs/Header ") || line.starts_with("std_msgs/msg/Header "))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::message::{Bool, HandPose, Image, TactileFrame, TactileTruth};

    #[test]
    fn statistics_are_those_of_the_values() {
        let mut samples = Samples::default();
        [3.0, 1.0, 4.0, 1.0, 5.0].into_iter().for_each(|value| samples.push(value));
        let points = samples.points();
        // numpy: mean 2.8, std 1.6.
        let expected = [(1, 2.8), (2, 1.0), (3, 5.0), (4, 1.6), (5, 5.0)];
        for (point, (data_type, data)) in points.iter().zip(expected) {
            assert_eq!(point.data_type, data_type);
            assert!((point.data - data).abs() < 1e-12, "{point:?}");
        }
        let none = Samples::default().points();
        assert!(none[..4].iter().all(|point| point.data.is_nan()) && none[4].data == 0.0);
    }

    #[test]
    fn messages_with_a_leading_header_are_told_apart() {
        assert!(
            [has_header::<Image>(), has_header::<TactileFrame>(), has_header::<TactileTruth>()].iter().all(|is| *is)
        );
        assert!(has_header::<HandPose>() && !has_header::<Bool>());
    }
}
