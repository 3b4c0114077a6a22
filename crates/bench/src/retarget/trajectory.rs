//! Synthetic motion of the built-in hand: seeded, free motion with a pinch by each finger in turn.

use std::f64::consts::TAU;
use std::sync::OnceLock;

use egotac::error::Result;
use egotac::hand::{HandModel, N_BETAS, N_KEYPOINTS, Side};
use egotac::retarget::human::{Hand, keypoint};
use egotac::sim::rig::{HandRig, Hinge, Motion};
use egotac::sim::scene::Site;
use glam::{DQuat, DVec3};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Normal};
use rayon::prelude::*;

/// Frames per second.
pub const RATE: f64 = 30.0;
/// Time from one pinch to the next, s.
const PERIOD: f64 = 4.0;
/// Free motion before each pinch, s.
const FREE: f64 = 1.0;
/// Time that a pinch takes to close, and again to open, s.
const APPROACH: f64 = 0.6;
/// Time that a pinch is held, s.
const HOLD: f64 = 0.8;
/// Distance of the tip keypoints in a pinch, m.
const PINCH: f64 = 0.013;
/// Weight of a pad's normal off the line between the tips in the search for a pinch, m per unit of the normal: small
/// beside the distance of the tips, which comes first.
const FACING: f64 = 0.0005;
/// Weight of an angle's distance from a half bent hand in the same search, m/rad.
const LEAVING: f64 = 0.0003;
/// Share of keypoints that are spikes.
const SPIKE_SHARE: f64 = 0.02;
/// Distance of a spike from its keypoint, m.
const SPIKE_DISTANCE: f64 = 0.04;

/// Keypoints of a right hand with its touch, frame by frame.
#[derive(Debug, Clone, Default)]
pub struct Trajectory {
    /// (T) keypoints, m.
    pub keypoints: Vec<[DVec3; N_KEYPOINTS]>,
    /// (T) contact of each fingertip, 0 or 1.
    pub tip_contact: Vec<[f64; 5]>,
    /// (T) force of the world on each fingertip, N, in the frame of the keypoints.
    pub tip_force: Vec<[DVec3; 5]>,
}

/// Fingers of the built-in hand that reach the thumb, with the angles of all hinges in the pinch, rad; found once.
static PINCHES: OnceLock<Vec<(usize, Vec<f64>)>> = OnceLock::new();

/// Noise on keypoints.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Noise {
    /// White noise of this standard deviation per coordinate, m.
    White(f64),
    /// One keypoint in fifty is 40 mm off.
    Spikes,
}

impl Trajectory {
    /// Generates `frames` frames at 30 Hz of the built-in right hand.
    ///
    /// # Errors
    /// If the built-in hand can't be rigged.
    pub fn generate(frames: usize, seed: u64) -> Result<Self> {
        let rig = HandRig::new(HandModel::builtin(Side::Right), [0.0; N_BETAS])?;
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let waves = Waves::draw(&rig, &mut rng);
        let pinches = PINCHES.get_or_init(|| {
            let fingers: Vec<usize> = (1..5).collect();
            fingers.into_par_iter().filter_map(|finger| Some((finger, pinch(&rig, finger)?))).collect()
        });
        let all: Vec<_> = (0..frames)
            .into_par_iter()
            .map(|frame| {
                let time = frame as f64 / RATE;
                let (turn, share, is_held) = schedule(time);
                let free = waves.at(&rig, time);
                let (finger, closed) = &pinches[turn % pinches.len()];
                let angles: Vec<f64> = free.iter().zip(closed).map(|(a, b)| a + share * (b - a)).collect();
                let wrist = DVec3::new(0.1 * (0.3 * time).sin(), 0.05 * (0.5 * time).cos(), 0.3);
                let orientation = DQuat::from_euler(
                    glam::EulerRot::XYZ,
                    0.6 * (0.4 * time).sin(),
                    0.3 * time,
                    0.5 * (0.27 * time).cos(),
                );
                let keypoints = Hand::of_model(&rig.model, &rig.params(wrist, orientation, &angles));
                let mut contact = [0.0; 5];
                let mut force = [DVec3::ZERO; 5];
                if is_held {
                    (contact[0], contact[*finger]) = (1.0, 1.0);
                    force = forces(&keypoints, *finger, time);
                }
                (keypoints, contact, force)
            })
            .collect();
        let mut made = Self::default();
        for (keypoints, contact, force) in all {
            made.keypoints.push(keypoints);
            made.tip_contact.push(contact);
            made.tip_force.push(force);
        }
        Ok(made)
    }

