//! Motion of one frame in its parent over time.

use std::collections::VecDeque;

use glam::{DQuat, DVec3};

/// Time over which motions are kept, nanoseconds; that of tf2.
pub(super) const CACHE_NANOS: i64 = 10_000_000_000;
/// Largest number of kept samples; 10 s at 1 kHz.
const MAX_SAMPLES: usize = 10_000;

/// A rotation and then a translation: `x -> rotation * x + translation`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Motion {
    /// Translation, m.
    pub(crate) translation: DVec3,
    /// Unit quaternion.
    pub(crate) rotation: DQuat,
}

impl Motion {
    /// Does not move.
    pub(crate) const IDENTITY: Self = Self { translation: DVec3::ZERO, rotation: DQuat::IDENTITY };

    /// Returns the motion that applies `first`, then this one.
    pub(crate) fn after(self, first: Self) -> Self {
        Self {
            translation: self.rotation * first.translation + self.translation,
            rotation: (self.rotation * first.rotation).normalize(),
        }
    }

    /// Returns the motion back.
    pub(crate) fn inverse(self) -> Self {
        let rotation = self.rotation.inverse();
        Self { translation: -(rotation * self.translation), rotation }
    }

    /// Returns the motion at `share` (0 to 1) of the way to `other`: positions on a line, rotations about a fixed axis.
    fn towards(self, other: Self, share: f64) -> Self {
        Self {
            translation: self.translation.lerp(other.translation, share),
            rotation: self.rotation.slerp(other.rotation, share),
        }
    }
}

/// Samples of a frame's pose in its parent.
#[derive(Debug)]
pub(super) struct Buffer {
    /// Name of the parent.
    pub(super) parent: String,
    /// True if the only sample holds at all times.
    is_static: bool,
    /// Time in nanoseconds and pose, oldest first, each time once.
    samples: VecDeque<(i64, Motion)>,
}

/// Reason why a buffer has no pose at a time; nanoseconds.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Outside {
    /// The newest sample is older.
    Future(i64),
    /// The oldest sample is newer.
    Past(i64),
}

impl Buffer {
    /// Starts a buffer with one sample.
    pub(super) fn new(parent: String, is_static: bool, time: i64, motion: Motion) -> Self {
        Self { parent, is_static, samples: [(time, motion)].into() }
    }

    /// Adds a sample; a sample of equal time is replaced. Returns false if it is older than all that is kept.
    pub(super) fn insert(&mut self, is_static: bool, time: i64, motion: Motion) -> bool {
        if is_static || self.is_static {
            *self = Self::new(std::mem::take(&mut self.parent), is_static, time, motion);
            return true;
        }
        let newest = self.samples.back().map_or(time, |(newest, _)| *newest);
        if newest - time > CACHE_NANOS {
            return false;
        }
        let at = self.samples.partition_point(|(other, _)| *other < time);
        match self.samples.get_mut(at).filter(|(other, _)| *other == time) {
            Some(same) => same.1 = motion,
            None => self.samples.insert(at, (time, motion)),
        }
        let newest = newest.max(time);
        while self.samples.len() > MAX_SAMPLES
            || self.samples.front().is_some_and(|(oldest, _)| newest - oldest > CACHE_NANOS)
        {
            self.samples.pop_front();
        }
        true
    }

    /// Time of the newest sample; None if it holds at all times.
    pub(super) fn newest(&self) -> Option<i64> {
        (!self.is_static).then(|| self.samples.back().map(|(time, _)| *time)).flatten()
    }

    /// Returns the pose at a time, interpolated between the samples around it.
    pub(super) fn at(&self, time: i64) -> std::result::Result<Motion, Outside> {
        let after = self.samples.partition_point(|(other, _)| *other < time);
        let (before, after) = (after.checked_sub(1).and_then(|i| self.samples.get(i)), self.samples.get(after));
        match (before, after) {
            (Some((_, motion)), _) | (_, Some((_, motion))) if self.is_static => Ok(*motion),
            (_, Some((at, motion))) if *at == time => Ok(*motion),
            (Some((from, a)), Some((to, b))) => Ok(a.towards(*b, (time - from) as f64 / (to - from) as f64)),
            (Some((newest, _)), None) => Err(Outside::Future(*newest)),
            (None, Some((oldest, _))) => Err(Outside::Past(*oldest)),
            (None, None) => Err(Outside::Future(0)),
        }
    }
}
