//! Rigid poses and their noise.

use glam::{DQuat, DVec3};

/// Pose `world_from_body`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pose {
    /// Position of the body's origin, m.
    pub position: DVec3,
    /// Orientation, a unit quaternion.
    pub orientation: DQuat,
}

impl Pose {
    /// Pose of a body whose frame is the world's.
    pub const IDENTITY: Self = Self { position: DVec3::ZERO, orientation: DQuat::IDENTITY };

    /// Reads position and quaternion (w, x, y, z) as stores hold them; `None` if a number is not finite or the quaternion is
    /// far from unit length.
    pub fn from_row(row: &[f32; 7]) -> Option<Self> {
        let [x, y, z, w, i, j, k] = row.map(f64::from);
        let (position, orientation) = (DVec3::new(x, y, z), DQuat::from_xyzw(i, j, k, w));
        let length = orientation.length();
        let is_pose = position.is_finite() && (0.5..2.0).contains(&length);
        is_pose.then(|| Self { position, orientation: orientation / length })
    }

    /// Returns the world place of a point of the body, m.
    pub fn point(&self, local: DVec3) -> DVec3 {
        self.position + self.orientation * local
    }

    /// Returns the pose whose frame `other` is given in.
    pub fn of(&self, other: &Self) -> Self {
        Self { position: self.point(other.position), orientation: self.orientation * other.orientation }
    }

    /// Returns the place of a world point in the body's frame, m.
    pub fn local(&self, world: DVec3) -> DVec3 {
        self.orientation.inverse() * (world - self.position)
    }
}

/// Standard deviations of independent noise in every pose of a recording.
#[derive(Debug, Clone, Copy, PartialEq, Default, serde::Serialize)]
pub struct PoseNoise {
    /// Per axis of the position, m.
    pub position: f64,
    /// Per axis of the rotation, rad.
    pub rotation: f64,
}

/// Median of the chi-square distribution with three degrees of freedom.
const CHI_SQUARE_MEDIAN: f64 = 2.365_974;
/// Sum of the squared binomials of the fourth difference.
const FOURTH_SQUARE: f64 = 70.0;

impl PoseNoise {
    /// Estimates the noise of poses at about equal times from their fourth differences, which smooth motion hardly has;
    /// zero with fewer than five poses in a row. Noise that changes slowly from frame to frame does not show.
    pub fn estimate(poses: &[Option<Pose>]) -> Self {
        let mut squares: [Vec<f64>; 2] = Default::default();
        for window in poses.windows(5) {
            let [Some(a), Some(b), Some(c), Some(d), Some(e)] = window else { continue };
            let position = a.position - 4.0 * b.position + 6.0 * c.position - 4.0 * d.position + e.position;
            let [a, b, d, e] = [a, b, d, e].map(|pose| aligned(pose.orientation, c.orientation));
            let rotation = a + b * -4.0 + c.orientation * 6.0 + d * -4.0 + e;
            squares[0].push(position.length_squared());
            squares[1].push(4.0 * rotation.length_squared());
        }
        let [position, rotation] = squares.map(|squares| match squares.is_empty() {
            true => 0.0,
            false => (crate::statistics::median(squares) / (FOURTH_SQUARE * CHI_SQUARE_MEDIAN)).sqrt(),
        });
        Self { position, rotation }
    }
}

/// Returns the sign of `q` that is nearer to `other`.
pub(super) fn aligned(q: DQuat, other: DQuat) -> DQuat {
    if q.dot(other) < 0.0 { -q } else { q }
}
