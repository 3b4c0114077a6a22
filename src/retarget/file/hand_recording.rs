//! Recorded human hand, the input of `egotac retarget run`.
//!
//! | tensor | shape | |
//! |---|---|---|
//! | `keypoints` | (T, 21, 3) m | wrist, then thumb, index, middle, ring, little, each from base to tip |
//! | or `hand_pose`, `global_orient`, `transl`, `betas` | (T, 45), (T, 3), (T, 3), (10) or (T, 10) | MANO parameters; all but `hand_pose` optional |
//! | `timestamps` | (T) s, optional | |
//! | `tip_contact` | (T, 5), optional | contact probability of each fingertip; NaN = unknown |
//! | `tip_force` | (T, 5, 3) N, optional | force of the world on each fingertip, in the frame of the keypoints |
//! | `force`, `contact` | (T, 778) or (T, 1556), optional | touch on the vertices |
//! | `object_pose` | (T, 7), optional | pose of the object: origin, m, and quaternion w, x, y, z, in the frame of the keypoints; NaN = absent |
//!
//! `tip_force` may also hold the forces of the fingertips on the world. Their direction tells which a file has: into the
//! pads or out of them. The output then uses the same sign as the input.

use std::path::Path;

use glam::{DQuat, DVec3, Vec3};
use safetensors::tensor::{SafeTensors, TensorView};

use crate::dataset::tensors::numbers;
use crate::error::{Error, Result};
use crate::file::{input, limits};
use crate::hand::{HandModel, HandParams, N_BETAS, N_KEYPOINTS, N_VERTICES, Side, Topology};
use crate::retarget::human::{Hand, pad_normal};
use crate::retarget::input::Input;
use crate::retarget::object::ObjectPose;
use crate::retarget::touch::{Touch, TouchPooling};
use crate::tactile::{CONTACT_FORCE_N, N_FIELD};

/// Greatest force of a fingertip that votes on the sign of forces, N: one outlier must not decide for the whole file.
const MAX_SIGN_VOTE_N: f64 = 10.0;

/// Recorded human hand. Optional tensors that the file lacks are empty.
#[derive(Debug, Clone, Default)]
pub struct HandRecording {
    /// (T) frames of (21) keypoints, m.
    keypoints: Vec<[DVec3; N_KEYPOINTS]>,
    /// (T) s.
    timestamps: Vec<f64>,
    /// (T) contact probability of each fingertip.
    tip_contact: Vec<[f64; 5]>,
    /// (T) force on each fingertip, N.
    tip_force: Vec<[DVec3; 5]>,
    /// (T, 778 or 1556) N.
    pub force: Vec<f32>,
    /// (T, 778 or 1556) probability.
    pub contact: Vec<f32>,
    /// (T) pose of the object; None = absent.
    pub object_pose: Vec<Option<ObjectPose>>,
    /// Vertex numbering, if the file states it.
    pub topology: Option<Topology>,
    /// Side of the hand, if the file states it.
    pub side: Option<Side>,
}

impl HandRecording {
    /// Reads a file. `model` returns the hand model of a topology and side, for files with MANO parameters.
    ///
    /// # Errors
    /// If it is not a safetensors file, holds no hand, or a tensor has another shape or dtype than its name requires.
    pub fn read(path: &Path, model: impl Fn(Option<Topology>, Option<Side>) -> Result<HandModel>) -> Result<Self> {
        let bytes = input::read(path, limits::FILE)?;
        Self::parse(&bytes, model).map_err(|error| Error::file(path, error))
    }

