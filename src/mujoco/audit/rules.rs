//! The rules of the audit, one function each.

use mujoco_rs::prelude::*;

use super::mesh::mesh_faults;
use super::touch::{PEAK_DEPTH, Touch, depth_limits, half_thickness, refsafe};
use super::{Finding, Rule, Severity};
use crate::mujoco::options::Integrator;
use crate::mujoco::world::World;

/// Mass ratio that default contacts bear.
const MOST_MASS_RATIO: f64 = 100.0;
/// How far a stiffened contact may give way under a stack, m.
const MOST_SINK: f64 = 1e-3;
/// How deep things may overlap at the start, m.
const MOST_START_DEPTH: f64 = 2e-3;
/// Least radius of gyration, m.
const LEAST_GYRATION: f64 = 1e-4;
/// Least thickness of a collision mesh, m.
const LEAST_THICKNESS: f64 = 1e-5;
/// impratio from which a held object does not visibly creep.
const STIFF_FRICTION: f64 = 10.0;

/// A light body carries a heavy one: it is pressed through, since contacts are soft in proportion to mass.
pub(super) fn mass_ratio(world: &World, touches: &[Touch]) -> Option<Finding> {
    let model = world.model();
    let g = glam::DVec3::from_array(world.options().gravity).length();
    let mass = |body: usize| model.body_subtreemass()[model.body_rootid()[body] as usize];
    let mut worst: Option<(f64, f64, [usize; 2])> = None;
    for touch in touches.iter().filter(|t| t.bodies.iter().all(|body| model.body_treeid()[*body] >= 0)) {
        let [a, b] = touch.bodies;
        if model.body_rootid()[a] == model.body_rootid()[b] {
            continue;
        }
        let (light, heavy) = if mass(a) < mass(b) { (a, b) } else { (b, a) };
        // A body that gravity does not pull presses with its actuators, not with its mass.
        let weighing = 1.0 - model.body_gravcomp()[heavy].clamp(0.0, 1.0);
        let ratio = weighing * mass(heavy) / mass(light).max(1e-12);
        let sink = sink(world, touch, ratio, g);
        if ratio > MOST_MASS_RATIO && sink > MOST_SINK && worst.is_none_or(|(most, ..)| ratio > most) {
            worst = Some((ratio, sink, [light, heavy]));
        }
    }
    let (ratio, sink, bodies) = worst?;
    let [light, heavy] = bodies.map(|body| body_name(world, body));
    let message = format!(
        "{heavy} is {ratio:.0} times as heavy as {light}, expected at most {MOST_MASS_RATIO:.0} or a stiffer contact: \
         on top of it, it would sink about {:.1} mm",
        1e3 * sink
    );
    Some(Finding { severity: Severity::Error, rule: Rule::MassRatio, message })
}

/// How far the lower contact of a stack gives way, m: at rest `d k r = (1 - d) a`, `a` what the load would accelerate.
fn sink(world: &World, touch: &Touch, ratio: f64, g: f64) -> f64 {
    let [_, d, ..] = touch.solimp;
    let stiffness = match touch.time_constant(world) {
        Some(time) => 1.0 / (d * time * touch.solref[1]).powi(2),
        None => -touch.solref[0] / (d * d),
    };
    (1.0 - d) / d * (ratio + 1.0) * g / stiffness.max(1e-9)
}

