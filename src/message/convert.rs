//! Conversions between the library's types and messages.

use ::image::RgbImage;
use glam::{DQuat, DVec3, Vec3};

use super::{
    HandKeypoints, HandPose, HandPoses, HandTactile, Header, Image, Point, Pose, Quaternion, TactileFrame,
    TactileRegions, TactileTruth,
};
use crate::error::{Error, Result};
use crate::hand::{HandModel, HandParams, N_KEYPOINTS, Region, Side, Topology};
use crate::image::Preparation;
use crate::model::Prediction;
use crate::tactile::{Certainty, TactileField, Validity};

impl HandTactile {
    /// Creates the message of one hand of a field.
    ///
    /// # Errors
    /// If the field does not hold 1556 forces and contacts.
    pub fn from_field(field: &TactileField, side: Side, score: f32) -> Result<Self> {
        let hand = |name, values: &[f32]| {
            let hand = values.get(side.range()).and_then(|hand| hand.try_into().ok());
            hand.ok_or_else(|| Error::shape(name, "[1556]", [values.len()]))
        };
        Ok(Self {
            side: side_code(side),
            score,
            force: hand("force", &field.force)?,
            contact: hand("contact", &field.contact)?,
            total_force: field.total_force(side),
        })
    }
}

impl TactileFrame {
    /// Creates the message of both hands of a field, left first. Score, inference time and model are unknown and the
    /// sequence number is 0; the caller sets the values that it knows.
    ///
    /// # Errors
    /// If the field does not hold 1556 forces and contacts.
    pub fn from_field(header: Header, field: &TactileField) -> Result<Self> {
        let hands = Side::BOTH.map(|side| HandTactile::from_field(field, side, f32::NAN));
        Ok(Self {
            header,
            hands: hands.into_iter().collect::<Result<_>>()?,
            sequence: 0,
            inference_secs: f64::NAN,
            model_id: String::new(),
            topology: field.topology.id().to_owned(),
            warming_up: false,
            familiarity: f32::NAN,
            reason: String::new(),
        })
    }

    /// Sets familiarity, presence of the hands and reason to those of a network's certainty.
    #[must_use]
    pub fn with_certainty(mut self, certainty: &Certainty) -> Self {
        self.familiarity = certainty.familiarity.unwrap_or(f32::NAN);
        for (hand, presence) in self.hands.iter_mut().zip(certainty.presence) {
            hand.score = presence.unwrap_or(f32::NAN);
        }
        self.reason = certainty.reason();
        self
    }

    /// Returns the field of both hands; a hand that is missing from the message is zero.
    ///
    /// # Errors
    /// If the topology or a side is unknown, a side occurs twice, a force is negative or infinite, or a contact is not
    /// within 0 to 1 (NaN means unknown and passes).
    pub fn to_field(&self) -> Result<TactileField> {
        let mut field = TactileField::zeros(Topology::from_id(&self.topology)?);
        let mut seen = [false; 2];
        for (index, hand) in self.hands.iter().enumerate() {
            let name = |field: &str| format!("hands[{index}].{field}");
            let side =
                side_from_code(hand.side).map_err(|got| Error::value(name("side"), "0 (left) or 1 (right)", got))?;
            if std::mem::replace(&mut seen[usize::from(hand.side)], true) {
                return Err(Error::value(name("side"), "each hand once", format!("{} twice", side.name())));
            }
            if let Some(vertex) = hand.force.iter().position(|f| *f < 0.0 || f.is_infinite()) {
                return Err(Error::value(
                    name(&format!("force[{vertex}]")),
                    "a number >= 0 or NaN",
                    hand.force[vertex],
                ));
            }
            if let Some(vertex) = hand.contact.iter().position(|c| *c < 0.0 || *c > 1.0) {
                let got = hand.contact[vertex];
                return Err(Error::value(name(&format!("contact[{vertex}]")), "a number from 0 to 1 or NaN", got));
            }
            field.force[side.range()].copy_from_slice(&hand.force);
            field.contact[side.range()].copy_from_slice(&hand.contact);
        }
        Ok(field)
    }
}

