//! Scores of a part of the vertices: one hand, one region.

use super::Options;
use crate::hand::{HandModel, Region, Side};
use crate::tactile::N_FIELD;

/// Vertices that are scored by themselves.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Part {
    /// Its name, e.g. `left` or `thumb_tip`.
    pub name: String,
    /// (1556) whether a vertex belongs to it.
    pub holds: Vec<bool>,
}

impl Part {
    /// One hand.
    pub fn hand(side: Side) -> Self {
        let range = side.range();
        Self { name: side.name().into(), holds: (0..N_FIELD).map(|vertex| range.contains(&vertex)).collect() }
    }

    /// Each region, of both hands together. `models`: left, then right.
    pub fn regions(models: &[HandModel; 2]) -> Vec<Self> {
        let of_vertices = models.each_ref().map(HandModel::regions).concat();
        let part = |region: Region| Self {
            name: region.name().into(),
            holds: of_vertices.iter().map(|of_vertex| *of_vertex == region).collect(),
        };
        Region::ALL.into_iter().map(part).collect()
    }
}

impl Options {
    /// The same, with no vertex counted outside of `part`, over `n_frames` frames.
    #[must_use]
    pub fn within(&self, part: &Part, n_frames: usize) -> Self {
        let cut = |mask: &[u8]| -> Vec<u8> {
            let counted = |index: usize| mask.get(index).is_none_or(|m| *m != 0) && part.holds[index % N_FIELD];
            (0..n_frames * N_FIELD).map(|index| u8::from(counted(index))).collect()
        };
        Self { mask_force: cut(&self.mask_force), mask_contact: cut(&self.mask_contact), ..self.clone() }
    }
}
