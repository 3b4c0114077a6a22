//! Ids of channels and schemas that the records of a file use.

use std::collections::BTreeSet;
use std::path::Path;

use mcap::records::{Record as Parsed, op};

use super::Records;
use super::note::{OriginalPiece, OriginalPieces};
use super::parse::parse;
use crate::dataset::labels::Notes;
use crate::error::Result;

/// Ids and topics of a file, from its records: summaries may omit channels.
#[derive(Debug, Default)]
pub(super) struct UsedIds {
    pub channels: BTreeSet<u16>,
    pub schemas: BTreeSet<u16>,
    pub topics: BTreeSet<String>,
}

impl UsedIds {
    /// Reads all records of the file at `path`; chunks with one of the `notes` stay compressed.
    ///
    /// # Errors
    /// If the file or a note can't be read.
    pub fn of(path: &Path, notes: Notes) -> Result<Self> {
        let mut used = Self::default();
        for piece in OriginalPieces::new(Records::open(path)?, notes) {
            match piece? {
                OriginalPiece::Piece(piece) => piece.records().for_each(|(opcode, body)| used.add(opcode, body)),
                OriginalPiece::Noted(_, note) => {
                    note.skeleton.definitions.iter().for_each(|(opcode, body)| used.add(*opcode, body));
                    used.channels.extend(note.skeleton.index.keys());
                }
            }
        }
        Ok(used)
    }

    fn add(&mut self, opcode: u8, body: &[u8]) {
        // Messages, channels and schemas begin with their id.
        let Some(id) = body.first_chunk().map(|id| u16::from_le_bytes(*id)) else { return };
        match opcode {
            op::MESSAGE => drop(self.channels.insert(id)),
            op::SCHEMA => drop(self.schemas.insert(id)),
            op::CHANNEL => {
                self.channels.insert(id);
                if let Some(Parsed::Channel(channel)) = parse(opcode, body) {
                    self.schemas.insert(channel.schema_id);
                    self.topics.insert(channel.topic);
                }
            }
            _ => {}
        }
    }
}

/// Returns an id from 1 on that is not in use: above all others where possible. Schema 0 means "none".
pub(super) fn free_id(used: &BTreeSet<u16>) -> Option<u16> {
    match used.last().map_or(Some(1), |last| last.checked_add(1)) {
        Some(above) => Some(above),
        None => (1..=u16::MAX).rev().find(|id| !used.contains(id)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_free_id_is_none_that_is_in_use() {
        assert_eq!(free_id(&BTreeSet::new()), Some(1));
        assert_eq!(free_id(&BTreeSet::from([0, 7])), Some(8));
        assert_eq!(free_id(&BTreeSet::from([1, u16::MAX, u16::MAX - 1])), Some(u16::MAX - 2));
        assert_eq!(free_id(&(0..=u16::MAX).collect()), None);
        assert_eq!(free_id(&(1..=u16::MAX).collect()), None);
    }
}
