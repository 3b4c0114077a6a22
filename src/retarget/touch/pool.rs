//! A hand's 778 vertices, pooled to its bones and palm.

use glam::DVec3;

use super::{DORSAL, PALM, SLOTS, Slot, Touch};
use crate::error::{Error, Result};
use crate::hand::{HandModel, HandParams, N_VERTICES, Region, Side, vertex_normals};
use crate::retarget::goal::bone_axes;
use crate::retarget::human::{Hand, keypoint};
use crate::tactile::CONTACT_FORCE_N;

/// What is known of each vertex: its slot, its inward normal and its place in the frame of its bone.
#[derive(Debug, Clone)]
pub struct Pool {
    slots: Vec<usize>,
    /// Direction in which the world presses there, in the bone's axes (normal, lateral, along).
    inward: Vec<DVec3>,
    /// Place along the bone, from its base to its end, 0 to 1.
    along: Vec<f64>,
}

impl Pool {
    /// For a hand model; what its vertices lie on does not change with the pose, as long as skin does not slide on bone.
    ///
    /// # Errors
    /// If the model at rest is no hand.
    pub fn new(model: &HandModel) -> Result<Self> {
        let posed = model.forward(&HandParams::default());
        let keypoints = model.keypoints(&posed).map(|point| point.as_dvec3());
        let hand = Hand::new(&keypoints, model.side)?;
        let to_wrist = hand.axes.transpose();
        let normals = vertex_normals(&posed.vertices, &model.faces);
        let slots: Vec<usize> = model.regions().into_iter().map(slot_of).collect();
        let mut inward = Vec::with_capacity(N_VERTICES);
        let mut along = Vec::with_capacity(N_VERTICES);
        for (vertex, slot) in slots.iter().copied().enumerate() {
            let normal = -(to_wrist * normals[vertex].as_dvec3());
            let place = to_wrist * (posed.vertices[vertex].as_dvec3() - hand.wrist);
            match slot < PALM {
                true => {
                    let (finger, bone) = (slot / 3, slot % 3);
                    inward.push(bone_axes(&hand.points, finger, bone).transpose() * normal);
                    let [from, to] = [0, 1].map(|end| hand.points[keypoint(finger, bone + end)]);
                    let line = to - from;
                    along.push(((place - from).dot(line) / line.length_squared()).clamp(0.0, 1.0));
                }
                false => {
                    inward.push(normal);
                    along.push(0.5);
                }
            }
        }
        Ok(Self { slots, inward, along })
    }

    /// Adds a field to a touch: `force` (778) N and `contact` (778) probability, or empty; unknown values (NaN) are left
    /// out.
    ///
    /// # Errors
    /// If a length is another, or a force is negative or infinite.
    pub fn add(&self, force: &[f32], contact: &[f32], touch: &mut Touch) -> Result<()> {
        for (name, values) in [("force", force), ("contact", contact)] {
            if !values.is_empty() && values.len() != N_VERTICES {
                return Err(Error::shape(name, format!("[{N_VERTICES}]"), [values.len()]));
            }
        }
        if let Some(bad) = force.iter().position(|f| f.is_infinite() || *f < 0.0) {
            return Err(Error::value(format!("force[{bad}]"), "a finite number >= 0, or NaN", force[bad]));
        }
        let mut slots = [Slot::default(); SLOTS];
        let mut weights = [0.0; SLOTS];
        for (vertex, value) in force.iter().enumerate().filter(|(_, value)| **value > 0.0) {
            let slot = self.slots[vertex];
            let value = f64::from(*value);
            slots[slot].force += value * self.inward[vertex];
            slots[slot].pressed += value;
            slots[slot].along += value * self.along[vertex];
            weights[slot] += value;
            if value > f64::from(CONTACT_FORCE_N) {
                slots[slot].contact = 1.0;
            }
        }
        for (vertex, value) in contact.iter().enumerate().filter(|(_, value)| value.is_finite()) {
            let slot = &mut slots[self.slots[vertex]];
            slot.contact = slot.contact.max(f64::from(*value).clamp(0.0, 1.0));
        }
        for (slot, weight) in slots.iter_mut().zip(weights) {
            slot.along = if weight > 0.0 { slot.along / weight } else { 0.5 };
        }
        for finger in 0..5 {
            if touch.tip_contact[finger].is_nan() {
                touch.tip_contact[finger] = slots[3 * finger + 2].contact;
            }
        }
        touch.slots = Some(Box::new(slots));
        Ok(())
    }
}

/// The slot of a region: finger * 3 + bone, then palm and back.
fn slot_of(region: Region) -> usize {
    match region {
        Region::Palm => PALM,
        Region::Dorsal => DORSAL,
        _ => {
            // Regions go from tip to base, bones from base to tip.
            let index = region.index();
            3 * (index / 3) + 2 - index % 3
        }
    }
}

/// The pool of the built-in hand.
///
/// # Errors
/// Never: the built-in hand is one.
pub fn builtin(side: Side) -> Result<Pool> {
    Pool::new(&HandModel::builtin(side))
}