    /// Returns the trajectory with noise on the keypoints.
    pub fn with(&self, noise: Noise, seed: u64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut noisy = self.clone();
        let Ok(normal) = Normal::new(0.0, 1.0) else { return noisy };
        let vector = |rng: &mut ChaCha8Rng| DVec3::from_array(std::array::from_fn(|_| normal.sample(rng)));
        for point in noisy.keypoints.iter_mut().flatten() {
            match noise {
                Noise::White(deviation) => *point += deviation * vector(&mut rng),
                Noise::Spikes => {
                    if rng.random_bool(SPIKE_SHARE) {
                        *point += SPIKE_DISTANCE * vector(&mut rng).normalize_or(DVec3::X);
                    }
                }
            }
        }
        noisy
    }
}

/// Returns the number of the pinch at a time, the share (0 to 1) by which it has closed, and true while it is held.
fn schedule(time: f64) -> (usize, f64, bool) {
    let turn = (time / PERIOD) as usize;
    let at = time % PERIOD - FREE;
    let smooth = |x: f64| x * x * x * (x * (6.0 * x - 15.0) + 10.0);
    let share = match at {
        x if x <= 0.0 => 0.0,
        x if x < APPROACH => smooth(x / APPROACH),
        x if x <= APPROACH + HOLD => 1.0,
        x if x < 2.0 * APPROACH + HOLD => smooth((2.0 * APPROACH + HOLD - x) / APPROACH),
        _ => 0.0,
    };
    (turn, share, share >= 1.0)
}

/// Returns the forces of thumb and finger on each other in a pinch, N: opposite, 0.5 to 3.5 N along the line between them,
/// and 0.3 of that across it.
fn forces(keypoints: &[DVec3; N_KEYPOINTS], finger: usize, time: f64) -> [DVec3; 5] {
    let mut forces = [DVec3::ZERO; 5];
    let line = (keypoints[keypoint(finger, 3)] - keypoints[keypoint(0, 3)]).normalize_or(DVec3::X);
    let across = line.any_orthonormal_vector();
    let slide = 0.3 * (across * (0.9 * time).cos() + line.cross(across) * (0.9 * time).sin());
    forces[finger] = (2.0 + 1.5 * (1.3 * time).sin()) * (line + slide);
    forces[0] = -forces[finger];
    forces
}

/// Free motion: each finger's hinges follow a sum of slow waves.
///
/// Waves are (frequency in Hz, phase in rad, amplitude).
struct Waves {
    fingers: [[(f64, f64, f64); 3]; 5],
    spread: [(f64, f64); 5],
}

impl Waves {
    fn draw(rig: &HandRig, rng: &mut ChaCha8Rng) -> Self {
        debug_assert!(!rig.hinges.is_empty());
        let mut wave =
            |low: f64, high: f64| (rng.random_range(low..high), rng.random_range(0.0..TAU), rng.random_range(0.5..1.0));
        let fingers = std::array::from_fn(|_| [wave(0.08, 0.2), wave(0.2, 0.45), wave(0.45, 0.8)]);
        let spread = std::array::from_fn(|_| (rng.random_range(0.1..0.3), rng.random_range(0.0..TAU)));
        Self { fingers, spread }
    }

    fn at(&self, rig: &HandRig, time: f64) -> Vec<f64> {
        let angle = |hinge: &Hinge| {
            let finger = finger_of(hinge.joint);
            let sum: f64 =
                self.fingers[finger].iter().map(|(f, phase, size)| size * (TAU * f * time + phase).sin()).sum();
            let bend = 0.35 + 0.22 * sum;
            let (f, phase) = self.spread[finger];
            let value = match (hinge.motion, (hinge.joint - 1) % 3) {
                (HingeMotion::Flex, 0) => 1.1 * bend,
                (HingeMotion::Flex, 1) => 1.3 * bend,
                (HingeMotion::Flex, _) => 0.8 * bend,
                (HingeMotion::Abduct, _) => 0.12 * (TAU * f * time + phase).sin(),
                (HingeMotion::Twist, _) => 0.0,
            };
            let value = if finger == 0 { 0.5 * value } else { value };
            value.clamp(hinge.range[0], hinge.range[1])
        };
        rig.hinges.iter().map(angle).collect()
    }
}

