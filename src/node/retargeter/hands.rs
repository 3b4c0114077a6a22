//! Messages of human hands, converted to keypoints and touch.

use anyhow::Context as _;
use glam::DVec3;

use super::keypoint_layout::KeypointLayout;
use super::path_of;
use crate::error::{Error, Result};
use crate::hand::{HandModel, N_KEYPOINTS, Side, Topology};
use crate::message::{HandPose, Header, PoseArray, TactileFrame};
use crate::node::params::Parameters;
use crate::retarget::human::Hand;
use crate::retarget::{Touch, TouchPooling};

/// Message of a human hand.
pub enum HandMessage {
    /// MANO parameters.
    Pose(Box<HandPose>),
    /// Positions of any hand tracker.
    Keypoints(Box<PoseArray>),
}

impl HandMessage {
    /// Header of the message.
    pub fn header(&self) -> &Header {
        match self {
            Self::Pose(pose) => &pose.header,
            Self::Keypoints(array) => &array.header,
        }
    }
}

/// Models of the hand that is followed, one for each topology.
pub struct HandModels {
    side: Side,
    /// Order of the positions of trackers.
    layout: KeypointLayout,
    models: Vec<(HandModel, TouchPooling)>,
}

impl HandModels {
    /// Loads the built-in hand of a side and, if its parameter names a file, that of MANO.
    ///
    /// # Errors
    /// If the file can't be used.
    pub fn load(parameters: &Parameters, side: Side) -> anyhow::Result<Self> {
        let mut models = vec![HandModel::builtin(side)];
        let name = match side {
            Side::Left => "mano_left",
            Side::Right => "mano_right",
        };
        if let Some(path) = path_of(parameters, name) {
            models.push(HandModel::load(&path, side).with_context(|| format!("parameter {name}"))?);
        }
        let pooled = models.into_iter().map(|model| TouchPooling::new(&model).map(|pooling| (model, pooling)));
        Ok(Self { side, layout: KeypointLayout::of(parameters), models: pooled.collect::<Result<_>>()? })
    }

    /// Returns the model of a topology.
    fn of(&self, topology: Topology) -> Result<&(HandModel, TouchPooling)> {
        let found = self.models.iter().find(|(model, _)| model.topology == topology);
        let expected = format!("{}, or the parameter mano_{}", Topology::EgotacHand1.id(), self.side.name());
        found.ok_or_else(|| Error::value("topology", expected, topology.id()))
    }

    /// Returns the keypoints of a hand, m.
    pub fn keypoints(&self, seen: &HandMessage) -> Result<[DVec3; N_KEYPOINTS]> {
        match seen {
            HandMessage::Pose(pose) => {
                let (model, _) = self.of(Topology::from_id(&pose.topology)?)?;
                Ok(Hand::of_model(model, &pose.to_params(model)?))
            }
            HandMessage::Keypoints(array) => {
                let points: Vec<DVec3> = array
                    .poses
                    .iter()
                    .map(|pose| DVec3::new(pose.position.x, pose.position.y, pose.position.z))
                    .collect();
                self.layout.keypoints(&points)
            }
        }
    }

    /// Returns the touch of a frame; None if it does not contain this hand, or nothing is known of it.
    pub fn touch(&self, frame: &TactileFrame) -> Result<Option<Touch>> {
        if !frame.hands.iter().any(|hand| hand.side == self.side as u8) {
            return Ok(None);
        }
        let (_, pooling) = self.of(Topology::from_id(&frame.topology)?)?;
        let field = frame.to_field()?;
        if field.is_unknown(self.side) {
            return Ok(None);
        }
        let mut touch = Touch::default();
        pooling.pool_into(&field.force[self.side.range()], &field.contact[self.side.range()], &mut touch)?;
        Ok(Some(touch))
    }
}
