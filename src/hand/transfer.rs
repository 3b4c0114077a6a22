//! Transfers fields between the built-in hand and a MANO file: one registration, then two sparse maps each way.

use glam::Vec3;
use parry3d::math::Vector;
use parry3d::query::PointQueryWithLocation;
use parry3d::shape::Triangle;

use super::fit::{Fit, FitCosts, PlaneTarget, fit_keypoints, refine};
use super::{HandModel, HandParams, N_FIELD, N_VERTICES, mesh};
use crate::error::{Error, Result};
use crate::hand::Topology;

/// Cost of a surface that faces the opposite way, as distance, m; it keeps the palm from mapping to the back.
const NORMAL_COST: f32 = 0.008;
/// Cost of a surface of another finger, as distance, m.
const FINGER_COST: f32 = 0.02;

/// Number of alternations between nearest-point search and fit, as in iterative closest point.
const SKIN_ROUNDS: usize = 4;
/// Largest distance of corresponding surface points, m. The two hands end at different places of the wrist, where
/// points have no counterpart.
const MAX_CORRESPONDENCE: f32 = 0.012;
/// Smallest cosine between the normals of corresponding surface points.
const MIN_NORMAL_COSINE: f32 = 0.6;

/// Registration of the built-in hand on a MANO file of the same side.
#[derive(Debug, Clone)]
pub struct HandMap {
    /// From the built-in hand to MANO.
    pub to_mano: Transfer,
    /// From MANO to the built-in hand.
    pub to_builtin: Transfer,
    /// Fit of the built-in hand to MANO's shape.
    pub fit: Fit,
    /// Mean distance of MANO's vertices from the fitted built-in surface, m.
    pub mean_distance: f32,
    /// Largest of these distances, m.
    pub max_distance: f32,
}

/// Linear maps of per-vertex values from one hand surface to another.
#[derive(Debug, Clone, PartialEq)]
pub struct Transfer {
    /// Interpolation at each target vertex, (778) lists of (source vertex, weight); weights of a list sum to 1.
    pub contact: Vec<Vec<(u32, f32)>>,
    /// Shares of each source vertex's force, (778) lists of (target vertex, share); shares of a list sum to 1.
    pub force: Vec<Vec<(u32, f32)>>,
}

/// A hand surface with the properties that correspondences depend on.
struct SkinSurface {
    vertices: Vec<Vec3>,
    normals: Vec<Vec3>,
    areas: Vec<f32>,
    faces: Vec<[u32; 3]>,
    /// Finger of each vertex: 0 is the palm, 1 to 5 are the fingers in MANO's order.
    fingers: Vec<usize>,
}

/// Point on a surface that corresponds to a vertex of another one.
struct SurfacePoint {
    face: usize,
    /// Barycentric coordinates.
    weights: [f32; 3],
    /// Distance from the vertex, m.
    distance: f32,
}

impl HandMap {
    /// Registers the built-in hand of `mano`'s side on it, both at rest with zero betas.
    ///
    /// A first fit of scale, translation, betas and pose aligns the keypoints, further fits align keypoints and
    /// surfaces. Each vertex then corresponds to the nearest point of the other surface that faces the same way on the
    /// same finger.
    pub fn new(mano: &HandModel) -> Self {
        let builtin = with_outermost_tips(&HandModel::builtin(mano.side));
        let mano = &with_outermost_tips(mano);
        let rest = mano.forward(&HandParams::default());
        let keypoints = mano.keypoints(&rest);
        let target = SkinSurface::new(mano, rest.vertices);
        let mut fit = fit_keypoints(&builtin, &keypoints);
        let mut fitted = SkinSurface::new(&builtin, fit.posed(&builtin).vertices);
        for _ in 0..SKIN_ROUNDS {
            let planes = fitted.planes_of(&target);
            fit = refine(&builtin, &fit, &keypoints, &planes, FitCosts::OTHER_MODEL);
            fitted = SkinSurface::new(&builtin, fit.posed(&builtin).vertices);
        }
        let on_builtin: Vec<SurfacePoint> = target.nearest_on(&fitted);
        let on_mano: Vec<SurfacePoint> = fitted.nearest_on(&target);
        let distances = on_builtin.iter().map(|nearest| nearest.distance);
        Self {
            mean_distance: distances.clone().sum::<f32>() / N_VERTICES as f32,
            max_distance: distances.fold(0.0, f32::max),
            to_mano: Transfer::new(&fitted, &target, &on_builtin, &on_mano),
            to_builtin: Transfer::new(&target, &fitted, &on_mano, &on_builtin),
            fit,
        }
    }

