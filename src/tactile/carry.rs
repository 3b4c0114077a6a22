//! Fields carried over from one vertex numbering to another.

use super::{TactileField, TactileSequence};
use crate::error::{Error, Result};
use crate::hand::{FieldMap, Topology};

impl TactileField {
    /// Returns the field on the vertices of `to`: total force kept, contact by the nearest vertex.
    ///
    /// # Errors
    /// If force or contact does not have 1556 entries.
    pub fn carried(self, map: &FieldMap, to: Topology) -> Result<Self> {
        if self.topology == to {
            return Ok(self);
        }
        Ok(Self { topology: to, force: map.force(to, &self.force)?, contact: map.nearest(to, &self.contact)? })
    }
}

impl TactileSequence {
    /// Returns the sequence on the vertices of `to`, as [`TactileField::carried`]; masks are carried over with their fields.
    ///
    /// # Errors
    /// If the sequence does not state its topology, or an array is not of whole frames.
    pub fn carried(self, map: &FieldMap, to: Topology) -> Result<Self> {
        match self.topology {
            Some(topology) if topology == to => Ok(self),
            Some(_) => Ok(Self {
                topology: Some(to),
                force: map.force(to, &self.force)?,
                contact: map.nearest(to, &self.contact)?,
                mask_force: map.force_mask(to, &self.mask_force)?,
                mask_contact: map.nearest(to, &self.mask_contact)?,
                ..self
            }),
            None => Err(Error::value("topology of the fields", "egotac-hand-1 or mano, to carry them over", "none")),
        }
    }
}
