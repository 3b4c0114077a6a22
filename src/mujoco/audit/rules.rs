//! The rules of the audit, one function each.

use mujoco_rs::prelude::*;

use super::mesh::mesh_faults;
use super::pairs::{GeomPair, depth_limits, half_thickness, refsafe};
use super::{Finding, Rule, Severity};
use crate::mujoco::options::Integrator;
use crate::mujoco::world::World;

/// Largest mass ratio that default contacts bear.
const MAX_MASS_RATIO: f64 = 100.0;
/// Largest penetration of the lower contact of a stack at rest, m.
const MAX_SINK: f64 = 1e-3;
/// Largest overlap of geoms at the start, m.
const MAX_START_DEPTH: f64 = 2e-3;
/// Smallest radius of gyration, m.
const MIN_GYRATION: f64 = 1e-4;
/// Smallest thickness of a collision mesh, m.
const MIN_THICKNESS: f64 = 1e-5;
/// Smallest impratio at which a held object does not visibly creep.
const MIN_IMPRATIO: f64 = 10.0;

/// Finds a light body that carries a heavy one. Contact stiffness scales with the light mass, so the heavy body sinks
/// in.
pub(super) fn mass_ratio(world: &World, pairs: &[GeomPair]) -> Option<Finding> {
    let model = world.model();
    let g = glam::DVec3::from_array(world.options().gravity).length();
    let mass = |body: usize| model.body_subtreemass()[model.body_rootid()[body] as usize];
    let mut worst: Option<(f64, f64, [usize; 2])> = None;
    for pair in pairs.iter().filter(|t| t.bodies.iter().all(|body| model.body_treeid()[*body] >= 0)) {
        let [a, b] = pair.bodies;
        if model.body_rootid()[a] == model.body_rootid()[b] {
            continue;
        }
        let (light, heavy) = if mass(a) < mass(b) { (a, b) } else { (b, a) };
        // A gravity-compensated body does not load the contact with its weight.
        let weighing = 1.0 - model.body_gravcomp()[heavy].clamp(0.0, 1.0);
        let ratio = weighing * mass(heavy) / mass(light).max(1e-12);
        let sink = sink(world, pair, ratio, g);
        if ratio > MAX_MASS_RATIO && sink > MAX_SINK && worst.is_none_or(|(most, ..)| ratio > most) {
            worst = Some((ratio, sink, [light, heavy]));
        }
    }
    let (ratio, sink, bodies) = worst?;
    let [light, heavy] = bodies.map(|body| body_name(world, body));
    let message = format!(
        "{heavy} is {ratio:.0} times as heavy as {light}, expected at most {MAX_MASS_RATIO:.0} or a stiffer contact: \
         on top of it, it would sink about {:.1} mm",
        1e3 * sink
    );
    Some(Finding { severity: Severity::Error, rule: Rule::MassRatio, message })
}

/// Returns the penetration of the lower contact of a stack at rest, m: `d k r = (1 - d) a`, with impedance `d`,
/// stiffness `k`, penetration `r`, and `a` the acceleration that the load alone would cause.
fn sink(world: &World, pair: &GeomPair, ratio: f64, g: f64) -> f64 {
    let [_, d, ..] = pair.solimp;
    let stiffness = match pair.time_constant(world) {
        Some(time) => 1.0 / (d * time * pair.solref[1]).powi(2),
        None => -pair.solref[0] / (d * d),
    };
    (1.0 - d) / d * (ratio + 1.0) * g / stiffness.max(1e-9)
}

/// Compares the timestep with the shortest time constant of a contact.
pub(super) fn contact_time(world: &World, pairs: &[GeomPair]) -> Option<Finding> {
    let dt = world.options().timestep;
    let times = pairs.iter().filter(|t| t.solref[0] > 0.0);
    let worst = times.min_by(|a, b| a.solref[0].total_cmp(&b.solref[0]))?;
    let time = worst.solref[0];
    let pair = pair_name(world, worst);
    let (severity, message) = if dt > 0.5 * time && !refsafe(world) {
        let most = 0.5 * time;
        (
            Severity::Error,
            format!("{pair}: the timestep is {dt} s, expected at most {most} s, half of the contact's time constant"),
        )
    } else if dt > 0.5 * time {
        let used = 2.0 * dt;
        (
            Severity::Advice,
            format!(
                "{pair}: the timestep is {dt} s, so the contact's time constant becomes {used} s in place of {time} s: a softer material"
            ),
        )
    } else if dt > 0.1 * time {
        (
            Severity::Advice,
            format!("{pair}: the timestep is {dt} s, for impulses to 2 % expected at most {} s", 0.1 * time),
        )
    } else {
        return None;
    };
    Some(Finding { severity, rule: Rule::ContactTime, message })
}

