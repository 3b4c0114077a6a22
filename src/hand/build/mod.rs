//! Generates the built-in hand `egotac-hand-1` from its anatomy.
//!
//! The result is committed as `src/hand/builtin.safetensors`, because rounding on another machine could connect other
//! vertices, and stores and checkpoints depend on the vertex indices. `egotac hand build` runs the generator.

mod anatomy;
mod extract;
mod remesh;
mod shape;
mod skin;
mod surface;

use std::f64::consts::FRAC_PI_4;

use glam::{DQuat, DVec3, Vec3};

use super::{HandModel, N_JOINTS, N_VERTICES, Side};
use crate::hand::Topology;
use remesh::{EditableMesh, TargetSurface};

pub use surface::ImplicitHand;

/// Grid spacing of the initial dense mesh, m.
const GRID: f64 = 0.0016;
/// Vertex counts at which edge collapse pauses for flips and smoothing.
const STAGES: [usize; 5] = [6000, 3000, 1600, 1000, N_VERTICES];

/// Parent of each joint, in MANO's joint order.
pub const PARENTS: [usize; N_JOINTS] = [0, 0, 1, 2, 0, 4, 5, 0, 7, 8, 0, 10, 11, 0, 13, 14];

/// Returns the 16 joints of the right hand at rest with zero betas, in MANO order, m.
pub fn rest_joints() -> [Vec3; N_JOINTS] {
    anatomy::joints().map(|joint| joint.as_vec3())
}

/// Generates the right hand, without pose blend shapes.
pub fn build() -> HandModel {
    let surface = ImplicitHand::new();
    let (points, faces) = mesh(&surface);
    let weights = skin::weights(&points, &faces, &surface.fingers);
    let single = |values: Vec<f64>| values.into_iter().map(|value| value as f32).collect::<Vec<f32>>();
    HandModel {
        side: Side::Right,
        topology: Topology::EgotacHand1,
        shapedirs: single(shape::shapedirs(&points, &weights, &surface.fingers)),
        posedirs: Vec::new(),
        j_regressor: single(shape::j_regressor(&points)),
        parents: PARENTS,
        lbs_weights: single(weights.into_iter().flatten().collect()),
        tip_vertices: tip_vertices(&points, &surface),
        v_template: points.iter().map(|point| point.as_vec3()).collect(),
        faces,
    }
}

/// Meshes the surface with exactly 778 vertices, finer where touch happens.
fn mesh(surface: &ImplicitHand) -> (Vec<DVec3>, Vec<[u32; 3]>) {
    let (low, high) = (DVec3::new(-0.105, -0.040, -0.065), DVec3::new(0.130, 0.040, 0.115));
    let (points, faces) = extract::surface_nets(|point| surface.value(point), low, high, GRID);
    let mut mesh = EditableMesh::new(surface, points, &faces);
    for count in STAGES {
        mesh.collapse_to(count);
        for _ in 0..6 {
            mesh.flip();
            mesh.smooth();
        }
    }
    // Split the relatively longest edges and collapse the shortest until the density is even.
    for _ in 0..12 {
        mesh.split_longest(12);
        mesh.flip();
        mesh.smooth();
        mesh.collapse_to(N_VERTICES);
        for _ in 0..4 {
            mesh.flip();
            mesh.smooth();
        }
    }
    mesh.compact()
}

impl TargetSurface for ImplicitHand {
    fn project(&self, point: DVec3) -> DVec3 {
        ImplicitHand::project(self, point)
    }

    fn normal(&self, point: DVec3) -> DVec3 {
        self.gradient(point).normalize_or_zero()
    }

    fn edge_length(&self, point: DVec3) -> f64 {
        const MIN_LENGTH: f64 = 0.0025;
        let normal = self.normal(point);
        // An edge longer than the radius of curvature would bridge the web between two fingers.
        edge_length(self, point, normal).min((0.9 / curvature(self, point, normal)).max(MIN_LENGTH))
    }
}

/// Computes the largest change of the normal per metre, over steps of 2 mm in four tangent directions.
fn curvature(surface: &ImplicitHand, point: DVec3, normal: DVec3) -> f64 {
    const STEP: f64 = 0.002;
    let tangent = normal.any_orthonormal_vector();
    let bend = |along: DVec3| {
        let [ahead, behind] = [STEP, -STEP].map(|step| surface.normal(point + along * step));
        ahead.distance(behind) / (2.0 * STEP)
    };
    let bends = (0..4).map(|eighth| bend(DQuat::from_axis_angle(normal, f64::from(eighth) * FRAC_PI_4) * tangent));
    bends.fold(1e-3, f64::max)
}

/// Returns the target edge length, m: shortest on the pads of the fingertips, longest on the back of the hand and at
/// the wrist.
fn edge_length(surface: &ImplicitHand, point: DVec3, normal: DVec3) -> f64 {
    let palmar_side = smoothstep(-0.5, 0.6, -normal.y);
    let palm = mix(0.0125, 0.0085, palmar_side);
    let palm = mix(palm, 0.0135, smoothstep(0.080, 0.105, point.x));
    let mut wanted = palm;
    for finger in &surface.fingers {
        let at = (point - finger.base).dot(finger.axis);
        let aside = (point - finger.base - finger.axis * at).length();
        // Skip points outside of the sweep around this finger's axis.
        if aside > 0.017 || at < 0.0 {
            continue;
        }
        let pad = smoothstep(-0.5, 0.5, normal.dot(finger.palmar) + 0.4 * normal.dot(finger.axis).max(0.0));
        let (tip, last_joint) = (finger.marks[finger.marks.len() - 1], finger.marks[finger.marks.len() - 2]);
        let along = (at / last_joint).min(1.0);
        let shaft = mix(mix(0.0085, 0.0075, along), mix(0.0070, 0.0052, along), pad);
        let end = mix(0.0062, 0.0038, pad);
        let on_finger = mix(shaft, end, smoothstep(last_joint - 0.004, mix(last_joint, tip, 0.35), at));
        wanted = mix(wanted, on_finger, smoothstep(0.0, 0.4 * finger.marks[1], at));
    }
    wanted
}

/// Returns the vertex nearest to the tip of each finger, thumb to little.
fn tip_vertices(points: &[DVec3], surface: &ImplicitHand) -> [u32; 5] {
    let [index, middle, little, ring, thumb] = &surface.fingers;
    [thumb, index, middle, ring, little].map(|finger| {
        let tip = finger.joints[3];
        let nearest = (0..points.len()).min_by(|&a, &b| points[a].distance(tip).total_cmp(&points[b].distance(tip)));
        nearest.unwrap_or(0) as u32
    })
}

fn mix(from: f64, to: f64, t: f64) -> f64 {
    from + (to - from) * t
}

fn smoothstep(low: f64, high: f64, x: f64) -> f64 {
    let t = ((x - low) / (high - low)).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}
