//! The messages of `egotac_msgs`; their fields' meaning stands in `msg/*.msg`.

use super::message;
use super::standard::{Header, Point, Point32, Pose, Time, Vector3, Wrench};
use crate::hand::{N_BETAS, N_VERTICES};

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
        /// Counts the frames of this publisher, from 0.
        sequence: u64,
        /// Time from taking up the image to the result, s; NaN = not applicable.
        inference_secs: f64,
        /// What computed this: `model_id` of [`HandModelInfo`], or `simulator/<scene>`.
        model_id: String,
        /// What the vertex indices mean: `egotac-hand-1` or `mano`.
        topology: String,
        /// True while the observation window is not full yet.
        warming_up: bool,
    }

    /// What a predictor is: its network and the hand its results live on.
    HandModelInfo = "egotac_msgs/msg/HandModelInfo" from "../../msg/HandModelInfo.msg" {
        /// When the model was loaded.
        header: Header,
        /// Id that each [`TactileFrame`] carries.
        model_id: String,
        /// The network's name, for people.
        model_name: String,
        /// SHA-256 of the weights file in hexadecimal digits.
        weights_sha256: String,
        /// The hand model's name, for people.
        hand_model: String,
        /// What the vertex indices mean.
        topology: String,
        /// Vertices of one hand.
        vertex_count: u32,
        /// Region of each vertex, the same for both hands.
        vertex_region: Vec<String>,
        /// Images per observation window.
        horizon: u32,
        /// Time between two images of the window, s.
        frame_dt: f64,
        /// Side of the square image the network sees, pixels.
        input_size: u32,
        /// Newtons per unit of the network's force output; NaN = no force.
        force_scale: f32,
    }

    /// Pose and shape of one hand, as MANO parameters.
    HandPose = "egotac_msgs/msg/HandPose" from "../../msg/HandPose.msg" {
        /// The image's stamp; the frame of `wrist` and `vertices`.
        header: Header,
        /// [`HandTactile::LEFT`] or [`HandTactile::RIGHT`].
        side: u8,
        /// What the parameters and vertex indices mean.
        topology: String,
        /// Pose of the wrist joint, m: at J0(betas) + transl, turned by global_orient.
        wrist: Pose,
        /// Rotations of the 15 finger joints relative to their parents: axis-angle, rad, MANO's order.
        hand_pose: [f32; 45],
        /// Shape coefficients.
        betas: [f32; N_BETAS],
        /// The posed vertices, m, 778 or none.
        vertices: Vec<Point32>,
    }

    /// The true touch for an image, and whether it can be trusted.
    TactileTruth = "egotac_msgs/msg/TactileTruth" from "../../msg/TactileTruth.msg" {
        /// True force and contact.
        frame: TactileFrame,
        /// Code of [`crate::Validity`]; 0 = valid.
        validity: u8,
        /// What the guard saw, in words; empty for a valid frame.
        reason: String,
    }

    /// What a trainer is doing.
    TrainerStatus = "egotac_msgs/msg/TrainerStatus" from "../../msg/TrainerStatus.msg" {
        /// Time of the status.
        header: Header,
        /// `idle`, `waiting`, `training`, `succeeded`, `cancelled` or `failed`.
        state: String,
        /// What it waits for, or why it failed.
        message: String,
        /// Live frames written since the start.
        recorded_frames: u64,
        /// Live episodes written since the start.
        recorded_episodes: u64,
        /// Live episodes removed to stay below the limit.
        evicted_episodes: u64,
        /// Live recordings on the disk, bytes.
        recorded_bytes: u64,
        /// Steps taken in the goal.
        step: u32,
        /// Steps asked for.
        steps: u32,
        /// Names of losses and scores.
        names: Vec<String>,
        /// Their values; NaN = undefined.
        values: Vec<f64>,
        /// Windows per second; NaN = unknown yet.
        windows_per_s: f64,
        /// Until the last step, s; NaN = unknown yet.
        remaining_secs: f64,
    }

    /// How well predictions agree with the truth, over the newest pairs.
    TactileMetrics = "egotac_msgs/msg/TactileMetrics" from "../../msg/TactileMetrics.msg" {
        /// Of the newest pair.
        header: Header,
        /// Pairs in the rolling window.
        window_pairs: u32,
        /// Time from the window's oldest pair to its newest, s.
        window_secs: f64,
        /// Pairs made since the start.
        pairs: u64,
        /// Predictions that found no truth.
        unmatched_predictions: u64,
        /// Truths that found no prediction.
        unmatched_truths: u64,
        /// Pairs left out because the truth is invalid.
        invalid_truths: u64,
        /// Names of the metrics.
        names: Vec<String>,
        /// One value per name; NaN = undefined.
        values: Vec<f64>,
    }

    /// Touch that one link of a robot hand is expected to feel.
    LinkTouch = "egotac_msgs/msg/LinkTouch" from "../../msg/LinkTouch.msg" {
        /// Name of the link's body.
        link: String,
        /// Force along the link's surface normal, N.
        normal_force: f64,
        /// Force on the link, torque about its origin; in its own frame, N and N m.
        wrench: Wrench,
        /// Where the force acts, in the link's own frame, m.
        position: Point,
        /// Probability that the link touches something.
        contact: f64,
    }

    /// Touch that a robot hand is expected to feel.
    RobotTouch = "egotac_msgs/msg/RobotTouch" from "../../msg/RobotTouch.msg" {
        /// Stamp of the tactile frame; the frame of `net_force`.
        header: Header,
        /// Name of the robot.
        robot: String,
        /// Stamp of the hand pose.
        hand_stamp: Time,
        /// All links that can take force.
        links: Vec<LinkTouch>,
        /// Joints that move on their own.
        joint_names: Vec<String>,
        /// What each must give to press like that, N m or N.
        joint_torques: Vec<f64>,
        /// Whether a joint's strength made forces smaller.
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
