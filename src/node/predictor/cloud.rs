//! Topic `~/points`: the field as a point cloud on the newest hand poses.

use std::sync::{Arc, Mutex};

use crate::hand::HandModel;
use crate::message::{HandPose, Header, PointCloud2};
use crate::node::input_topics::{InputTopic, Need};
use crate::node::lock::lock;
use crate::node::log::Log;
use crate::node::params::Parameters;
use crate::node::point_cloud::{self, PosedHand, point_cloud};
use crate::node::publisher::Publisher;
use crate::node::qos;
use crate::node::runtime::Runtime;
use crate::tactile::TactileField;

/// Largest difference between the stamps of an image and of a hand pose that is drawn for it, s: five frames at 25 Hz.
const MAX_POSE_AGE_SECS: f64 = 0.2;

/// Frame of hands whose pose is unknown: they are nowhere in the camera's frame.
const REST_FRAME: &str = "hand_rest";

/// Newest pose of each hand, left first.
type Poses = Arc<Mutex<[Option<HandPose>; 2]>>;

/// Publishes the point cloud.
pub(super) struct Cloud {
    publisher: Publisher<PointCloud2>,
    hands: [HandModel; 2],
    /// Vertices of both hands while their poses are unknown.
    rest: Vec<PosedHand>,
    poses: Poses,
    parameters: Arc<Parameters>,
    log: Log,
}

impl Cloud {
    /// Creates the publisher for `hands`, left first, and subscribes to their poses.
    ///
    /// # Errors
    /// If ROS refuses a topic.
    pub(super) fn create(runtime: &mut Runtime, hands: [HandModel; 2]) -> anyhow::Result<Self> {
        let poses = Poses::default();
        subscribe_poses(runtime, Arc::clone(&poses))?;
        Ok(Self {
            publisher: runtime.publisher("~/points", qos::output())?,
            rest: point_cloud::rest_hands(&hands),
            hands,
            poses,
            parameters: Arc::clone(runtime.parameters()),
            log: runtime.log().clone(),
        })
    }

    /// Publishes `field` if the topic has a subscriber and the hands are of its topology.
    ///
    /// # Errors
    /// If the node is gone or the middleware refuses the message.
    pub(super) fn publish(&self, header: Header, field: &TactileField) -> anyhow::Result<()> {
        let wanted = self.parameters.get::<bool>("publish_points") && self.publisher.subscriber_count() > 0;
        if !wanted || field.topology != self.hands[0].topology {
            return Ok(());
        }
        let threshold = self.parameters.get::<f64>("contact_threshold") as f32;
        let cloud = match self.posed_hands(&header) {
            Some((frame_id, hands)) => point_cloud(Header { stamp: header.stamp, frame_id }, field, &hands, threshold),
            None => {
                let header = Header { stamp: header.stamp, frame_id: REST_FRAME.into() };
                point_cloud(header, field, &self.rest, threshold)
            }
        };
        self.publisher.publish(&cloud)
    }

    /// Returns the hands whose pose is known at the image's time, and the frame they are in.
    fn posed_hands(&self, image: &Header) -> Option<(String, Vec<PosedHand>)> {
        let poses = lock(&self.poses).clone();
        let mut frame_id = None;
        let mut hands = Vec::new();
        for (pose, model) in poses.iter().zip(&self.hands) {
            let Some(pose) = pose else { continue };
            if (pose.header.stamp.secs() - image.stamp.secs()).abs() > MAX_POSE_AGE_SECS {
                continue;
            }
            if *frame_id.get_or_insert_with(|| pose.header.frame_id.clone()) != pose.header.frame_id {
                self.log.warn_throttled("frames", "hand_pose: the hands are in different frames; only one is drawn");
                continue;
            }
            match pose.to_params(model) {
                Ok(params) => hands.push(PosedHand { side: model.side, vertices: model.forward(&params).vertices }),
                Err(error) => self.log.warn_throttled("hand_pose", format!("hand_pose: {error}")),
            }
        }
        (!hands.is_empty()).then(|| (frame_id.unwrap_or_default(), hands))
    }
}

fn subscribe_poses(runtime: &mut Runtime, poses: Poses) -> anyhow::Result<()> {
    let log = runtime.log().clone();
    let input = InputTopic {
        name: "hand_pose".into(),
        content: "poses of the hands",
        qos: qos::newest_input().keep_last(4),
        matches: false,
        need: Need::Optional,
    };
    runtime.input::<HandPose>(input, move |pose| match pose.and_then(|pose| Ok((pose.side()?, pose))) {
        Ok((side, pose)) => lock(&poses)[side as usize] = Some(pose),
        Err(error) => log.warn_throttled("hand_pose", format!("hand_pose: {error}")),
    })
}
