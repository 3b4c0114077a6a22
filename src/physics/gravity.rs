//! Direction of gravity and the support plane, from bodies at rest that no hand touches.

use glam::{DVec3, Vec3};

use super::body::RigidBody;
use super::pose::{Pose, PoseNoise};
use super::take::{Fixed, Take};
use crate::error::Result;
use crate::hand::Side;

/// Acceleration of free fall, m/s².
pub const FREE_FALL: f64 = 9.81;
/// Depth of the band of surface points that lie on the support, m, beside three standard deviations of the pose.
const BAND: f64 = 0.003;
/// Distance from hands at which a resting body is not held, m.
const FREE_OF_HANDS: f32 = 0.03;
/// Motion of a body at rest: m over [`REST_SECS`], beside noise.
const REST: f64 = 0.002;
const REST_SECS: f64 = 0.4;
/// Share of the best direction's score that the second best must stay below.
const CLEAR: f64 = 0.6;
/// Factor on the score of a direction whose plane bodies or hands pass through.
const PIERCED: f64 = 0.2;
/// Half size of the slab that stands for the support, m.
pub(crate) const SLAB: Vec3 = Vec3::new(2.0, 2.0, 0.05);

/// Direction of gravity and the plane that carries resting bodies.
#[derive(Debug, Clone)]
pub struct Support {
    /// Unit vector against gravity.
    pub up: DVec3,
    /// Height of the plane along `up`, m.
    pub height: f64,
}

impl Support {
    /// Finds the support of bodies that rest while no hand is near. Candidates are the world's six axes: data sets align one
    /// of them with gravity. `None` if nothing rests, or two directions explain the rest about equally well.
    pub fn find(take: &Take) -> Option<Self> {
        let axes = [DVec3::X, DVec3::Y, DVec3::Z].into_iter().flat_map(|axis| [axis, -axis]);
        let resting = resting(take);
        let mut scores: Vec<(f64, Self)> = axes
            .map(|up| {
                let mut heights = Vec::new();
                let mut score = 0.0;
                for (body, pose, sd) in &resting {
                    let along: Vec<f64> = body.samples.iter().map(|p| up.dot(pose.point(p.as_dvec3()))).collect();
                    let lowest = along.iter().copied().fold(f64::INFINITY, f64::min);
                    let band = lowest + BAND + 3.0 * sd;
                    score += along.iter().filter(|a| **a <= band).count() as f64 / along.len().max(1) as f64;
                    heights.push(lowest);
                }
                let height = crate::statistics::median(heights.iter().copied());
                // Resting bodies share one plane: a direction under which they hang at different heights is wrong.
                let together = heights.iter().filter(|h| (**h - height).abs() < 0.01).count() as f64;
                let support = Self { up, height };
                if support.is_pierced(take) {
                    score *= PIERCED;
                }
                (score * together / heights.len().max(1) as f64, support)
            })
            .collect();
        scores.sort_by(|a, b| b.0.total_cmp(&a.0));
        let (best, second) = (scores.first()?.0, scores.get(1)?.0);
        (best > 0.0 && second <= CLEAR * best).then(|| scores.swap_remove(0).1)
    }

    /// True if bodies or wrists are below the plane in more than a few frames, which a support does not allow.
    fn is_pierced(&self, take: &Take) -> bool {
        let (mut below, mut all) = (0usize, 0usize);
        let mut count = |lowest: f64, sd: f64| {
            below += usize::from(lowest < self.height - BAND - 0.005 - 4.0 * sd);
            all += 1;
        };
        for (body, poses) in take.bodies.iter().zip(&take.poses) {
            let sd = PoseNoise::estimate(poses).position;
            for pose in poses.iter().flatten() {
                let along = body.samples.iter().map(|p| self.up.dot(pose.point(p.as_dvec3())));
                count(along.fold(f64::INFINITY, f64::min), sd);
            }
        }
        for wrist in Side::BOTH.into_iter().flat_map(|side| take.wrists(side)).flatten() {
            count(self.up.dot(wrist.position), 0.01);
        }
        below as f64 > 0.03 * all as f64
    }

    /// Finds the height of the support under bodies at rest for a known direction `up`; `None` if nothing rests.
    pub fn below(take: &Take, up: DVec3) -> Option<Self> {
        let lowest = |(body, pose, _): (&RigidBody, Pose, f64)| {
            body.samples.iter().map(|p| up.dot(pose.point(p.as_dvec3()))).fold(f64::INFINITY, f64::min)
        };
        let heights: Vec<f64> = resting(take).into_iter().map(lowest).filter(|height| height.is_finite()).collect();
        (!heights.is_empty()).then(|| Self { up, height: crate::statistics::median(heights) })
    }

    /// Returns the acceleration of free fall, m/s².
    pub fn gravity(&self) -> DVec3 {
        -self.up * FREE_FALL
    }

    /// Returns the plane as a slab whose top it is.
    ///
    /// # Errors
    /// None in practice: the slab has fixed positive sizes.
    pub fn slab(&self) -> Result<Fixed> {
        let orientation = glam::DQuat::from_rotation_arc(DVec3::Z, self.up);
        let position = self.up * (self.height - f64::from(SLAB.z));
        Fixed::block("support plane", SLAB, Pose { position, orientation })
    }
}

/// Returns bodies at instants of rest without a hand near, each with its pose and the standard deviation of its position, m.
fn resting<'a>(take: &'a Take) -> Vec<(&'a RigidBody, Pose, f64)> {
    let mut found = Vec::new();
    for (body, poses) in take.bodies.iter().zip(&take.poses) {
        if body.solid.is_none() || body.samples.is_empty() {
            continue;
        }
        let sd = PoseNoise::estimate(poses).position;
        let mut last = f64::NEG_INFINITY;
        for (frame, time) in take.times.iter().enumerate() {
            if time - last < REST_SECS {
                continue;
            }
            let Some(pose) = poses[frame] else { continue };
            let mut window = (frame..poses.len()).take_while(|other| take.times[*other] - time <= REST_SECS);
            let at_rest = window.all(|other| {
                poses[other].is_some_and(|p| {
                    p.position.distance(pose.position) < REST + 6.0 * sd
                        && p.orientation.dot(pose.orientation).abs() > 0.9995
                })
            });
            let full = take.times.last().is_some_and(|end| end - time >= REST_SECS);
            if at_rest && full && is_free(take, body, &pose, frame) {
                found.push((body, pose, sd));
                last = *time;
            }
        }
    }
    found
}

/// True if no hand is near a body.
fn is_free(take: &Take, body: &RigidBody, pose: &Pose, frame: usize) -> bool {
    let Some(solid) = &body.solid else { return false };
    Side::BOTH.into_iter().all(|side| {
        let vertices = take.vertices(side, frame).unwrap_or_default();
        vertices.iter().all(|v| solid.distance(pose.local(v.as_dvec3()).as_vec3(), FREE_OF_HANDS) > FREE_OF_HANDS)
    })
}
