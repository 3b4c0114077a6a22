//! Places where a body can be pushed: near a hand's link, and on its supports.

use glam::{DVec3, Vec3};

use super::body::{RigidBody, distance_and_normal};
use super::pose::Pose;
use super::take::{Fixed, Take};
use crate::geometry::Solid;
use crate::hand::{N_JOINTS, N_VERTICES, Side};

/// Depth of a band of vertices behind the nearest one of a link that stands for its patch, m: skin gives way by about this.
const BAND: f32 = 0.0015;
/// Largest numbers of points of a link's patch and of a support.
const LINK_POINTS: usize = 3;
const SUPPORT_POINTS: usize = 6;
/// Gap up to which exact poses of a support mean contact, m.
pub(super) const SUPPORT_GAP: f64 = 0.001;

/// Thing that pushes a body.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Pusher {
    /// A link of a hand.
    Link(Side, usize),
    /// A fixed thing, by index.
    Fixed(usize),
    /// Another body, by index.
    Body(usize),
}

/// Patch of contact between a pusher and a body.
#[derive(Debug, Clone)]
pub struct Patch {
    /// Pusher.
    pub pusher: Pusher,
    /// Least signed distance, m; negative means penetration.
    pub gap: f64,
    /// Points on the body's surface with the outward unit normal of the body there, world frame, m.
    pub points: Vec<(DVec3, DVec3)>,
}

/// Finds the patches of a hand's posed (778) `vertices`, m, on a body at `pose`; gaps up to `reach`, m, count.
/// `link_of`: link of each vertex.
pub fn hand_patches(
    vertices: &[Vec3],
    link_of: &[usize],
    side: Side,
    body: &RigidBody,
    pose: &Pose,
    reach: f64,
) -> Vec<Patch> {
    let Some(solid) = &body.solid else { return Vec::new() };
    let (centre, radius) = ball_around(vertices);
    if !solid.may_reach(pose.local(centre).as_vec3(), radius, reach as f32) {
        return Vec::new();
    }
    let local: Vec<Vec3> = vertices.iter().map(|v| pose.local(v.as_dvec3()).as_vec3()).collect();
    let distances: Vec<f32> = local.iter().map(|v| solid.distance(*v, reach as f32)).collect();
    let mut nearest = [f32::INFINITY; N_JOINTS];
    for (link, distance) in link_of.iter().zip(&distances) {
        nearest[*link] = nearest[*link].min(*distance);
    }
    let mut patches = Vec::new();
    for (link, gap) in nearest.iter().enumerate().filter(|(_, gap)| f64::from(**gap) <= reach) {
        let last = gap + BAND;
        let of_link = (0..N_VERTICES).filter(|v| link_of[*v] == link && distances[*v] <= last);
        let band: Vec<(DVec3, f32)> = of_link.map(|v| (local[v].as_dvec3(), distances[v])).collect();
        let points = spread(&band, LINK_POINTS);
        let on_surface = points.into_iter().filter_map(|point| surface_point(solid, point, reach));
        let points: Vec<(DVec3, DVec3)> =
            on_surface.map(|(point, normal)| (pose.point(point), pose.orientation * normal)).collect();
        if !points.is_empty() {
            patches.push(Patch { pusher: Pusher::Link(side, link), gap: f64::from(*gap), points });
        }
    }
    patches
}

/// Finds the patch of a body on a fixed thing or another body; gaps up to `reach`, m, count.
pub fn support_patch(
    body: &RigidBody,
    pose: &Pose,
    pusher: Pusher,
    solid: &Solid,
    at: &Pose,
    reach: f64,
) -> Option<Patch> {
    let (centre, radius) = ball_around(&body.samples);
    if !solid.may_reach(at.local(pose.point(centre)).as_vec3(), radius, reach as f32) {
        return None;
    }
    let near: Vec<(DVec3, f32)> = body
        .samples
        .iter()
        .map(|point| at.local(pose.point(point.as_dvec3())))
        .map(|place| (place, solid.distance(place.as_vec3(), reach as f32)))
        .filter(|(_, distance)| f64::from(*distance) <= reach)
        .collect();
    let gap = near.iter().map(|(_, distance)| *distance).fold(f32::INFINITY, f32::min);
    let band: Vec<(DVec3, f32)> = near.into_iter().filter(|(_, distance)| *distance <= gap + BAND).collect();
    let points: Vec<(DVec3, DVec3)> = spread(&band, SUPPORT_POINTS)
        .into_iter()
        .filter_map(|place| surface_point(solid, place, reach))
        // Outward of the body is into the support.
        .map(|(place, normal)| (at.point(place), -(at.orientation * normal)))
        .collect();
    (!points.is_empty()).then_some(Patch { pusher, gap: f64::from(gap), points })
}

