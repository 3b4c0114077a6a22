//! A tactile glove of another make: other taxels, gain and spread than the simulator's label.

use egotac::hand::{HandModel, N_VERTICES, Region, Side, vertex_normals};
use egotac::tactile::{N_FIELD, TactileSequence};
use glam::Vec3;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

/// Seed of the taxels' gains.
const SEED: u64 = 20;

/// Properties of a sensor.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Sensor {
    /// Taxels of a hand on palm and inner side of the fingers, each of a radius in metres; `None` = one per vertex, all over.
    pub layout: Option<(usize, f32)>,
    /// Standard deviation by which each force spreads over the skin in addition, m; 0 = none.
    pub spread: f32,
    /// Mean gain, and the standard deviation of the logarithm of a taxel's own; `None` = 1 for all.
    pub gain: Option<(f32, f32)>,
}

/// Linear map from the forces on the vertices of one hand to a sensor's readings, at the vertices.
#[derive(Debug)]
struct HandMap {
    /// (778) weights of each vertex's force in the readings: vertex, weight.
    rows: Vec<Vec<(u32, f32)>>,
}

impl Sensor {
    /// Returns what the sensor reads where these are the forces. Contact and masks stay as they are.
    pub fn read(&self, truth: &TactileSequence) -> TactileSequence {
        let maps = Side::BOTH.map(|side| self.map(side));
        let mut read = truth.clone();
        for (row, forces) in truth.force.chunks_exact(N_FIELD).enumerate() {
            let out = &mut read.force[row * N_FIELD..(row + 1) * N_FIELD];
            for (side, map) in Side::BOTH.into_iter().zip(&maps) {
                map.apply(&forces[side.range()], &mut out[side.range()]);
            }
        }
        read
    }

    fn map(&self, side: Side) -> HandMap {
        let model = HandModel::builtin(side);
        let vertices = &model.v_template;
        let mut rng = ChaCha8Rng::seed_from_u64(SEED + side as u64);
        let mut gains = |count: usize| -> Vec<f32> {
            let (mean, deviation) = self.gain.unwrap_or((1.0, 0.0));
            (0..count).map(|_| mean * (deviation * rng.sample::<f32, _>(StandardNormal)).exp()).collect()
        };
        // taxels[v]: taxels that read vertex v, with the share of v's force and the taxel's gain in one number; the reading
        // is laid on the vertices of the taxel in equal parts.
        let rows = match self.layout {
            None => gains(N_VERTICES).into_iter().enumerate().map(|(v, gain)| vec![(v as u32, gain)]).collect(),
            Some((count, radius)) => {
                let inner: Vec<usize> = inner_side(&model);
                let centres = farthest(vertices, &inner, count);
                let gains = gains(centres.len());
                let mut members: Vec<Vec<u32>> = vec![Vec::new(); centres.len()];
                for vertex in &inner {
                    let distance = |centre: &usize| vertices[*vertex].distance(vertices[*centre]);
                    let nearest =
                        (0..centres.len()).min_by(|a, b| distance(&centres[*a]).total_cmp(&distance(&centres[*b])));
                    if let Some(taxel) = nearest.filter(|taxel| distance(&centres[*taxel]) <= radius) {
                        members[taxel].push(*vertex as u32);
                    }
                }
                let mut rows = vec![Vec::new(); N_VERTICES];
                for (taxel, members) in members.iter().enumerate() {
                    let part = gains[taxel] / members.len().max(1) as f32;
                    for vertex in members {
                        rows[*vertex as usize] = members.iter().map(|to| (*to, part)).collect();
                    }
                }
                rows
            }
        };
        HandMap { rows: if self.spread > 0.0 { spread(vertices, self.spread, &rows) } else { rows } }
    }
}

impl HandMap {
    /// Maps forces (778) to readings (778); an unknown force is unknown where it would be read, and at its vertex.
    fn apply(&self, forces: &[f32], readings: &mut [f32]) {
        readings.fill(0.0);
        for (vertex, row) in self.rows.iter().enumerate() {
            let force = forces[vertex];
            if force.is_nan() {
                readings[vertex] = f32::NAN;
            }
            if force != 0.0 {
                row.iter().for_each(|(to, weight)| readings[*to as usize] += weight * force);
            }
        }
    }
}

/// Returns the vertices that face the palm's side at rest.
fn inner_side(model: &HandModel) -> Vec<usize> {
    let regions = model.regions();
    let normals = vertex_normals(&model.v_template, &model.faces);
    // The palms of both hands face -y at rest.
    (0..N_VERTICES).filter(|v| regions[*v] != Region::Dorsal && normals[*v].y <= 0.0).collect()
}

