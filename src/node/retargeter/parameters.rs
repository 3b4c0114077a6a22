//! Parameters of the node `retargeter`.

use std::path::PathBuf;

use super::keypoint_layout;
use crate::node::hand_confidence;
use crate::node::input_topics::reliability_parameter;
use crate::node::params::{Allowed, Parameter, Parameters};
use crate::retarget::LiveOptions;

/// The node's parameters.
pub fn parameters() -> Vec<Parameter> {
    let mut parameters = of_the_hand();
    parameters.extend(of_the_motion());
    parameters
}

/// Parameters of the robot and of the hand that it follows.
fn of_the_hand() -> Vec<Parameter> {
    vec![
        hand_confidence::parameter(),
        keypoint_layout::parameter(),
        Parameter::fixed(
            "robot",
            "four_finger",
            Allowed::Any,
            "Robot hand: a name of `egotac retarget list` or its start, a YAML file, or a model (MJCF or URDF).",
        ),
        Parameter::fixed(
            "model",
            "",
            Allowed::Any,
            "Model file in place of the one that the robot's file names; empty = that one.",
        ),
        Parameter::fixed(
            "object",
            "",
            Allowed::Any,
            "Object that the hand holds: links stay out of it and touching fingertips lie on it. A model (MJCF, URDF) or mesh \
             (OBJ, STL; its convex hull counts); empty = none. The topic object carries its pose.",
        ),
        Parameter::fixed(
            "object_timeout_ms",
            200.0,
            Allowed::Doubles(0.0, 60_000.0),
            "Greatest difference of the stamps of a hand and the object pose that is used for it, milliseconds.",
        ),
        Parameter::fixed(
            "tf_timeout_ms",
            100.0,
            Allowed::Doubles(0.0, 10_000.0),
            "Longest wait of an object pose in another frame than the hand for the transform of its stamp, milliseconds.",
        ),
        Parameter::fixed(
            "side",
            "robot",
            Allowed::OneOf(&["robot", "left", "right"]),
            "Side of the human hand that is followed; robot = the robot's own side.",
        ),
        Parameter::fixed(
            "sync_slop_ms",
            20.0,
            Allowed::Doubles(0.0, 1000.0),
            "Greatest difference of the stamps of a hand and its touch, milliseconds.",
        ),
        Parameter::fixed(
            "touch_wait_ms",
            200.0,
            Allowed::Doubles(0.0, 60_000.0),
            "Greatest time that a hand waits for its touch while touches with the stamps of hands come, milliseconds; 0 = never.",
        ),
        Parameter::fixed("mano_left", "", Allowed::Any, "Left MANO file, for hands of the topology mano."),
        Parameter::fixed("mano_right", "", Allowed::Any, "Right MANO file, for hands of the topology mano."),
        reliability_parameter("match"),
    ]
}

/// Parameters of the robot's motion.
fn of_the_motion() -> Vec<Parameter> {
    vec![
        Parameter::fixed(
            "rate_hz",
            60.0,
            Allowed::Doubles(1.0, 1000.0),
            "Rate at which joints are published, whether hands come or not, hertz.",
        ),
        Parameter::fixed(
            "start",
            "measured",
            Allowed::OneOf(&["measured", "rest"]),
            "Pose in which the robot is before the first command, and when the node is enabled again: measured = that on the \
             topic joint_states, for which the node waits; rest = the rest pose of its model, and later that of the last command.",
        ),
        Parameter::fixed(
            "acceleration",
            50.0,
            Allowed::Doubles(0.01, 100_000.0),
            "Greatest acceleration of a hinge, rad/s^2; of a slide a tenth of it, m/s^2. Velocity limits are in the robot's file.",
        ),
        Parameter::fixed(
            "ramp_secs",
            1.0,
            Allowed::Doubles(0.0, 600.0),
            "Time in which the velocity limit grows from 0 to its full value after each start, seconds.",
        ),
        Parameter::new(
            "input_timeout_ms",
            500.0,
            Allowed::Doubles(0.0, 600_000.0),
            "Time without a hand after which the robot brakes and holds its pose, milliseconds; 0 = never: it goes on to the last \
             hand's pose.",
        ),
        Parameter::fixed(
            "deadman",
            false,
            Allowed::Any,
            "Move only while true (std_msgs/Bool) arrives on the topic deadman; otherwise brake and hold.",
        ),
        Parameter::new(
            "deadman_timeout_ms",
            250.0,
            Allowed::Doubles(1.0, 600_000.0),
            "Longest time between two messages on deadman, milliseconds.",
        ),
        Parameter::fixed(
            "publish_positions",
            false,
            Allowed::Any,
            "Also publish ~/position_commands (std_msgs/Float64MultiArray) for a forward position controller.",
        ),
        Parameter::new("enabled", true, Allowed::Any, "True to follow hands; also set by ~/set_enabled."),
    ]
}

/// Returns the limits of the robot's motion.
pub fn live_options(parameters: &Parameters) -> LiveOptions {
    LiveOptions {
        acceleration: parameters.get("acceleration"),
        ramp_secs: parameters.get("ramp_secs"),
        period: 1.0 / parameters.get::<f64>("rate_hz"),
    }
}

/// Returns the path of a parameter; None if it is empty.
pub fn path_of(parameters: &Parameters, name: &str) -> Option<PathBuf> {
    Some(parameters.get::<String>(name)).filter(|path| !path.is_empty()).map(PathBuf::from)
}
