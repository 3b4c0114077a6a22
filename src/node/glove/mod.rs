//! The node `glove`: readings of tactile gloves become true touch with the stamps of a camera's images.

mod calibration;
mod sync;

use std::cell::RefCell;
use std::process::ExitCode;
use std::rc::Rc;
use std::sync::Arc;
use std::time::Duration;

use anyhow::Context as _;

use super::clock::RosClock;
use super::diagnostics::{self, Level, Tally, TaskReport};
use super::enabled::serve_set_enabled;
use super::images::ImageTransport;
use super::input_topics::{InputTopic, Need, reliability_parameter};
use super::log::Log;
use super::params::{Allowed, Parameter, Parameters};
use super::publisher::Publisher;
use super::runtime::Runtime;
use super::shutdown::Shutdown;
use super::{program, qos};
use crate::error::{Error, Result};
use crate::hand::{N_FIELD, N_VERTICES, Side};
use crate::message::{Float32MultiArray, GloveReading, TactileFrame, TactileTruth};
use crate::sensor::{self, TaxelMap};
use crate::tactile::{CONTACT_FORCE_N, TactileField, Validity};
use calibration::{Calibration, Taxels};
use sync::{GloveSync, Limits, Paired};

/// Time between two looks for images whose readings are complete.
const LOOK_PERIOD: Duration = Duration::from_millis(5);

/// Runs the program `egotac_glove`.
pub fn main() -> ExitCode {
    program::run("glove", "Publishes the touch that tactile gloves measure, for a camera's images.", parameters(), run)
}

/// Parameters of the node.
fn parameters() -> Vec<Parameter> {
    vec![
        Parameter::fixed(
            "sensor",
            "aether_132",
            Allowed::Any,
            "Taxel map of the gloves: a name of egotac sensor list, or a YAML file of egotac sensor new.",
        ),
        Parameter::new("rest", 0.0, Allowed::Doubles(-1e9, 1e9), "Reading without touch, of left and right."),
        Parameter::new(
            "newtons_per_unit",
            0.0,
            Allowed::Doubles(-1e9, 1e9),
            "Newtons per unit of a reading above rest, of left and right; negative for readings that fall with pressure. 0 = no \
             calibration: contact is estimated from the range, and force stays unknown.",
        ),
        Parameter::new(
            "full",
            1.0,
            Allowed::Doubles(-1e9, 1e9),
            "Reading at the end of the range, of left and right without a calibration.",
        ),
        Parameter::new(
            "contact_share",
            0.1,
            Allowed::Doubles(0.0, 1.0),
            "Share of the range above which a glove without a calibration is in contact.",
        ),
        Parameter::new(
            "delay_ms",
            0.0,
            Allowed::Doubles(0.0, 10_000.0),
            "Age of a reading without a stamp when it arrives, milliseconds.",
        ),
        Parameter::fixed(
            "max_gap_ms",
            100.0,
            Allowed::Doubles(1.0, 10_000.0),
            "Longest time between two readings that are interpolated, milliseconds; images between readings farther apart have no \
             truth.",
        ),
        Parameter::fixed(
            "max_wait_ms",
            500.0,
            Allowed::Doubles(1.0, 10_000.0),
            "Longest time that an image waits for a reading after it, milliseconds.",
        ),
        ImageTransport::parameter(),
        reliability_parameter("match"),
        Parameter::new("enabled", true, Allowed::Any, "Publish touch; ~/set_enabled sets it, too."),
    ]
}

