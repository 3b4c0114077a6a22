//! Groups of vertices that are scored separately: one hand, one region.

use crate::hand::{HandModel, Region, Side};
use crate::tactile::{N_FIELD, TactileSequence};

/// Vertices that are scored separately.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct VertexGroup {
    /// Name, e.g. `left` or `thumb_tip`.
    pub name: String,
    /// (1556) true if the vertex belongs to the group.
    pub contains: Vec<bool>,
}

impl VertexGroup {
    /// Returns the vertices of one hand.
    pub fn hand(side: Side) -> Self {
        let range = side.range();
        Self { name: side.name().into(), contains: (0..N_FIELD).map(|vertex| range.contains(&vertex)).collect() }
    }

    /// Returns one group per region, of both hands together. `models`: left, then right.
    pub fn regions(models: &[HandModel; 2]) -> Vec<Self> {
        let of_vertices = models.each_ref().map(HandModel::regions).concat();
        let group = |region: Region| Self {
            name: region.name().into(),
            contains: of_vertices.iter().map(|of_vertex| *of_vertex == region).collect(),
        };
        Region::ALL.into_iter().map(group).collect()
    }

    /// Masks out the target's vertices outside of the group.
    pub fn restrict(&self, target: &mut TactileSequence) {
        let entries = target.force.len();
        for mask in [&mut target.mask_force, &mut target.mask_contact] {
            let counted = |index: usize| mask.get(index).is_none_or(|m| *m != 0) && self.contains[index % N_FIELD];
            *mask = (0..entries).map(|index| u8::from(counted(index))).collect();
        }
    }
}
