//! Retargets a closing human hand to a robot hand and prints the robot's joint positions.
//!
//! `cargo run --release --features sim --example retarget_keypoints -- [ROBOT]`; `egotac retarget list` names the robots.

use egotac::hand::{HandModel, HandParams, Side};
use egotac::retarget::{Input, Retargeter, Robot};
use glam::Vec3;

const FRAMES: usize = 50;
const FRAME_SECS: f64 = 0.04;

fn main() -> anyhow::Result<()> {
    let name = std::env::args().nth(1).unwrap_or_else(|| "four_finger".into());
    let mut retargeter = Retargeter::new(Robot::load(&name, None)?)?;
    println!("time_s,{}", retargeter.robot().joint_names().join(","));

    let hand = HandModel::builtin(Side::Right);
    for frame in 0..FRAMES {
        let closing = frame as f32 / (FRAMES - 1) as f32;
        let mut params = HandParams::default();
        // Joints 0..12 of the pose belong to index, middle, little and ring finger; they flex about the z axis.
        for joint in &mut params.hand_pose[0..12] {
            *joint = Vec3::new(0.0, 0.0, 0.9 * closing);
        }
        let keypoints = hand.keypoints(&hand.forward(&params)).map(|point| point.as_dvec3());
        let time = frame as f64 * FRAME_SECS;
        let output = retargeter.push(&Input::new(keypoints, time))?;
        let qpos: Vec<String> = output.qpos.iter().map(|angle| format!("{angle:.4}")).collect();
        println!("{time:.2},{}", qpos.join(","));
    }
    Ok(())
}
