//! Metadata of a checkpoint.

use std::collections::BTreeMap;
use std::path::Path;

use serde::Serialize;
use serde::de::DeserializeOwned;

use super::Config;
use super::unknown::DoubtThresholds;
use crate::error::{Error, Result};
use crate::hand::Topology;
use crate::image::{Filter, Framing, IMAGENET_MEAN, IMAGENET_STD, Preparation, Resize};
use crate::tactile::ForceKind;

/// Key of the threshold of familiarity; absent = the default.
const FAMILIARITY: &str = "familiarity_threshold";
/// Key of the threshold of presence; absent = the default.
const PRESENCE: &str = "presence_threshold";
/// Key of the temperature of the contact logits; absent = 1.
const TEMPERATURE: &str = "contact_temperature";

/// Metadata of a checkpoint; one key of the file's metadata per field.
#[derive(Debug, Clone, PartialEq)]
pub struct Metadata {
    /// Name of the model, for people and messages.
    pub name: String,
    /// Numbering of the vertices.
    pub topology: Topology,
    /// Newtons per unit of the force head's output: 99th percentile of the active training force.
    pub force_scale: f32,
    /// Meaning of the forces, that of the training data.
    pub force_kind: ForceKind,
    /// True if the force head was trained; otherwise forces are unknown (NaN).
    pub has_force: bool,
    /// Seconds between observation steps.
    pub frame_dt: f64,
    /// Part of the world that the pictures show.
    pub framing: Framing,
    /// Conversion of images to the square input.
    pub resize: Resize,
    /// Resampling filter.
    pub filter: Filter,
    /// Mean per RGB channel, for values in 0..1.
    pub mean: [f32; 3],
    /// Standard deviation per RGB channel, for values in 0..1.
    pub std: [f32; 3],
    /// Thresholds below which touch is unknown.
    pub doubt: DoubtThresholds,
    /// Temperature T that contact logits are divided by, so that probabilities agree with frequencies; 1 = not calibrated.
    pub contact_temperature: f32,
    /// Data, command, seed and metrics of the training: free text, JSON if egotac trained the network.
    pub training: String,
}

impl Metadata {
    /// Creates the metadata of a network for the built-in hand with ImageNet statistics; `force_scale` in N, `frame_dt` in s.
    pub fn new(name: impl Into<String>, force_scale: f32, frame_dt: f64) -> Self {
        Self {
            name: name.into(),
            topology: Topology::default(),
            force_scale,
            force_kind: ForceKind::default(),
            has_force: true,
            frame_dt,
            framing: Framing::default(),
            resize: Resize::default(),
            filter: Filter::default(),
            mean: IMAGENET_MEAN,
            std: IMAGENET_STD,
            doubt: DoubtThresholds::default(),
            contact_temperature: 1.0,
            training: String::new(),
        }
    }

    /// Returns the preparation of images for a network of this geometry.
    pub fn preparation(&self, config: &Config) -> Preparation {
        Preparation { side: config.image, resize: self.resize, filter: self.filter, mean: self.mean, std: self.std }
    }

    /// Checks ranges.
    ///
    /// # Errors
    /// Names the first field that is out of range.
    pub fn check(&self) -> Result<()> {
        let positive = |name: &str, value: f64| match value.is_finite() && value > 0.0 {
            true => Ok(()),
            false => Err(Error::value(name, "a finite number > 0", value)),
        };
        positive("force_scale", f64::from(self.force_scale))?;
        positive("frame_dt", self.frame_dt)?;
        positive(TEMPERATURE, f64::from(self.contact_temperature))?;
        self.doubt.check()?;
        self.std.iter().try_for_each(|std| positive("std", f64::from(*std)))?;
        match self.mean.iter().find(|mean| !mean.is_finite()) {
            Some(mean) => Err(Error::value("mean", "finite numbers", mean)),
            None => Ok(()),
        }
    }

