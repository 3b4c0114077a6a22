//! Names of the demo's topics and nodes, as the nodes have them without remapping.

/// Camera images of the simulator.
pub const IMAGE: &str = "/image_raw";
/// Calibration of the simulated camera.
pub const CAMERA_INFO: &str = "/camera_info";
/// What the simulator knows of the touch.
pub const TRUTH: &str = "/truth/tactile";
/// Poses of the simulated hands.
pub const HAND_POSE: &str = "/truth/hand_pose";
/// What the predictor says of the touch.
pub const TACTILE: &str = "/predictor/tactile";
/// What the predictor is.
pub const MODEL_INFO: &str = "/predictor/model_info";
/// The verifier's rolling metrics.
pub const METRICS: &str = "/verifier/metrics";
