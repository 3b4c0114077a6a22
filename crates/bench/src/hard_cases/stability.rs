//! Stiffness, damping and integration in relation to the timestep.

use egotac::error::Result;
use egotac::mujoco::{Integrator, PhysicsOptions, World};

use super::watch::{Watched, compare, options, simulate};
use super::{Family, HardCase, Outcome};

const FAMILY: Family = Family::Stability;

pub(super) const CASES: &[HardCase] = &[
    FAMILY.case(
        "stiff_without_refsafe",
        "solref .001 with refsafe off at 2 ms; a box falls by 30 mm",
        "leave refsafe on",
        stiff_without_refsafe,
    ),
    FAMILY.case("direct_1e6", "solref -1e6 -1e3 at 2 ms; a box falls by 30 mm", "integrator discrete", || {
        direct("-1e6 -1e3")
    }),
    FAMILY.case("direct_1e9", "solref -1e9 -1e4 at 2 ms; a box falls by 30 mm", "integrator discrete", || {
        direct("-1e9 -1e4")
    }),
    FAMILY.case(
        "underdamped",
        "twelve dice, solref .004 with damping ratio 0.1, at 2 ms",
        "a timestep of an eighth of the time constant",
        underdamped,
    ),
    FAMILY.case("fast_spin", "a 0.2 kg box spins at 100 rad/s in the air, 2 s at 1 ms", "integrator rk4", || {
        spin(100.0, Integrator::ImplicitFast, 2.0)
    }),
    FAMILY.case("fast_spin_euler", "the same with integrator euler", "integrator rk4", || {
        spin(100.0, Integrator::Euler, 2.0)
    }),
    FAMILY.case("slow_spin", "a 0.2 kg box spins at 10 rad/s in the air, 2 s at 1 ms", "integrator rk4", || {
        spin(10.0, Integrator::ImplicitFast, 2.0)
    }),
];

/// Height from which the box falls, m.
const FALL: f64 = 0.03;

/// Drops a box by [`FALL`] and returns the height that it reaches above its start, mm.
fn falls(flag: &str, solref: &str, physics: &PhysicsOptions) -> Result<(f64, Watched)> {
    let mjcf = format!(
        r#"<mujoco><option>{flag}</option><default><geom solref="{solref}"/></default><worldbody>
        <geom name="floor" type="plane" size="1 1 .1"/><body name="box" pos="0 0 {}"><freejoint name="box"/>
        <geom name="box" type="box" size=".05 .05 .05" mass=".2"/></body></worldbody></mujoco>"#,
        0.05 + FALL
    );
    let mut highest = 0f64;
    let see = |world: &mut World| highest = highest.max(world.qpos()[2]);
    let run = simulate(&mjcf, physics, &["box"], 1.5, |_| (), see)?;
    Ok((1e3 * (highest - 0.05 - FALL), run))
}

fn stiff_without_refsafe() -> Result<Outcome> {
    let physics = PhysicsOptions::default();
    let without = falls(r#"<flag refsafe="disable"/>"#, ".001 1", &physics)?;
    Ok(compare(without, falls("", ".001 1", &physics)?, "height gained by a fall, mm", 1.0))
}

fn direct(solref: &str) -> Result<Outcome> {
    let discrete = options(|o| o.integrator = Integrator::Discrete)?;
    let unguarded = falls("", solref, &PhysicsOptions::default())?;
    Ok(compare(unguarded, falls("", solref, &discrete)?, "height gained by a fall, mm", 1.0))
}

fn underdamped() -> Result<Outcome> {
    const SIDE: f64 = 0.016;
    let dice: String = (0..12)
        .map(|i| {
            let (x, z) = (0.03 * f64::from(i % 4) - 0.045, 0.02 + 0.03 * f64::from(i / 4));
            format!(
                r#"<body name="die{i}" pos="{x} {} {z}" quat="1 .{i} .3 .1"><freejoint name="die{i}"/>
                <geom type="box" size="{1} {1} {1}" mass=".01"/></body>"#,
                0.004 * f64::from(i / 4),
                0.5 * SIDE
            )
        })
        .collect();
    let mjcf = format!(
        r#"<mujoco><default><geom solref=".004 .1"/></default><worldbody><geom name="floor" type="plane" size="1 1 .1"/>
        {dice}</worldbody></mujoco>"#
    );
    let names: Vec<String> = (0..12).map(|i| format!("die{i}")).collect();
    let names: Vec<&str> = names.iter().map(String::as_str).collect();
    let run = |timestep: f64| -> Result<(f64, Watched)> {
        let physics = options(|o| o.timestep = timestep)?;
        let mut highest = 0f64;
        let see = |world: &mut World| {
            highest = world.qpos().iter().skip(2).step_by(7).fold(highest, |most, z| most.max(*z));
        };
        let run = simulate(&mjcf, &physics, &names, 1.0, |_| (), see)?;
        Ok((1e3 * (highest - 0.08), run))
    };
    Ok(compare(run(2e-3)?, run(0.004 / 8.0)?, "height gained by a fall, mm", 5.0))
}

fn spin(rate: f64, integrator: Integrator, seconds: f64) -> Result<Outcome> {
    let run = |integrator: Integrator| -> Result<(f64, Watched)> {
        let mjcf = r#"<mujoco><worldbody><body name="box"><freejoint name="box"/>
            <geom type="box" size=".02 .03 .05" mass=".2"/></body></worldbody></mujoco>"#;
        let physics = options(|o| (o.timestep, o.gravity, o.integrator) = (1e-3, [0.0; 3], integrator))?;
        let turn = |world: &mut World| {
            let axis = glam::DVec3::new(0.3, 1.0, 0.2).normalize() * rate;
            world.qvel_mut()[3..6].copy_from_slice(&axis.to_array());
        };
        let mut begun = None;
        let mut run = simulate(mjcf, &physics, &["box"], seconds, turn, |world| {
            begun.get_or_insert(world.kinetic_energy());
        })?;
        let ended = run.world.kinetic_energy();
        Ok((100.0 * (ended / begun.unwrap_or(f64::NAN) - 1.0), run))
    };
    Ok(compare(run(integrator)?, run(Integrator::Rk4)?, "energy of rotation, %", 2.0))
}
