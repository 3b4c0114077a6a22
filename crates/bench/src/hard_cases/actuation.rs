//! Servos and constraints.

use egotac::error::Result;
use egotac::mujoco::{Integrator, PhysicsOptions, World};

use super::watch::{Watched, compare, options, simulate};
use super::{Family, HardCase, Outcome};

pub(super) const CASES: &[HardCase] = &[
    HardCase {
        family: Family::Actuation,
        name: "welded_and_gripped",
        recipe: "an object welded to the world is gripped by servos of 4 kN/m that overshoot by 40 mm",
        remedy: "limit the servos' force to 5 N",
        run: welded_and_gripped,
    },
    HardCase {
        family: Family::Actuation,
        name: "huge_servo_gain",
        recipe: "a phalanx of 10 g, kp 1e4 and no damping, at 2 ms",
        remedy: "integrator discrete",
        run: huge_servo_gain,
    },
];

fn welded_and_gripped() -> Result<Outcome> {
    let run = |limit: &str| -> Result<(f64, Watched)> {
        let finger = |name: &str, x: f64, axis: f64| {
            format!(
                r#"<body name="{name}" pos="{x} 0 0" gravcomp="1"><joint name="{name}" type="slide" axis="{axis} 0 0" armature=".02"/>
                <geom name="{name}" type="capsule" size=".01 .01" mass=".05"/></body>"#
            )
        };
        let servo = |name: &str| format!(r#"<position name="{name}" joint="{name}" kp="4000" kv="40" {limit}/>"#);
        let mjcf = format!(
            r#"<mujoco><worldbody>{}{}<body name="box"><freejoint name="box"/><geom name="box" type="box" size=".03 .03 .03"
            mass=".2"/></body></worldbody><equality><weld body1="box"/></equality><actuator>{}{}</actuator></mujoco>"#,
            finger("one", -0.04, 1.0),
            finger("other", 0.04, -1.0),
            servo("one"),
            servo("other")
        );
        let close = |world: &mut World| {
            for name in ["one", "other"] {
                if let Ok(servo) = world.servo(name) {
                    world.set_target(servo, 0.04);
                }
            }
        };
        let mut run = simulate(&mjcf, &PhysicsOptions::default(), &[], 1.0, close, |_| ())?;
        run.world.forward();
        let most = run.world.contacts().map(|contact| contact.normal_force).sum::<f64>() / 2.0;
        Ok(((most - 5.0).max(0.0), run))
    };
    let (unguarded, remedied) = (run("")?, run(r#"forcerange="-5 5""#)?);
    Ok(compare(unguarded, remedied, "grip above 5 N, N", 0.1))
}

/// Target of the servo, rad; small, because at this gain the phalanx reaches it within a step.
const TARGET: f64 = 0.01;

fn huge_servo_gain() -> Result<Outcome> {
    let run = |integrator: Integrator| -> Result<(f64, Watched)> {
        let mjcf = r#"<mujoco><worldbody><body name="phalanx"><joint name="bend" type="hinge" axis="0 1 0"/>
            <geom type="capsule" fromto="0 0 0 .03 0 0" size=".008" mass=".01"/></body></worldbody>
            <actuator><position name="bend" joint="bend" kp="1e4"/></actuator></mujoco>"#;
        let physics = options(|o| o.integrator = integrator)?;
        let bend = |world: &mut World| {
            if let Ok(servo) = world.servo("bend") {
                world.set_target(servo, TARGET);
            }
        };
        let run = simulate(mjcf, &physics, &[], 2.0, bend, |_| ())?;
        Ok(((run.world.qpos()[0] - TARGET).abs(), run))
    };
    let (unguarded, remedied) = (run(Integrator::ImplicitFast)?, run(Integrator::Discrete)?);
    Ok(compare(unguarded, remedied, "angle, rad", 1e-5))
}