/// Finds directly given stiffness that an explicit integrator cannot integrate at the timestep.
pub(super) fn direct_stiffness(world: &World, pairs: &[GeomPair]) -> Option<Finding> {
    if world.options().integrator == Integrator::Discrete {
        return None;
    }
    let dt = world.options().timestep;
    let worst = pairs.iter().min_by(|a, b| a.solref[0].total_cmp(&b.solref[0]))?;
    let rate = (-worst.solref[0]).max(0.0).sqrt();
    (dt * rate > 1.0).then(|| {
        let message = format!(
            "{}: solref {} is stiffer than {:.0}, what a timestep of {dt} s bears without the integrator `discrete`",
            pair_name(world, worst),
            worst.solref[0],
            -1.0 / (dt * dt)
        );
        Finding { severity: Severity::Error, rule: Rule::DirectStiffness, message }
    })
}

/// Finds an underdamped contact that gains energy at the timestep.
pub(super) fn contact_damping(world: &World, pairs: &[GeomPair]) -> Option<Finding> {
    let dt = world.options().timestep;
    let loose = |t: &&GeomPair| t.solref[0] > 0.0 && t.solref[1] < 1.0 && dt > t.solref[0] / 8.0 * (1.0 + 1e-9);
    let worst = pairs.iter().filter(loose).min_by(|a, b| a.solref[1].total_cmp(&b.solref[1]))?;
    let [time, ratio] = worst.solref;
    let message = format!(
        "{}: the contact's damping ratio is {ratio}, expected at least 1 or a timestep of at most {} s: it would gain energy",
        pair_name(world, worst),
        time / 8.0
    );
    Some(Finding { severity: Severity::Error, rule: Rule::ContactDamping, message })
}

/// Finds a pair that passes through each other at the expected speed.
pub(super) fn tunnelling(world: &World, pairs: &[GeomPair], speed: f64) -> Option<Finding> {
    let worst = pairs.iter().min_by(|a, b| a.speed_limit(world).total_cmp(&b.speed_limit(world)))?;
    let most = worst.speed_limit(world);
    (most < speed).then(|| {
        let message = format!(
            "{}: above {most:.2} m/s they pass through each other; shorten the contact's time constant and the timestep, or \
             thicken them",
            pair_name(world, worst)
        );
        Finding { severity: Severity::Advice, rule: Rule::Tunnelling, message }
    })
}

/// Finds geoms that overlap at the start.
pub(super) fn start_depth(world: &World) -> Option<Finding> {
    let limits = depth_limits(world, 2.0 * MAX_START_DEPTH);
    let excess = |geoms: [usize; 2], distance: f64| -distance - 0.5 * limits[geoms[0]].min(limits[geoms[1]]);
    let bodies = world.model().geom_bodyid();
    let tree = |geom: usize| world.model().body_treeid()[bodies[geom] as usize];
    // Joints hold the links of one mechanism together: overlapping links separate without being thrown apart.
    let linked = |[a, b]: [usize; 2]| tree(a) >= 0 && tree(a) == tree(b);
    let worst = |of_one: bool| {
        let gaps = world.gaps().filter(|(geoms, distance)| linked(*geoms) == of_one && excess(*geoms, *distance) > 0.0);
        gaps.max_by(|a, b| excess(a.0, a.1).total_cmp(&excess(b.0, b.1)))
    };
    let thrown = worst(false).map(|gap| (gap, Severity::Error, "they would be thrown apart"));
    let (gap, severity, end) =
        thrown.or_else(|| worst(true).map(|gap| (gap, Severity::Advice, "they press on each other")))?;
    let (geoms, distance) = gap;
    let message = format!(
        "{} and {} start {:.1} mm inside of each other, expected at most {:.1} mm: {end}",
        geom_name(world, geoms[0]),
        geom_name(world, geoms[1]),
        -1e3 * distance,
        -1e3 * (distance + excess(geoms, distance)),
    );
    Some(Finding { severity, rule: Rule::StartDepth, message })
}

