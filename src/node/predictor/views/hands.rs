//! Hands on which the views show touch: the newest poses, or hands at rest.

use std::sync::{Arc, Mutex};

use crate::hand::{HandModel, Side};
use crate::message::{HandPose, HandPoses, Header};
use crate::node::hand_confidence;
use crate::node::input_topics::{InputTopic, Need};
use crate::node::lock::lock;
use crate::node::log::Log;
use crate::node::params::Parameters;
use crate::node::placed_hand::{self, PlacedHand};
use crate::node::predictor::camera::Camera;
use crate::node::qos;
use crate::node::runtime::Runtime;

/// Largest difference between the stamps of an image and of a hand pose that is drawn for it, s: five frames at 25 Hz.
const MAX_POSE_AGE_SECS: f64 = 0.2;

/// Frame of hands whose pose is unknown: they are nowhere in the camera's frame.
const REST_FRAME: &str = "hand_rest";

/// Newest pose of each hand, left first.
type Poses = Arc<Mutex<[Option<HandPose>; 2]>>;

/// Hands on which the views show touch.
pub(super) struct Hands {
    /// Models of both hands, left first.
    pub(super) models: [HandModel; 2],
    /// Hands while their poses are unknown.
    rest: Vec<PlacedHand>,
    poses: Poses,
    log: Log,
}

impl Hands {
    /// Subscribes to the poses of the hands `models`, left first, in the view of a camera.
    ///
    /// # Errors
    /// If ROS refuses a topic.
    pub(super) fn subscribe(runtime: &mut Runtime, camera: &Camera, models: [HandModel; 2]) -> anyhow::Result<Self> {
        let poses = Poses::default();
        subscribe_poses(runtime, camera, &poses)?;
        Ok(Self { rest: placed_hand::rest_hands(&models), models, poses, log: runtime.log().clone() })
    }

    /// Returns the hands at the image's time with the stamp and the frame that they are in: those whose pose is known, or else both
    /// at rest.
    pub(super) fn at(&self, image: &Header) -> (Header, Vec<PlacedHand>) {
        let (frame_id, hands) = self.posed_hands(image).unwrap_or_else(|| (REST_FRAME.to_owned(), self.rest.clone()));
        (Header { stamp: image.stamp, frame_id }, hands)
    }

    /// Returns the hands whose pose is known at the image's time, and the frame they are in.
    fn posed_hands(&self, image: &Header) -> Option<(String, Vec<PlacedHand>)> {
        let poses = lock(&self.poses).clone();
        let mut frame_id = None;
        let mut hands = Vec::new();
        for (pose, model) in poses.iter().zip(&self.models) {
            let Some(pose) = pose else { continue };
            if (pose.header.stamp.secs() - image.stamp.secs()).abs() > MAX_POSE_AGE_SECS {
                continue;
            }
            if *frame_id.get_or_insert_with(|| pose.header.frame_id.clone()) != pose.header.frame_id {
                self.log.warn_throttled("frames", "hand poses: the hands are in different frames; only one is drawn");
                continue;
            }
            match pose.to_params(model) {
                Ok(params) => hands.push(PlacedHand { side: model.side, posed: model.forward(&params) }),
                Err(error) => self.log.warn_throttled("hand_pose", format!("hand pose: {error}")),
            }
        }
        (!hands.is_empty()).then(|| (frame_id.unwrap_or_default(), hands))
    }
}

/// Subscribes to poses of one hand per message, and of both.
fn subscribe_poses(runtime: &mut Runtime, camera: &Camera, poses: &Poses) -> anyhow::Result<()> {
    let input = InputTopic {
        name: camera.input("hand_pose"),
        content: "poses of the hands",
        qos: qos::newest_input().keep_last(4),
        matches: false,
        need: Need::Optional,
    };
    let both = InputTopic { name: camera.input("hand_poses"), ..input.clone() };
    let (single, log) = (keeper(runtime, poses), runtime.log().clone());
    runtime.input::<HandPose>(input, move |pose| match pose.and_then(|pose| Ok((pose.side()?, pose))) {
        Ok((side, pose)) => single(side, pose),
        Err(error) => log.warn_throttled("hand_pose", format!("hand_pose: {error}")),
    })?;
    let (each, log) = (keeper(runtime, poses), runtime.log().clone());
    runtime.input::<HandPoses>(both, move |poses| match poses.and_then(HandPoses::into_poses) {
        Ok(poses) => poses.into_iter().for_each(|(side, pose)| each(side, pose)),
        Err(error) => log.warn_throttled("hand_poses", format!("hand_poses: {error}")),
    })
}

/// Returns a function that keeps a pose if its confidence is high enough.
fn keeper(runtime: &Runtime, poses: &Poses) -> impl Fn(Side, HandPose) + 'static {
    let (parameters, poses): (Arc<Parameters>, Poses) = (Arc::clone(runtime.parameters()), Arc::clone(poses));
    move |side, pose| {
        if hand_confidence::is_enough(&parameters, pose.confidence) {
            lock(&poses)[side as usize] = Some(pose);
        }
    }
}