/// Returns a ball that holds all points, a little larger than rounding asks for: centre and radius, m.
fn ball_around(points: &[Vec3]) -> (DVec3, f32) {
    /// Radius that covers the rounding of places in f32, m.
    const SLACK: f32 = 1e-4;
    let (low, high) = points.iter().fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(l, h), p| (l.min(*p), h.max(*p)));
    ((0.5 * (low + high)).as_dvec3(), 0.5 * (high - low).length() + SLACK)
}

/// Finds links of a hand within reach of things whose forces the motion does not tell.
pub fn blocked_links(
    vertices: &[Vec3],
    link_of: &[usize],
    others: &[(&Solid, Pose)],
    other_hand: Option<&[Vec3]>,
    reach: f64,
) -> [bool; N_JOINTS] {
    let mut blocked = [false; N_JOINTS];
    let cutoff = reach as f32;
    for (solid, pose) in others {
        for (vertex, link) in vertices.iter().zip(link_of) {
            if !blocked[*link] && solid.distance(pose.local(vertex.as_dvec3()).as_vec3(), cutoff) <= cutoff {
                blocked[*link] = true;
            }
        }
    }
    if let Some(other) = other_hand {
        // Vertices are up to 8 mm apart: half of that is between a vertex and the other surface.
        let near = cutoff + 0.004;
        let (low, high) = other.iter().fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(l, h), v| (l.min(*v), h.max(*v)));
        for (vertex, link) in vertices
            .iter()
            .zip(link_of)
            .filter(|(vertex, _)| vertex.cmpge(low - near).all() && vertex.cmple(high + near).all())
        {
            blocked[*link] |= other.iter().any(|v| v.distance_squared(*vertex) <= near * near);
        }
    }
    blocked
}

/// Returns the solids whose forces the motion does not tell, with their poses at a frame.
pub fn untold<'a>(take: &'a Take, frame: usize) -> Vec<(&'a Solid, Pose)> {
    let held = take.bodies.iter().zip(&take.poses).filter(|(body, _)| body.held.is_some() || body.mass.is_none());
    let held = held.filter_map(|(body, poses)| Some((body.solid.as_ref()?, poses.get(frame).copied().flatten()?)));
    held.chain(take.fixed.iter().map(|Fixed { solid, pose, .. }| (solid, *pose))).collect()
}

/// Chooses up to `most` places far from each other, from the deepest on.
fn spread(band: &[(DVec3, f32)], most: usize) -> Vec<DVec3> {
    let Some((first, _)) = band.iter().min_by(|a, b| a.1.total_cmp(&b.1)) else { return Vec::new() };
    let mut chosen = vec![*first];
    while chosen.len() < most {
        let apart = |place: &DVec3| chosen.iter().map(|c| c.distance_squared(*place)).fold(f64::INFINITY, f64::min);
        let farthest = band.iter().map(|(place, _)| (*place, apart(place))).max_by(|a, b| a.1.total_cmp(&b.1));
        match farthest {
            // Points closer than 3 mm are one place.
            Some((place, square)) if square > 9e-6 => chosen.push(place),
            _ => break,
        }
    }
    chosen
}

/// Moves a place onto a solid's surface; returns it with the outward normal.
fn surface_point(solid: &Solid, place: DVec3, reach: f64) -> Option<(DVec3, DVec3)> {
    let (distance, normal) = distance_and_normal(solid, place, reach)?;
    Some((place - normal * distance, normal))
}
