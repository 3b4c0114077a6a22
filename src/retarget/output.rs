//! Output of the retargeter.

use super::touch::ExpectedTouch;

/// Outcome of a frame.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, PartialOrd, Ord)]
#[repr(u8)]
pub enum Status {
    /// Solved.
    #[default]
    Solved = 0,
    /// Solved, with outlying keypoints replaced.
    Repaired = 1,
    /// Solved, but the speed limit or links in the way kept the robot from the pose.
    Limited = 2,
    /// The solver reached its greatest number of steps.
    Capped = 3,
    /// The frame was bad; the last good pose is held.
    Held = 4,
}

impl Status {
    /// All, in the order of their codes.
    pub const ALL: [Status; 5] = [Self::Solved, Self::Repaired, Self::Limited, Self::Capped, Self::Held];

    /// Describes the status in a few words.
    pub fn reason(self) -> &'static str {
        match self {
            Self::Solved => "solved",
            Self::Repaired => "outlying keypoints replaced",
            Self::Limited => "joints too slow, or links in the way",
            Self::Capped => "iteration cap reached",
            Self::Held => "bad input, last good pose held",
        }
    }
}

/// Pose, commands and expected touch of the robot.
#[derive(Debug, Clone, Default)]
pub struct Output {
    /// Position of every hinge and slide, rad or m, in the order of [`super::Robot::joint_names`].
    pub qpos: Vec<f64>,
    /// Velocity of each of them, rad/s or m/s; empty unless the retargeter has [`super::LiveOptions`].
    pub qvel: Vec<f64>,
    /// Mean acceleration of each of them in the last step, rad/s^2 or m/s^2; empty unless live.
    pub qacc: Vec<f64>,
    /// Positions at which the robot stops if it brakes from now on, rad or m; empty unless live.
    pub stop_qpos: Vec<f64>,
    /// Time that this takes, s; 0 unless live.
    pub stop_secs: f64,
    /// Commands for the drivers, in the order of [`super::robot::commands::Commands::names`].
    pub ctrl: Vec<f64>,
    /// Cost of the pose found, m^2.
    pub objective: f64,
    /// Time from input to output, s.
    pub solve_secs: f64,
    /// Steps of the solver.
    pub iterations: usize,
    /// Outcome of the frame.
    pub status: Status,
    /// Touch that the robot should measure; if live, once it is in the pose of the last frame.
    pub expected_touch: ExpectedTouch,
}