    /// Returns the transfer to `to`.
    pub fn towards(&self, to: Topology) -> &Transfer {
        match to {
            Topology::Mano => &self.to_mano,
            Topology::EgotacHand1 => &self.to_builtin,
        }
    }
}

impl Transfer {
    /// Creates the maps from `source` to `target`. `at_target` holds the point on `source` of each target vertex,
    /// `at_source` the point on `target` of each source vertex.
    fn new(source: &SkinSurface, target: &SkinSurface, at_target: &[SurfacePoint], at_source: &[SurfacePoint]) -> Self {
        let contact: Vec<Vec<(u32, f32)>> = at_target.iter().map(|nearest| nearest.corners(&source.faces)).collect();
        // Force is pressure times area. The interpolated pressure defines the shares of each source vertex's force;
        // normalising them conserves the total.
        let mut force = vec![Vec::new(); source.vertices.len()];
        for (vertex, corners) in contact.iter().enumerate() {
            for &(corner, weight) in corners {
                force[corner as usize].push((vertex as u32, weight * target.areas[vertex]));
            }
        }
        for (shares, nearest) in force.iter_mut().zip(at_source) {
            let total: f32 = shares.iter().map(|(_, share)| share).sum();
            if total > 0.0 {
                shares.iter_mut().for_each(|(_, share)| *share /= total);
            } else {
                // No target vertex takes its value from this one: the source surface is finer here.
                *shares = nearest.corners(&target.faces);
            }
        }
        Self { contact, force }
    }

    /// Interpolates the contact of both hands, (1556); a vertex that depends on NaN becomes NaN.
    ///
    /// # Errors
    /// If `contact` does not have 1556 entries.
    pub fn contact(&self, contact: &[f32]) -> Result<Vec<f32>> {
        check_length("contact", contact)?;
        let gather = |hand: &[f32]| -> Vec<f32> {
            let value = |corners: &Vec<(u32, f32)>| corners.iter().map(|&(v, weight)| hand[v as usize] * weight).sum();
            self.contact.iter().map(value).collect()
        };
        Ok(contact.chunks_exact(N_VERTICES).flat_map(gather).collect())
    }

    /// Transfers the forces of both hands, (1556), N; the total of each hand is conserved.
    ///
    /// # Errors
    /// If `force` does not have 1556 entries.
    pub fn force(&self, force: &[f32]) -> Result<Vec<f32>> {
        check_length("force", force)?;
        Ok(force.chunks_exact(N_VERTICES).flat_map(|hand| self.force_of_hand(hand)).collect())
    }

    /// Transfers the forces of one hand, (778), N.
    pub(super) fn force_of_hand(&self, hand: &[f32]) -> Vec<f32> {
        let mut carried = vec![0f64; N_VERTICES];
        for (shares, &force) in self.force.iter().zip(hand).filter(|(_, force)| **force != 0.0) {
            // Shares are rounded to f32; dividing by their sum keeps the total to the rounding of the result.
            let sum: f64 = shares.iter().map(|(_, share)| f64::from(*share)).sum();
            for &(vertex, share) in shares {
                carried[vertex as usize] += f64::from(force) * f64::from(share) / sum;
            }
        }
        carried.into_iter().map(|force| force as f32).collect()
    }

