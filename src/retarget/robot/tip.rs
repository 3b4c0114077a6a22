//! Fingertips: where a robot finger ends.

use glam::DVec3;

use super::kinematics::SAME_KNUCKLE;
use super::lookup;
use super::spec::TipSpec;
use crate::error::{Error, Result};
use crate::mujoco::World;
use crate::mujoco::parts::Parts;

/// Depth of the outer layer whose middle is a shape's far end, m: thin enough for a point, thick enough to hold vertices.
const OUTER_LAYER: f64 = 0.001;
/// Length of a last phalanx without any shape, relative to the one before it.
const LAST_PHALANX_RATIO: f64 = 0.8;
/// Least distance of a body without shape from the last joint at which it marks the tip, m.
const MIN_MARKER_DISTANCE: f64 = 0.002;

/// Tip of a finger.
#[derive(Debug, Clone)]
pub struct Tip {
    /// Body that carries it.
    pub body: usize,
    /// Position in that body's frame, m.
    pub position: DVec3,
    /// Part of the model that it was derived from, for people.
    pub name: String,
}

/// Returns the body that the tip of a robot file names; `finger`: its key, for errors.
///
/// # Errors
/// If not exactly one of body, site and geom is given, or there is none of that name.
pub fn named_body(parts: &Parts, finger: &str, tip: &TipSpec) -> Result<usize> {
    match (&tip.body, &tip.site, &tip.geom) {
        (Some(name), None, None) => lookup::body(parts, name),
        (None, Some(name), None) => lookup::site(parts, name).map(|site| parts.sites[site].body),
        (None, None, Some(name)) => lookup::geom(parts, name).map(|geom| parts.geoms[geom].body),
        (body, site, geom) => {
            let given = [body, site, geom].into_iter().flatten().count();
            let got = if given == 0 { "none of them".to_owned() } else { format!("{given} of them") };
            Err(Error::value(format!("fingers.{finger}.tip"), "one of body, site and geom", got))
        }
    }
}

/// Finds the tip of a finger as its file says, otherwise from the model: a site whose name contains "tip", a body without
/// shape whose name does, or the far end of the last part's shapes.
///
/// `last`: last body of the finger that moves; `joints`: those of the finger, from base to tip.
///
/// # Errors
/// If a name is not in the model.
pub fn find_tip(world: &World, parts: &Parts, spec: &TipSpec, last: usize, joints: &[usize]) -> Result<Tip> {
    let anchor = joints.last().map_or_else(|| world.body_pose(last).0, |joint| world.joint_axis(*joint).0);
    if let Some(name) = &spec.site {
        let site = &parts.sites[lookup::site(parts, name)?];
        let position = spec.pos.map_or(site.position, DVec3::from_array);
        return Ok(Tip { body: site.body, position, name: format!("site {name}") });
    }
    if let Some(name) = &spec.geom {
        let geom = lookup::geom(parts, name)?;
        let body = parts.geoms[geom].body;
        let far = || far_end(world, parts, &[geom], anchor).unwrap_or_else(|| world.geom_pose(geom).0);
        let position = spec.pos.map_or_else(|| local(world, body, far()), DVec3::from_array);
        return Ok(Tip { body, position, name: format!("geom {name}") });
    }
    if let Some(name) = &spec.body {
        let body = lookup::body(parts, name)?;
        let far = || {
            let geoms: Vec<usize> = (0..parts.geoms.len()).filter(|geom| parts.geoms[*geom].body == body).collect();
            let far = far_end(world, parts, &colliding_or_all(parts, geoms), anchor);
            far.map_or(DVec3::ZERO, |far| local(world, body, far))
        };
        let position = spec.pos.map_or_else(far, DVec3::from_array);
        return Ok(Tip { body, position, name: format!("body {name}") });
    }
    Ok(derived_tip(world, parts, last, joints, anchor))
}