    fn parse(bytes: &[u8], model: impl Fn(Option<Topology>, Option<Side>) -> Result<HandModel>) -> Result<Self> {
        let tensors =
            SafeTensors::deserialize(bytes).map_err(|error| Error::value("input", "a safetensors file", error))?;
        let (_, header) = SafeTensors::read_metadata(bytes).map_err(|e| Error::value("input", "a header", e))?;
        let metadata = header.metadata().clone().unwrap_or_default();
        let topology = metadata.get("topology").map(|id| Topology::from_id(id)).transpose()?;
        let side = match metadata.get("side").map(String::as_str) {
            None => None,
            Some("left") => Some(Side::Left),
            Some("right") => Some(Side::Right),
            Some(other) => return Err(Error::unknown("side", other, ["left", "right"])),
        };
        let keypoints = keypoints(&tensors, || model(topology, side))?;
        let frames = keypoints.len();
        let optional = |name: &str, shapes: &[Vec<usize>]| -> Result<Vec<f64>> {
            let Ok(tensor) = tensors.tensor(name) else { return Ok(Vec::new()) };
            let shape = shapes.iter().find(|shape| *shape == tensor.shape()).unwrap_or(&shapes[0]);
            numbers(name, &tensor, shape)
        };
        let field = |name| -> Result<Vec<f32>> {
            let values = optional(name, &[vec![frames, N_VERTICES], vec![frames, N_FIELD]])?;
            Ok(values.into_iter().map(|x| x as f32).collect())
        };
        let object_pose = optional("object_pose", &[vec![frames, 7]])?;
        let tip_force = optional("tip_force", &[vec![frames, 5, 3]])?;
        let tip_force: Vec<DVec3> = tip_force.as_chunks::<3>().0.iter().map(|f| DVec3::from_array(*f)).collect();
        Ok(Self {
            timestamps: optional("timestamps", &[vec![frames]])?,
            tip_contact: optional("tip_contact", &[vec![frames, 5]])?.as_chunks::<5>().0.to_vec(),
            tip_force: tip_force.as_chunks::<5>().0.to_vec(),
            object_pose: object_pose.as_chunks::<7>().0.iter().map(present_pose).collect(),
            force: field("force")?,
            contact: field("contact")?,
            keypoints,
            topology,
            side,
        })
    }

    /// Number of frames.
    pub fn len(&self) -> usize {
        self.keypoints.len()
    }

    /// True if the file holds any touch.
    fn has_touch(&self) -> bool {
        !(self.tip_contact.is_empty() && self.tip_force.is_empty() && self.force.is_empty() && self.contact.is_empty())
    }

    /// True if `tip_force` holds the forces of the fingertips on the world, which point out of the pads.
    pub fn forces_point_out(&self, side: Side) -> bool {
        let mut out = 0.0;
        for (keypoints, forces) in self.keypoints.iter().zip(&self.tip_force) {
            let Ok(hand) = Hand::new(keypoints, side) else { continue };
            for (finger, force) in forces.iter().enumerate().filter(|(_, force)| force.is_finite()) {
                out += (hand.axes.transpose() * *force)
                    .dot(pad_normal(&hand.points, finger))
                    .clamp(-MAX_SIGN_VOTE_N, MAX_SIGN_VOTE_N);
            }
        }
        out > 0.0
    }

    /// Returns the time of a frame, s; `dt`: time between frames if the file has no timestamps, s.
    pub fn time(&self, frame: usize, dt: f64) -> f64 {
        self.timestamps.get(frame).copied().unwrap_or(frame as f64 * dt)
    }

    /// Returns a frame. `dt`: time between frames if the file has no timestamps, s; `pooling`: for files with vertex fields;
    /// `sign`: -1 if forces point out.
    ///
    /// # Errors
    /// If a force of the frame is negative or infinite; the error names it.
    pub fn input(&self, frame: usize, dt: f64, side: Side, pooling: Option<&TouchPooling>, sign: f64) -> Result<Input> {
        let mut input = Input::new(self.keypoints[frame], self.time(frame, dt));
        input.object = self.object_pose.get(frame).copied().flatten();
        if !self.has_touch() {
            return Ok(input);
        }
        let mut touch = Touch::default();
        if let Some(contact) = self.tip_contact.get(frame) {
            touch.tip_contact = *contact;
        }
        if let Some(forces) = self.tip_force.get(frame) {
            touch.tip_force = Some(forces.map(|force| sign * force));
            for (contact, force) in touch.tip_contact.iter_mut().zip(forces) {
                if contact.is_nan() && self.tip_contact.is_empty() && force.is_finite() {
                    *contact = f64::from(u8::from(force.length() > f64::from(CONTACT_FORCE_N)));
                }
            }
        }
        if let Some(pooling) = pooling {
            let [force, contact] = [&self.force, &self.contact].map(|values| self.of_side(values, frame, side));
            pooling.pool_into(force, contact, &mut touch)?;
        }
        input.touch = Some(touch);
        Ok(input)
    }

