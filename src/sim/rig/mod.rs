//! Rigs: hinges, pads and collision hulls of a hand model, derived from its joints and skinning weights.

mod hinge;

use glam::{DAffine3, DMat3, DQuat, DVec3, Vec3};
use parry3d::shape::SharedShape;

use self::hinge::hinges;
pub use self::hinge::{Hinge, HingeMotion};
use super::convex;
use super::scene::HandSite;
use crate::error::{Error, Result};
pub use crate::hand::JOINT_NAMES;
use crate::hand::{HandModel, HandParams, N_BETAS, N_JOINTS, PosedHand, Side};

/// Smallest skinning weight of a vertex in a link's collision hull, even if another link has a larger one: hulls of
/// neighbours overlap, so that nothing slips into the knuckles.
const HULL_WEIGHT: f32 = 0.3;
/// Distance in the rest pose below which two links never collide, m.
const MIN_REST_DISTANCE: f32 = 0.002;

/// Hand model with the mechanism that a physics model needs.
#[derive(Debug, Clone)]
pub struct HandRig {
    /// Hand model.
    pub model: HandModel,
    /// Shape coefficients.
    pub betas: [f32; N_BETAS],
    /// Rest positions of the joints, m.
    pub joints: [DVec3; N_JOINTS],
    /// Rest positions of the vertices, m.
    pub vertices: Vec<Vec3>,
    /// Directions of the hand at rest.
    pub frame: HandFrame,
    /// Hinges in the order of the mechanism.
    pub hinges: Vec<Hinge>,
    /// Corners of each link's collision hull in the link's frame, m.
    pub hulls: Vec<Vec<DVec3>>,
    /// Largest number of corners of a hull in the engine; `None` keeps all.
    pub max_corners: Option<usize>,
    /// Pairs of links that never collide.
    pub excluded: Vec<(usize, usize)>,
    /// Convex hulls of the links.
    shapes: Vec<SharedShape>,
    /// Pads in the order of [`HandSite`].
    pads: [Pad; 6],
}

/// Unit directions of a hand at rest.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HandFrame {
    /// Direction of the stretched fingers.
    pub fingers: DVec3,
    /// Direction that the palm faces.
    pub palm: DVec3,
    /// Direction from the little finger's side to the thumb's.
    pub thumb: DVec3,
}

/// Point of the skin that touches at a contact goal.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pad {
    /// Index of the link's joint.
    pub joint: usize,
    /// Position in the link's frame, m.
    pub position: DVec3,
    /// Outward unit normal in the link's frame.
    pub normal: DVec3,
}

impl HandRig {
    /// Derives hinges, pads and hulls of a hand of the given shape.
    ///
    /// # Errors
    /// If joints coincide, or a link has too few vertices to span a hull.
    pub fn new(model: HandModel, betas: [f32; N_BETAS]) -> Result<Self> {
        let rest = model.forward(&HandParams { betas, ..HandParams::default() });
        let joints = rest.joints.map(|j| j.as_dvec3());
        let frame = HandFrame::of(model.side, &joints)?;
        let hulls = hulls(&model, &rest.vertices, &joints);
        let tips = HandSite::FINGERS.map(|site| tip(&model, &rest.vertices, &joints, base_joint(site)));
        let pads = pads(&model, &rest.vertices, &joints, &frame, &tips);
        let hinges = hinges(&joints, &frame, &tips);
        let shapes = shapes(&hulls)?;
        let excluded = excluded(&shapes, &joints);
        Ok(Self {
            model,
            betas,
            joints,
            vertices: rest.vertices,
            frame,
            hinges,
            hulls,
            max_corners: None,
            excluded,
            shapes,
            pads,
        })
    }

    /// Limits the corners of the engine's hulls; plans keep the fine hulls, so that the motion stays the same.
    ///
    /// # Errors
    /// If `max` is below 4: fewer corners span no volume.
    pub(crate) fn limit_corners(&mut self, max: usize) -> Result<()> {
        if max < 4 {
            return Err(Error::value("hull corners", "at least 4", max));
        }
        self.max_corners = Some(max);
        Ok(())
    }

    /// Returns the side of the hand.
    pub fn side(&self) -> Side {
        self.model.side
    }

    /// Returns the name of a body, joint or mesh of this hand in a physics model.
    pub fn name(&self, part: &str) -> String {
        format!("{}/{part}", self.side().name())
    }

    /// Returns the pad of a site.
    pub fn pad(&self, site: HandSite) -> Pad {
        self.pads[site as usize]
    }