/// Runs the node until `shutdown`.
///
/// # Errors
/// If the taxel map can't be read, or ROS refuses a topic.
fn run(mut runtime: Runtime, shutdown: &Shutdown) -> anyhow::Result<()> {
    let parameters = Arc::clone(runtime.parameters());
    let map = sensor::open(&parameters.get::<String>("sensor")).context("parameter sensor")?;
    let secs = |name: &str| parameters.get::<f64>(name) * 1e-3;
    let glove = Rc::new(RefCell::new(Gloves {
        sync: GloveSync::new(Limits { max_gap: secs("max_gap_ms"), max_wait: secs("max_wait_ms") }),
        map,
        parameters: Arc::clone(&parameters),
        clock: runtime.clock().clone(),
        log: runtime.log().clone(),
        tally: Tally::default(),
        sequence: 0,
    }));
    subscribe(&mut runtime, &glove)?;
    let publisher = runtime.publisher("~/truth", qos::output())?;
    serve_set_enabled(&mut runtime)?;
    let gloves = Rc::clone(&glove);
    runtime.every(LOOK_PERIOD, move |_| gloves.borrow_mut().publish(&publisher));
    diagnostics::publish(&mut runtime, String::new, move |_| vec![glove.borrow().task_report()])?;
    runtime.spin(shutdown);
    Ok(())
}

fn subscribe(runtime: &mut Runtime, glove: &Rc<RefCell<Gloves>>) -> anyhow::Result<()> {
    for side in Side::BOTH {
        let gloves = Rc::clone(glove);
        let input = InputTopic::new(runtime, side.name(), "readings", qos::every_input(), Need::OneOf("readings"));
        runtime.input::<Float32MultiArray>(input, move |reading| {
            let mut gloves = gloves.borrow_mut();
            let taken = reading.and_then(|reading| gloves.take_array(side, &reading));
            gloves.check(side.name(), taken);
        })?;
    }
    let gloves = Rc::clone(glove);
    let input = InputTopic::new(runtime, "reading", "readings", qos::every_input(), Need::OneOf("readings"));
    runtime.input::<GloveReading>(input, move |reading| {
        let mut gloves = gloves.borrow_mut();
        let taken = reading.and_then(|reading| gloves.take_reading(reading));
        gloves.check("reading", taken);
    })?;
    let transport = ImageTransport::of(runtime.parameters());
    let gloves = Rc::clone(glove);
    let input = InputTopic::new(runtime, "image", "images", qos::every_input(), Need::Required);
    transport.subscribe(runtime, input, move |payload| {
        let mut gloves = gloves.borrow_mut();
        gloves.tally.received();
        let now = gloves.now();
        let taken = transport.header(&payload).map(|header| gloves.sync.push_image(header, now));
        gloves.check("image", taken);
    })
}

/// State of the node.
struct Gloves {
    sync: GloveSync,
    map: TaxelMap,
    parameters: Arc<Parameters>,
    clock: RosClock,
    log: Log,
    tally: Tally,
    sequence: u64,
}

impl Gloves {
    fn now(&self) -> f64 {
        self.clock.now().secs()
    }

    /// Logs what was wrong with a message.
    fn check(&self, topic: &'static str, taken: Result<()>) {
        if let Err(error) = taken {
            self.log.warn_throttled(topic, format!("{topic}: message dropped: {error}"));
        }
    }

    /// Takes a reading without stamp and calibration, which the parameters give.
    fn take_array(&mut self, side: Side, reading: &Float32MultiArray) -> Result<()> {
        let number = |name: &str| self.parameters.get::<f64>(name) as f32;
        let gain = number("newtons_per_unit");
        let calibration = Calibration {
            rest: vec![number("rest")],
            newtons_per_unit: if gain == 0.0 { Vec::new() } else { vec![gain] },
            full: vec![number("full")],
        };
        let values = reading.data.get(reading.layout.data_offset as usize..).unwrap_or_default();
        let stamp = self.now() - self.parameters.get::<f64>("delay_ms") * 1e-3;
        self.push(side, stamp, values, &calibration)
    }

    fn take_reading(&mut self, reading: GloveReading) -> Result<()> {
        let GloveReading { header, side, values, rest, newtons_per_unit, full } = reading;
        let side = Side::BOTH
            .into_iter()
            .find(|known| *known as u8 == side)
            .ok_or_else(|| Error::value("side", "0 (left) or 1 (right)", side))?;
        let stamp = if header.stamp.is_zero() { self.now() } else { header.stamp.secs() };
        self.push(side, stamp, &values, &Calibration { rest, newtons_per_unit, full })
    }