/// Returns the finger of a MANO joint, thumb 0 to little finger 4.
fn finger_of(joint: usize) -> usize {
    [1, 2, 4, 3, 0][(joint - 1) / 3]
}

/// Finds the angles at which thumb and finger meet, pad to pad as far as possible, by damped least squares. Returns `None`
/// if they do not reach each other.
fn pinch(rig: &HandRig, finger: usize) -> Option<Vec<f64>> {
    let mine: Vec<usize> =
        (0..rig.hinges.len()).filter(|k| [0, finger].contains(&finger_of(rig.hinges[*k].joint))).collect();
    let start = |[of_finger, of_thumb]: [f64; 2]| -> Vec<f64> {
        let bend = |hinge: &Hinge| match hinge.motion {
            HingeMotion::Flex if finger_of(hinge.joint) == finger => of_finger,
            HingeMotion::Flex => of_thumb,
            _ => 0.0,
        };
        rig.hinges.iter().map(|hinge| bend(hinge).clamp(hinge.range[0], hinge.range[1])).collect()
    };
    let rest = start([0.8, 0.35]);
    let residuals = |angles: &[f64]| -> nalgebra::DVector<f64> {
        let posed = rig.model.forward(&rig.params(DVec3::ZERO, DQuat::IDENTITY, angles));
        let points = rig.model.keypoints(&posed).map(|point| point.as_dvec3());
        let normal = |site| {
            let pad = rig.pad(site);
            posed.rotations[pad.joint].as_dmat3() * pad.normal
        };
        let line = points[keypoint(finger, 3)] - points[keypoint(0, 3)];
        let along = line.normalize_or(DVec3::X);
        // At the touching distance, not nearer.
        let miss = line - PINCH * along;
        let facing = [normal(Site::FINGERS[0]) - along, normal(Site::FINGERS[finger]) + along];
        let facing = facing.into_iter().flat_map(|off| (FACING * off).to_array());
        let leave = mine.iter().map(|k| LEAVING * (angles[*k] - rest[*k]));
        let all: Vec<f64> = miss.to_array().into_iter().chain(facing).chain(leave).collect();
        nalgebra::DVector::from_vec(all)
    };
    let settle = |mut angles: Vec<f64>| -> (Vec<f64>, nalgebra::DVector<f64>) {
        for _ in 0..40 {
            let now = residuals(&angles);
            let columns: Vec<_> = mine
                .iter()
                .map(|k| {
                    let mut moved = angles.clone();
                    moved[*k] += 1e-3;
                    (residuals(&moved) - &now) / 1e-3
                })
                .collect();
            let jacobian = nalgebra::DMatrix::from_columns(&columns);
            let normal = jacobian.transpose() * &jacobian + nalgebra::DMatrix::identity(mine.len(), mine.len()) * 1e-6;
            let Some(step) = normal.cholesky().map(|factor| factor.solve(&(jacobian.transpose() * &now))) else {
                break;
            };
            for (k, step) in mine.iter().zip(step.iter()) {
                let [low, high] = rig.hinges[*k].range;
                angles[*k] = (angles[*k] - step.clamp(-0.2, 0.2)).clamp(low, high);
            }
        }
        let miss = residuals(&angles);
        (angles, miss)
    };
    let starts = [0.4, 0.8].into_iter().flat_map(|finger| [0.0, 0.4].map(|thumb| [finger, thumb]));
    let ends = starts.map(|bends| settle(start(bends)));
    let (angles, miss) = ends.min_by(|(_, a), (_, b)| a.norm().total_cmp(&b.norm()))?;
    (miss.rows(0, 3).norm() < 0.003).then_some(angles)
}