    /// Returns place, m, and orientation of the nail of a finger's last link in the link's frame, with z out of the nail and
    /// y towards the fingertip; `None` for other links.
    pub fn nail(&self, joint: usize) -> Option<(DVec3, DQuat)> {
        let site = HandSite::FINGERS.into_iter().find(|site| self.pad(*site).joint == joint)?;
        let pad = self.pad(site);
        let out = -pad.normal;
        let along = pad.position.reject_from_normalized(out).try_normalize()?;
        let own = self.model.strongest_joints();
        let points: Vec<DVec3> = self
            .vertices
            .iter()
            .zip(own)
            .filter(|(_, strongest)| *strongest == joint)
            .map(|(vertex, _)| vertex.as_dvec3() - self.joints[joint])
            .collect();
        let length = points.iter().map(|point| point.dot(along)).fold(0.0, f64::max);
        let near_tip = points.iter().filter(|point| (0.6..0.9).contains(&(point.dot(along) / length)));
        let place = near_tip.max_by(|a, b| a.dot(out).total_cmp(&b.dot(out)))?;
        let across = along.cross(out);
        Some((*place, DQuat::from_mat3(&DMat3::from_cols(across, along, out))))
    }

    /// Returns the parent of a joint; `None` for the wrist.
    pub fn parent(&self, joint: usize) -> Option<usize> {
        (self.model.parents[joint] != joint).then_some(self.model.parents[joint])
    }

    /// Returns the pairs of links of different fingers that can collide.
    pub fn colliding(&self) -> Vec<(usize, usize)> {
        let all = (0..N_JOINTS).flat_map(|a| (a + 1..N_JOINTS).map(move |b| (a, b)));
        all.filter(|(a, b)| site_of(*a) != site_of(*b) && !self.excluded.contains(&(*a, *b))).collect()
    }

    /// Returns the convex hull of a link in its frame.
    pub fn shape(&self, joint: usize) -> &SharedShape {
        &self.shapes[joint]
    }

    /// Computes the parameters of the hand from the wrist's pose and the hinge angles, without approximation.
    ///
    /// `angles`: rad, in the order of `hinges`. Of several hinges of a joint, the first is outermost.
    pub fn params(&self, wrist: DVec3, orientation: DQuat, angles: &[f64]) -> HandParams {
        let mut turns = [DQuat::IDENTITY; N_JOINTS];
        for (hinge, angle) in self.hinges.iter().zip(angles) {
            turns[hinge.joint] *= DQuat::from_axis_angle(hinge.axis, *angle);
        }
        HandParams {
            betas: self.betas,
            global_orient: rotation_vector(orientation).as_vec3(),
            hand_pose: std::array::from_fn(|i| rotation_vector(turns[i + 1]).as_vec3()),
            transl: (wrist - self.joints[0]).as_vec3(),
        }
    }

    /// Computes rest vertices, m, that linear blend skinning maps to the posed vertices.
    ///
    /// The engine's skins have no pose blend shapes; with these rest vertices the picture shows them.
    pub fn bound_vertices(&self, posed: &PosedHand) -> Vec<Vec3> {
        let bones: Vec<DAffine3> = (0..N_JOINTS)
            .map(|joint| {
                let rotation = posed.rotations[joint].as_dmat3();
                DAffine3::from_mat3_translation(
                    rotation,
                    posed.joints[joint].as_dvec3() - rotation * self.joints[joint],
                )
            })
            .collect();
        let blend = |weights: &[f32]| {
            let mut sum = DAffine3 { matrix3: DMat3::ZERO, translation: DVec3::ZERO };
            let total: f64 = weights.iter().map(|w| f64::from(*w)).sum();
            for (bone, weight) in bones.iter().zip(weights).filter(|(_, weight)| **weight > 0.0) {
                sum.matrix3 += bone.matrix3 * (f64::from(*weight) / total);
                sum.translation += bone.translation * (f64::from(*weight) / total);
            }
            sum
        };
        let rows = self.model.lbs_weights.chunks_exact(N_JOINTS).zip(&posed.vertices);
        rows.map(|(weights, vertex)| blend(weights).inverse().transform_point3(vertex.as_dvec3()).as_vec3()).collect()
    }

    /// Returns the rotation of the rest hand that points fingers and palm in the given directions; `fingers` is exact.
    pub fn orientation(&self, fingers: DVec3, palm: DVec3) -> DQuat {
        let basis = |fingers: DVec3, palm: DVec3| {
            let f = fingers.normalize();
            let p = palm.reject_from_normalized(f).try_normalize().unwrap_or_else(|| f.any_orthonormal_vector());
            DMat3::from_cols(f, p, f.cross(p))
        };
        let world = basis(fingers, palm);
        let rest = basis(self.frame.fingers, self.frame.palm);
        DQuat::from_mat3(&(world * rest.transpose())).normalize()
    }
}

