//! Contact frequency and force of each region of the hands.

use crate::dataset::{CONTACT_THRESHOLD, Labelled};
use crate::hand::{HandModel, N_VERTICES, Region, Side};

/// Contact and force of one region of one hand.
#[derive(Debug, Clone, PartialEq)]
pub struct RegionRow {
    /// The hand.
    pub side: Side,
    /// The region.
    pub region: Region,
    /// Share of the labelled frames in which a vertex of the region is touched.
    pub contact_ratio: f64,
    /// Mean total force on the region over its frames with contact, N; None = no contact, or unknown forces.
    pub mean_force: Option<f64>,
}

/// Returns the rows of both hands, left first.
pub fn region_rows(labelled: &Labelled, hands: &[HandModel; 2]) -> Vec<RegionRow> {
    let regions = hands.each_ref().map(HandModel::regions);
    let mut rows = Vec::new();
    for side in Side::BOTH {
        for region in Region::ALL {
            let of_region = regions[side as usize].iter().enumerate().filter(|(_, other)| **other == region);
            let vertices: Vec<usize> = of_region.map(|(vertex, _)| side as usize * N_VERTICES + vertex).collect();
            let (mut known, mut touched, mut force) = (0u64, 0u64, 0.0);
            let labels = &labelled.labels;
            let frames = (0..labels.n_frames()).map(|frame| (labels.force_at(frame), labels.contact_at(frame)));
            // Touch is unknown on a whole hand, or known on it.
            let first = side.range().start;
            for (forces, contacts) in frames.filter(|(_, contacts)| !contacts[first].is_nan()) {
                known += 1;
                if vertices.iter().any(|vertex| f64::from(contacts[*vertex]) > CONTACT_THRESHOLD) {
                    touched += 1;
                    force += vertices.iter().map(|vertex| f64::from(forces[*vertex])).sum::<f64>();
                }
            }
            let contact_ratio = touched as f64 / known.max(1) as f64;
            let mean_force = Some(force / touched.max(1) as f64).filter(|force| touched > 0 && !force.is_nan());
            rows.push(RegionRow { side, region, contact_ratio, mean_force });
        }
    }
    rows
}
