//! The robot's wrist frame, found from its own fingers.

use glam::{DMat3, DVec3};

use super::fingers::Finger;
use crate::error::{Error, Result};
use crate::hand::Side;
use crate::mujoco::World;

/// The robot's wrist frame: palmar, radial, distal, as [`crate::retarget::human`] has them for people.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct WristFrame {
    /// Body it is fixed to.
    pub body: usize,
    /// Columns palmar, radial, distal in the body's frame.
    pub axes: DMat3,
    /// Which hand it is.
    pub side: Side,
}

impl WristFrame {
    /// Derives the frame: distal as the fingers point when they are straight, radial from the last finger's base to the
    /// first's, palmar to the side to which they close.
    ///
    /// # Errors
    /// If the fingers do not tell.
    pub fn derive(world: &World, fingers: &[Finger], body: usize, side: Option<Side>) -> Result<Self> {
        let (_, rotation) = world.body_pose(body);
        let base = |finger: &Finger| world.joint_axis(finger.joints[0]).0;
        let knuckle = |finger: &Finger| finger.knuckles.last().map_or(base(finger), |joint| world.joint_axis(*joint).0);
        let tip = |finger: &Finger| place(world, finger);
        let others: Vec<&Finger> = fingers.iter().filter(|finger| finger.human != 0).collect();
        let Some(first) = others.first() else {
            return Err(Error::value(
                "wrist.frame",
                "rows palmar, radial, distal, as there is no finger but a thumb",
                "auto",
            ));
        };
        let pad: DVec3 = others.iter().map(|finger| normal(world, finger)).sum();
        let distal = match others.iter().all(|finger| finger.knuckles.is_empty()) {
            // Jaws on slides: across the way they close, from the root on.
            true => {
                let way = pad.normalize_or_zero();
                let middle = fingers.iter().map(tip).sum::<DVec3>() / fingers.len() as f64;
                (middle - world.body_pose(body).0).reject_from(way)
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
            return Err(Error::value(
                "wrist.frame",
                "rows palmar, radial, distal, as fingers do not tell them",
                "auto",
            ));
        };
        let palmar = radial.cross(distal);
        let closes_to = palmar.dot(pad);
        let side = side.unwrap_or(if closes_to >= 0.0 { Side::Right } else { Side::Left });
        let palmar = if side == Side::Right { palmar } else { -palmar };
        let axes = rotation.transpose() * DMat3::from_cols(palmar, radial, distal);
        Ok(Self { body, axes, side })
    }

    /// A frame that is given as rows in the body's frame.
    ///
    /// # Errors
    /// If the rows are not of unit length and at right angles.
    pub fn given(body: usize, rows: [[f64; 3]; 3]) -> Result<Self> {
        let axes = DMat3::from_cols_array_2d(&rows);
        let off = (axes.transpose() * axes - DMat3::IDENTITY)
            .to_cols_array()
            .into_iter()
            .fold(0.0, |a: f64, b| a.max(b.abs()));
        if off.is_nan() || off > 1e-3 {
            return Err(Error::value("wrist.frame", "rows of unit length at right angles", format!("{rows:?}")));
        }
        let side = if axes.determinant() > 0.0 { Side::Right } else { Side::Left };
        Ok(Self { body, axes, side })
    }

    /// Columns palmar, radial, distal in the world.
    pub fn world_axes(&self, world: &World) -> DMat3 {
        world.body_pose(self.body).1 * self.axes
    }
}

/// World position of a finger's tip.
pub fn place(world: &World, finger: &Finger) -> DVec3 {
    let (origin, rotation) = world.body_pose(finger.tip_body);
    origin + rotation * finger.tip
}

/// Outward normal of a finger's pad in the world.
pub fn normal(world: &World, finger: &Finger) -> DVec3 {
    world.body_pose(finger.tip_body).1 * finger.pad_normal
}