/// Returns the rotation vector (axis times angle, rad) of a unit quaternion, with an angle of at most pi.
///
/// It is accurate near 0 and near pi, where a logarithm by the trace of the matrix loses all digits.
pub fn rotation_vector(q: DQuat) -> DVec3 {
    let q = if q.w < 0.0 { -q } else { q };
    let v = DVec3::new(q.x, q.y, q.z);
    let sine = v.length();
    // angle / sin(angle/2) -> 2 / w as the angle goes to 0
    let scale = if sine < 1e-9 { 2.0 / q.w } else { 2.0 * sine.atan2(q.w) / sine };
    v * scale
}

/// Returns the first joint of a finger; the wrist for the palm.
///
pub(crate) fn base_joint(site: HandSite) -> usize {
    match site {
        HandSite::Thumb => 13,
        HandSite::Index => 1,
        HandSite::Middle => 4,
        HandSite::Ring => 10,
        HandSite::Little => 7,
        HandSite::Palm => 0,
    }
}

/// Returns the site of a joint.
pub fn site_of(joint: usize) -> HandSite {
    match joint {
        1..=3 => HandSite::Index,
        4..=6 => HandSite::Middle,
        7..=9 => HandSite::Little,
        10..=12 => HandSite::Ring,
        13..=15 => HandSite::Thumb,
        _ => HandSite::Palm,
    }
}

impl HandFrame {
    /// Derives the directions from the rest joints.
    ///
    /// # Errors
    /// If joints coincide.
    fn of(side: Side, joints: &[DVec3; N_JOINTS]) -> Result<Self> {
        let knuckles = [1, 4, 7, 10].map(|joint| joints[joint]).iter().sum::<DVec3>() / 4.0;
        let flat = || Error::value("rest joints", "a hand that spans a plane", "coinciding joints");
        let fingers = (knuckles - joints[0]).try_normalize().ok_or_else(flat)?;
        let thumb = (joints[1] - joints[7]).reject_from_normalized(fingers).try_normalize().ok_or_else(flat)?;
        let palm = match side {
            Side::Right => thumb.cross(fingers),
            Side::Left => fingers.cross(thumb),
        };
        Ok(Self { fingers, palm, thumb })
    }

    /// Returns the direction that a finger's pad faces at rest: the palm's; the thumb's is turned towards the fingers.
    fn pad_direction(&self, site: HandSite) -> DVec3 {
        match site {
            HandSite::Thumb => (0.55 * self.palm - 0.85 * self.thumb).normalize(),
            _ => self.palm,
        }
    }
}

/// Iterates over the vertices of which the link has the largest skinning weight, or one of at least `min_weight`.
fn link_vertices<'a>(model: &'a HandModel, joint: usize, min_weight: f32) -> impl Iterator<Item = usize> + 'a {
    model.lbs_weights.chunks_exact(N_JOINTS).enumerate().filter_map(move |(vertex, weights)| {
        let leads = weights.iter().all(|w| *w <= weights[joint]);
        (leads || weights[joint] >= min_weight).then_some(vertex)
    })
}

/// Collects the corners of each link's hull in the link's frame, m.
fn hulls(model: &HandModel, vertices: &[Vec3], joints: &[DVec3; N_JOINTS]) -> Vec<Vec<DVec3>> {
    let local = |joint: usize| {
        link_vertices(model, joint, HULL_WEIGHT).map(|v| vertices[v].as_dvec3() - joints[joint]).collect()
    };
    (0..N_JOINTS).map(local).collect()
}

/// Returns the farthest point of a finger's last link along its bone, m.
fn tip(model: &HandModel, vertices: &[Vec3], joints: &[DVec3; N_JOINTS], base: usize) -> DVec3 {
    let bone = (joints[base + 2] - joints[base + 1]).normalize_or_zero();
    let along = |v: &usize| (vertices[*v].as_dvec3() - joints[base + 2]).dot(bone);
    let far = link_vertices(model, base + 2, 0.5).max_by(|a, b| along(a).total_cmp(&along(b)));
    far.map_or(joints[base + 2] + bone * 0.02, |v| joints[base + 2] + bone * along(&v))
}

