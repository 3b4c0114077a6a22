//! Scores of a part of the vertices: one hand, one region.

use crate::hand::{HandModel, Region, Side};
use crate::tactile::{N_FIELD, TactileSequence};

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

    /// Masks out the target's vertices outside of the part.
    pub fn restrict(&self, target: &mut TactileSequence) {
        let entries = target.force.len();
        for mask in [&mut target.mask_force, &mut target.mask_contact] {
            let counted = |index: usize| mask.get(index).is_none_or(|m| *m != 0) && self.holds[index % N_FIELD];
            *mask = (0..entries).map(|index| u8::from(counted(index))).collect();
        }
    }
}
