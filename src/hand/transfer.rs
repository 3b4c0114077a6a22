//! Carries fields between the built-in hand and a MANO file: registration once, two sparse maps each way.

use glam::Vec3;
use parry3d::math::Vector;
use parry3d::query::PointQueryWithLocation;
use parry3d::shape::Triangle;

use super::fit::{Fit, Pull, fit_keypoints, refine};
use super::{HandModel, HandParams, N_JOINTS, N_VERTICES, mesh};
use crate::error::{Error, Result};
use crate::hand::Topology;
use crate::tactile::N_FIELD;

/// What a surface that faces the other way costs, as metres of distance: a palm never maps to a back.
const NORMAL_COST: f32 = 0.008;
/// What a surface of another finger costs, as metres of distance.
const FINGER_COST: f32 = 0.02;

/// How often the nearest places of the skins are looked up and followed.
const SKIN_ROUNDS: usize = 4;
/// Skin farther away than this does not pull, m: MANO ends elsewhere at the wrist.
const PULL_REACH: f32 = 0.012;

/// Registration of the built-in hand on a MANO file of the same side.
#[derive(Debug, Clone)]
pub struct HandMap {
    /// From the built-in hand to MANO.
    pub to_mano: Transfer,
    /// From MANO to the built-in hand.
    pub to_builtin: Transfer,
    /// How the built-in hand was brought to MANO's shape.
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

/// A surface with what the search for correspondences looks at.
struct Surface {
    vertices: Vec<Vec3>,
    normals: Vec<Vec3>,
    areas: Vec<f32>,
    faces: Vec<[u32; 3]>,
    /// Finger of each vertex: 0 palm, 1 to 5.
    fingers: Vec<usize>,
}

/// Nearest place on a surface.
struct Nearest {
    face: usize,
    weights: [f32; 3],
    distance: f32,
}

impl HandMap {
    /// Registers the built-in hand of `mano`'s side on it, both at rest with zero betas.
    ///
    /// Similarity, betas and pose bring the built-in keypoints onto MANO's, then keypoints and skin; then each vertex takes the nearest place of
    /// the other surface that faces the same way on the same finger.
    pub fn new(mano: &HandModel) -> Self {
        let builtin = with_outermost_tips(&HandModel::builtin(mano.side));
        let mano = &with_outermost_tips(mano);
        let rest = mano.forward(&HandParams::default());
        let keypoints = mano.keypoints(&rest);
        let target = Surface::new(mano, rest.vertices);
        let mut fit = fit_keypoints(&builtin, &keypoints);
        let mut fitted = Surface::new(&builtin, fit.posed(&builtin).vertices);
        for _ in 0..SKIN_ROUNDS {
            fit = refine(&builtin, &fit, &keypoints, &fitted.pulls_to(&target));
            fitted = Surface::new(&builtin, fit.posed(&builtin).vertices);
        }
        let on_builtin: Vec<Nearest> = target.nearest_on(&fitted);
        let on_mano: Vec<Nearest> = fitted.nearest_on(&target);
        let distances = on_builtin.iter().map(|nearest| nearest.distance);
        Self {
            mean_distance: distances.clone().sum::<f32>() / N_VERTICES as f32,
            max_distance: distances.fold(0.0, f32::max),
            to_mano: Transfer::new(&fitted, &target, &on_builtin, &on_mano),
            to_builtin: Transfer::new(&target, &fitted, &on_mano, &on_builtin),
            fit,
        }
    }

    /// The transfer that ends in `to`.
    pub fn towards(&self, to: Topology) -> &Transfer {
        match to {
            Topology::Mano => &self.to_mano,
            Topology::EgotacHand1 => &self.to_builtin,
        }
    }
}

impl Transfer {
    fn new(source: &Surface, target: &Surface, at_target: &[Nearest], at_source: &[Nearest]) -> Self {
        let contact: Vec<Vec<(u32, f32)>> = at_target.iter().map(|nearest| nearest.corners(&source.faces)).collect();
        // A force is a pressure times an area. Interpolate the pressure, then give each source vertex's force out in
        // the shares that this makes, so that none is lost.
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
                // No target vertex looks here: the surface is finer than the target's.
                *shares = nearest.corners(&target.faces);
            }
        }
        Self { contact, force }
    }

    /// Carries contact of both hands over by interpolation, (1556); NaN stays where it is needed.
    ///
    /// # Errors
    /// If `contact` has not 1556 entries.
    pub fn contact(&self, contact: &[f32]) -> Result<Vec<f32>> {
        check_length("contact", contact)?;
        let gather = |hand: &[f32]| -> Vec<f32> {
            let value = |corners: &Vec<(u32, f32)>| corners.iter().map(|&(v, weight)| hand[v as usize] * weight).sum();
            self.contact.iter().map(value).collect()
        };
        Ok(contact.chunks_exact(N_VERTICES).flat_map(gather).collect())
    }

    /// Carries forces of both hands over, (1556) N; each hand's total stays the same.
    ///
    /// # Errors
    /// If `force` has not 1556 entries.
    pub fn force(&self, force: &[f32]) -> Result<Vec<f32>> {
        check_length("force", force)?;
        let scatter = |hand: &[f32]| -> Vec<f32> {
            let mut carried = vec![0f64; N_VERTICES];
            for (shares, &force) in self.force.iter().zip(hand) {
                for &(vertex, share) in shares.iter().filter(|_| force != 0.0) {
                    carried[vertex as usize] += f64::from(force) * f64::from(share);
                }
            }
            carried.into_iter().map(|force| force as f32).collect()
        };
        Ok(force.chunks_exact(N_VERTICES).flat_map(scatter).collect())
    }

    /// Carries a 0/1 mask of both hands over, (1556): 1 where all that a value would be made of is 1.
    ///
    /// # Errors
    /// If `mask` has not 1556 entries.
    pub fn mask(&self, mask: &[u8]) -> Result<Vec<u8>> {
        check_length("mask", mask)?;
        let gather = |hand: &[u8]| -> Vec<u8> {
            let value = |corners: &Vec<(u32, f32)>| u8::from(corners.iter().all(|&(v, _)| hand[v as usize] != 0));
            self.contact.iter().map(value).collect()
        };
        Ok(mask.chunks_exact(N_VERTICES).flat_map(gather).collect())
    }
}

