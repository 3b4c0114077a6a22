//! Long holds: creep of friction.

use egotac::error::Result;
use egotac::mujoco::options::Unchecked;
use egotac::mujoco::{Cone, World};

use super::watch::{Watched, compare, options, simulate};
use super::{Family, HardCase, Outcome};

const FAMILY: Family = Family::Hold;

pub(super) const CASES: &[HardCase] = &[
    FAMILY.case("creep_elliptic", "a box of 250 g held by two pads with 6 N, impratio 1", "impratio 100", || {
        held(|o| o.impratio = 1.0, |o| o.impratio = 100.0)
    }),
    FAMILY.case("creep_pyramidal", "the same with the pyramidal cone", "3 noslip_iterations", || {
        held(
            |o| (o.impratio, o.cone) = (1.0, Cone::Pyramidal),
            |o| (o.impratio, o.cone, o.noslip_iterations) = (1.0, Cone::Pyramidal, 3),
        )
    }),
    FAMILY.case("creep_default", "the same with this project's defaults, impratio 10", "impratio 100", || {
        held(|_| (), |o| o.impratio = 100.0)
    }),
];

const HELD: &str = r#"<mujoco><default><geom condim="4" friction="1 .01 .0001"/></default><worldbody>
    <body name="box" pos="0 0 .2"><freejoint name="box"/><geom name="box" type="box" size=".03 .03 .05" mass=".25"/></body>
    <body name="one" pos="-.04 0 .2" gravcomp="1"><joint name="one" type="slide" axis="1 0 0" armature=".05" damping="5"/>
    <geom name="one" type="box" size=".01 .01 .01" mass=".05"/></body>
    <body name="other" pos=".04 0 .2" gravcomp="1"><joint name="other" type="slide" axis="-1 0 0" armature=".05" damping="5"/>
    <geom name="other" type="box" size=".01 .01 .01" mass=".05"/></body></worldbody><actuator>
    <position name="one" joint="one" kp="2000" kv="20" forcerange="-6 6"/>
    <position name="other" joint="other" kp="2000" kv="20" forcerange="-6 6"/></actuator></mujoco>"#;

fn held(as_written: impl FnOnce(&mut Unchecked), remedy: impl FnOnce(&mut Unchecked)) -> Result<Outcome> {
    let run = |physics: egotac::mujoco::PhysicsOptions| -> Result<(f64, Watched)> {
        let close = |world: &mut World| {
            for name in ["one", "other"] {
                if let Ok(servo) = world.servo(name) {
                    world.set_target(servo, 0.01);
                }
            }
        };
        let mut settled = None;
        let run = simulate(HELD, &physics, &["box"], 3.0, close, |world| {
            if world.time() >= 1.0 {
                settled.get_or_insert(world.qpos()[2]);
            }
        })?;
        // From 1 s, when the box has settled, to 3 s.
        Ok((1e3 * (settled.unwrap_or(f64::NAN) - run.world.qpos()[2]) / 2.0, run))
    };
    let (unguarded, remedied) = (run(options(as_written)?)?, run(options(remedy)?)?);
    Ok(compare(unguarded, remedied, "slip of the held box, mm/s", 0.5))
}
