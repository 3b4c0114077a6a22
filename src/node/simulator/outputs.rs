//! Topics of the node `simulator`.

use glam::{DQuat, DVec3};

use crate::camera::{Distortion, Intrinsics};
use crate::hand::{HandModel, Side};
use crate::message::{
    CameraInfo, Clock, CompressedImage, HandPose, HandPoses, Header, Image, Point, Quaternion, RegionOfInterest,
    TactileFrame, TactileTruth, Time,
};
use crate::node::images::jpeg;
use crate::node::params::Parameters;
use crate::node::publisher::Publisher;
use crate::node::qos;
use crate::node::runtime::Runtime;
use crate::sim::SimFrame;
use crate::sim::camera::CameraPose;

/// Publishers of a simulated frame.
pub(super) struct Outputs {
    frame_id: String,
    image: Publisher<Image>,
    compressed: Option<Publisher<CompressedImage>>,
    camera_info: Publisher<CameraInfo>,
    truth: Publisher<TactileTruth>,
    hand_pose: Publisher<HandPose>,
    hand_poses: Publisher<HandPoses>,
    clock: Option<Publisher<Clock>>,
    hands: [HandModel; 2],
    sequence: u64,
}

impl Outputs {
    /// Creates the publishers that the parameters ask for.
    ///
    /// # Errors
    /// If ROS refuses a topic.
    pub(super) fn create(runtime: &mut Runtime, parameters: &Parameters) -> anyhow::Result<Self> {
        let compressed = parameters.get::<bool>("compressed");
        let compressed_topic = format!("{}/compressed", runtime.resolve("image_raw"));
        let with_clock = parameters.get::<String>("pace") != "wall";
        Ok(Self {
            frame_id: parameters.get("frame_id"),
            image: runtime.publisher("image_raw", qos::image_output())?,
            compressed: compressed.then(|| runtime.publisher(&compressed_topic, qos::image_output())).transpose()?,
            camera_info: runtime.publisher("camera_info", qos::every_output())?,
            truth: runtime.publisher("truth/tactile", qos::every_output())?,
            hand_pose: runtime.publisher("truth/hand_pose", qos::every_output())?,
            hand_poses: runtime.publisher("truth/hand_poses", qos::every_output())?,
            clock: with_clock.then(|| runtime.publisher("/clock", qos::every_output())).transpose()?,
            hands: Side::BOTH.map(HandModel::builtin),
            sequence: 0,
        })
    }

    /// Returns the number of subscribers of the images.
    pub(super) fn image_subscribers(&self) -> usize {
        self.image.subscriber_count() + self.compressed.as_ref().map_or(0, Publisher::subscriber_count)
    }

    /// Returns the number of subscribers of all topics of a frame.
    pub(super) fn subscribers(&self) -> usize {
        self.image_subscribers()
            + self.camera_info.subscriber_count()
            + self.truth.subscriber_count()
            + self.hand_pose.subscriber_count()
            + self.hand_poses.subscriber_count()
    }

    /// Publishes all messages of a frame with one stamp. The truth precedes the image, so that it arrives before the
    /// prediction.
    ///
    /// # Errors
    /// If the node is gone or the middleware refuses a message.
    pub(super) fn publish(
        &mut self,
        frame: &SimFrame,
        scene: &str,
        intrinsics: Intrinsics,
        stamp: Time,
    ) -> anyhow::Result<()> {
        if let Some(clock) = &self.clock {
            clock.publish(&Clock { clock: stamp })?;
        }
        let header = Header { stamp, frame_id: self.frame_id.clone() };
        self.publish_truth(frame, scene, &header)?;
        self.camera_info.publish(&camera_info(header.clone(), intrinsics))?;
        let image = &frame.frame.camera_ego_rgb;
        if let Some(compressed) = &self.compressed {
            compressed.publish(&jpeg(header.clone(), image)?)?;
        }
        self.image.publish(&Image::from_rgb(header, image))
    }

    /// Publishes the true touch and the true poses of the hands in the scene.
    fn publish_truth(&mut self, frame: &SimFrame, scene: &str, header: &Header) -> anyhow::Result<()> {
        let data = &frame.frame;
        let poses = [&data.left_hand_pose, &data.right_hand_pose];
        let mut truth = TactileFrame::from_field(header.clone(), &data.field)?;
        for (hand, pose) in truth.hands.iter_mut().zip(poses) {
            hand.score = f32::from(u8::from(pose.is_some()));
        }
        truth.sequence = self.sequence;
        truth.model_id = format!("simulator/{scene}");
        self.sequence += 1;
        self.truth.publish(&TactileTruth::new(truth, data.validity))?;
        let known = self.hands.iter().zip(poses).filter_map(|(model, params)| Some((model, params.as_ref()?)));
        let poses: Vec<HandPose> = known
            .map(|(model, params)| {
                let mut pose = HandPose::from_params(header.clone(), model, params);
                pose.confidence = 1.0;
                transform_to_camera(&mut pose, &frame.camera);
                pose
            })
            .collect();
        for pose in &poses {
            self.hand_pose.publish(pose)?;
        }
        self.hand_poses.publish(&HandPoses::new(header.clone(), poses))
    }
}

/// Transforms the wrist from the world frame to the camera's optical frame, which the header names.
fn transform_to_camera(pose: &mut HandPose, camera: &CameraPose) {
    let Point { x, y, z } = pose.wrist.position;
    let position = camera.camera_from_world(DVec3::new(x, y, z));
    let Quaternion { x, y, z, w } = pose.wrist.orientation;
    let orientation = (camera.orientation.inverse() * DQuat::from_xyzw(x, y, z, w)).normalize();
    pose.wrist.position = Point { x: position.x, y: position.y, z: position.z };
    pose.wrist.orientation = Quaternion { x: orientation.x, y: orientation.y, z: orientation.z, w: orientation.w };
}

fn camera_info(header: Header, intrinsics: Intrinsics) -> CameraInfo {
    let Intrinsics { width, height, fx, fy, cx, cy, distortion: Distortion([k1, k2]) } = intrinsics;
    CameraInfo {
        header,
        height,
        width,
        distortion_model: "plumb_bob".to_owned(),
        d: vec![k1, k2, 0.0, 0.0, 0.0],
        k: [fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0],
        r: [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        p: [fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0],
        binning_x: 0,
        binning_y: 0,
        roi: RegionOfInterest::default(),
    }
}
