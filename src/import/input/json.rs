//! Values of JSON annotations, named by their path in the file.

use std::path::{Path, PathBuf};

use glam::{DAffine3, DQuat, DVec3};
use serde_json::Value;

use crate::error::{Error, Result};

/// Largest deviation of a quaternion's length from 1.
const MAX_STRETCH: f64 = 1e-2;

/// A JSON value in a file.
#[derive(Debug, Clone)]
pub struct Json {
    file: PathBuf,
    place: String,
    value: Value,
}

impl Json {
    /// Parses the content of `file`.
    ///
    /// # Errors
    /// If it is not JSON.
    pub fn parse(file: &Path, content: &[u8]) -> Result<Self> {
        let value = serde_json::from_slice(content).map_err(|error| Error::file(file, format!("not JSON: {error}")))?;
        Ok(Self { file: file.to_path_buf(), place: String::new(), value })
    }

    /// Returns the value itself.
    pub fn value(&self) -> &Value {
        &self.value
    }

    /// Returns the value of a key; an absent one is null.
    pub fn get(&self, key: &str) -> Self {
        let place = if self.place.is_empty() { key.to_string() } else { format!("{}.{key}", self.place) };
        Self { file: self.file.clone(), place, value: self.value[key].clone() }
    }

    /// True if the value is absent or null.
    pub fn is_null(&self) -> bool {
        self.value.is_null()
    }

    /// Returns keys and values of an object.
    pub fn entries(&self) -> Vec<(String, Self)> {
        let keys = self.value.as_object().into_iter().flat_map(|object| object.keys());
        keys.map(|key| (key.clone(), self.get(key))).collect()
    }

    /// Returns the items of a list.
    pub fn items(&self) -> Vec<Self> {
        let item = |(index, value): (usize, &Value)| Self {
            file: self.file.clone(),
            place: format!("{}[{index}]", self.place),
            value: value.clone(),
        };
        self.value.as_array().into_iter().flatten().enumerate().map(item).collect()
    }

    /// Returns a finite number.
    ///
    /// # Errors
    /// If the value is none.
    pub fn number(&self) -> Result<f64> {
        self.value.as_f64().filter(|number| number.is_finite()).ok_or_else(|| self.expected("a number"))
    }

    /// Returns a whole number.
    ///
    /// # Errors
    /// If the value is none.
    pub fn whole(&self) -> Result<i64> {
        self.value.as_i64().ok_or_else(|| self.expected("a whole number"))
    }

    /// Returns a list of numbers.
    ///
    /// # Errors
    /// If the value is not a list, or an item is not a finite number.
    pub fn numbers(&self) -> Result<Vec<f64>> {
        if !self.value.is_array() {
            return Err(self.expected("a list of numbers"));
        }
        self.items().iter().map(Self::number).collect()
    }

    /// Returns a list of exactly `N` numbers.
    ///
    /// # Errors
    /// If the value is none.
    pub fn exactly<const N: usize>(&self) -> Result<[f64; N]> {
        let numbers = self.numbers()?;
        numbers.try_into().map_err(|_| self.expected(&format!("{N} numbers")))
    }

    /// Returns a motion with `quaternion_wxyz` and `translation_xyz`, m.
    ///
    /// # Errors
    /// If one of them is absent or no rotation.
    pub fn motion(&self) -> Result<DAffine3> {
        let rotation = self.get("quaternion_wxyz");
        let [w, x, y, z] = rotation.exactly()?;
        let quaternion = DQuat::from_xyzw(x, y, z, w);
        if (quaternion.length() - 1.0).abs() > MAX_STRETCH {
            return Err(rotation.expected("a quaternion of length 1"));
        }
        let translation = DVec3::from_array(self.get("translation_xyz").exactly()?);
        Ok(DAffine3::from_rotation_translation(quaternion.normalize(), translation))
    }

    /// Creates the error of a value that is not `expected`.
    pub fn expected(&self, expected: &str) -> Error {
        const SHOWN: usize = 60;
        let mut got = if self.value.is_null() { "nothing".into() } else { self.value.to_string() };
        if let Some((end, _)) = got.char_indices().nth(SHOWN) {
            got.truncate(end);
            got += "...";
        }
        let place = if self.place.is_empty() { "content" } else { &self.place };
        Error::file(&self.file, format!("{place}: expected {expected}, got {got}"))
    }
}
