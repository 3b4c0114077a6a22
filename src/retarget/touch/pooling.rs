//! Pooling of a field on the 778 vertices of a hand to its bones, palm and back.

use glam::DVec3;

use super::human::{DORSAL, N_SEGMENTS, PALM, SegmentTouch, Touch};
use crate::error::{Error, Result};
use crate::hand::{HandModel, HandParams, N_VERTICES, Region, Side, vertex_normals};
use crate::retarget::human::{Hand, bone_axes, keypoint};
use crate::tactile::CONTACT_FORCE_N;

/// Pools vertex fields of one hand model to segments.
#[derive(Debug, Clone)]
pub struct TouchPooling {
    /// (778) segment of each vertex.
    segments: Vec<usize>,
    /// (778) inward normal of each vertex in the axes of its segment: the direction in which the world presses there.
    inward: Vec<DVec3>,
    /// (778) position of each vertex along its bone, 0 (base) to 1 (end).
    along: Vec<f64>,
}

impl TouchPooling {
    /// Measures the vertices of a hand model at rest. Relative to its bone, a vertex stays where it is in every pose: skin
    /// that slides on bone is neglected.
    ///
    /// # Errors
    /// If the keypoints of the model at rest can't be a hand.
    pub fn new(model: &HandModel) -> Result<Self> {
        let posed = model.forward(&HandParams::default());
        let keypoints = model.keypoints(&posed).map(|point| point.as_dvec3());
        let hand = Hand::new(&keypoints, model.side)?;
        let to_wrist = hand.axes.transpose();
        let normals = vertex_normals(&posed.vertices, &model.faces);
        let segments: Vec<usize> = model.regions().into_iter().map(segment_of).collect();
        let mut inward = Vec::with_capacity(N_VERTICES);
        let mut along = Vec::with_capacity(N_VERTICES);
        for (vertex, segment) in segments.iter().copied().enumerate() {
            let normal = -(to_wrist * normals[vertex].as_dvec3());
            let position = to_wrist * (posed.vertices[vertex].as_dvec3() - hand.wrist);
            match segment < PALM {
                true => {
                    let (finger, bone) = (segment / 3, segment % 3);
                    inward.push(bone_axes(&hand.points, finger, bone).transpose() * normal);
                    let [from, to] = [0, 1].map(|end| hand.points[keypoint(finger, bone + end)]);
                    let line = to - from;
                    along.push(((position - from).dot(line) / line.length_squared()).clamp(0.0, 1.0));
                }
                false => {
                    inward.push(normal);
                    along.push(0.5);
                }
            }
        }
        Ok(Self { segments, inward, along })
    }

    /// Pools for the built-in hand.
    ///
    /// # Errors
    /// Never: the keypoints of the built-in hand are a hand.
    pub fn builtin(side: Side) -> Result<Self> {
        Self::new(&HandModel::builtin(side))
    }

    /// Pools a field into `touch.segments`, and into each `touch.tip_contact` that is unknown.
    ///
    /// `force`: (778) N, and `contact`: (778) probability; either may be empty. Unknown values (NaN) are ignored, and a hand of which
    /// nothing is known leaves `touch` as it is.
    ///
    /// # Errors
    /// If a field has another length, or a force is negative or infinite.
    pub fn pool_into(&self, force: &[f32], contact: &[f32], touch: &mut Touch) -> Result<()> {
        for (name, values) in [("force", force), ("contact", contact)] {
            if !values.is_empty() && values.len() != N_VERTICES {
                return Err(Error::shape(name, format!("[{N_VERTICES}]"), [values.len()]));
            }
        }
        if let Some(bad) = force.iter().position(|f| f.is_infinite() || *f < 0.0) {
            return Err(Error::value(format!("force[{bad}]"), "a finite number >= 0, or NaN", force[bad]));
        }
        let mut values = force.iter().chain(contact).peekable();
        if values.peek().is_some() && values.all(|value| value.is_nan()) {
            return Ok(());
        }
        let mut segments = [SegmentTouch::default(); N_SEGMENTS];
        for (vertex, value) in force.iter().enumerate().filter(|(_, value)| **value > 0.0) {
            let segment = &mut segments[self.segments[vertex]];
            let newtons = f64::from(*value);
            segment.force += newtons * self.inward[vertex];
            segment.pressed += newtons;
            segment.along += newtons * self.along[vertex];
            if *value > CONTACT_FORCE_N {
                segment.contact = 1.0;
            }
        }
        for (vertex, value) in contact.iter().enumerate().filter(|(_, value)| value.is_finite()) {
            let segment = &mut segments[self.segments[vertex]];
            segment.contact = segment.contact.max(f64::from(*value).clamp(0.0, 1.0));
        }
        for segment in &mut segments {
            segment.along = if segment.pressed > 0.0 { segment.along / segment.pressed } else { 0.5 };
        }
        for finger in 0..5 {
            if touch.tip_contact[finger].is_nan() {
                touch.tip_contact[finger] = segments[3 * finger + 2].contact;
            }
        }
        touch.segments = Some(Box::new(segments));
        Ok(())
    }
}

/// Segment of a region of the hand's surface.
fn segment_of(region: Region) -> usize {
    match region {
        Region::Palm => PALM,
        Region::Dorsal => DORSAL,
        _ => {
            // Regions count from tip to base, bones from base to tip.
            let index = region.index();
            3 * (index / 3) + 2 - index % 3
        }
    }
}
