//! Poses, transforms and wrenches: `geometry_msgs`, `tf2_msgs`.

use super::common::Header;
use crate::message::message;

message! {
    /// A position, m.
    #[derive(Copy, Default)]
    #[allow(missing_docs)]
    Point = "geometry_msgs/msg/Point" { x: f64, y: f64, z: f64 }

    /// A rotation.
    #[derive(Copy)]
    #[allow(missing_docs)]
    Quaternion = "geometry_msgs/msg/Quaternion" { x: f64, y: f64, z: f64, w: f64 }

    /// A position and a rotation.
    #[derive(Copy, Default)]
    Pose = "geometry_msgs/msg/Pose" {
        /// Position, m.
        position: Point,
        /// Orientation.
        orientation: Quaternion,
    }

    /// Three numbers with a direction.
    #[derive(Copy, Default)]
    #[allow(missing_docs)]
    Vector3 = "geometry_msgs/msg/Vector3" { x: f64, y: f64, z: f64 }

    /// A force and a torque.
    #[derive(Copy, Default)]
    Wrench = "geometry_msgs/msg/Wrench" {
        /// Force, N.
        force: Vector3,
        /// Torque, N m.
        torque: Vector3,
    }

    /// A force and a torque at a time.
    #[derive(Default)]
    WrenchStamped = "geometry_msgs/msg/WrenchStamped" {
        /// Time, and coordinate frame of the wrench; the torque is about the frame's origin.
        header: Header,
        /// The wrench.
        wrench: Wrench,
    }

    /// A rotation and then a translation.
    #[derive(Copy, Default)]
    Transform = "geometry_msgs/msg/Transform" {
        /// Translation, m.
        translation: Vector3,
        /// Rotation.
        rotation: Quaternion,
    }

    /// Pose of a coordinate frame in its parent.
    #[derive(Default)]
    TransformStamped = "geometry_msgs/msg/TransformStamped" {
        /// Time, and name of the parent frame.
        header: Header,
        /// Name of the frame.
        child_frame_id: String,
        /// Pose of the frame in its parent.
        transform: Transform,
    }

    /// Transforms of a tree of coordinate frames.
    #[derive(Default)]
    TFMessage = "tf2_msgs/msg/TFMessage" {
        /// The transforms.
        transforms: Vec<TransformStamped>,
    }

    /// A pose at a time.
    PoseStamped = "geometry_msgs/msg/PoseStamped" {
        /// Time, and coordinate frame of the pose.
        header: Header,
        /// The pose.
        pose: Pose,
    }

    /// Several poses.
    PoseArray = "geometry_msgs/msg/PoseArray" {
        /// Time, and coordinate frame of the poses.
        header: Header,
        /// The poses.
        poses: Vec<Pose>,
    }
}

impl Default for Quaternion {
    /// Returns the identity.
    fn default() -> Self {
        Self { x: 0.0, y: 0.0, z: 0.0, w: 1.0 }
    }
}
