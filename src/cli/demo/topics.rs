//! Default topic names of the demo's nodes.

/// Camera images of the simulator.
pub const IMAGE: &str = "/image_raw";
/// Calibration of the simulated camera.
pub const CAMERA_INFO: &str = "/camera_info";
/// True touch from the simulator.
pub const TRUTH: &str = "/truth/tactile";
/// Poses of the simulated hands.
pub const HAND_POSE: &str = "/truth/hand_pose";
/// Touch from the predictor.
pub const TACTILE: &str = "/predictor/tactile";
/// Description of the predictor's network.
pub const MODEL_INFO: &str = "/predictor/model_info";
/// Rolling metrics from the verifier.
pub const METRICS: &str = "/verifier/metrics";
