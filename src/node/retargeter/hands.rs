//! Hands as messages bring them, and what of them the robot follows.

use anyhow::Context as _;
use glam::DVec3;

use super::path_of;
use crate::error::{Error, Result};
use crate::hand::{HandModel, N_KEYPOINTS, Side, Topology};
use crate::message::{HandPose, Header, PoseArray, TactileFrame};
use crate::node::params::Parameters;
use crate::retarget::human::Hand;
use crate::retarget::{Pool, Touch};

/// A hand as it came.
pub enum Seen {
    /// With joint angles and shape.
    Pose(Box<HandPose>),
    /// 21 points of any hand tracker.
    Keypoints(Box<PoseArray>),
}

impl Seen {
    /// Stamp and frame.
    pub fn header(&self) -> &Header {
        match self {
            Self::Pose(pose) => &pose.header,
            Self::Keypoints(array) => &array.header,
        }
    }
}

/// Models of the hand that is followed.
pub struct Hands {
    side: Side,
    /// With what its vertices pool to.
    models: Vec<(HandModel, Pool)>,
}

impl Hands {
    /// The built-in hand of a side and, if its parameter names a file, that of MANO.
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
        let pooled = models.into_iter().map(|model| Pool::new(&model).map(|pool| (model, pool)));
        Ok(Self { side, models: pooled.collect::<Result<_>>()? })
    }

    fn of(&self, topology: Topology) -> Result<&(HandModel, Pool)> {
        let found = self.models.iter().find(|(model, _)| model.topology == topology);
        let expected = format!("{}, or the parameter mano_{}", Topology::EgotacHand1.id(), self.side.name());
        found.ok_or_else(|| Error::value("topology", expected, topology.id()))
    }

    /// The keypoints of a hand, m.
    pub fn keypoints(&self, seen: &Seen) -> Result<[DVec3; N_KEYPOINTS]> {
        match seen {
            Seen::Pose(pose) => {
                let (model, _) = self.of(Topology::from_id(&pose.topology)?)?;
                Ok(Hand::of_model(model, &pose.to_params(model)?))
            }
            Seen::Keypoints(array) => {
                let points: Vec<DVec3> = array
                    .poses
                    .iter()
                    .map(|pose| DVec3::new(pose.position.x, pose.position.y, pose.position.z))
                    .collect();
                points.try_into().map_err(|points: Vec<_>| Error::shape("poses", N_KEYPOINTS, [points.len()]))
            }
        }
    }

    /// The touch of a frame; None if it says nothing about this hand.
    pub fn touch(&self, frame: &TactileFrame) -> Result<Option<Touch>> {
        if !frame.hands.iter().any(|hand| hand.side == self.side as u8) {
            return Ok(None);
        }
        let (_, pool) = self.of(Topology::from_id(&frame.topology)?)?;
        let field = frame.to_field()?;
        let mut touch = Touch::default();
        pool.add(&field.force[self.side.range()], &field.contact[self.side.range()], &mut touch)?;
        Ok(Some(touch))
    }
}
