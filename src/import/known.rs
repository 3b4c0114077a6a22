//! Numbers that a journal keeps of each labelled moment beside its label: distances and poses.

use glam::{DAffine3, DQuat};

use super::hands::{HandModels, PosedRecord};
use super::recording::{Moment, Recording};
use super::sensors::Sensor;
use crate::hand::{HandParams, Side};
use crate::tactile::N_FIELD;

/// Numbers of a pose: position and quaternion (w, x, y, z).
pub const POSE: usize = 7;
/// Numbers of a hand's parameters.
const HAND: usize = 61;

/// Known quantities of one moment beside force and contact; NaN = unknown.
#[derive(Debug, Clone, PartialEq)]
pub struct Known {
    /// (1556) signed distance from the nearest object, m.
    pub distances: Vec<f32>,
    /// Left and right hand in the world frame.
    pub hands: [Option<HandParams>; 2],
    /// (7) `world_from_camera`.
    pub camera: Vec<f32>,
    /// (objects, 7) `world_from_object`.
    pub objects: Vec<f32>,
    /// (2) measured force that is on no vertex of the left and the right hand, N; empty if the recording measures none.
    pub lost: Vec<f32>,
    /// Reading of each sensor of the recording.
    pub readings: Vec<Vec<f32>>,
    /// (1556) relative reading at each vertex, 0 to 1; empty if the recording has no glove without a calibration.
    pub relative: Vec<f32>,
}

impl Known {
    /// Collects the numbers of a moment, in the world frame.
    pub fn new(
        moment: &Moment,
        hands: &[Option<PosedRecord>; 2],
        models: &HandModels,
        recording: &Recording,
        distances: Vec<f32>,
    ) -> Self {
        let world = moment.world_from_reference;
        let moved = |side: Side| {
            let hand = hands[side as usize].as_ref()?;
            Some(models.moved(side, &hand.params, recording.convention, world))
        };
        let object = |pose: &Option<DAffine3>| pose_values(pose.map(|pose| world * pose));
        Self {
            distances,
            hands: Side::BOTH.map(moved),
            camera: pose_values(moment.world_from_camera).to_vec(),
            objects: moment.objects.iter().flat_map(object).collect(),
            lost: Vec::new(),
            readings: recording
                .sensors
                .iter()
                .enumerate()
                .map(|(index, sensor)| reading(moment, index, sensor))
                .collect(),
            relative: Vec::new(),
        }
    }

    /// Returns all numbers in a row.
    pub fn into_values(self) -> Vec<f32> {
        let hands = self.hands.iter().flat_map(|hand| hand.as_ref().map_or([f32::NAN; HAND], HandParams::to_array));
        self.distances
            .iter()
            .copied()
            .chain(hands)
            .chain(self.camera)
            .chain(self.objects)
            .chain(self.lost)
            .chain(self.readings.into_iter().flatten())
            .chain(self.relative)
            .collect()
    }

    /// Reads the numbers of [`Known::into_values`] of a recording. An empty row, that of a moment without a label, is unknown.
    pub fn from_values(values: &[f32], recording: &Recording) -> Self {
        let sensors: Vec<usize> = recording.sensors.iter().map(Sensor::values).collect();
        let n_lost = if recording.measures_force { 2 } else { 0 };
        let n_relative = if recording.glove.is_some() { N_FIELD } else { 0 };
        Self::split(values, [recording.objects.len(), n_lost, n_relative], &sensors)
    }

    /// Splits a row by the numbers of objects, of lost forces and of relative readings, and the values of each sensor.
    fn split(values: &[f32], [n_objects, n_lost, n_relative]: [usize; 3], sensors: &[usize]) -> Self {
        let mut rest = values;
        let mut take = |n: usize| {
            let (taken, tail) = rest.split_at_checked(n).unwrap_or((&[], &[]));
            rest = tail;
            if taken.len() == n { taken.to_vec() } else { vec![f32::NAN; n] }
        };
        let distances = take(N_FIELD);
        let hands = [take(HAND), take(HAND)].map(|values| {
            let values: [f32; HAND] = values.try_into().ok()?;
            (!values[0].is_nan()).then(|| HandParams::from_array(&values))
        });
        let (camera, objects, lost) = (take(POSE), take(POSE * n_objects), take(n_lost));
        let readings = sensors.iter().map(|n| take(*n)).collect();
        Self { distances, hands, camera, objects, lost, readings, relative: take(n_relative) }
    }
}

/// Returns the reading of a sensor; NaN where the moment has none.
fn reading(moment: &Moment, index: usize, sensor: &Sensor) -> Vec<f32> {
    let reading = moment.readings.get(index).cloned().flatten();
    reading.filter(|values| values.len() == sensor.values()).unwrap_or_else(|| sensor.unknown())
}

/// Returns position, m, and quaternion (w, x, y, z); NaN for an unknown pose.
fn pose_values(pose: Option<DAffine3>) -> [f32; POSE] {
    let Some(pose) = pose else { return [f32::NAN; POSE] };
    let (q, p) = (DQuat::from_mat3(&pose.matrix3), pose.translation);
    [p.x, p.y, p.z, q.w, q.x, q.y, q.z].map(|value| value as f32)
}

#[cfg(test)]
mod tests {
    use glam::Vec3;

    use super::*;

    #[test]
    fn numbers_survive_the_journal_and_an_absent_row_is_unknown() {
        let right = HandParams { transl: Vec3::new(0.1, 0.2, 0.3), ..HandParams::default() };
        let camera = vec![1.0, 2.0, 3.0, 1.0, 0.0, 0.0, 0.0];
        let objects: Vec<f32> = (0..14).map(|k| k as f32).collect();
        let lost = vec![0.25, 0.5];
        let readings = vec![vec![1.0; 6], vec![2.0; 3]];
        let distances = vec![0.5; N_FIELD];
        let relative = vec![0.25; N_FIELD];
        let known = Known { distances, hands: [None, Some(right)], camera, objects, lost, readings, relative };
        assert_eq!(Known::split(&known.clone().into_values(), [2, 2, N_FIELD], &[6, 3]), known);
        let unknown = Known::split(&[], [2, 0, 0], &[4]);
        assert!(unknown.readings[0].len() == 4 && unknown.readings[0][0].is_nan());
        assert!(unknown.hands == [None, None] && unknown.objects.len() == 14);
        assert!(unknown.distances.iter().chain(&unknown.camera).chain(&unknown.objects).all(|value| value.is_nan()));
    }
}
