//! The demo's numbers.

use serde_json::{Value, json};

use super::Moment;
use crate::cli::retarget::Demo;
use crate::hand::Side;
use crate::machine::Machine;
use crate::retarget::{Retargeter, Status};
use crate::statistics::median;
use crate::text::significant;

/// Human force from which on a moment counts as a touch, N.
const TOUCH: f64 = 0.05;

/// What was seen, as JSON.
pub fn summary(args: &Demo, retargeter: &Retargeter, side: Side, moments: &[Moment], held: usize) -> Value {
    let robot = retargeter.robot();
    let touching = || moments.iter().filter(|moment| moment.output.feel.asked.length() > TOUCH);
    let errors: Vec<f64> = touching()
        .map(|moment| {
            let feel = &moment.output.feel;
            let sum: glam::DVec3 = feel.links.iter().map(|link| link.force).sum();
            (sum - feel.asked).length() / feel.asked.length()
        })
        .collect();
    let touching_frames = errors.len();
    let most = |value: fn(&Moment) -> f64| moments.iter().map(value).fold(0.0, f64::max);
    let ranges: Vec<[f64; 2]> = robot.output_joints().map(|joint| robot.parts.joints[joint].range).collect();
    let beyond = moments
        .iter()
        .flat_map(|moment| moment.output.qpos.iter().zip(&ranges).map(|(q, [low, high])| (q - high).max(low - q)))
        .fold(0.0, f64::max);
    json!({
        "command": args.command(),
        "version": env!("CARGO_PKG_VERSION"),
        "machine": Machine::this().to_string(),
        "robot": robot.spec.robot,
        "scene": args.scene,
        "seed": args.seed,
        "touch": args.touch,
        "human_side": side.name(),
        "frames": moments.len(),
        "held_frames": held,
        "limited_frames": moments.iter().filter(|moment| moment.output.status == Status::Limited).count(),
        "touching_frames": touching_frames,
        "human_force_most_n": most(Moment::human),
        "robot_force_most_n": most(Moment::robot),
        "net_force_error_median": median(errors),
        "clipped_frames": moments.iter().filter(|moment| moment.output.feel.clipped).count(),
        "beyond_joint_limits_rad": beyond,
        "solve_median_us": median(moments.iter().map(|moment| 1e6 * moment.output.solve_secs)),
    })
}

/// The moment of the human's firmest touch.
pub fn firmest(moments: &[Moment]) -> Option<usize> {
    (0..moments.len()).max_by(|a, b| moments[*a].human().total_cmp(&moments[*b].human()))
}

/// The summary in a line.
pub fn headline(summary: &Value) -> String {
    let number = |name: &str| significant(summary[name].as_f64().unwrap_or(f64::NAN));
    format!(
        "{} follows the {} hand for {} frames ({} held): {} N on the human's skin, {} N on the robot's links at most; net \
         force within {} % (median); {} us per frame (median)",
        summary["robot"].as_str().unwrap_or_default(),
        summary["human_side"].as_str().unwrap_or_default(),
        summary["frames"],
        summary["held_frames"],
        number("human_force_most_n"),
        number("robot_force_most_n"),
        significant(100.0 * summary["net_force_error_median"].as_f64().unwrap_or(f64::NAN)),
        number("solve_median_us"),
    )
}

impl Moment {
    /// Sum of the human's normal forces, N.
    pub fn human(&self) -> f64 {
        self.force.iter().copied().filter(|force| force.is_finite()).map(f64::from).sum()
    }

    /// Sum of the robot's expected normal forces, N.
    pub fn robot(&self) -> f64 {
        self.output.feel.links.iter().map(|link| link.normal_force).sum()
    }
}