impl TactileTruth {
    /// Creates the truth of one simulated frame.
    pub fn new(frame: TactileFrame, validity: Validity) -> Self {
        Self { header: frame.header.clone(), frame, validity: validity.code(), reason: validity.reason().to_owned() }
    }

    /// Returns the frame's validity: valid, or the guard that refused it.
    ///
    /// # Errors
    /// If the code is unknown.
    pub fn validity(&self) -> Result<Validity> {
        Validity::from_code("validity", self.validity)
    }
}

impl HandPose {
    /// Creates the message of `model` posed by `params`, given in `header.frame_id`. The confidence is NaN; a
    /// caller that knows it sets it.
    pub fn from_params(header: Header, model: &HandModel, params: &HandParams) -> Self {
        let position = rest_wrist(model, params) + params.transl.as_dvec3();
        let orientation = DQuat::from_scaled_axis(params.global_orient.as_dvec3());
        let mut hand_pose = [0.0; 45];
        for (chunk, joint) in hand_pose.chunks_exact_mut(3).zip(&params.hand_pose) {
            chunk.copy_from_slice(&joint.to_array());
        }
        Self {
            header,
            side: side_code(model.side),
            topology: model.topology.id().to_owned(),
            wrist: Pose {
                position: Point { x: position.x, y: position.y, z: position.z },
                orientation: Quaternion { x: orientation.x, y: orientation.y, z: orientation.z, w: orientation.w },
            },
            hand_pose,
            betas: params.betas,
            confidence: f32::NAN,
        }
    }

    /// Returns the side of the hand.
    ///
    /// # Errors
    /// If the code is unknown.
    pub fn side(&self) -> Result<Side> {
        side_from_code(self.side).map_err(|got| Error::value("side", "0 (left) or 1 (right)", got))
    }

    /// Returns the parameters of `model` that give this pose.
    ///
    /// # Errors
    /// If the message is for another hand or topology, a number is not finite, or the orientation is not a rotation.
    pub fn to_params(&self, model: &HandModel) -> Result<HandParams> {
        if self.side()? != model.side {
            return Err(Error::value("side", format!("{} ({})", side_code(model.side), model.side.name()), self.side));
        }
        Topology::from_id(&self.topology)?.must_match(model.topology)?;
        let Point { x, y, z } = self.wrist.position;
        let position = DVec3::new(x, y, z);
        let Quaternion { x, y, z, w } = self.wrist.orientation;
        let orientation = DQuat::from_xyzw(x, y, z, w);
        if !position.is_finite() {
            return Err(Error::value("wrist.position", "finite numbers", position));
        }
        // Publishers round quaternions: accept a small error of length, refuse what is not a rotation.
        let length = orientation.length();
        if !length.is_finite() || (length - 1.0).abs() > 1e-3 {
            return Err(Error::value("wrist.orientation", "a unit quaternion", format!("length {length}")));
        }
        for (name, values) in [("hand_pose", &self.hand_pose[..]), ("betas", &self.betas[..])] {
            if let Some(index) = values.iter().position(|value| !value.is_finite()) {
                return Err(Error::value(format!("{name}[{index}]"), "a finite number", values[index]));
            }
        }
        let mut params = HandParams {
            betas: self.betas,
            global_orient: orientation.normalize().to_scaled_axis().as_vec3(),
            hand_pose: std::array::from_fn(|joint| Vec3::from_slice(&self.hand_pose[3 * joint..])),
            transl: Vec3::ZERO,
        };
        params.transl = (position - rest_wrist(model, &params)).as_vec3();
        Ok(params)
    }
}

impl HandPoses {
    /// Creates the message of the poses of one image. Each pose gets `header`.
    pub fn new(header: Header, poses: impl IntoIterator<Item = HandPose>) -> Self {
        let poses = poses.into_iter().map(|pose| HandPose { header: header.clone(), ..pose }).collect();
        Self { header, poses }
    }