/// Returns `count` of the candidates, each as far as possible from those before it.
fn farthest(vertices: &[Vec3], candidates: &[usize], count: usize) -> Vec<usize> {
    let mut chosen: Vec<usize> = candidates.first().copied().into_iter().collect();
    let mut nearest: Vec<f32> = vec![f32::INFINITY; candidates.len()];
    while let Some(last) = chosen.last().copied().filter(|_| chosen.len() < count.min(candidates.len())) {
        for (distance, vertex) in nearest.iter_mut().zip(candidates) {
            *distance = distance.min(vertices[*vertex].distance(vertices[last]));
        }
        let at = (0..candidates.len()).max_by(|a, b| nearest[*a].total_cmp(&nearest[*b]));
        chosen.extend(at.map(|at| candidates[at]));
    }
    chosen
}

/// Spreads each vertex's force by a Gaussian before the sensor reads it; the sum is kept.
fn spread(vertices: &[Vec3], sigma: f32, rows: &[Vec<(u32, f32)>]) -> Vec<Vec<(u32, f32)>> {
    let of = |from: usize| {
        let weight = |to: usize| (-vertices[from].distance_squared(vertices[to]) / (2.0 * sigma * sigma)).exp();
        let near: Vec<(usize, f32)> =
            (0..N_VERTICES).map(|to| (to, weight(to))).filter(|(_, weight)| *weight > 1e-3).collect();
        let sum: f32 = near.iter().map(|(_, weight)| weight).sum();
        let mut row = vec![0.0; N_VERTICES];
        for (through, share) in near {
            rows[through].iter().for_each(|(to, weight)| row[*to as usize] += share / sum * weight);
        }
        row.into_iter()
            .enumerate()
            .filter(|(_, weight)| *weight > 0.0)
            .map(|(to, weight)| (to as u32, weight))
            .collect()
    };
    (0..N_VERTICES).map(of).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn truth() -> TactileSequence {
        let model = HandModel::builtin(Side::Right);
        let tip = model.tip_vertices[1] as usize;
        let mut force = vec![0.0; 2 * N_FIELD];
        force[N_FIELD + Side::Right.range().start + tip] = 2.0;
        TactileSequence::from_force(None, force)
    }

    fn total(sequence: &TactileSequence, frame: usize) -> f32 {
        sequence.force_at(frame).iter().sum()
    }

    #[test]
    fn a_sensor_without_differences_reads_the_truth_and_spreading_keeps_the_sum() {
        let truth = truth();
        assert_eq!(Sensor::default().read(&truth).force, truth.force);
        let spread = Sensor { spread: 0.006, ..Sensor::default() }.read(&truth);
        assert!((total(&spread, 1) - 2.0).abs() < 1e-4 && total(&spread, 0) == 0.0);
        assert!(spread.force.iter().filter(|force| **force > 0.01).count() > 5);
        assert!(spread.force_at(1)[Side::Left.range()].iter().all(|force| *force == 0.0));
    }

    #[test]
    fn a_gain_scales_and_taxels_read_only_what_they_cover() {
        let truth = truth();
        let halved = Sensor { gain: Some((0.5, 0.0)), ..Sensor::default() }.read(&truth);
        assert!((total(&halved, 1) - 1.0).abs() < 1e-6);
        let everywhere = TactileSequence::from_force(None, vec![1.0; N_FIELD]);
        let read = Sensor { layout: Some((48, 0.006)), ..Sensor::default() }.read(&everywhere);
        let model = HandModel::builtin(Side::Left);
        let inner = inner_side(&model);
        let covered = read.force_at(0)[Side::Left.range()].iter().filter(|force| **force > 0.0).count();
        assert!(
            covered > 48 && covered < inner.len() && inner.len() < N_VERTICES / 2 + 150,
            "{covered} {}",
            inner.len()
        );
        // Within a taxel the reading is even, and the taxels together read each covered vertex once.
        assert!((total(&read, 0) - 2.0 * covered as f32).abs() < 0.1 * covered as f32);
        assert_eq!(farthest(&model.v_template, &inner, 5).len(), 5);
    }

    #[test]
    fn an_unknown_force_stays_unknown() {
        let mut truth = truth();
        truth.force[3] = f32::NAN;
        assert!(Sensor { spread: 0.005, ..Sensor::default() }.read(&truth).force[3].is_nan());
    }
}