    /// Returns the entries of the file's metadata: strings; numbers, flags and lists in JSON.
    pub fn to_map(&self) -> BTreeMap<String, String> {
        let enum_name = |name: String| name.trim_matches('"').to_string();
        let mut map = BTreeMap::from([
            ("name".into(), self.name.clone()),
            ("topology".into(), self.topology.id().into()),
            ("force_scale".into(), json(&self.force_scale)),
            ("has_force".into(), json(&self.has_force)),
            ("frame_dt".into(), json(&self.frame_dt)),
            ("resize".into(), enum_name(json(&self.resize))),
            ("filter".into(), enum_name(json(&self.filter))),
            ("mean".into(), json(&self.mean)),
            ("std".into(), json(&self.std)),
            ("training".into(), self.training.clone()),
        ]);
        let (own, default) = (self.doubt, DoubtThresholds::default());
        let optional = [
            (FAMILIARITY, own.familiarity, default.familiarity),
            (PRESENCE, own.presence, default.presence),
            (TEMPERATURE, self.contact_temperature, 1.0),
        ];
        // Files of before these keys keep their bytes.
        for (key, value, _) in optional.into_iter().filter(|(_, value, default)| value != default) {
            map.insert(key.into(), json(&value));
        }
        if !self.framing.is_whole() {
            map.insert(Framing::KEY.into(), self.framing.name().into());
        }
        if self.force_kind != ForceKind::default() {
            map.insert(ForceKind::ATTRIBUTE.into(), self.force_kind.id().into());
        }
        map
    }

    /// Reads the entries of a file's metadata.
    ///
    /// # Errors
    /// If a key is missing or its value out of range.
    pub(super) fn from_map(path: &Path, map: &BTreeMap<String, String>) -> Result<Self> {
        let text = |key: &str| {
            map.get(key).cloned().ok_or_else(|| Error::Missing {
                name: format!("metadata {key:?}"),
                place: path.display().to_string(),
                present: names(map.keys()),
            })
        };
        fn parse<T: DeserializeOwned>(path: &Path, key: &str, json: &str, expected: &str) -> Result<T> {
            serde_json::from_str(json)
                .map_err(|_| Error::file(path, format!("metadata {key:?}: expected {expected}, got {json:?}")))
        }
        let optional = |key: &str, default: f32, expected: &str| match map.get(key) {
            Some(json) => parse(path, key, json, expected),
            None => Ok(default),
        };
        let threshold = |key: &str, default: f32| optional(key, default, "a number from 0 to 1");
        let default = DoubtThresholds::default();
        let quoted = |key: &str| Ok::<_, Error>(json(&text(key)?));
        let metadata = Self {
            name: text("name")?,
            topology: Topology::from_id(&text("topology")?)?,
            force_scale: parse(path, "force_scale", &text("force_scale")?, "a number, newtons")?,
            // Checkpoints of earlier versions predict spread forces.
            force_kind: map.get(ForceKind::ATTRIBUTE).map_or(Ok(ForceKind::default()), |id| ForceKind::from_id(id))?,
            has_force: parse(path, "has_force", &text("has_force")?, "true or false")?,
            frame_dt: parse(path, "frame_dt", &text("frame_dt")?, "a number, seconds")?,
            framing: match map.get(Framing::KEY) {
                Some(name) => parse(path, Framing::KEY, &json(name), "frame or hands")?,
                None => Framing::default(),
            },
            resize: parse(path, "resize", &quoted("resize")?, "crop, centre, letterbox or squash")?,
            filter: parse(path, "filter", &quoted("filter")?, "triangle or bicubic")?,
            mean: parse(path, "mean", &text("mean")?, "three numbers in brackets")?,
            std: parse(path, "std", &text("std")?, "three numbers in brackets")?,
            doubt: DoubtThresholds {
                familiarity: threshold(FAMILIARITY, default.familiarity)?,
                presence: threshold(PRESENCE, default.presence)?,
            },
            contact_temperature: optional(TEMPERATURE, 1.0, "a finite number > 0")?,
            training: text("training")?,
        };
        metadata.check().map_err(|error| Error::file(path, error))?;
        Ok(metadata)
    }
}

/// Returns the JSON of a plain value, whose serialisation cannot fail.
pub(super) fn json<T: Serialize + ?Sized>(value: &T) -> String {
    serde_json::to_string(value).unwrap_or_default()
}

/// Joins names for a message.
pub(super) fn names<'a>(names: impl Iterator<Item = &'a String>) -> String {
    let names: Vec<&str> = names.map(String::as_str).collect();
    if names.is_empty() { "nothing".into() } else { names.join(", ") }
}
