//! Labels from geometry: contact by the distance of hands from objects.

use std::sync::Arc;
use std::time::{Duration, Instant};

use super::forces::{HandForces, VertexForces};
use super::hands::{HandModels, PosedRecord};
use super::known::Known;
use super::recording::{Moment, Reader, RecordedObject, Recording};
use super::shapes::{FAR, Gaps, MeshFile, Shape, ShapeCache};
use crate::dataset::{ImageSource, LabelFrame};
use crate::error::{Error, Result};
use crate::geometry::PROXIMITY;
use crate::hand::{Fit, Side, Topology};
use crate::label::{InferenceTiming, Journal, Labeller};
use crate::tactile::{CONTACT_FORCE_N, Certainty, N_FIELD, TactileField};

/// Number of labels in a journal block.
const BLOCK: usize = 64;
/// Longest time between two journal writes: the work that a killed process loses.
const AT_LATEST: Duration = Duration::from_secs(2);

/// Rule by which a vertex counts as touched.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum ContactRule {
    /// A point of an object's resampled surface is within 1 cm, the paper's rule.
    Proximity,
    /// The signed distance from an object's surface is at most this, m.
    SignedDistance(f32),
}

/// Meaning of contact where a calibrated sensor measures force.
pub const FORCE_RULE: &str = "force above 0.05 N";

impl ContactRule {
    /// Describes the rule for the store's attributes.
    pub fn text(self) -> String {
        match self {
            Self::Proximity => format!("a point of an object's surface within {PROXIMITY} m"),
            Self::SignedDistance(most) => format!("signed distance from an object's surface at most {most} m"),
        }
    }
}

/// Maker of labels for one recording.
pub struct GeometryLabeller<'a> {
    /// The recording.
    pub reader: &'a dyn Reader,
    /// Hand models.
    pub hands: &'a HandModels,
    /// Shapes of objects.
    pub shapes: &'a ShapeCache,
    /// Rule of contact.
    pub rule: ContactRule,
}

/// Shapes of a recording's objects; `None` = unknown.
pub struct ObjectShapes(Vec<Option<Arc<Shape>>>);

impl ObjectShapes {
    /// Reads the shapes of a recording's objects. A shape that can't be read is unknown; [`faults`] tells why.
    ///
    /// # Errors
    /// If the medium of a mesh fails.
    pub fn read(recording: &Recording, shapes: &ShapeCache) -> Result<Self> {
        let shape = |file: Option<&MeshFile>| match file.map(|file| shapes.get(file)).transpose() {
            Err(error) if error.is_of_medium() => Err(error),
            shape => Ok(shape.unwrap_or_default()),
        };
        recording.objects.iter().map(|object| shape(object.mesh.as_ref())).collect::<Result<_>>().map(Self)
    }
}

/// Lists the objects of a recording without a usable shape, and the reasons.
pub fn faults(recording: &Recording, shapes: &ShapeCache) -> Vec<String> {
    let fault = |object: &RecordedObject| match &object.mesh {
        None => Some(format!("object {}: its mesh was not found", object.name)),
        Some(file) => shapes.get(file).err().map(|error| format!("object {}: {error}", object.name)),
    };
    recording.objects.iter().filter_map(fault).collect()
}

/// Poses both hands of a moment; `fits` are those of the previous one.
///
/// # Errors
/// If a hand can't be posed.
pub fn posed(
    moment: &Moment,
    recording: &Recording,
    hands: &HandModels,
    fits: &mut [Option<Fit>; 2],
) -> Result<[Option<PosedRecord>; 2]> {
    let mut posed = [None, None];
    for side in Side::BOTH {
        let fit = &mut fits[side as usize];
        match &moment.hands[side as usize] {
            Some(hand) => posed[side as usize] = Some(hands.pose(side, hand, recording.convention, fit)?),
            None => *fit = None,
        }
    }
    Ok(posed)
}

/// Labels one moment: force and contact, and the signed distances from the objects, (1556) m. Contact follows from the force
/// where it was measured, else from the distances. NaN where a hand is unknown; where
/// an object's shape or pose is unknown, vertices that touch no other object are NaN as well, because they may touch that one.
pub fn labelled(
    moment: &Moment,
    hands: &[Option<PosedRecord>; 2],
    forces: &[Option<VertexForces>; 2],
    shapes: &ObjectShapes,
    rule: ContactRule,
    topology: Topology,
) -> (TactileField, Vec<f32>) {
    let mut field = TactileField { topology, force: vec![f32::NAN; N_FIELD], contact: vec![f32::NAN; N_FIELD] };
    let mut distances = vec![f32::NAN; N_FIELD];
    for side in Side::BOTH {
        let Some(hand) = &hands[side as usize] else { continue };
        let mut gaps = Gaps::new(hand.vertices.len());
        let mut all_known = !shapes.0.is_empty();
        for (shape, pose) in shapes.0.iter().zip(&moment.objects) {
            match (shape, pose) {
                (Some(shape), Some(pose)) => gaps.add(&hand.vertices, shape, *pose),
                _ => all_known = false,
            }
        }
        for (index, vertex) in side.range().enumerate() {
            let touches = match rule {
                ContactRule::Proximity => gaps.points[index] <= PROXIMITY,
                ContactRule::SignedDistance(most) => gaps.surface[index] <= most,
            };
            if touches || all_known {
                field.contact[vertex] = f32::from(touches);
            }
            if all_known {
                distances[vertex] = gaps.surface[index].min(FAR);
            }
        }
        if let Some(VertexForces { newtons, .. }) = &forces[side as usize] {
            for (vertex, newtons) in side.range().zip(newtons) {
                let touches = f32::from(*newtons > CONTACT_FORCE_N);
                (field.force[vertex], field.contact[vertex]) =
                    (*newtons, if newtons.is_nan() { f32::NAN } else { touches });
            }
        }
    }
    (field, distances)
}

