//! Streams with clocks of their own, resampled to the stamps of images: forces linearly, poses along screw motions.

use glam::{DAffine3, DMat3, DQuat, DVec3};

use crate::error::{Error, Result};

/// Frames whose mean is taken as a sensor's reading without touch.
const BASELINE: usize = 10;
/// Reading, N, below which the sensor's noise is cut off.
const FLOOR: f32 = 0.2;
/// Sine of half an angle below which the angle counts as zero.
const TINY: f64 = 1e-9;

/// Values with their times.
#[derive(Debug, Clone, PartialEq)]
pub struct Stream<T> {
    /// (n) s, growing.
    stamps: Vec<f64>,
    /// (n).
    values: Vec<T>,
}

/// Values between which a time lies, and its share of the way from the first to the second.
struct Bracket<'a, T> {
    before: &'a T,
    after: &'a T,
    share: f64,
}

impl<T> Default for Stream<T> {
    /// Returns a stream without values.
    fn default() -> Self {
        Self { stamps: Vec::new(), values: Vec::new() }
    }
}

impl<T> Stream<T> {
    /// Creates a stream.
    ///
    /// # Errors
    /// If the numbers of stamps and values differ, or the stamps are not finite or don't grow.
    pub fn new(stamps: Vec<f64>, values: Vec<T>) -> Result<Self> {
        if stamps.len() != values.len() {
            return Err(Error::shape("stream", format!("[{}]", stamps.len()), [values.len()]));
        }
        if let Some(at) = stamps.iter().position(|stamp| !stamp.is_finite()) {
            return Err(Error::value(format!("stamps[{at}]"), "finite seconds", stamps[at]));
        }
        if let Some(at) = stamps.windows(2).position(|pair| pair[1] <= pair[0]) {
            let got = format!("{} after {}", stamps[at + 1], stamps[at]);
            return Err(Error::value(format!("stamps[{}]", at + 1), "seconds that grow", got));
        }
        Ok(Self { stamps, values })
    }

    /// Appends a value. One that is not newer than the last is refused: returns false.
    pub fn push(&mut self, stamp: f64, value: T) -> bool {
        let newer = stamp.is_finite() && self.stamps.last().is_none_or(|last| stamp > *last);
        if newer {
            self.stamps.push(stamp);
            self.values.push(value);
        }
        newer
    }

    /// Drops the values that no time from `from` on needs: all but the last one before it.
    pub fn forget(&mut self, from: f64) {
        let useless = self.stamps.partition_point(|stamp| *stamp <= from).saturating_sub(1);
        self.stamps.drain(..useless);
        self.values.drain(..useless);
    }

    /// Time of the newest value, s.
    pub fn newest(&self) -> Option<f64> {
        self.stamps.last().copied()
    }

    /// Number of values.
    pub fn len(&self) -> usize {
        self.values.len()
    }

    /// True if there is no value.
    pub fn is_empty(&self) -> bool {
        self.values.is_empty()
    }

    /// Returns the values around a time; `None` before the first, after the last, and where they are more than `max_gap` s apart.
    fn around(&self, time: f64, max_gap: f64) -> Option<Bracket<'_, T>> {
        let after = self.stamps.partition_point(|stamp| *stamp < time);
        let at = *self.stamps.get(after)?;
        if at == time {
            return Some(Bracket { before: &self.values[after], after: &self.values[after], share: 0.0 });
        }
        let before = after.checked_sub(1)?;
        let step = at - self.stamps[before];
        let share = (time - self.stamps[before]) / step;
        (step <= max_gap).then(|| Bracket { before: &self.values[before], after: &self.values[after], share })
    }
}

impl Stream<Vec<f32>> {
    /// Returns the values at a time, linear between those around it; `None` where the stream has none around it that are at most
    /// `max_gap` s apart.
    pub fn linear(&self, time: f64, max_gap: f64) -> Option<Vec<f32>> {
        let Bracket { before, after, share } = self.around(time, max_gap)?;
        // NaN at a weight of zero is still unknown only if the time is that of the value itself.
        let mix = |(a, b): (&f32, &f32)| (f64::from(*a) * (1.0 - share) + f64::from(*b) * share) as f32;
        Some(before.iter().zip(after).map(mix).collect())
    }
}

impl Stream<DAffine3> {
    /// Returns the rigid pose at a time, on the screw motion between the poses around it; `None` as [`Stream::linear`].
    pub fn rigid(&self, time: f64, max_gap: f64) -> Option<DAffine3> {
        let Bracket { before, after, share } = self.around(time, max_gap)?;
        Some(screw(before, after, share))
    }
}

/// Returns the pose at a share of the screw motion from one rigid pose to another: from · exp(share · log(from⁻¹ · to)), SE(3).
pub fn screw(from: &DAffine3, to: &DAffine3, share: f64) -> DAffine3 {
    let step = from.inverse() * *to;
    let rotation = DQuat::from_mat3(&step.matrix3).normalize();
    // The shorter of the two ways around.
    let rotation = if rotation.w < 0.0 { -rotation } else { rotation };
    let sine = rotation.xyz().length();
    if sine < TINY {
        return *from * DAffine3::from_mat3_translation(step.matrix3, step.translation * share);
    }
    let (axis, angle) = (rotation.xyz() / sine, 2.0 * sine.atan2(rotation.w));
    // step.translation = left_jacobian(angle) · v, with the velocity v of the screw.
    let velocity = left_jacobian(axis, angle).inverse() * step.translation;
    let turned = DQuat::from_axis_angle(axis, angle * share);
    let moved = left_jacobian(axis, angle * share) * velocity * share;
    *from * DAffine3::from_rotation_translation(turned, moved)
}

