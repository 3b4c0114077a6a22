//! Retargeting: pose and touch of a human hand, as joint commands and expected contact forces of a robot hand.
//!
//! ```
//! use egotac::hand::{HandModel, HandParams, Side};
//! use egotac::retarget::human::Hand;
//! use egotac::retarget::{Input, Retargeter, Robot};
//!
//! # fn main() -> egotac::Result<()> {
//! let robot = Robot::load("four_finger", None)?;
//! let mut retargeter = Retargeter::new(robot)?;
//! let keypoints = Hand::of_model(&HandModel::builtin(Side::Right), &HandParams::default()); // or any hand tracker's
//! let output = retargeter.push(&Input::new(keypoints, 0.0))?; // metres, seconds
//! println!("{:?}", output.qpos); // radians
//! # Ok(())
//! # }
//! ```
//!
//! A frame passes these modules in turn:
//!
//! | module | step |
//! |---|---|
//! | [`human`] | checks of the keypoints, wrist frame |
//! | [`filter`] | outliers, smoothing, size of the hand |
//! | [`object`] | pose of the held object relative to the robot |
//! | [`goal`] | targets of the frame, as terms of a [`problem`] |
//! | `search`, [`solver`] | the pose with the least cost |
//! | `motion_limit` | speed limits, links in the way |
//! | `live_motion` | on a live robot also acceleration limits, and a free way to brake |
//! | [`touch`] | expected contact forces |
//!
//! Units are SI. Keypoints, forces and object poses are in one right-handed frame of the caller's choice; inside, a hand
//! is in its wrist frame (palmar, radial, distal), a robot in the world of its model.

pub(crate) mod file;
#[doc(hidden)]
pub mod filter;
#[doc(hidden)]
pub mod goal;
#[doc(hidden)]
pub mod human;
mod input;
mod live_motion;
mod motion_limit;
pub mod object;
mod output;
#[doc(hidden)]
pub mod problem;
mod retargeter;
pub mod robot;
mod search;
#[doc(hidden)]
pub mod solver;
pub mod touch;

pub use self::input::Input;
pub use self::live_motion::LiveOptions;
pub use self::object::ObjectPose;
pub use self::output::{Output, Status};
pub use self::retargeter::{Options, Retargeter};
pub use self::robot::Robot;
pub use self::touch::{ExpectedTouch, Touch, TouchPooling};