/// Derives the tip from the model; `anchor`: position of the last joint, m.
fn derived_tip(world: &World, parts: &Parts, last: usize, joints: &[usize], anchor: DVec3) -> Tip {
    let of_part = |body: usize| parts.bodies[body].part == parts.bodies[last].part;
    if let Some(site) = parts.sites.iter().find(|site| of_part(site.body) && site.name.to_lowercase().contains("tip")) {
        return Tip { body: site.body, position: site.position, name: format!("site {}", site.name) };
    }
    let marker = (0..parts.bodies.len()).find(|body| {
        let name = parts.bodies[*body].name.to_lowercase();
        let is_bare = parts.geoms.iter().all(|geom| geom.body != *body);
        of_part(*body) && *body != last && name.contains("tip") && is_bare
    });
    if let Some(body) = marker {
        return Tip { body, position: DVec3::ZERO, name: format!("body {}", parts.bodies[body].name) };
    }
    let far = farthest(world, parts, last, anchor).unwrap_or_else(|| {
        let anchors = joints.iter().rev().map(|joint| world.joint_axis(*joint).0);
        let before = anchors.into_iter().find(|before| before.distance(anchor) > SAME_KNUCKLE);
        before.map_or(world.body_pose(last).0, |before| anchor + LAST_PHALANX_RATIO * (anchor - before))
    });
    Tip { body: last, position: local(world, last, far), name: format!("far end of {}", parts.bodies[last].name) }
}

/// Transforms a point of the world to a body's frame.
fn local(world: &World, body: usize, point: DVec3) -> DVec3 {
    let (origin, rotation) = world.body_pose(body);
    rotation.transpose() * (point - origin)
}

/// Returns the geoms that collide, or all if none does.
pub fn colliding_or_all(parts: &Parts, geoms: Vec<usize>) -> Vec<usize> {
    let colliding: Vec<usize> = geoms.iter().copied().filter(|geom| parts.geoms[*geom].bits != [0, 0]).collect();
    if colliding.is_empty() { geoms } else { colliding }
}

/// Returns the far end, seen from a point, of the shapes that move with a body; if there is no shape, the farthest origin
/// of the other bodies that move with it.
pub fn farthest(world: &World, parts: &Parts, last: usize, from: DVec3) -> Option<DVec3> {
    let of_part = |body: usize| parts.bodies[body].part == parts.bodies[last].part;
    let geoms: Vec<usize> = (0..parts.geoms.len()).filter(|geom| of_part(parts.geoms[*geom].body)).collect();
    far_end(world, parts, &colliding_or_all(parts, geoms), from).or_else(|| {
        let bodies = (0..parts.bodies.len()).filter(|body| of_part(*body) && *body != last);
        let origins = bodies.map(|body| world.body_pose(body).0);
        let farthest = origins.max_by(|a, b| a.distance(from).total_cmp(&b.distance(from)));
        farthest.filter(|far| far.distance(from) > MIN_MARKER_DISTANCE)
    })
}

/// Returns the middle of the outer layer of some geoms, on the line from a point through their middle; None without
/// vertices.
fn far_end(world: &World, parts: &Parts, geoms: &[usize], from: DVec3) -> Option<DVec3> {
    let points: Vec<DVec3> = geoms.iter().flat_map(|geom| world_points(world, parts, *geom)).collect();
    let count = points.len() as f64;
    let middle = points.iter().sum::<DVec3>() / count.max(1.0);
    let line = (middle - from).try_normalize()?;
    let reach = |point: &DVec3| (*point - from).dot(line);
    let most = points.iter().map(reach).fold(f64::NEG_INFINITY, f64::max);
    let outer: Vec<&DVec3> = points.iter().filter(|point| reach(point) > most - OUTER_LAYER).collect();
    let sum: DVec3 = outer.iter().copied().sum();
    (!outer.is_empty()).then(|| sum / outer.len() as f64)
}

/// Returns the vertices of a geom in the world, m.
pub fn world_points<'a>(world: &World, parts: &'a Parts, geom: usize) -> impl Iterator<Item = DVec3> + 'a {
    let (origin, rotation) = world.geom_pose(geom);
    parts.geoms[geom].points.iter().map(move |point| origin + rotation * *point)
}
