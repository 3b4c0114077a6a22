//! Vertex numbering of a hand.

use serde::{Deserialize, Serialize};

use crate::error::{Error, Result};

/// Vertex numbering of a hand. Fields of different topologies must not be combined.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, Deserialize)]
pub enum Topology {
    /// The built-in hand.
    #[default]
    #[serde(rename = "egotac-hand-1")]
    EgotacHand1,
    /// The published MANO hand.
    #[serde(rename = "mano")]
    Mano,
}

impl Topology {
    /// Returns the id that stores, checkpoints and messages carry.
    pub fn id(self) -> &'static str {
        match self {
            Topology::EgotacHand1 => "egotac-hand-1",
            Topology::Mano => "mano",
        }
    }

    /// Returns the name of the hand model, for people.
    pub fn hand_model(self) -> &'static str {
        match self {
            Topology::EgotacHand1 => "egotac built-in hand",
            Topology::Mano => "MANO",
        }
    }

    /// Returns the other numbering.
    pub fn other(self) -> Self {
        match self {
            Topology::EgotacHand1 => Topology::Mano,
            Topology::Mano => Topology::EgotacHand1,
        }
    }

    /// Parses an id.
    ///
    /// # Errors
    /// If the id is unknown; the error lists the valid ones.
    pub fn from_id(id: &str) -> Result<Self> {
        match id {
            "egotac-hand-1" => Ok(Self::EgotacHand1),
            "mano" => Ok(Self::Mano),
            _ => Err(Error::unknown("topology", id, ["egotac-hand-1", "mano"])),
        }
    }

    /// Checks that two topologies are equal.
    ///
    /// # Errors
    /// If they differ.
    pub fn must_match(self, other: Self) -> Result<()> {
        if self == other {
            return Ok(());
        }
        Err(Error::Topology { left: self.id().into(), right: other.id().into() })
    }
}
