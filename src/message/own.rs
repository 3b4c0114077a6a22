//! Messages of `egotac_msgs`, as `msg/*.msg` defines them.

use super::message;
use super::standard::{Header, Point, Pose, Time, Vector3, Wrench};
use crate::hand::{N_BETAS, N_KEYPOINTS, N_VERTICES};

message! {
    /// Touch on one hand.
    HandTactile = "egotac_msgs/msg/HandTactile" from "../../msg/HandTactile.msg" {
        /// [`HandTactile::LEFT`] or [`HandTactile::RIGHT`].
        side: u8,
        /// Confidence that this hand is in the image; NaN = unknown.
        score: f32,
        /// Normal force on each vertex, N, never negative; NaN = unknown.
        force: [f32; N_VERTICES],
        /// Contact probability of each vertex; NaN = unknown.
        contact: [f32; N_VERTICES],
        /// Sum of the forces, N; NaN where a force is unknown.
        total_force: f32,
    }

    /// Touch on both hands, as seen in one image.
    TactileFrame = "egotac_msgs/msg/TactileFrame" from "../../msg/TactileFrame.msg" {
        /// Copied from the newest image of the observation window.
        header: Header,
        /// At most one entry per hand, left first; empty = no result for this image.
        hands: Vec<HandTactile> [<= 2],
        /// Index of the frame at this publisher, from 0.
        sequence: u64,
        /// Time from the start of processing to the result, s; NaN = not applicable.
        inference_secs: f64,
        /// Producer: `model_id` of [`HandModelInfo`], or `simulator/<scene>`.
        model_id: String,
        /// Meaning of vertex indices: `egotac-hand-1` or `mano`.
        topology: String,
        /// True while the observation window is not full yet.
        warming_up: bool,
        /// Likeness of the image to the network's training images, 0 to 1; NaN = not estimated.
        familiarity: f32,
        /// Why touch of a hand is not known; empty = touch of both hands is known.
        reason: String,
    }

    /// Description of a predictor: its network and its hand model.
    HandModelInfo = "egotac_msgs/msg/HandModelInfo" from "../../msg/HandModelInfo.msg" {
        /// [`HandModelInfo::INTERFACE_VERSION`] of the publisher.
        interface_version: u16,
        /// Time at which the model was loaded.
        header: Header,
        /// Id in each [`TactileFrame`] of the predictor.
        model_id: String,
        /// The network's name, for people.
        model_name: String,
        /// SHA-256 of the weights file in hexadecimal digits.
        weights_sha256: String,
        /// The hand model's name, for people.
        hand_model: String,
        /// Meaning of vertex indices.
        topology: String,
        /// Number of vertices of one hand.
        vertex_count: u32,
        /// Region of each vertex, the same for both hands.
        vertex_region: Vec<String>,
        /// Names of the entries of [`TactileRegions`]; empty if the regions are unknown.
        region_names: Vec<String>,
        /// Number of images in the observation window.
        horizon: u32,
        /// Time between two images of the window, s.
        frame_dt: f64,
        /// Side of the network's square input image, pixels.
        input_size: u32,
        /// Newtons per unit of the network's force output; NaN = no force.
        force_scale: f32,
    }

    /// Pose and shape of one hand, as MANO parameters.
    HandPose = "egotac_msgs/msg/HandPose" from "../../msg/HandPose.msg" {
        /// Stamp of the image, and coordinate frame of `wrist`.
        header: Header,
        /// [`HandTactile::LEFT`] or [`HandTactile::RIGHT`].
        side: u8,
        /// Meaning of the parameters.
        topology: String,
        /// Pose of the wrist joint, m: position J0(betas) + transl, orientation global_orient.
        wrist: Pose,
        /// Rotations of the 15 finger joints relative to their parents: axis-angle, rad, MANO's order.
        hand_pose: [f32; 45],
        /// Shape coefficients.
        betas: [f32; N_BETAS],
        /// Confidence that this pose is right, 0 to 1; NaN = not estimated.
        confidence: f32,
    }

    /// Poses of both hands at one stamp.
    HandPoses = "egotac_msgs/msg/HandPoses" from "../../msg/HandPoses.msg" {
        /// Stamp and coordinate frame of all poses.
        header: Header,
        /// At most one entry per hand, left first; empty = no hand was found.
        poses: Vec<HandPose> [<= 2],
    }

    /// Touch on the 17 regions of each hand.
    TactileRegions = "egotac_msgs/msg/TactileRegions" from "../../msg/TactileRegions.msg" {
        /// Stamp and frame of the image.
        header: Header,
        /// Total normal force on each region, N: 17 of the left hand, then of the right; NaN = unknown.
        force: [f32; 34],
        /// Highest contact probability in each region; NaN = unknown.
        contact: [f32; 34],
        /// Confidence that the left and the right hand are present; NaN = unknown.
        presence: [f32; 2],
    }

    /// True touch for an image, and its validity.
    TactileTruth = "egotac_msgs/msg/TactileTruth" from "../../msg/TactileTruth.msg" {
        /// Stamp and frame of the image, equal to those of `frame`.
        header: Header,
        /// True force and contact.
        frame: TactileFrame,
        /// Code of [`crate::Validity`]; 0 = valid.
        validity: u8,
        /// Reason of the guard that refused the frame; empty for a valid frame.
        reason: String,
    }

    /// Reading of one tactile glove, with its calibration.
    GloveReading = "egotac_msgs/msg/GloveReading" from "../../msg/GloveReading.msg" {
        /// Time of the measurement; zero = unknown.
        header: Header,
        /// [`HandTactile::LEFT`] or [`HandTactile::RIGHT`].
        side: u8,
        /// Reading of each channel; NaN = unknown.
        values: Vec<f32>,
        /// Reading without touch, per channel or one for all; empty = 0.
        rest: Vec<f32>,
        /// Newtons per unit above `rest`, per channel or one for all; empty = no calibration.
        newtons_per_unit: Vec<f32>,
        /// Reading at the end of the range, per channel or one for all; empty = 1.
        full: Vec<f32>,
    }

    /// State of a trainer.
    TrainerStatus = "egotac_msgs/msg/TrainerStatus" from "../../msg/TrainerStatus.msg" {
        /// Time of the status.
        header: Header,
        /// [`TrainerStatus::IDLE`] or another of the constants.
        state: String,
        /// Condition that it waits for, or cause of the failure.
        message: String,
        /// Number of live frames written since the start.
        recorded_frames: u64,
        /// Number of live episodes written since the start.
        recorded_episodes: u64,
        /// Number of live episodes removed to stay below the limit.
        evicted_episodes: u64,
        /// Size of the live recordings on disk, bytes.
        recorded_bytes: u64,
        /// Number of steps taken in the goal.
        step: u32,
        /// Number of steps of the goal.
        steps: u32,
        /// Names of losses and scores.
        names: Vec<String>,
        /// One value per name; NaN = undefined.
        values: Vec<f64>,
        /// Training speed, windows per second; NaN = not yet known.
        windows_per_s: f64,
        /// Time until the last step, s; NaN = not yet known.
        remaining_secs: f64,
    }

    /// Net effect of the touch on one region of a hand.
    TactileContact = "egotac_msgs/msg/TactileContact" from "../../msg/TactileContact.msg" {
        /// Stamp of the image, and frame of the vectors.
        header: Header,
        /// Name of the region with its hand, for instance `right_index_tip`.
        name: String,
        /// Centre of the contact, m.
        position: Point,
        /// Unit normal of the skin, out of the hand.
        normal: Vector3,
        /// Force on the skin, N, and torque about the frame's origin, N m; NaN = unknown.
        wrench: Wrench,
    }

    /// Contacts on both hands, as seen in one image.
    TactileContacts = "egotac_msgs/msg/TactileContacts" from "../../msg/TactileContacts.msg" {
        /// Stamp of the image, and frame of the contacts.
        header: Header,
        /// True if touch and place of the left and of the right hand are known.
        known: [bool; 2],
        /// Regions in contact, those of the left hand first.
        contacts: Vec<TactileContact>,
    }

    /// Keypoints of both hands in an image, as a network estimates them.
    HandKeypoints = "egotac_msgs/msg/HandKeypoints" from "../../msg/HandKeypoints.msg" {
        /// Header of the image.
        header: Header,
        /// Width of the image, pixels.
        width: u32,
        /// Height of the image, pixels.
        height: u32,
        /// Probability that the left and the right hand are in the image, 0 to 1.
        presence: [f32; 2],
        /// Position of each keypoint to the right, pixels, left hand first; NaN = unknown.
        x: [f32; 2 * N_KEYPOINTS],
        /// Position of each keypoint downwards, pixels; NaN = unknown.
        y: [f32; 2 * N_KEYPOINTS],
        /// Confidence of each keypoint, 0 to 1; NaN = unknown.
        confidence: [f32; 2 * N_KEYPOINTS],
    }

    /// Agreement of predictions and truth over the newest pairs.
    TactileMetrics = "egotac_msgs/msg/TactileMetrics" from "../../msg/TactileMetrics.msg" {
        /// Header of the newest pair.
        header: Header,
        /// Number of pairs in the rolling window.
        window_pairs: u32,
        /// Time from the oldest to the newest pair of the window, s.
        window_secs: f64,
        /// Number of pairs since the start.
        pairs: u64,
        /// Number of predictions without truth.
        unmatched_predictions: u64,
        /// Number of truths without prediction.
        unmatched_truths: u64,
        /// Number of pairs left out because the truth is invalid.
        invalid_truths: u64,
        /// Names of the metrics.
        names: Vec<String>,
        /// One value per name; NaN = undefined.
        values: Vec<f64>,
    }

    /// Expected touch on one link of a robot hand.
    LinkTouch = "egotac_msgs/msg/LinkTouch" from "../../msg/LinkTouch.msg" {
        /// Name of the link's body.
        link: String,
        /// Force along the link's surface normal, N.
        normal_force: f64,
        /// Force on the link and torque about its origin, in the link's frame, N and N m.
        wrench: Wrench,
        /// Point of application in the link's frame, m.
        position: Point,
        /// Contact probability.
        contact: f64,
    }

    /// Expected touch on a robot hand.
    RobotTouch = "egotac_msgs/msg/RobotTouch" from "../../msg/RobotTouch.msg" {
        /// Stamp of the tactile frame, and coordinate frame of `net_force`.
        header: Header,
        /// Name of the robot.
        robot: String,
        /// Stamp of the hand pose.
        hand_stamp: Time,
        /// Links that can take force.
        links: Vec<LinkTouch>,
        /// Names of the actuated joints.
        joint_names: Vec<String>,
        /// Torque or force of each joint that gives these forces, N m or N.
        joint_torques: Vec<f64>,
        /// True if the limit of a joint reduced forces.
        clipped: bool,
        /// Net force on the human hand, N.
        net_force: Vector3,
        /// Force that no link could take, N.
        left_out: f64,
    }
}

impl HandTactile {
    /// `side` of a left hand.
    pub const LEFT: u8 = 0;
    /// `side` of a right hand.
    pub const RIGHT: u8 = 1;
}

impl HandModelInfo {
    /// Version of the messages; it grows by one with each change of a field of any message.
    pub const INTERFACE_VERSION: u16 = 2;
}

impl TrainerStatus {
    /// `state` before the first goal.
    pub const IDLE: &'static str = "idle";
    /// `state` of a live goal that waits for enough recorded frames.
    pub const WAITING: &'static str = "waiting";
    /// `state` of a goal that trains.
    pub const TRAINING: &'static str = "training";
    /// `state` after a goal that took all its steps.
    pub const SUCCEEDED: &'static str = "succeeded";
    /// `state` after a cancelled goal.
    pub const CANCELLED: &'static str = "cancelled";
    /// `state` after a goal that failed.
    pub const FAILED: &'static str = "failed";
}
