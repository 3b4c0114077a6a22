//! Meaning of the force at a vertex.

use serde::{Deserialize, Serialize};

use crate::error::{Error, Result};

/// Meaning of the force at a vertex. Fields of different kinds must not be compared or trained on together.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ForceKind {
    /// Share of the contact forces: the vertices of a hand sum to the force on it.
    #[default]
    Spread,
    /// Value that a sensor at the vertex reads, as interpolated between a glove's taxels: the sum depends on the mesh.
    Reading,
}

impl ForceKind {
    /// Name of the attribute in stores, tensor files and checkpoints.
    pub const ATTRIBUTE: &str = "force_kind";

    /// Returns the id that files carry.
    pub fn id(self) -> &'static str {
        match self {
            Self::Spread => "spread",
            Self::Reading => "reading",
        }
    }

    /// Parses an id.
    ///
    /// # Errors
    /// If the id is unknown; the error lists the valid ones.
    pub fn from_id(id: &str) -> Result<Self> {
        match id {
            "spread" => Ok(Self::Spread),
            "reading" => Ok(Self::Reading),
            _ => Err(Error::unknown("force_kind", id, ["spread", "reading"])),
        }
    }

    /// Checks that two kinds are equal.
    ///
    /// # Errors
    /// If they differ.
    pub fn must_match(self, other: Self) -> Result<()> {
        match self == other {
            true => Ok(()),
            false => {
                let got = format!("{} and {}; `egotac sensor convert` converts forces", self.id(), other.id());
                Err(Error::value(Self::ATTRIBUTE, "forces of one kind", got))
            }
        }
    }
}
