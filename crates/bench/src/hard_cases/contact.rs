//! Contacts: masses, depths, speeds, sizes.

use egotac::error::Result;
use egotac::mujoco::PhysicsOptions;

use super::watch::{Watched, compare, options, settle, simulate};
use super::{Family, HardCase, Outcome};

const FAMILY: Family = Family::Contact;

pub(super) const CASES: &[HardCase] = &[
    FAMILY.case(
        "mass_ratio_100",
        "a 1 kg box of 100 mm on a 10 g box of 40 mm, default contacts",
        "solref .004, solimp .999 .9999 .0001",
        || mass_ratio(100.0),
    ),
    FAMILY.case(
        "mass_ratio_1000",
        "the same on a 1 g box: the heavy box passes through it",
        "solref .004, solimp .999 .9999 .0001",
        || mass_ratio(1000.0),
    ),
    FAMILY.case("sunken_start", "a box starts 10 mm inside of the floor", "start on the floor", sunken_start),
    FAMILY.case(
        "coincident_spheres",
        "two balls of 60 mm start at the same place",
        "start side by side",
        coincident_spheres,
    ),
    FAMILY.case(
        "thin_plate",
        "a 1 g ball of 6 mm meets a plate of 1 mm at 1 m/s: it passes through at any timestep",
        "time constant 1 ms, timestep 0.5 ms",
        || thin_plate(Meeting { radius: 0.003, speed: 1.0 }, (0.001, 5e-4)),
    ),
    FAMILY.case(
        "thin_plate_fast",
        "a ball of 16 mm meets a plate of 1 mm at 10 m/s: it passes the plate between two steps",
        "time constant 0.1 ms, timestep 0.05 ms",
        || thin_plate(Meeting { radius: 0.008, speed: 10.0 }, (1e-4, 5e-5)),
    ),
    FAMILY.case("tiny_cube", "a cube of 2 mm falls by 2 mm", "time constant 2 ms, timestep 0.2 ms", tiny_cube),
    FAMILY.case("tiny_ball", "a ball of 1 mm lies on the floor", "time constant 2 ms, timestep 0.2 ms", tiny_ball),
    FAMILY.case("tiny_mass", "a cube of 0.2 mm, 8 micrograms", "a cube of 2 mm", tiny_mass),
    FAMILY.case(
        "fast_impact",
        "a ball of 40 mm and 50 g meets the floor at 10 m/s",
        "time constant 0.8 ms, timestep 0.04 ms",
        fast_impact,
    ),
    FAMILY.case(
        "coarse_impact",
        "a contact of 4 ms time constant at a timestep of 2 ms: the bounce is a different one",
        "a timestep of a twentieth of the time constant",
        coarse_impact,
    ),
];

fn mass_ratio(ratio: f64) -> Result<Outcome> {
    let run = |softness: &str| -> Result<(f64, Watched)> {
        let mjcf = format!(
            r#"<mujoco><default><geom {softness}/></default><worldbody><geom name="floor" type="plane" size="1 1 .1"/>
            <body name="light" pos="0 0 .02"><freejoint name="light"/><geom type="box" size=".02 .02 .02" mass="{}"/></body>
            <body name="heavy" pos="0 0 .09"><freejoint name="heavy"/><geom type="box" size=".05 .05 .05" mass="1"/></body>
            </worldbody></mujoco>"#,
            1.0 / ratio
        );
        let run = settle(&mjcf, &PhysicsOptions::default(), &["light", "heavy"], 2.0)?;
        Ok((1e3 * (0.09 - run.world.position(run.world.body("heavy")?).z), run))
    };
    let stiff = r#"solref=".004 1" solimp=".999 .9999 .0001""#;
    Ok(compare(run("")?, run(stiff)?, "height of the heavy box, mm", 0.5))
}

fn sunken_start() -> Result<Outcome> {
    let run = |height: f64| -> Result<(f64, Watched)> {
        let mjcf = format!(
            r#"<mujoco><worldbody><geom name="floor" type="plane" size="1 1 .1"/><body name="box" pos="0 0 {height}">
            <freejoint name="box"/><geom name="box" type="box" size=".05 .05 .05" mass=".2"/></body></worldbody></mujoco>"#
        );
        let mut fastest = 0f64;
        let see = |world: &mut egotac::mujoco::World| fastest = fastest.max(world.qvel()[2]);
        let run = simulate(&mjcf, &PhysicsOptions::default(), &["box"], 0.5, |_| (), see)?;
        Ok((fastest, run))
    };
    Ok(compare(run(0.04)?, run(0.05)?, "upward speed at rest, m/s", 0.01))
}

fn coincident_spheres() -> Result<Outcome> {
    let run = |apart: f64| -> Result<(f64, Watched)> {
        let ball = |name: &str, x: f64| {
            format!(
                r#"<body name="{name}" pos="{x} 0 0"><freejoint name="{name}"/><geom name="{name}" size=".03" mass=".1"/></body>"#
            )
        };
        let mjcf = format!("<mujoco><worldbody>{}{}</worldbody></mujoco>", ball("one", 0.0), ball("other", apart));
        let still = options(|o| o.gravity = [0.0; 3])?;
        let mut fastest = 0f64;
        let see = |world: &mut egotac::mujoco::World| {
            fastest = world.qvel().iter().fold(fastest, |most, v| most.max(v.abs()));
        };
        let run = simulate(&mjcf, &still, &["one", "other"], 0.2, |_| (), see)?;
        Ok((fastest, run))
    };
    Ok(compare(run(0.0)?, run(0.06)?, "speed out of rest, m/s", 0.01))
}

