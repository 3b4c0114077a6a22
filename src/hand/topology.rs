//! Vertex numbering of a hand.

use serde::{Deserialize, Serialize};

use crate::error::{Error, Result};

/// What a vertex index means; two topologies never mix.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, Deserialize)]
pub enum Topology {
    /// Our built-in hand.
    #[default]
    #[serde(rename = "egotac-hand-1")]
    EgotacHand1,
    /// The published MANO hand.
    #[serde(rename = "mano")]
    Mano,
}

impl Topology {
    /// The id as stores, checkpoints and messages carry it.
    pub fn id(self) -> &'static str {
        match self {
            Topology::EgotacHand1 => "egotac-hand-1",
            Topology::Mano => "mano",
        }
    }

    /// Reads an id.
    ///
    /// # Errors
    /// If the id is unknown.
    pub fn from_id(id: &str) -> Result<Self> {
        match id {
            "egotac-hand-1" => Ok(Self::EgotacHand1),
            "mano" => Ok(Self::Mano),
            _ => Err(Error::unknown("topology", id, ["egotac-hand-1", "mano"])),
        }
    }

    /// Refuses two different topologies.
    ///
    /// # Errors
    /// If `other` is not the same.
    pub fn must_match(self, other: Self) -> Result<()> {
        if self == other {
            return Ok(());
        }
        Err(Error::Topology { left: self.id().into(), right: other.id().into() })
    }
}
