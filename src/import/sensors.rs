//! Tactile sensors whose readings are stored as they are, because no file says what they mean in newtons.

use serde_json::{Value, json};

use crate::error::Result;
use crate::hand::Side;

/// Beginning of the names of arrays with raw readings, before the side of the hand.
pub const TACTILE: &str = "data/tactile_";

/// A tactile sensor of a recording.
#[derive(Debug, Clone, PartialEq)]
pub struct Sensor {
    /// Hand that wears it.
    pub side: Side,
    /// Lengths of the axes of one reading, such as rows and columns.
    pub shape: Vec<usize>,
    /// Make of the sensor.
    pub model: &'static str,
    /// Unit of its readings.
    pub unit: &'static str,
    /// True if a harder touch gives a lower reading.
    pub falls: bool,
    /// Reading without touch, where the data set states one.
    pub rest: Option<f32>,
    /// Reading at the end of the sensor's range.
    pub full: f32,
    /// Indices of cells of the reading that no taxel belongs to; their values mean nothing.
    pub unused: Vec<usize>,
}

impl Sensor {
    /// Returns the name of the array with the readings, (T, shape) f32.
    pub fn array(&self) -> String {
        format!("{TACTILE}{}", self.side.name())
    }

    /// Returns the number of values of one reading.
    pub fn values(&self) -> usize {
        self.shape.iter().product()
    }

    /// Returns a reading that is unknown.
    pub fn unknown(&self) -> Vec<f32> {
        vec![f32::NAN; self.values()]
    }

    /// Returns the share of the sensor's range of each value of a reading, 0 to 1; cells without a taxel are NaN.
    pub fn relative(&self, reading: &[f32]) -> Vec<f32> {
        let rest = self.rest.unwrap_or(0.0);
        let mut relative: Vec<f32> =
            reading.iter().map(|value| ((value - rest) / (self.full - rest)).clamp(0.0, 1.0)).collect();
        for cell in &self.unused {
            relative[*cell] = f32::NAN;
        }
        relative
    }

    /// Describes the sensor for the store's attributes.
    pub fn description(&self) -> Value {
        json!({
            "array": self.array(),
            "hand": self.side.name(),
            "model": self.model,
            "kind": "raw reading",
            "unit": self.unit,
            "calibration": null,
            "falls_with_pressure": self.falls,
            "reading_without_touch": self.rest,
            "reading_at_the_end_of_the_range": self.full,
            "shape": self.shape,
            "unused_cells": self.unused,
        })
    }
}

/// Gives the readings of an instant to `map`, such as a taxel map: it takes those of the left and the right hand, row-major,
/// `None` = unknown, and returns values at the (1556) vertices.
///
/// # Errors
/// As `map`.
pub fn at_vertices(
    sensors: &[Sensor],
    readings: &[Option<Vec<f32>>],
    map: impl FnOnce([Option<&[f32]>; 2]) -> Result<Vec<f32>>,
) -> Result<Vec<f32>> {
    let mut hands = [None, None];
    for (sensor, reading) in sensors.iter().zip(readings) {
        hands[sensor.side as usize] = reading.as_deref();
    }
    map(hands)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn readings_come_to_a_map_by_hand() {
        let sensor = |side: Side| Sensor {
            side,
            shape: vec![2, 3],
            model: "glove",
            unit: "counts",
            falls: false,
            rest: None,
            full: 4.0,
            unused: vec![5],
        };
        let sensors = [sensor(Side::Right), sensor(Side::Left)];
        let readings = [Some(vec![1.0; 6]), None];
        let sum = at_vertices(&sensors, &readings, |[left, right]| {
            assert!(left.is_none());
            Ok(vec![right.unwrap().iter().sum()])
        });
        assert_eq!(sum.unwrap(), [6.0]);
        let relative = sensors[0].relative(&[-1.0, 0.0, 1.0, 4.0, 9.0, 2.0]);
        assert_eq!(relative[..5], [0.0, 0.0, 0.25, 1.0, 1.0]);
        assert!(relative[5].is_nan());
        let falling = Sensor { falls: true, rest: Some(3072.0), full: 0.0, ..sensor(Side::Left) };
        assert_eq!(falling.relative(&[3072.0, 3100.0, 1536.0, 0.0, 1.0, 1.0])[..4], [0.0, 0.0, 0.5, 1.0]);
        assert_eq!((sensors[0].array(), sensors[1].unknown().len()), ("data/tactile_right".into(), 6));
    }
}