/// Derives the pads of the fingers and the palm.
fn pads(
    model: &HandModel,
    vertices: &[Vec3],
    joints: &[DVec3; N_JOINTS],
    frame: &HandFrame,
    tips: &[DVec3; 5],
) -> [Pad; 6] {
    std::array::from_fn(|i| {
        let Some(&site) = HandSite::FINGERS.get(i) else {
            return palm_pad(model, vertices, joints, frame);
        };
        let joint = base_joint(site) + 2;
        let bone = tips[i] - joints[joint];
        let length = bone.length().max(1e-6);
        let bone = bone / length;
        let normal = frame.pad_direction(site).reject_from_normalized(bone).normalize_or_zero();
        let sideways = bone.cross(normal);
        let local = |v: usize| vertices[v].as_dvec3() - joints[joint];
        // The centre of the pulp: beyond the middle of the link, not at its side, as far out as the skin goes.
        let score = |v: &usize| {
            let p = local(*v);
            p.dot(normal) - 0.5 * p.dot(sideways).abs() - 0.3 * (p.dot(bone) - 0.6 * length).abs()
        };
        let best = link_vertices(model, joint, 0.5).max_by(|a, b| score(a).total_cmp(&score(b)));
        Pad { joint, position: best.map_or(DVec3::ZERO, local), normal }
    })
}

/// Derives the pad of the palm: the vertex nearest to the palm's centre line.
fn palm_pad(model: &HandModel, vertices: &[Vec3], joints: &[DVec3; N_JOINTS], frame: &HandFrame) -> Pad {
    let knuckles = [1, 4, 7, 10].map(|joint| joints[joint]).iter().sum::<DVec3>() / 4.0;
    let centre = joints[0].lerp(knuckles, 0.6);
    let local = |v: usize| vertices[v].as_dvec3() - centre;
    let aside = |v: &usize| local(*v).reject_from_normalized(frame.palm).length();
    let best = link_vertices(model, 0, 0.5)
        .filter(|v| local(*v).dot(frame.palm) > 0.0)
        .min_by(|a, b| aside(a).total_cmp(&aside(b)));
    Pad { joint: 0, position: best.map_or(centre, |v| vertices[v].as_dvec3()) - joints[0], normal: frame.palm }
}

/// Computes the convex hulls of the links.
///
/// # Errors
/// If the corners of a link span no volume.
fn shapes(hulls: &[Vec<DVec3>]) -> Result<Vec<SharedShape>> {
    let shape = |(joint, corners): (usize, &Vec<DVec3>)| {
        convex::hull(corners).ok_or_else(|| {
            let name = format!("lbs_weights of joint {joint} ({})", JOINT_NAMES[joint]);
            Error::value(name, "vertices that span a volume", format!("{} vertices", corners.len()))
        })
    };
    hulls.iter().enumerate().map(shape).collect()
}

/// Returns the pairs of links that never collide: of neighbouring fingers, or close in the rest pose.
fn excluded(shapes: &[SharedShape], joints: &[DVec3; N_JOINTS]) -> Vec<(usize, usize)> {
    let pose = |joint: usize| convex::pose(joints[joint], DQuat::IDENTITY);
    let mut pairs = Vec::new();
    for a in 0..N_JOINTS {
        for b in a + 1..N_JOINTS {
            let gap = parry3d::query::distance(&pose(a), &*shapes[a], &pose(b), &*shapes[b]);
            if are_neighbours(a, b) || gap.is_ok_and(|gap| gap.distance < MIN_REST_DISTANCE) {
                pairs.push((a, b));
            }
        }
    }
    pairs
}

/// Returns true if two links belong to fingers side by side.
///
/// Their flanks touch all the time; as convex hulls they would press each other apart with newtons that no skin feels.
/// The thumb can touch every finger, and every finger the palm.
fn are_neighbours(a: usize, b: usize) -> bool {
    let (a, b) = (site_of(a), site_of(b));
    let between =
        [(HandSite::Index, HandSite::Middle), (HandSite::Middle, HandSite::Ring), (HandSite::Ring, HandSite::Little)];
    between.contains(&(a, b)) || between.contains(&(b, a))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rotation_vectors_are_accurate_near_zero_and_near_pi() {
        let axis = DVec3::new(0.3, -0.5, 0.8).normalize();
        for angle in [0.0, 1e-12, 1e-8, 1e-4, 1.0, 3.0, std::f64::consts::PI - 1e-8] {
            let got = rotation_vector(DQuat::from_axis_angle(axis, angle));
            assert!((got - axis * angle).length() < 1e-12, "angle {angle}: {got}");
        }
        // Beyond pi the same rotation has a shorter vector in the opposite direction.
        let got = rotation_vector(DQuat::from_axis_angle(axis, 4.0));
        assert!((got + axis * (std::f64::consts::TAU - 4.0)).length() < 1e-12);
    }
}