    /// Returns the poses with their sides. The header of the array replaces that of each pose.
    ///
    /// # Errors
    /// If a side is unknown or occurs twice.
    pub fn into_poses(self) -> Result<Vec<(Side, HandPose)>> {
        let mut poses: Vec<(Side, HandPose)> = Vec::with_capacity(self.poses.len());
        for (index, pose) in self.poses.into_iter().enumerate() {
            let name = format!("poses[{index}].side");
            let side = side_from_code(pose.side).map_err(|got| Error::value(&name, "0 (left) or 1 (right)", got))?;
            if poses.iter().any(|(other, _)| *other == side) {
                return Err(Error::value(name, "each hand once", format!("{} twice", side.name())));
            }
            poses.push((side, HandPose { header: self.header.clone(), ..pose }));
        }
        Ok(poses)
    }
}

impl TactileRegions {
    /// Sums up a frame of a hand whose vertices lie in `regions`, (778) of the left and the right hand. A hand that is missing from
    /// the frame is zero, with presence 0.
    ///
    /// # Errors
    /// As [`TactileFrame::to_field`].
    pub fn from_frame(frame: &TactileFrame, regions: &[Vec<Region>; 2]) -> Result<Self> {
        let field = frame.to_field()?;
        let (force, contact) = (field.region_forces(regions), field.region_contacts(regions));
        let array = |name, values: Vec<f32>| {
            let got = values.len();
            values.try_into().map_err(|_| Error::shape(name, "[34]", [got]))
        };
        let mut presence = [0.0; 2];
        for hand in &frame.hands {
            presence[usize::from(hand.side)] = hand.score;
        }
        Ok(Self {
            header: frame.header.clone(),
            force: array("force", force)?,
            contact: array("contact", contact)?,
            presence,
        })
    }
}

impl HandKeypoints {
    /// Creates the message of an image of width and height `size`, pixels, that was prepared by `preparation`; None if the network
    /// does not estimate keypoints.
    pub fn from_prediction(
        header: Header,
        prediction: &Prediction,
        preparation: &Preparation,
        (width, height): (u32, u32),
    ) -> Option<Self> {
        let keypoints = prediction.keypoints(preparation, width, height)?;
        let presence = prediction.certainty.presence.map(|presence| presence.unwrap_or(f32::NAN));
        Some(Self::from_values(header, (width, height), presence, &keypoints))
    }

    /// Creates the message from the keypoints of both hands, (42) of x, y and confidence.
    pub fn from_values(
        header: Header,
        (width, height): (u32, u32),
        presence: [f32; 2],
        keypoints: &[[f32; 3]; 2 * N_KEYPOINTS],
    ) -> Self {
        let [x, y, confidence] = [0, 1, 2].map(|axis: usize| keypoints.map(|keypoint| keypoint[axis]));
        Self { header, width, height, presence, x, y, confidence }
    }
}

impl Image {
    /// Creates an `rgb8` message without row padding.
    pub fn from_rgb(header: Header, image: &RgbImage) -> Self {
        Self {
            header,
            height: image.height(),
            width: image.width(),
            encoding: "rgb8".to_owned(),
            is_bigendian: 0,
            step: 3 * image.width(),
            data: image.as_raw().clone(),
        }
    }
}

/// Position of the wrist joint J0(betas) before `transl`, m. Rotations turn the hand about this point.
fn rest_wrist(model: &HandModel, params: &HandParams) -> DVec3 {
    let shaped = HandParams { betas: params.betas, ..HandParams::default() };
    model.joints(&shaped)[0].as_dvec3()
}

fn side_code(side: Side) -> u8 {
    match side {
        Side::Left => HandTactile::LEFT,
        Side::Right => HandTactile::RIGHT,
    }
}

fn side_from_code(code: u8) -> std::result::Result<Side, u8> {
    match code {
        HandTactile::LEFT => Ok(Side::Left),
        HandTactile::RIGHT => Ok(Side::Right),
        other => Err(other),
    }
}