    /// Transfers a 0/1 mask of the forces of one hand, (778): 1 if all vertices that give force are 1.
    pub(super) fn force_mask_of_hand(&self, hand: &[u8]) -> Vec<u8> {
        let mut carried = vec![1; N_VERTICES];
        for shares in self.force.iter().zip(hand).filter(|(_, mask)| **mask == 0).map(|(shares, _)| shares) {
            shares.iter().for_each(|&(vertex, _)| carried[vertex as usize] = 0);
        }
        carried
    }

    /// Takes the values of one hand, (778), from the vertex with the largest weight of each interpolation.
    pub(super) fn nearest_of_hand<T: Copy>(&self, hand: &[T]) -> Vec<T> {
        let nearest = |corners: &Vec<(u32, f32)>| corners.iter().max_by(|a, b| a.1.total_cmp(&b.1)).map_or(0, |c| c.0);
        self.contact.iter().map(|corners| hand[nearest(corners) as usize]).collect()
    }

    /// Transfers a 0/1 mask of both hands, (1556): 1 if all source vertices of the value are 1.
    ///
    /// # Errors
    /// If `mask` does not have 1556 entries.
    pub fn mask(&self, mask: &[u8]) -> Result<Vec<u8>> {
        check_length("mask", mask)?;
        let gather = |hand: &[u8]| -> Vec<u8> {
            let value = |corners: &Vec<(u32, f32)>| u8::from(corners.iter().all(|&(v, _)| hand[v as usize] != 0));
            self.contact.iter().map(value).collect()
        };
        Ok(mask.chunks_exact(N_VERTICES).flat_map(gather).collect())
    }
}

/// Returns the model with its fingertips at the vertices furthest along the last bones, so that the tips of both hands
/// correspond; the usual MANO tip vertices lie on the pads.
fn with_outermost_tips(model: &HandModel) -> HandModel {
    let joints = super::lbs::rest_joints(model);
    let strongest = model.strongest_joints();
    let tip = |last: usize| {
        let along = joints[last] - joints[model.parents[last]];
        let own = |vertex: &u32| strongest[*vertex as usize] == last;
        let reach = |vertex: u32| model.v_template[vertex as usize].dot(along);
        (0..N_VERTICES as u32).filter(own).max_by(|&a, &b| reach(a).total_cmp(&reach(b)))
    };
    // Last joints, thumb to little finger. A finger without vertices of its own keeps its tip.
    let mut tips = model.tip_vertices;
    for (slot, last) in tips.iter_mut().zip([15, 3, 6, 12, 9]) {
        *slot = tip(last).unwrap_or(*slot);
    }
    HandModel { tip_vertices: tips, ..model.clone() }
}

impl SkinSurface {
    fn new(model: &HandModel, vertices: Vec<Vec3>) -> Self {
        Self {
            normals: mesh::vertex_normals(&vertices, &model.faces),
            areas: mesh::vertex_areas(&vertices, &model.faces),
            faces: model.faces.clone(),
            fingers: model.strongest_joints().into_iter().map(|joint| joint.div_ceil(3)).collect(),
            vertices,
        }
    }

    /// Returns for each vertex the corresponding point on `other`.
    fn nearest_on(&self, other: &SkinSurface) -> Vec<SurfacePoint> {
        let triangles: Vec<Triangle> = other.faces.iter().map(|face| triangle(&other.vertices, face)).collect();
        let spheres: Vec<(Vec3, f32)> = other.faces.iter().map(|face| sphere(&other.vertices, face)).collect();
        (0..self.vertices.len()).map(|vertex| self.nearest(vertex, other, &triangles, &spheres)).collect()
    }

