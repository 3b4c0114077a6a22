//! Inputs that would end the process: refused before the engine sees them.

use egotac::error::Result;
use egotac::mujoco::options::Unchecked;
use egotac::mujoco::{Integrator, PhysicsOptions, Solver, World};

use super::{Family, HardCase, Outcome, accepted};

const FAMILY: Family = Family::Process;

pub(super) const CASES: &[HardCase] = &[
    FAMILY.case(
        "invalid_options",
        "a timestep of 0, below 0, NaN or 1000 s, no iterations, an integrator that does not exist",
        "values within their ranges",
        invalid_options,
    ),
    FAMILY.case(
        "tactile_beside_bare_sdf",
        "a tactile sensor in a model with an sdf geom that has no plugin",
        "a mesh in place of the sdf",
        tactile_beside_bare_sdf,
    ),
    FAMILY.case(
        "soft_body_with_implicitfast",
        "an elastic flex, and implicitfast, rk4, pgs or noslip set after the model is compiled",
        "integrator discrete, solver newton",
        soft_body,
    ),
    FAMILY.case(
        "discrete_inverse_with_rk4",
        "flags fwdinv and invdiscrete, and integrator rk4",
        "integrator implicitfast",
        discrete_inverse,
    ),
    FAMILY.case("small_memory", "36 boxes on the floor in 100 kB of memory", "the engine's own size", small_memory),
];

/// Returns the outcome for models that must be refused. They are not run: the process would end or hang.
fn refused(bad: Vec<Result<World>>, good: Result<World>) -> Outcome {
    let (through, guard) = accepted(bad);
    let (remedied, remedied_guard) = match good {
        Ok(mut world) => {
            (0..50).for_each(|_| world.step());
            (if world.is_finite() { 0.0 } else { 1.0 }, String::new())
        }
        Err(error) => (1.0, error.to_string()),
    };
    let guard = if through > 0.0 { String::new() } else { guard };
    Outcome { error_of: "the process", tolerance: 0.0, unguarded: None, guard, remedied, remedied_guard }
}

fn invalid_options() -> Result<Outcome> {
    const BALL: &str = r#"<mujoco><worldbody><geom type="plane" size="1 1 .1"/><body pos="0 0 .1"><freejoint/>
        <geom size=".02"/></body></worldbody></mujoco>"#;
    let with = |options: Unchecked| World::from_mjcf(BALL, &PhysicsOptions::try_from(options)?);
    let unknown = |text: &str| {
        let options = serde_yaml::from_str(text).map_err(|e| egotac::Error::value("options", "known ones", e))?;
        World::from_mjcf(BALL, &options)
    };
    let bad = vec![
        with(Unchecked { timestep: 0.0, ..Default::default() }),
        with(Unchecked { timestep: -1e-3, ..Default::default() }),
        with(Unchecked { timestep: f64::NAN, ..Default::default() }),
        with(Unchecked { timestep: 1000.0, ..Default::default() }),
        with(Unchecked { iterations: 0, ..Default::default() }),
        unknown("integrator: 77"),
        unknown("integrator: leapfrog"),
    ];
    Ok(refused(bad, with(Unchecked::default())))
}

fn tactile_beside_bare_sdf() -> Result<Outcome> {
    let model = |kind: &str| {
        let mjcf = format!(
            r#"<mujoco><asset><mesh name="s" builtin="sphere" params="2" scale=".02 .02 .02"/></asset><worldbody>
            <geom type="plane" size="1 1 .1"/><body pos="0 0 .015"><freejoint/><geom name="g" type="{kind}" mesh="s"/></body>
            <body pos="0 0 .05"><freejoint/><geom name="h" size=".02"/></body></worldbody>
            <sensor><tactile geom="h" mesh="s"/></sensor></mujoco>"#
        );
        World::from_mjcf(&mjcf, &PhysicsOptions::default())
    };
    Ok(refused(vec![model("sdf")], model("mesh")))
}

fn soft_body() -> Result<Outcome> {
    const FLEX: &str = r#"<mujoco><option integrator="discrete"/><worldbody><geom type="plane" size="1 1 .1"/>
        <flexcomp type="grid" count="3 3 3" spacing=".02 .02 .02" dim="3" name="f" radius=".002" mass=".1" pos="0 0 .1">
        <elasticity young="1e4" poisson=".2" damping=".01"/><contact selfcollide="none"/></flexcomp></worldbody></mujoco>"#;
    let soft = Unchecked { integrator: Integrator::Discrete, timestep: 1e-3, ..Default::default() };
    let with = |options: Unchecked| World::from_mjcf(FLEX, &PhysicsOptions::try_from(options)?);
    let bad = vec![
        with(Unchecked { integrator: Integrator::ImplicitFast, ..soft.clone() }),
        with(Unchecked { integrator: Integrator::Rk4, ..soft.clone() }),
        with(Unchecked { integrator: Integrator::Euler, ..soft.clone() }),
        with(Unchecked { solver: Solver::Pgs, ..soft.clone() }),
        with(Unchecked { noslip_iterations: 3, ..soft.clone() }),
    ];
    Ok(refused(bad, with(soft)))
}

fn discrete_inverse() -> Result<Outcome> {
    const FLAGS: &str = r#"<mujoco><option><flag fwdinv="enable" invdiscrete="enable"/></option><worldbody>
        <geom type="plane" size="1 1 .1"/><body pos="0 0 .02"><freejoint/><geom size=".02"/></body></worldbody></mujoco>"#;
    let with = |integrator: Integrator| {
        World::from_mjcf(FLAGS, &PhysicsOptions::try_from(Unchecked { integrator, ..Default::default() })?)
    };
    Ok(refused(vec![with(Integrator::Rk4)], with(Integrator::ImplicitFast)))
}

fn small_memory() -> Result<Outcome> {
    let boxes: String = (0..36)
        .map(|i| {
            let (x, y) = (0.1 * f64::from(i % 6), 0.1 * f64::from(i / 6));
            format!(r#"<body pos="{x} {y} .02"><freejoint/><geom type="box" size=".02 .02 .02" mass=".1"/></body>"#)
        })
        .collect();
    let with = |size: &str| {
        let floor = r#"<geom type="plane" size="1 1 .1"/>"#;
        let mjcf = format!("<mujoco>{size}<worldbody>{floor}{boxes}</worldbody></mujoco>");
        World::from_mjcf(&mjcf, &PhysicsOptions::default())
    };
    Ok(refused(vec![with(r#"<size memory="100K"/>"#), with(r#"<size memory="200K"/>"#)], with("")))
}