pub(super) fn contact_time(world: &World, touches: &[Touch]) -> Option<Finding> {
    let dt = world.options().timestep;
    let times = touches.iter().filter(|t| t.solref[0] > 0.0);
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

pub(super) fn direct_stiffness(world: &World, touches: &[Touch]) -> Option<Finding> {
    if world.options().integrator == Integrator::Discrete {
        return None;
    }
    let dt = world.options().timestep;
    let worst = touches.iter().min_by(|a, b| a.solref[0].total_cmp(&b.solref[0]))?;
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

pub(super) fn contact_damping(world: &World, touches: &[Touch]) -> Option<Finding> {
    let dt = world.options().timestep;
    let loose = |t: &&Touch| t.solref[0] > 0.0 && t.solref[1] < 1.0 && dt > t.solref[0] / 8.0 * (1.0 + 1e-9);
    let worst = touches.iter().filter(loose).min_by(|a, b| a.solref[1].total_cmp(&b.solref[1]))?;
    let [time, ratio] = worst.solref;
    let message = format!(
        "{}: the contact's damping ratio is {ratio}, expected at least 1 or a timestep of at most {} s: it would gain energy",
        pair_name(world, worst),
        time / 8.0
    );
    Some(Finding { severity: Severity::Error, rule: Rule::ContactDamping, message })
}

pub(super) fn tunnelling(world: &World, touches: &[Touch], speed: f64) -> Option<Finding> {
    let limit = |touch: &Touch| {
        let time = touch.time_constant(world).map_or(0.0, |time| PEAK_DEPTH * time).max(world.options().timestep);
        touch.geoms.map(|geom| half_thickness(world, geom)).iter().sum::<f64>() / time
    };
    let worst = touches.iter().min_by(|a, b| limit(a).total_cmp(&limit(b)))?;
    let most = limit(worst);
    (most < speed).then(|| {
        let message = format!(
            "{}: above {most:.2} m/s they pass through each other; shorten the contact's time constant and the timestep, or \
             thicken them",
            pair_name(world, worst)
        );
        Finding { severity: Severity::Advice, rule: Rule::Tunnelling, message }
    })
}

pub(super) fn start_depth(world: &World) -> Option<Finding> {
    let limits = depth_limits(world, 2.0 * MOST_START_DEPTH);
    let excess = |geoms: [usize; 2], distance: f64| -distance - 0.5 * limits[geoms[0]].min(limits[geoms[1]]);
    let bodies = world.model().geom_bodyid();
    let tree = |geom: usize| world.model().body_treeid()[bodies[geom] as usize];
    // Links of one mechanism are held by its joints: they part, and are not thrown.
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

/// Bodies that turn freely with next to no inertia spin up from rounding.
pub(super) fn inertia(world: &World) -> Option<Finding> {
    let model = world.model();
    let turning = model.jnt_type().iter().zip(model.jnt_bodyid());
    let turning = turning.filter(|(kind, _)| matches!(**kind, MjtJoint::mjJNT_FREE | MjtJoint::mjJNT_BALL));
    let gyration = |body: usize| {
        let least = model.body_inertia()[body].into_iter().fold(f64::INFINITY, f64::min);
        (least / model.body_mass()[body].max(1e-15)).sqrt()
    };
    // A body with children turns them too.
    let alone = |body: usize| !model.body_parentid().iter().any(|parent| *parent as usize == body);
    let bodies = turning.map(|(_, body)| *body as usize).filter(|body| alone(*body));
    let worst = bodies.min_by(|a, b| gyration(*a).total_cmp(&gyration(*b)))?;
    (gyration(worst) < LEAST_GYRATION).then(|| {
        let message = format!(
            "{}: the radius of gyration is {:.1e} m, expected at least {LEAST_GYRATION:.0e} m: it would spin from rounding",
            body_name(world, worst),
            gyration(worst)
        );
        Finding { severity: Severity::Error, rule: Rule::Inertia, message }
    })
}

/// Meshes collide as their convex hull, which hides what is wrong with them.
pub(super) fn meshes(world: &World) -> Option<Finding> {
    let model = world.model();
    let collides = |geom: usize| model.geom_contype()[geom] != 0 || model.geom_conaffinity()[geom] != 0;
    let is_mesh = |geom: usize| matches!(model.geom_type()[geom], MjtGeomBase::mjGEOM_MESH | MjtGeomBase::mjGEOM_SDF);
    let geoms: Vec<usize> = (0..model.geom_type().len()).filter(|geom| is_mesh(*geom) && collides(*geom)).collect();
    if let Some(thin) = geoms.iter().find(|geom| half_thickness(world, **geom) < 0.5 * LEAST_THICKNESS) {
        let message = format!(
            "{}: the mesh is {:.1e} m thick, expected at least {LEAST_THICKNESS:.0e} m",
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

pub(super) fn creep(world: &World) -> Option<Finding> {
    let options = world.options();
    if options.impratio >= STIFF_FRICTION || options.noslip_iterations >= 3 {
        return None;
    }
    let message = format!(
        "impratio is {}, for holding expected at least {STIFF_FRICTION} or 3 noslip_iterations: a held object slides out of the \
         hand by a millimetre per second",
        options.impratio
    );
    Some(Finding { severity: Severity::Advice, rule: Rule::Creep, message })
}

pub(super) fn sleep(world: &World) -> Option<Finding> {
    let sleeps = world.model().opt().enableflags & MjtEnableBit::mjENBL_SLEEP as i32 != 0;
    sleeps.then(|| Finding {
        severity: Severity::Advice,
        rule: Rule::Sleep,
        message: "bodies may sleep: contacts between sleeping bodies are missing from the list".into(),
    })
}

fn pair_name(world: &World, touch: &Touch) -> String {
    let [a, b] = touch.geoms.map(|geom| geom_name(world, geom));
    format!("{a} and {b}")
}

/// Name of a geom, or of its body and its number.
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
