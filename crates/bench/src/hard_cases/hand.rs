//! The hand model in impossible poses.

use std::f32::consts::PI;

use egotac::error::Result;
use egotac::hand::{HandModel, HandParams, Side};
use glam::Vec3;

use super::{Family, HardCase, Outcome};

pub(super) const CASES: &[HardCase] = &[
    HardCase {
        family: Family::Hand,
        name: "pose_of_whole_turns",
        recipe: "every joint turned by a whole turn, or by a hundred: nothing should move",
        remedy: "none needed",
        run: whole_turns,
    },
    HardCase {
        family: Family::Hand,
        name: "pose_without_numbers",
        recipe: "NaN in the rotation of one joint",
        remedy: "a rotation of 0",
        run: without_numbers,
    },
];

fn whole_turns() -> Result<Outcome> {
    let model = HandModel::builtin(Side::Right);
    let rest = model.forward(&HandParams::default()).vertices;
    let error = |turns: f32| {
        let axis = Vec3::new(0.48, -0.6, 0.64).normalize();
        let pose = [axis * (2.0 * PI * turns); 15];
        let posed = model.forward(&HandParams { hand_pose: pose, ..HandParams::default() });
        let moved = posed.vertices.iter().zip(&rest).map(|(a, b)| f64::from(a.distance(*b)));
        1e3 * moved.fold(0.0, f64::max)
    };
    // Single precision holds a hundred turns to 3e-5 rad.
    let (one, many) = (error(1.0), error(100.0));
    Ok(Outcome {
        error_of: "vertices, mm",
        tolerance: 0.05,
        unguarded: Some(many),
        guard: String::new(),
        remedied: one,
        remedied_guard: String::new(),
    })
}

/// Checks that NaN in the pose becomes NaN in the vertices, and that the force spreader refuses these.
fn without_numbers() -> Result<Outcome> {
    let model = HandModel::builtin(Side::Left);
    let spreader = egotac::geometry::ForceSpreader::new(&model, egotac::geometry::SIGMA)?;
    let mut pose = [Vec3::ZERO; 15];
    let label = |pose: [Vec3; 15]| {
        let posed = model.forward(&HandParams { hand_pose: pose, ..HandParams::default() });
        let contact =
            egotac::geometry::LinkContact { link: 3, position: glam::DVec3::ZERO, normal: glam::DVec3::Y, force: 1.0 };
        let finite = posed.vertices.iter().filter(|v| v.is_finite()).count();
        (finite, spreader.spread(&posed.vertices, &[contact]).map(|label| label.sum_residual()))
    };
    let (_, good) = label(pose);
    pose[2].y = f32::NAN; // joint 3, the tip of the index finger
    let (finite, spoilt) = label(pose);
    let (through, guard) = super::accepted([spoilt]);
    let guard = if through > 0.0 || finite == model.v_template.len() { String::new() } else { guard };
    Ok(Outcome {
        error_of: "force on the vertices, relative",
        tolerance: 1e-6,
        unguarded: None,
        guard,
        remedied: good?,
        remedied_guard: String::new(),
    })
}