/// Returns the left Jacobian of SO(3) at a rotation about a unit axis.
fn left_jacobian(axis: DVec3, angle: f64) -> DMat3 {
    if angle.abs() < TINY {
        return DMat3::IDENTITY;
    }
    let cross = DMat3::from_cols(
        DVec3::new(0.0, axis.z, -axis.y),
        DVec3::new(-axis.z, 0.0, axis.x),
        DVec3::new(axis.y, -axis.x, 0.0),
    );
    DMat3::IDENTITY + cross * ((1.0 - angle.cos()) / angle) + cross * cross * (1.0 - angle.sin() / angle)
}

/// Filters the readings of a glove in place, as the public converter of the Aether glove does: the mean of each taxel's first ten
/// frames is subtracted, what is below 0.2 N is cut off, and each frame becomes the mean of itself and its two neighbours.
///
/// `frames`: readings in order, all of the same number, N. NaN stays unknown, and so does the mean that it enters.
pub fn filter(frames: &mut [Vec<f32>]) {
    let width = frames.first().map_or(0, Vec::len);
    for taxel in 0..width {
        let first = frames.iter().take(BASELINE).map(|frame| frame[taxel]).filter(|value| !value.is_nan());
        let (count, sum) = first.fold((0, 0.0), |(count, sum), value| (count + 1, sum + f64::from(value)));
        let rest = if count == 0 { 0.0 } else { (sum / f64::from(count)) as f32 };
        let cut: Vec<f32> =
            frames.iter().map(|frame| frame[taxel] - rest).map(|v| if v < FLOOR { 0.0 } else { v }).collect();
        for (index, frame) in frames.iter_mut().enumerate() {
            let around = &cut[index.saturating_sub(1)..(index + 2).min(cut.len())];
            frame[taxel] = (around.iter().sum::<f32>() / around.len() as f32).max(0.0);
            if around.iter().any(|value| value.is_nan()) {
                frame[taxel] = f32::NAN;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pose(axis: DVec3, angle: f64, at: DVec3) -> DAffine3 {
        DAffine3::from_rotation_translation(DQuat::from_axis_angle(axis.normalize(), angle), at)
    }

    #[test]
    fn forces_are_linear_between_their_stamps_and_unknown_across_gaps() {
        let stream = Stream::new(vec![0.0, 1.0, 5.0], vec![vec![0.0, 2.0], vec![1.0, 0.0], vec![9.0, 9.0]]).unwrap();
        assert_eq!(stream.linear(0.25, 2.0), Some(vec![0.25, 1.5]));
        assert_eq!(stream.linear(1.0, 0.1), Some(vec![1.0, 0.0]));
        assert_eq!([-0.1, 2.0, 5.1].map(|time| stream.linear(time, 2.0)), [None, None, None]);
        assert!(Stream::new(vec![0.0, 0.0], vec![1, 2]).unwrap_err().to_string().contains("stamps[1]"));
        assert!(Stream::new(vec![0.0], vec![1, 2]).is_err());
    }

    #[test]
    fn a_constant_screw_is_followed_exactly() {
        // A body that turns about a fixed line in space: its pose at any time is known.
        let (axis, through) = (DVec3::new(0.3, -0.5, 0.8).normalize(), DVec3::new(0.4, 0.1, -0.2));
        let body = pose(DVec3::X, 0.7, DVec3::new(0.1, 0.2, 0.3));
        let at = |time: f64| {
            let turn = DQuat::from_axis_angle(axis, 1.3 * time);
            let about = DAffine3::from_rotation_translation(turn, through - turn * through + axis * (0.05 * time));
            about * body
        };
        for share in [0.0, 0.2, 0.5, 0.9, 1.0] {
            let (got, want) = (screw(&at(0.0), &at(1.0), share), at(share));
            assert!(got.abs_diff_eq(want, 1e-12), "{share}: {got:?} {want:?}");
        }
        let still = pose(DVec3::Y, 0.4, DVec3::ONE);
        let moved = DAffine3::from_translation(DVec3::X) * still;
        assert!(screw(&still, &moved, 0.25).abs_diff_eq(DAffine3::from_translation(DVec3::X * 0.25) * still, 1e-12));
    }

    #[test]
    fn a_stream_forgets_all_but_what_later_times_need() {
        let mut stream = Stream::new(Vec::new(), Vec::new()).unwrap();
        assert!((0..10).all(|k| stream.push(f64::from(k), vec![k as f32])) && !stream.push(9.0, vec![0.0]));
        stream.forget(6.5);
        assert_eq!((stream.len(), stream.newest(), stream.linear(6.5, 1.0)), (4, Some(9.0), Some(vec![6.5])));
    }

    #[test]
    fn the_filter_removes_rest_and_noise_and_keeps_a_steady_force() {
        let mut frames: Vec<Vec<f32>> =
            (0..40).map(|k| vec![0.3 + if k >= 20 { 1.0 } else { 0.1 * (k % 2) as f32 }]).collect();
        filter(&mut frames);
        assert!(frames[..19].iter().all(|frame| frame[0] == 0.0));
        assert!(frames[22..].iter().all(|frame| (frame[0] - 0.95).abs() < 1e-5), "{:?}", frames[30]);
    }
}
