//! Summary of the demo.

use serde_json::{Value, json};

use super::Moment;
use crate::cli::retarget::Demo;
use crate::hand::Side;
use crate::machine::Machine;
use crate::retarget::{Retargeter, Status};
use crate::statistics::median;
use crate::text::significant;

/// Net force of the human above which a moment counts as touching, N.
const MIN_TOUCH_FORCE: f64 = 0.05;

/// Returns the summary as JSON.
pub fn summary(args: &Demo, retargeter: &Retargeter, side: Side, moments: &[Moment], held: usize) -> Value {
    let robot = retargeter.robot();
    let touching = || moments.iter().filter(|moment| moment.output.expected_touch.net_force.length() > MIN_TOUCH_FORCE);
    let errors: Vec<f64> = touching()
        .map(|moment| {
            let touch = &moment.output.expected_touch;
            let sum: glam::DVec3 = touch.links.iter().map(|link| link.force).sum();
            (sum - touch.net_force).length() / touch.net_force.length()
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
        "clipped_frames": moments.iter().filter(|moment| moment.output.expected_touch.clipped).count(),
        "beyond_joint_limits_rad": beyond,
        "solve_median_us": median(moments.iter().map(|moment| 1e6 * moment.output.solve_secs)),
    })
}

/// Returns the index of the moment in which the human presses most.
pub fn firmest(moments: &[Moment]) -> Option<usize> {
    (0..moments.len()).max_by(|a, b| moments[*a].human().total_cmp(&moments[*b].human()))
}

/// Returns the summary in one line.
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

    /// Sum of the normal forces expected on the robot, N.
    pub fn robot(&self) -> f64 {
        self.output.expected_touch.links.iter().map(|link| link.normal_force).sum()
    }
}