    fn push(&mut self, side: Side, stamp: f64, values: &[f32], calibration: &Calibration) -> Result<()> {
        let channels = self.map.layout.channels;
        if values.len() != channels {
            let name = format!("values of the {} glove, taxel map {}", side.name(), self.map.layout.name);
            return Err(Error::shape(name, format!("[{channels}]"), [values.len()]));
        }
        if values.iter().any(|value| value.is_infinite()) {
            return Err(Error::value(
                format!("values of the {} glove", side.name()),
                "finite numbers or NaN",
                "infinity",
            ));
        }
        let (taxels, now) = (calibration.taxels(values)?, self.now());
        self.sync.push_reading(side, stamp, taxels, now);
        Ok(())
    }

    /// Publishes the truth of all images whose readings are complete.
    fn publish(&mut self, publisher: &Publisher<TactileTruth>) {
        let now = self.now();
        while let Some(paired) = self.sync.pop(now) {
            if paired.taxels.iter().all(Option::is_none) {
                self.tally.dropped("no_reading");
                continue;
            }
            if !self.parameters.get::<bool>("enabled") {
                self.tally.dropped("disabled");
                continue;
            }
            let stamp = paired.header.stamp;
            match self.truth(paired).map_err(anyhow::Error::from).and_then(|truth| publisher.publish(&truth)) {
                Ok(()) => {
                    self.sequence += 1;
                    self.tally.processed(self.clock.secs_since(stamp));
                }
                Err(error) => self.log.warn_throttled("truth", format!("~/truth: {error:#}")),
            }
        }
    }

    /// Returns the touch of an image. A hand without a reading is unknown.
    fn truth(&self, Paired { header, taxels }: Paired) -> Result<TactileTruth> {
        let mut field = TactileField {
            topology: self.map.topology,
            force: vec![f32::NAN; N_FIELD],
            contact: vec![f32::NAN; N_FIELD],
        };
        let share = self.parameters.get::<f64>("contact_share") as f32;
        for (side, taxels) in Side::BOTH.into_iter().zip(&taxels) {
            let hand = &self.map.hands[side as usize];
            let (values, least) = match taxels {
                Some(Taxels::Newtons(values)) => {
                    field.force[side.range()].copy_from_slice(&hand.spread(values));
                    (values, CONTACT_FORCE_N)
                }
                Some(Taxels::Shares(values)) => (values, share),
                None => continue,
            };
            let contact = hand.reading(values).into_iter();
            let contact = contact.map(|value| if value.is_nan() { value } else { f32::from(value > least) });
            field.contact[side.range()].copy_from_slice(&contact.collect::<Vec<_>>()[..N_VERTICES]);
        }
        let mut frame = TactileFrame::from_field(header, &field)?;
        frame.sequence = self.sequence;
        frame.model_id = format!("glove/{}", self.map.layout.name);
        let mut unknown = Vec::new();
        for (hand, (side, taxels)) in frame.hands.iter_mut().zip(Side::BOTH.into_iter().zip(&taxels)) {
            match taxels {
                Some(Taxels::Newtons(_)) => hand.score = 1.0,
                Some(Taxels::Shares(_)) => {
                    hand.score = 1.0;
                    unknown.push(format!("force of the {} hand: its glove has no calibration", side.name()));
                }
                None => unknown.push(format!("{} hand: no reading of a glove at this time", side.name())),
            }
        }
        frame.reason = unknown.join("; ");
        Ok(TactileTruth::new(frame, Validity::Valid))
    }

    fn task_report(&self) -> TaskReport {
        let mut counts = self.tally.counts();
        let rates = counts.rates();
        let (level, message) = match (rates.received > 0.0, rates.processed > 0.0) {
            (false, _) => (Level::Stale, "no images".to_owned()),
            (true, false) => (Level::Warn, "no reading of a glove at the images' stamps".to_owned()),
            (true, true) => (Level::Ok, format!("taxel map {}", self.map.layout.name)),
        };
        let mut values = counts.values(rates);
        values.push(("waiting_images_dropped".to_owned(), self.sync.dropped.to_string()));
        TaskReport { task: "truth".into(), level, message, values }
    }
}
