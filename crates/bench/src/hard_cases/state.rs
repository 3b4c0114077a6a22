//! Non-finite states, exhausted memory, sleeping bodies.

use egotac::error::Result;
use egotac::mujoco::{PhysicsOptions, Solver, World};
use glam::{DQuat, DVec3};

use super::watch::{Watched, compare, options, settle, simulate};
use super::{Family, HardCase, Outcome, accepted};

const FAMILY: Family = Family::State;

pub(super) const CASES: &[HardCase] = &[
    FAMILY.case(
        "state_not_a_number",
        "NaN, infinity or 1e11 in a position, a velocity, a force, a torque or a servo's target",
        "place bodies through `World::set_pose`, which refuses them",
        not_a_number,
    ),
    FAMILY.case(
        "no_rotation",
        "a zero quaternion, one of length 2, one with NaN for a body's orientation",
        "a unit quaternion",
        no_rotation,
    ),
    FAMILY.case(
        "full_memory",
        "49 boxes on the floor in 552 kB of memory, solver pgs",
        "the engine's own size",
        full_memory,
    ),
    FAMILY.case(
        "sleeping_bodies",
        "a box falls asleep on the floor: its contacts leave the list",
        "no sleep for labelled bodies",
        sleeping,
    ),
];

const BOX: &str = r#"<mujoco><option><flag sleep="disable"/></option><worldbody><geom name="floor" type="plane" size="1 1 .1"/>
    <body name="box" pos="0 0 .05"><freejoint name="box"/><geom name="box" type="box" size=".05 .05 .05" mass=".2"/></body>
    <body name="arm" pos="1 0 1"><joint name="arm" type="hinge" axis="0 1 0" damping=".1"/><geom size=".02" mass=".1"/></body>
    </worldbody><actuator><position name="arm" joint="arm" kp="1"/></actuator></mujoco>"#;

fn not_a_number() -> Result<Outcome> {
    let physics = PhysicsOptions::default();
    let pull = |world: &mut World, force: DVec3, torque: DVec3| {
        if let Ok(body) = world.body("box") {
            world.apply_force(body, force, torque);
        }
    };
    let aim = |world: &mut World, target: f64| {
        if let Ok(servo) = world.servo("arm") {
            world.set_target(servo, target);
        }
    };
    let (mut lost, mut reports) = (0, Vec::new());
    for bad in [f64::NAN, f64::INFINITY, 1e11] {
        for kind in 0..5 {
            // A large servo target is a valid state: the engine bounds targets only if the model does.
            if kind == 4 && bad.is_finite() {
                continue;
            }
            let spoil = |world: &mut World| match kind {
                0 => world.qpos_mut()[0] = bad,
                1 => world.qvel_mut()[1] = bad,
                2 => pull(world, DVec3::X * bad, DVec3::ZERO),
                3 => pull(world, DVec3::ZERO, DVec3::Z * bad),
                _ => aim(world, bad),
            };
            let run = simulate(BOX, &physics, &["box"], 0.2, spoil, |_| ())?;
            lost += 1;
            // A state that passes unnoticed must not hide behind the report of another.
            let guard = if run.errors.is_empty() { None } else { Some(run.errors) };
            reports.push(guard);
        }
    }
    let guard = match reports.iter().all(Option::is_some) {
        true => reports.into_iter().flatten().next().unwrap_or_default(),
        false => String::new(),
    };
    let mut world = World::from_mjcf(BOX, &physics)?;
    let joint = world.free_joint("box")?;
    let spoilt = [f64::NAN, f64::INFINITY].map(|bad| world.set_pose(joint, DVec3::X * bad, DQuat::IDENTITY));
    Ok(Outcome {
        error_of: "invalid states that were simulated",
        tolerance: 0.0,
        unguarded: Some(f64::from(lost)),
        guard,
        remedied: accepted(spoilt).0,
        remedied_guard: String::new(),
    })
}

fn no_rotation() -> Result<Outcome> {
    let mut world = World::from_mjcf(BOX, &PhysicsOptions::default())?;
    let joint = world.free_joint("box")?;
    let mut place = |q: DQuat| world.set_pose(joint, DVec3::Z, q);
    let bad = [
        DQuat::from_xyzw(0.0, 0.0, 0.0, 0.0),
        DQuat::from_xyzw(0.0, 0.0, 0.0, 2.0),
        DQuat::from_xyzw(f64::NAN, 0.0, 0.0, 1.0),
        // The usual formula gives this for a zero axis and an angle of 1.
        DQuat::from_xyzw(0.0, 0.0, 0.0, 0.5f64.cos()),
    ];
    let (unguarded, guard) = accepted(bad.map(&mut place));
    let turned = DQuat::from_axis_angle(DVec3::X, 1.0);
    place(turned)?;
    world.forward();
    let found = world.orientation(world.body_of(joint));
    let error_of = "rotations wrongly accepted, or error of the rotation, rad";
    let remedied = found.angle_between(turned);
    Ok(Outcome {
        error_of,
        tolerance: 1e-7,
        unguarded: Some(unguarded),
        guard,
        remedied,
        remedied_guard: String::new(),
    })
}

fn full_memory() -> Result<Outcome> {
    let boxes: String = (0..49)
        .map(|i| {
            let (x, y) = (0.1 * f64::from(i % 7), 0.1 * f64::from(i / 7));
            format!(
                r#"<body name="box{i}" pos="{x} {y} .02"><freejoint name="box{i}"/><geom type="box" size=".02 .02 .02" mass=".1"/></body>"#
            )
        })
        .collect();
    let run = |size: &str| -> Result<(f64, Watched)> {
        let mjcf = format!(
            r#"<mujoco>{size}<worldbody><geom name="floor" type="plane" size="1 1 .1"/>{boxes}</worldbody></mujoco>"#
        );
        let physics = options(|o| (o.solver, o.iterations, o.tolerance) = (Solver::Pgs, 1000, 1e-4))?;
        let run = settle(&mjcf, &physics, &[], 0.2)?;
        Ok((100.0 * run.world.arena_use(), run))
    };
    let (unguarded, remedied) = (run(r#"<size memory="552K"/>"#)?, run("")?);
    Ok(compare(unguarded, remedied, "memory in use, %", 80.0))
}

fn sleeping() -> Result<Outcome> {
    let run = |mjcf: &str| -> Result<(f64, Watched)> {
        let mut run = settle(mjcf, &PhysicsOptions::default(), &["box"], 2.0)?;
        run.world.forward();
        let lift: DVec3 = run.world.contacts().map(|contact| contact.force).sum();
        Ok((100.0 * (lift.z / (0.2 * 9.81) - 1.0).abs(), run))
    };
    let (unguarded, remedied) = (run(&BOX.replace(r#"sleep="disable""#, r#"sleep="enable""#))?, run(BOX)?);
    Ok(compare(unguarded, remedied, "force that carries the box, %", 0.1))
}
