//! Tactile sensors whose readings are stored as they are, because no file says what they mean in newtons.

use serde_json::{Value, json};

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

    /// Returns a reading of which nothing is known.
    pub fn unknown(&self) -> Vec<f32> {
        vec![f32::NAN; self.values()]
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
            "shape": self.shape,
            "unused_cells": self.unused,
        })
    }
}