    /// Returns one hand's values of a frame.
    fn of_side<'a>(&self, values: &'a [f32], frame: usize, side: Side) -> &'a [f32] {
        let width = values.len() / self.len().max(1);
        let all = &values[frame * width..(frame + 1) * width];
        if width == N_FIELD { &all[side.range()] } else { all }
    }
}

/// Returns the pose in a row of `object_pose`; None if it is all NaN.
fn present_pose(row: &[f64; 7]) -> Option<ObjectPose> {
    let [x, y, z, qw, qx, qy, qz] = *row;
    let pose = ObjectPose { position: DVec3::new(x, y, z), orientation: DQuat::from_xyzw(qx, qy, qz, qw) };
    (!row.iter().all(|x| x.is_nan())).then_some(pose)
}

/// Returns the keypoints of each frame: those of the file, or of its MANO parameters.
fn keypoints(tensors: &SafeTensors, model: impl FnOnce() -> Result<HandModel>) -> Result<Vec<[DVec3; N_KEYPOINTS]>> {
    if let Ok(tensor) = tensors.tensor("keypoints") {
        let frames = tensor.shape().first().copied().unwrap_or(0);
        let values = numbers("keypoints", &tensor, &[frames, N_KEYPOINTS, 3])?;
        let points: Vec<DVec3> = values.as_chunks::<3>().0.iter().map(|p| DVec3::from_array(*p)).collect();
        return Ok(points.as_chunks::<N_KEYPOINTS>().0.to_vec());
    }
    if let Ok(pose) = tensors.tensor("hand_pose") {
        return posed_keypoints(tensors, &pose, &model()?);
    }
    let present = tensors.names().join(", ");
    let name = "keypoints (T, 21, 3) or hand_pose (T, 45)".into();
    Err(Error::Missing { name, place: "the input".into(), present })
}

/// Returns the keypoints of each frame's MANO parameters.
fn posed_keypoints(tensors: &SafeTensors, pose: &TensorView, model: &HandModel) -> Result<Vec<[DVec3; N_KEYPOINTS]>> {
    let frames = pose.shape().first().copied().unwrap_or(0);
    let pose = numbers("hand_pose", pose, &[frames, 45])?;
    let rows = |name: &str, width: usize| -> Result<Vec<f64>> {
        let Ok(tensor) = tensors.tensor(name) else { return Ok(vec![0.0; frames * width]) };
        if tensor.shape() == [width] {
            let row = numbers(name, &tensor, &[width])?;
            return Ok(row.iter().copied().cycle().take(frames * width).collect());
        }
        numbers(name, &tensor, &[frames, width])
    };
    let (orient, transl, betas) = (rows("global_orient", 3)?, rows("transl", 3)?, rows("betas", N_BETAS)?);
    let vec3 = |values: &[f64]| Vec3::new(values[0] as f32, values[1] as f32, values[2] as f32);
    let frame = |frame: usize| {
        let params = HandParams {
            betas: std::array::from_fn(|k| betas[N_BETAS * frame + k] as f32),
            global_orient: vec3(&orient[3 * frame..]),
            hand_pose: std::array::from_fn(|joint| vec3(&pose[45 * frame + 3 * joint..])),
            transl: vec3(&transl[3 * frame..]),
        };
        Hand::of_model(model, &params)
    };
    Ok((0..frames).map(frame).collect())
}