/// A ball on its way to a plate.
struct Meeting {
    /// m.
    radius: f64,
    /// m/s.
    speed: f64,
}

fn thin_plate(Meeting { radius, speed }: Meeting, (time, timestep): (f64, f64)) -> Result<Outcome> {
    let run = |time: f64, timestep: f64| -> Result<(f64, Watched)> {
        let mjcf = format!(
            r#"<mujoco><default><geom solref="{time} 1"/></default><worldbody>
            <geom name="plate" type="box" size=".05 .05 .0005" pos="0 0 -.0005"/><body name="ball" pos="0 0 .021">
            <freejoint name="ball"/><geom name="ball" size="{radius}" mass=".001"/></body></worldbody></mujoco>"#
        );
        let physics = options(|o| (o.timestep, o.gravity) = (timestep, [0.0; 3]))?;
        let mut deepest = 0f64;
        let throw = |world: &mut egotac::mujoco::World| world.qvel_mut()[2] = -speed;
        let see = |world: &mut egotac::mujoco::World| deepest = deepest.max(radius - world.qpos()[2]);
        let run = simulate(&mjcf, &physics, &["ball"], 0.1, throw, see)?;
        Ok((1e3 * deepest, run))
    };
    Ok(compare(run(0.02, 2e-3)?, run(time, timestep)?, "depth in the plate, mm", 0.5))
}

fn small(geom: &str, height: f64, time: f64, timestep: f64) -> Result<(f64, f64, Watched)> {
    let mjcf = format!(
        r#"<mujoco><default><geom solref="{time} 1" density="1000"/></default><worldbody>
        <geom name="floor" type="plane" size="1 1 .1"/><body name="small" pos="0 0 {height}"><freejoint name="small"/>
        <geom name="small" {geom}/></body></worldbody></mujoco>"#
    );
    let physics = options(|o| o.timestep = timestep)?;
    let mut lowest = f64::INFINITY;
    let see = |world: &mut egotac::mujoco::World| lowest = lowest.min(world.qpos()[2]);
    let run = simulate(&mjcf, &physics, &["small"], 0.3, |_| (), see)?;
    Ok((lowest, run.world.qpos()[2], run))
}

fn tiny_cube() -> Result<Outcome> {
    let run = |time: f64, timestep: f64| -> Result<(f64, Watched)> {
        let (lowest, _, run) = small(r#"type="box" size=".001 .001 .001""#, 0.003, time, timestep)?;
        Ok((100.0 * (0.001 - lowest) / 0.001, run))
    };
    Ok(compare(run(0.02, 2e-3)?, run(0.002, 2e-4)?, "depth in the floor, % of half its size", 20.0))
}

fn tiny_ball() -> Result<Outcome> {
    let run = |time: f64, timestep: f64| -> Result<(f64, Watched)> {
        let (_, rest, run) = small(r#"size=".0005""#, 0.0005, time, timestep)?;
        Ok((100.0 * (0.0005 - rest) / 0.0005, run))
    };
    Ok(compare(run(0.02, 2e-3)?, run(0.002, 2e-4)?, "height at rest, % of its radius", 5.0))
}

fn tiny_mass() -> Result<Outcome> {
    let run = |half: f64| small(&format!(r#"type="box" size="{half} {half} {half}""#), 2.0 * half, 0.002, 2e-4);
    let (unguarded, guard) = super::accepted([run(1e-4)]);
    let (remedied, remedied_guard) = match run(1e-3) {
        Ok((.., run)) => (0.0, run.errors),
        Err(error) => (1.0, error.to_string()),
    };
    let error_of = "models wrongly accepted or refused";
    Ok(Outcome { error_of, tolerance: 0.0, unguarded: Some(unguarded), guard, remedied, remedied_guard })
}

fn impact(speed: f64, time: f64, timestep: f64) -> Result<(f64, f64, Watched)> {
    let mjcf = format!(
        r#"<mujoco><default><geom solref="{time} 1"/></default><worldbody><geom name="floor" type="plane" size="1 1 .1"/>
        <body name="ball" pos="0 0 .0301"><freejoint name="ball"/><geom name="ball" size=".02" mass=".05"/></body>
        </worldbody></mujoco>"#
    );
    let physics = options(|o| (o.timestep, o.gravity) = (timestep, [0.0; 3]))?;
    let mut lowest = f64::INFINITY;
    let throw = |world: &mut egotac::mujoco::World| world.qvel_mut()[2] = -speed;
    let see = |world: &mut egotac::mujoco::World| lowest = lowest.min(world.qpos()[2]);
    let run = simulate(&mjcf, &physics, &["ball"], 0.01 / speed + 30.0 * time, throw, see)?;
    Ok((0.02 - lowest, run.world.qvel()[2], run))
}

fn fast_impact() -> Result<Outcome> {
    let run = |time: f64, timestep: f64| -> Result<(f64, Watched)> {
        let (depth, _, run) = impact(10.0, time, timestep)?;
        Ok((1e3 * depth, run))
    };
    Ok(compare(run(0.02, 2e-3)?, run(8e-4, 4e-5)?, "depth in the floor, mm", 4.0))
}

fn coarse_impact() -> Result<Outcome> {
    let (_, fine, _) = impact(1.0, 0.004, 1e-5)?;
    // The whole impulse is m (v + exit speed).
    let error = |exit: f64| 100.0 * (exit - fine).abs() / (1.0 + fine);
    let run = |timestep: f64| -> Result<(f64, Watched)> {
        let (_, exit, run) = impact(1.0, 0.004, timestep)?;
        Ok((error(exit), run))
    };
    Ok(compare(run(2e-3)?, run(2e-4)?, "impulse against a timestep of 0.01 ms, %", 1.0))
}
