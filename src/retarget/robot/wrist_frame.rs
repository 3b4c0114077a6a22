//! Wrist frame of a robot, derived from its fingers.

use glam::{DMat3, DVec3};

use super::fingers::Finger;
use crate::error::{Error, Result};
use crate::hand::Side;
use crate::mujoco::World;

/// Greatest deviation of a given frame from an orthonormal basis, per entry of axes^T axes.
const MAX_DEVIATION: f64 = 1e-3;

/// Wrist frame of a robot: palmar, radial, distal, as [`crate::retarget::human`] defines it for people.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct WristFrame {
    /// Body that it is fixed to.
    pub body: usize,
    /// Columns palmar, radial, distal in the body's frame.
    pub axes: DMat3,
    /// Side of the hand.
    pub side: Side,
}

impl WristFrame {
    /// Derives the frame: distal as the fingers point in the present pose, radial from the last finger's base to the
    /// first's, palmar to the side to which the fingers close. `side`: None = the side for which that is the palm.
    ///
    /// # Errors
    /// If there is no finger but a thumb, or the directions of the fingers cancel out.
    pub fn derive(world: &World, fingers: &[Finger], body: usize, side: Option<Side>) -> Result<Self> {
        let (_, rotation) = world.body_pose(body);
        let base = |finger: &Finger| world.joint_axis(finger.joints[0]).0;
        let knuckle = |finger: &Finger| finger.knuckles.last().map_or(base(finger), |joint| world.joint_axis(*joint).0);
        let tip = |finger: &Finger| finger.tip_position(world);
        let others: Vec<&Finger> = fingers.iter().filter(|finger| finger.human != 0).collect();
        let Some(first) = others.first() else {
            return Err(not_derivable("there is no finger but a thumb"));
        };
        let pad: DVec3 = others.iter().map(|finger| finger.world_pad_normal(world)).sum();
        let distal = match others.iter().all(|finger| finger.knuckles.is_empty()) {
            // Jaws on slides point from the root to the middle of their tips, across the direction in which they close.
            true => {
                let closing = pad.normalize_or_zero();
                let middle = fingers.iter().map(tip).sum::<DVec3>() / fingers.len() as f64;
                (middle - world.body_pose(body).0).reject_from(closing)
            }
            false => others.iter().map(|finger| (tip(finger) - base(finger)).normalize_or_zero()).sum(),
        };
        let distal = distal.try_normalize().or_else(|| (tip(first) - knuckle(first)).try_normalize());
        let last = others[others.len() - 1];
        let across = match others.len() {
            1 => distal.unwrap_or(DVec3::Z).cross(pad),
            _ => base(first) - base(last),
        };
        let (Some(distal), Some(radial)) =
            (distal, distal.and_then(|distal| across.reject_from_normalized(distal).try_normalize()))
        else {
            return Err(not_derivable("the directions of the fingers cancel out"));
        };
        let palmar = radial.cross(distal);
        let side = side.unwrap_or(if palmar.dot(pad) >= 0.0 { Side::Right } else { Side::Left });
        let palmar = if side == Side::Right { palmar } else { -palmar };
        let axes = rotation.transpose() * DMat3::from_cols(palmar, radial, distal);
        Ok(Self { body, axes, side })
    }

    /// Checks a frame that is given as rows palmar, radial, distal in the body's frame.
    ///
    /// # Errors
    /// If the rows are not orthonormal.
    pub fn given(body: usize, rows: [[f64; 3]; 3]) -> Result<Self> {
        let axes = DMat3::from_cols_array_2d(&rows);
        let deviation = (axes.transpose() * axes - DMat3::IDENTITY)
            .to_cols_array()
            .into_iter()
            .fold(0.0, |a: f64, b| a.max(b.abs()));
        if deviation.is_nan() || deviation > MAX_DEVIATION {
            return Err(Error::value("wrist.frame", "rows of unit length at right angles", format!("{rows:?}")));
        }
        let side = if axes.determinant() > 0.0 { Side::Right } else { Side::Left };
        Ok(Self { body, axes, side })
    }

    /// Returns the columns palmar, radial, distal in the world.
    pub fn world_axes(&self, world: &World) -> DMat3 {
        world.body_pose(self.body).1 * self.axes
    }
}

fn not_derivable(reason: &str) -> Error {
    Error::value("wrist.frame", format!("rows palmar, radial, distal, because {reason}"), "auto")
}