/// Finds a freely rotating body whose inertia is so small that rounding spins it up.
pub(super) fn inertia(world: &World) -> Option<Finding> {
    let model = world.model();
    let turning = model.jnt_type().iter().zip(model.jnt_bodyid());
    let turning = turning.filter(|(kind, _)| matches!(**kind, MjtJoint::mjJNT_FREE | MjtJoint::mjJNT_BALL));
    let gyration = |body: usize| {
        let least = model.body_inertia()[body].into_iter().fold(f64::INFINITY, f64::min);
        (least / model.body_mass()[body].max(1e-15)).sqrt()
    };
    // A body with children rotates with their inertia too.
    let alone = |body: usize| !model.body_parentid().iter().any(|parent| *parent as usize == body);
    let bodies = turning.map(|(_, body)| *body as usize).filter(|body| alone(*body));
    let worst = bodies.min_by(|a, b| gyration(*a).total_cmp(&gyration(*b)))?;
    (gyration(worst) < MIN_GYRATION).then(|| {
        let message = format!(
            "{}: the radius of gyration is {:.1e} m, expected at least {MIN_GYRATION:.0e} m: it would spin from rounding",
            body_name(world, worst),
            gyration(worst)
        );
        Finding { severity: Severity::Error, rule: Rule::Inertia, message }
    })
}

/// Finds faults of collision meshes, which the engine hides by colliding their convex hulls.
pub(super) fn meshes(world: &World) -> Option<Finding> {
    let model = world.model();
    let collides = |geom: usize| model.geom_contype()[geom] != 0 || model.geom_conaffinity()[geom] != 0;
    let is_mesh = |geom: usize| matches!(model.geom_type()[geom], MjtGeomBase::mjGEOM_MESH | MjtGeomBase::mjGEOM_SDF);
    let geoms: Vec<usize> = (0..model.geom_type().len()).filter(|geom| is_mesh(*geom) && collides(*geom)).collect();
    if let Some(thin) = geoms.iter().find(|geom| half_thickness(world, **geom) < 0.5 * MIN_THICKNESS) {
        let message = format!(
            "{}: the mesh is {:.1e} m thick, expected at least {MIN_THICKNESS:.0e} m",
            geom_name(world, *thin),
            2.0 * half_thickness(world, *thin)
        );
        return Some(Finding { severity: Severity::Error, rule: Rule::Mesh, message });
    }
    geoms.into_iter().find_map(|geom| {
        let mesh = usize::try_from(model.geom_dataid()[geom]).ok()?;
        let range = |first: &[i32], count: &[i32]| first[mesh] as usize..(first[mesh] + count[mesh]) as usize;
        let vertices = &model.mesh_vert()[range(model.mesh_vertadr(), model.mesh_vertnum())];
        let faces = &model.mesh_face()[range(model.mesh_faceadr(), model.mesh_facenum())];
        let vertices: Vec<_> = vertices.iter().map(|v| glam::Vec3::from_array(*v)).collect();
        let faces: Vec<[u32; 3]> = faces.iter().map(|f| f.map(|i| i as u32)).collect();
        let faults = mesh_faults(&vertices, &faces);
        if faults.is_empty() {
            return None;
        }
        let faults: Vec<String> = faults.iter().map(ToString::to_string).collect();
        let message = format!("{}: the mesh {}", geom_name(world, geom), faults.join(", "));
        Some(Finding { severity: Severity::Advice, rule: Rule::Mesh, message })
    })
}

/// Finds friction too soft to hold an object.
pub(super) fn creep(world: &World) -> Option<Finding> {
    let options = world.options();
    if options.impratio >= MIN_IMPRATIO || options.noslip_iterations >= 3 {
        return None;
    }
    let message = format!(
        "impratio is {}, for holding expected at least {MIN_IMPRATIO} or 3 noslip_iterations: a held object slides out of the \
         hand by a millimetre per second",
        options.impratio
    );
    Some(Finding { severity: Severity::Advice, rule: Rule::Creep, message })
}

/// Finds a model whose bodies may sleep.
pub(super) fn sleep(world: &World) -> Option<Finding> {
    let sleeps = world.model().opt().enableflags & MjtEnableBit::mjENBL_SLEEP as i32 != 0;
    sleeps.then(|| Finding {
        severity: Severity::Advice,
        rule: Rule::Sleep,
        message: "bodies may sleep: contacts between sleeping bodies are missing from the list".into(),
    })
}

fn pair_name(world: &World, pair: &GeomPair) -> String {
    let [a, b] = pair.geoms.map(|geom| geom_name(world, geom));
    format!("{a} and {b}")
}

/// Returns the name of a geom, or its index and its body's name.
fn geom_name(world: &World, geom: usize) -> String {
    match world.model().id_to_name(MjtObjBase::mjOBJ_GEOM, geom) {
        Some(name) if !name.is_empty() => format!("`{name}`"),
        _ => format!("geom {geom} of {}", body_name(world, world.model().geom_bodyid()[geom] as usize)),
    }
}

fn body_name(world: &World, body: usize) -> String {
    match world.model().id_to_name(MjtObjBase::mjOBJ_BODY, body) {
        Some(name) if !name.is_empty() => format!("`{name}`"),
        _ => format!("body {body}"),
    }
}