/// Distributes the measured forces of a moment over both hands; `None` where there are none.
fn forces_of(
    moment: &Moment,
    hands: &[Option<PosedRecord>; 2],
    sensed: &[HandForces],
) -> Result<[Option<VertexForces>; 2]> {
    let mut found = [None, None];
    for (index, forces) in sensed.iter().enumerate() {
        if let (Some(hand), Some(measured)) = (&hands[index], &moment.forces[index]) {
            found[index] = Some(forces.spread(&hand.vertices, measured)?);
        }
    }
    Ok(found)
}

/// Returns the lost force of both hands, N, if the recording measures force; NaN = not measured.
fn lost(recording: &Recording, forces: &[Option<VertexForces>; 2]) -> Vec<f32> {
    match recording.measures_force {
        true => forces.iter().map(|forces| forces.as_ref().map_or(f32::NAN, |forces| forces.lost)).collect(),
        false => Vec::new(),
    }
}

impl Labeller for GeometryLabeller<'_> {
    fn label_unit(
        &mut self,
        _: &dyn ImageSource,
        _: usize,
        journal: &mut Journal,
        progress: &mut dyn FnMut(),
    ) -> Result<InferenceTiming> {
        let mut timing = InferenceTiming::default();
        if journal.progress().complete {
            return Ok(timing);
        }
        let recording = self.reader.recording();
        let shapes = ObjectShapes::read(recording, self.shapes)?;
        let hands = self.hands.of(recording)?;
        let hands = hands.as_ref();
        let topology = hands.topology();
        let sensed = match recording.measures_force {
            true => Side::BOTH.iter().map(|side| HandForces::new(hands.model(*side, recording.convention))).collect(),
            false => Ok(Vec::new()),
        }?;
        let first = journal.progress().frames;
        let (mut fits, mut written) = ([None, None], Instant::now());
        // A fit depends on those before it in its block: replay the block that an earlier run began.
        for index in first - first % BLOCK..recording.frames {
            if index % BLOCK == 0 {
                fits = [None, None];
            }
            let started = Instant::now();
            let label = self.reader.moment(index).and_then(|moment| {
                let posed = posed(&moment, recording, hands, &mut fits)?;
                if index < first {
                    return Ok(LabelFrame::without(moment.stamp_secs, String::new()));
                }
                let forces = forces_of(&moment, &posed, &sensed)?;
                let (mut field, distances) = labelled(&moment, &posed, &forces, &shapes, self.rule, topology);
                let models = Side::BOTH.map(|side| hands.model(side, recording.convention));
                if let Some(touch) = self.reader.touch(index, models)? {
                    field = touch;
                }
                let mut known = Known::new(&moment, &posed, hands, recording, distances);
                known.lost = lost(recording, &forces);
                if let Some(glove) = &recording.glove {
                    let readings = &moment.readings;
                    [known.relative, field.contact] =
                        glove.relative(&recording.sensors, readings, models, &recording.path)?;
                }
                let further = known.into_values();
                Ok(LabelFrame {
                    stamp_secs: moment.stamp_secs,
                    warming_up: false,
                    touch: Ok(field),
                    further,
                    certainty: Certainty::default(),
                })
            });
            if index < first {
                continue;
            }
            timing.network_secs += started.elapsed().as_secs_f64();
            let label = match label {
                Ok(label) => label,
                Err(cause) if cause.is_of_medium() => {
                    journal.flush(Vec::new(), false)?;
                    let (unit, frames) = (recording.name.clone(), index);
                    return Err(Error::Stopped { unit, frames, cause: Box::new(cause) });
                }
                Err(error) => LabelFrame::without(f64::NAN, error.to_string()),
            };
            journal.push(&label, None);
            if journal.pending() >= BLOCK || written.elapsed() > AT_LATEST {
                journal.flush(Vec::new(), false)?;
                written = Instant::now();
            }
            progress();
        }
        journal.flush(Vec::new(), true)?;
        self.reader.release();
        Ok(timing)
    }
}