/// The model with its fingertips at the vertices furthest along the last bones, so that both hands' tips mean the same
/// place (MANO's customary vertices lie on the pads).
fn with_outermost_tips(model: &HandModel) -> HandModel {
    let joints = super::lbs::rest_joints(model);
    let tip = |last: usize| {
        let along = joints[last] - joints[model.parents[last]];
        let own = |vertex: &u32| strongest_joint(model, *vertex as usize) == last;
        let reach = |vertex: u32| model.v_template[vertex as usize].dot(along);
        (0..N_VERTICES as u32).filter(own).max_by(|&a, &b| reach(a).total_cmp(&reach(b)))
    };
    // Thumb to little finger; a finger without skin of its own keeps its vertex.
    let mut tips = model.tip_vertices;
    for (slot, last) in tips.iter_mut().zip([15, 3, 6, 12, 9]) {
        *slot = tip(last).unwrap_or(*slot);
    }
    HandModel { tip_vertices: tips, ..model.clone() }
}

/// The joint that moves a vertex most.
fn strongest_joint(model: &HandModel, vertex: usize) -> usize {
    let weights = &model.lbs_weights[vertex * N_JOINTS..][..N_JOINTS];
    (0..N_JOINTS).max_by(|&a, &b| weights[a].total_cmp(&weights[b])).unwrap_or(0)
}

impl Surface {
    fn new(model: &HandModel, vertices: Vec<Vec3>) -> Self {
        Self {
            normals: mesh::vertex_normals(&vertices, &model.faces),
            areas: mesh::vertex_areas(&vertices, &model.faces),
            faces: model.faces.clone(),
            fingers: (0..vertices.len()).map(|vertex| strongest_joint(model, vertex).div_ceil(3)).collect(),
            vertices,
        }
    }

    /// For each of own vertices the nearest fitting place on `other`.
    fn nearest_on(&self, other: &Surface) -> Vec<Nearest> {
        let triangles: Vec<Triangle> = other.faces.iter().map(|face| triangle(&other.vertices, face)).collect();
        (0..self.vertices.len()).map(|vertex| self.nearest(vertex, other, &triangles)).collect()
    }

    /// Planes of `other` that own vertices shall lie on, where both skins face the same way.
    fn pulls_to(&self, other: &Surface) -> Vec<Pull> {
        let pull = |(vertex, nearest): (usize, Nearest)| {
            let corners = nearest.corners(&other.faces);
            let mix = |values: &[Vec3]| corners.iter().map(|&(v, weight)| values[v as usize] * weight).sum::<Vec3>();
            let normal = mix(&other.normals).normalize_or_zero();
            let fits = nearest.distance < PULL_REACH && normal.dot(self.normals[vertex]) > 0.6;
            fits.then(|| Pull { vertex, place: mix(&other.vertices), normal })
        };
        self.nearest_on(other).into_iter().enumerate().filter_map(pull).collect()
    }

    fn nearest(&self, vertex: usize, other: &Surface, triangles: &[Triangle]) -> Nearest {
        let [x, y, z] = self.vertices[vertex].to_array();
        let mut best = (f32::INFINITY, Nearest { face: 0, weights: [1.0, 0.0, 0.0], distance: f32::INFINITY });
        for (face, (corners, triangle)) in other.faces.iter().zip(triangles).enumerate() {
            let (place, location) = triangle.project_local_point_and_get_location(Vector::new(x, y, z), false);
            let Some(weights) = location.barycentric_coordinates() else { continue };
            let place = Vec3::new(place.point.x, place.point.y, place.point.z);
            let distance = place.distance(self.vertices[vertex]);
            let corner = |k: usize| corners[k] as usize;
            let normal: Vec3 = (0..3).map(|k| other.normals[corner(k)] * weights[k]).sum();
            let (own, theirs) = (self.fingers[vertex], other.fingers[corner(strongest(weights))]);
            let strange = own != 0 && theirs != 0 && own != theirs;
            let turned = 1.0 - normal.normalize_or_zero().dot(self.normals[vertex]);
            let cost = distance + NORMAL_COST * turned + if strange { FINGER_COST } else { 0.0 };
            if cost < best.0 {
                best = (cost, Nearest { face, weights, distance });
            }
        }
        best.1
    }
}

impl Nearest {
    /// Corners with their weights, those of zero left out.
    fn corners(&self, faces: &[[u32; 3]]) -> Vec<(u32, f32)> {
        faces[self.face].into_iter().zip(self.weights).filter(|&(_, weight)| weight > 0.0).collect()
    }
}

fn strongest(weights: [f32; 3]) -> usize {
    (0..3).max_by(|&a, &b| weights[a].total_cmp(&weights[b])).unwrap_or(0)
}

fn triangle(vertices: &[Vec3], face: &[u32; 3]) -> Triangle {
    let [a, b, c] = face.map(|vertex| vertices[vertex as usize]).map(|v| Vector::new(v.x, v.y, v.z));
    Triangle::new(a, b, c)
}

fn check_length<T>(name: &str, values: &[T]) -> Result<()> {
    if values.len() == N_FIELD { Ok(()) } else { Err(Error::shape(name, format!("[{N_FIELD}]"), [values.len()])) }
}
