//! Scene files with extreme values.

use std::path::Path;

use egotac::error::Result;
use egotac::hand::FINGER_LIMIT;
use egotac::sim::{Rollout, RolloutOptions, Scene, UniformRange};
use egotac::tactile::Validity;

use super::{Family, HardCase, Outcome};

const FAMILY: Family = Family::Scene;

pub(super) const CASES: &[HardCase] = &[
    FAMILY.case("object_of_1_mm", "a cube of 1 mm and 1 mg under a hovering hand", "a cube of 20 mm and 8 g", || {
        object_of(0.001, 1e-6, Good { edge: 0.02, mass: 0.008 })
    }),
    FAMILY.case("object_of_10_m", "a cube of 10 m and 1 t around the whole scene", "a cube of 60 mm and 100 g", || {
        object_of(10.0, 1000.0, Good { edge: 0.06, mass: 0.1 })
    }),
    FAMILY.case("far_away", "a cube a thousand kilometres away", "a cube on the table", far_away),
    FAMILY.case(
        "grip_of_183_N",
        "a cube of 0.93 kg with a friction of 0.05 is pinched with twice the force that holds it: 183 N at each finger",
        "a cube of 50 g with a friction of 0.9",
        pinch,
    ),
    FAMILY.case("camera_looks_at_itself", "the camera's eye is where it looks", "an eye apart from it", camera),
];

/// A cube of usual size.
struct Good {
    /// m.
    edge: f64,
    /// kg.
    mass: f64,
}

fn scene(edge: f64, mass: f64, x: f64, camera: &str) -> Result<Scene> {
    let text = format!(
        "description: A cube and an idle hand.\nobjects:\n  - name: cube\n    shape: {{ cube: {{ size: {edge:e} }} }}\n    mass: {mass:e}\n    \
         friction: 0.9\n    position: [{x:e}, 0]\nhands:\n  - side: right\n{camera}"
    );
    Scene::parse("extreme", Path::new("extreme.yaml"), &text)
}

/// Returns the error of the cube's height at the end, mm, and the first report of a guard.
fn rest(edge: f64, mass: f64, x: f64, camera: &str) -> Result<(f64, String)> {
    let options = RolloutOptions { picture: None, ..RolloutOptions::default() };
    let mut rollout = Rollout::new(&scene(edge, mass, x, camera)?, 0, &options)?;
    let (mut height, mut report) = (f64::NAN, String::new());
    while let Some(frame) = rollout.next_frame()? {
        height = frame.objects[0].position.z;
        if frame.frame.validity != Validity::Valid && report.is_empty() {
            report = frame.frame.validity.reason().to_owned();
        }
        if !(frame.camera.position.is_finite() && frame.camera.orientation.is_finite()) {
            height = f64::NAN;
        }
    }
    Ok((1e3 * (height - 0.5 * edge).abs(), report))
}

/// Returns the outcome; the error of a refused run is its report.
fn outcome(as_written: Result<(f64, String)>, remedied: Result<(f64, String)>) -> Outcome {
    let (unguarded, guard) = match as_written {
        Ok((error, report)) => (Some(error), report),
        Err(error) => (None, error.to_string()),
    };
    let (remedied, remedied_guard) = remedied.unwrap_or_else(|error| (f64::NAN, error.to_string()));
    Outcome { error_of: "height of the cube at rest, mm", tolerance: 0.1, unguarded, guard, remedied, remedied_guard }
}

fn object_of(edge: f64, mass: f64, good: Good) -> Result<Outcome> {
    Ok(outcome(rest(edge, mass, 0.0, ""), rest(good.edge, good.mass, 0.0, "")))
}

/// Returns the scene `pinch_cube` with a cube of this mass and friction, and a further force at each finger, N.
fn pinch_scene(mass: f64, friction: f64, [low, high]: [f64; 2]) -> Result<Scene> {
    let mut spec = Scene::load("pinch_cube")?.spec;
    spec.objects[0].mass = UniformRange::fixed(mass);
    spec.objects[0].friction = UniformRange::fixed(friction);
    if let Some(act) = &mut spec.hands[0].act {
        act.grip = UniformRange::fixed(2.0);
        for contact in act.contacts.values_mut() {
            contact.force = UniformRange::new(low, high);
        }
    }
    Scene::checked("pinch", spec)
}

/// Returns the largest force on a finger's link beyond that of a human hand, N, and the first report of a guard.
fn beyond_a_hand(scene: &Scene, seed: u64) -> Result<(f64, String)> {
    let options = RolloutOptions { picture: None, ..RolloutOptions::default() };
    let mut rollout = Rollout::new(scene, seed, &options)?;
    let (mut beyond, mut report) = (0.0f64, String::new());
    while let Some(frame) = rollout.next_frame()? {
        let links = frame.hands.iter().flatten().flat_map(|hand| hand.links.into_iter().skip(1));
        beyond = links.fold(beyond, |beyond, force| beyond.max(force - FINGER_LIMIT));
        if frame.frame.validity != Validity::Valid && report.is_empty() {
            report = frame.frame.validity.reason().to_owned();
        }
    }
    Ok((beyond, report))
}

fn strength(as_written: Result<(f64, String)>, remedied: Result<(f64, String)>) -> Outcome {
    let outcome = outcome(as_written, remedied);
    Outcome { error_of: "force on a finger's link beyond 80 N, N", tolerance: 0.0, ..outcome }
}

fn pinch() -> Result<Outcome> {
    let run = |mass: f64, friction: f64| beyond_a_hand(&pinch_scene(mass, friction, [0.4, 1.2])?, 0);
    Ok(strength(run(0.93, 0.05), run(0.05, 0.9)))
}

fn far_away() -> Result<Outcome> {
    Ok(outcome(rest(0.04, 0.05, 1e6, ""), rest(0.04, 0.05, 0.0, "")))
}

fn camera() -> Result<Outcome> {
    let at = |eye: &str| rest(0.04, 0.05, 0.0, &format!("camera: {{ eye: {eye}, target: [0, 0, 0.05], sway: 0 }}\n"));
    Ok(outcome(at("[0, 0, 0.05]"), at("[0, -0.3, 0.4]")))
}
