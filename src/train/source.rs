//! Sources of training data: groups of stores with common sampling and supervision.

use std::fmt;
use std::path::PathBuf;

use serde::de::{self, MapAccess, Visitor, value::MapAccessDeserializer};
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use crate::tactile::CONTACT_FORCE_N;

/// Stores of the same kind of images and labels; in YAML a path, or `{ stores: [..], quota: .., mirror: .., labels: .., weigh_by_std: .. }`.
#[derive(Debug, Clone, PartialEq)]
pub struct TrainingSource {
    /// Stores, or folders of `*.zarr`.
    pub stores: Vec<PathBuf>,
    /// Least share of each epoch, 0 to 1.
    pub quota: f64,
    /// True if the images may be mirrored, which swaps the two hands.
    pub mirror: bool,
    /// Labels that are supervised.
    pub labels: Supervision,
    /// True if forces weigh by their standard deviation, `data/mano_force_std`: see [`force_weight`].
    pub weigh_by_std: bool,
}

/// Standard deviation of a force that halves its weight, N: the force above which a vertex counts as touched.
const HALF_WEIGHT_STD: f32 = CONTACT_FORCE_N;

/// Returns the weight of a force label in the loss, 0 to 1, by its standard deviation, N: 1 / (1 + (std / 0.05 N)²), the weight
/// of inverse variance beside an error of the network of 0.05 N. A deviation that is unknown (NaN) gives 0.
pub fn force_weight(std: f32) -> f32 {
    let ratio = std / HALF_WEIGHT_STD;
    let weight = 1.0 / (1.0 + ratio * ratio);
    if weight.is_nan() { 0.0 } else { weight }
}

/// Labels of a source that are supervised. `Proximity` needs an array of its own; the others supervise what the store has.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Supervision {
    /// Force and contact.
    #[default]
    Both,
    /// Contact only, as if the store had no force.
    Contact,
    /// Force only, as if the store had no contact: for sensors that miss light touch, beside a source that knows contact better.
    Force,
    /// Force, and contact only where there is some: of sensors that miss light touch, contact is certain and its absence is not.
    Felt,
    /// Contact only, and by distance in place of force: a vertex within 1 cm of an object counts as touched
    /// (`data/mano_proximity`), as in recordings that know where hands and objects are, but no force.
    Proximity,
}

impl Supervision {
    /// Returns true if forces are supervised.
    pub fn has_force(self) -> bool {
        matches!(self, Self::Both | Self::Force | Self::Felt)
    }

    /// Returns true if both contact and its absence are supervised.
    pub fn has_contact(self) -> bool {
        matches!(self, Self::Both | Self::Contact | Self::Proximity)
    }
}

/// A source as a YAML map.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Written {
    stores: Vec<PathBuf>,
    #[serde(default)]
    quota: f64,
    #[serde(default)]
    mirror: bool,
    #[serde(default)]
    labels: Supervision,
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    weigh_by_std: bool,
}

impl TrainingSource {
    /// Creates a source of one path, with default sampling and supervision.
    pub fn path(path: impl Into<PathBuf>) -> Self {
        Self::of([path.into()])
    }

    /// Creates a source of several paths, with default sampling and supervision.
    pub fn of(stores: impl IntoIterator<Item = PathBuf>) -> Self {
        let stores = stores.into_iter().collect();
        Self { stores, quota: 0.0, mirror: false, labels: Supervision::Both, weigh_by_std: false }
    }
}

impl<'de> Deserialize<'de> for TrainingSource {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct PathOrMap;
        impl<'de> Visitor<'de> for PathOrMap {
            type Value = TrainingSource;

            fn expecting(&self, f: &mut fmt::Formatter) -> fmt::Result {
                write!(f, "a path, or a map of stores, quota, mirror and labels")
            }

            fn visit_str<E: de::Error>(self, path: &str) -> Result<TrainingSource, E> {
                Ok(TrainingSource::path(path))
            }

            fn visit_map<M: MapAccess<'de>>(self, map: M) -> Result<TrainingSource, M::Error> {
                let Written { stores, quota, mirror, labels, weigh_by_std } =
                    Written::deserialize(MapAccessDeserializer::new(map))?;
                Ok(TrainingSource { stores, quota, mirror, labels, weigh_by_std })
            }
        }
        deserializer.deserialize_any(PathOrMap)
    }
}

impl Serialize for TrainingSource {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self {
            Self { stores, .. } if stores.len() == 1 && *self == Self::path(&stores[0]) => {
                stores[0].serialize(serializer)
            }
            Self { stores, quota, mirror, labels, weigh_by_std } => Written {
                stores: stores.clone(),
                quota: *quota,
                mirror: *mirror,
                labels: *labels,
                weigh_by_std: *weigh_by_std,
            }
            .serialize(serializer),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_source_is_a_path_or_a_map_and_survives_a_round_trip() {
        let text = "- a.zarr\n- stores:\n  - b.zarr\n  - c.zarr\n  quota: 0.2\n  mirror: true\n  labels: contact\n";
        let sources: Vec<TrainingSource> = serde_yaml::from_str(text).unwrap();
        let stores = ["b.zarr", "c.zarr"].map(PathBuf::from);
        let long =
            TrainingSource { quota: 0.2, mirror: true, labels: Supervision::Contact, ..TrainingSource::of(stores) };
        assert_eq!(sources, [TrainingSource::path("a.zarr"), long]);
        assert_eq!(serde_yaml::to_string(&sources).unwrap(), text);
        let near: TrainingSource = serde_yaml::from_str("{stores: [a.zarr], labels: proximity}").unwrap();
        assert_eq!(near.labels, Supervision::Proximity);
        let force: TrainingSource = serde_yaml::from_str("{stores: [a.zarr], labels: force}").unwrap();
        assert_eq!(force.labels, Supervision::Force);
        let felt: TrainingSource = serde_yaml::from_str("{stores: [a.zarr], labels: felt}").unwrap();
        assert_eq!(felt.labels, Supervision::Felt);
        let weighed: TrainingSource = serde_yaml::from_str("{stores: [a.zarr], weigh_by_std: true}").unwrap();
        assert!(weighed.weigh_by_std && serde_yaml::to_string(&weighed).unwrap().contains("weigh_by_std: true"));
        let error = |text: &str| serde_yaml::from_str::<TrainingSource>(text).unwrap_err().to_string();
        assert!(error("{stores: [a], quotum: 3}").contains("quotum"));
        assert!(error("3").contains("a path, or a map of stores"));
    }

    #[test]
    fn a_force_known_exactly_weighs_one_and_one_that_nobody_knows_nothing() {
        assert_eq!(force_weight(0.0), 1.0);
        assert!((force_weight(0.05) - 0.5).abs() < 1e-6);
        assert_eq!(force_weight(f32::NAN), 0.0);
        assert_eq!(force_weight(f32::INFINITY), 0.0);
    }
}