    /// Returns the tangent planes of `other` at the points that correspond to vertices of this surface.
    fn planes_of(&self, other: &SkinSurface) -> Vec<PlaneTarget> {
        let plane = |(vertex, nearest): (usize, SurfacePoint)| {
            let corners = nearest.corners(&other.faces);
            let mix = |values: &[Vec3]| corners.iter().map(|&(v, weight)| values[v as usize] * weight).sum::<Vec3>();
            let normal = mix(&other.normals).normalize_or_zero();
            let fits = nearest.distance < MAX_CORRESPONDENCE && normal.dot(self.normals[vertex]) > MIN_NORMAL_COSINE;
            fits.then(|| PlaneTarget { vertex, point: mix(&other.vertices), normal })
        };
        self.nearest_on(other).into_iter().enumerate().filter_map(plane).collect()
    }

    /// Returns the point on `other` with the least sum of distance, normal cost and finger cost.
    fn nearest(
        &self,
        vertex: usize,
        other: &SkinSurface,
        triangles: &[Triangle],
        spheres: &[(Vec3, f32)],
    ) -> SurfacePoint {
        /// Rounding of a distance, m.
        const ROUNDING: f32 = 1e-6;
        let [x, y, z] = self.vertices[vertex].to_array();
        let mut best = (f32::INFINITY, SurfacePoint { face: 0, weights: [1.0, 0.0, 0.0], distance: f32::INFINITY });
        for (face, (corners, triangle)) in other.faces.iter().zip(triangles).enumerate() {
            // The cost is at least the distance, and that at least the distance to the sphere around the triangle.
            let (centre, radius) = spheres[face];
            if centre.distance(self.vertices[vertex]) - radius - ROUNDING > best.0 {
                continue;
            }
            let (place, location) = triangle.project_local_point_and_get_location(Vector::new(x, y, z), false);
            let Some(weights) = location.barycentric_coordinates() else { continue };
            let place = Vec3::new(place.point.x, place.point.y, place.point.z);
            let distance = place.distance(self.vertices[vertex]);
            let corner = |k: usize| corners[k] as usize;
            let normal: Vec3 = (0..3).map(|k| other.normals[corner(k)] * weights[k]).sum();
            let (own, theirs) = (self.fingers[vertex], other.fingers[corner(strongest(weights))]);
            let other_finger = own != 0 && theirs != 0 && own != theirs;
            let turned = 1.0 - normal.normalize_or_zero().dot(self.normals[vertex]);
            let cost = distance + NORMAL_COST * turned + if other_finger { FINGER_COST } else { 0.0 };
            if cost < best.0 {
                best = (cost, SurfacePoint { face, weights, distance });
            }
        }
        best.1
    }
}

impl SurfacePoint {
    /// Returns the corners with weights above zero.
    fn corners(&self, faces: &[[u32; 3]]) -> Vec<(u32, f32)> {
        faces[self.face].into_iter().zip(self.weights).filter(|&(_, weight)| weight > 0.0).collect()
    }
}

/// Returns the corner with the largest weight.
fn strongest(weights: [f32; 3]) -> usize {
    (0..3).max_by(|&a, &b| weights[a].total_cmp(&weights[b])).unwrap_or(0)
}

fn triangle(vertices: &[Vec3], face: &[u32; 3]) -> Triangle {
    let [a, b, c] = face.map(|vertex| vertices[vertex as usize]).map(|v| Vector::new(v.x, v.y, v.z));
    Triangle::new(a, b, c)
}

/// Returns a sphere around a triangle.
fn sphere(vertices: &[Vec3], face: &[u32; 3]) -> (Vec3, f32) {
    let corners = face.map(|vertex| vertices[vertex as usize]);
    let centre = (corners[0] + corners[1] + corners[2]) / 3.0;
    (centre, corners.iter().map(|corner| corner.distance(centre)).fold(0.0, f32::max))
}

fn check_length<T>(name: &str, values: &[T]) -> Result<()> {
    if values.len() == N_FIELD { Ok(()) } else { Err(Error::shape(name, format!("[{N_FIELD}]"), [values.len()])) }
}
