//! Files of `egotac retarget run`, both safetensors.

mod hand_recording;
mod robot_trajectory;

pub use self::hand_recording::HandRecording;
pub use self::robot_trajectory::RobotTrajectory;
