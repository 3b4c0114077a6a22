//! Files of `egotac retarget run`: hands in, robots out, both safetensors.
//!
//! | tensor in | shape | |
//! |---|---|---|
//! | `keypoints` | (T, 21, 3) m | wrist, then thumb, index, middle, ring, little, each from base to tip |
//! | or `hand_pose`, `global_orient`, `transl`, `betas` | (T, 45), (T, 3), (T, 3), (10) or (T, 10) | MANO parameters; all but `hand_pose` optional |
//! | `timestamps` | (T) s, optional | |
//! | `tip_contact` | (T, 5), optional | probability that each fingertip touches; NaN = unknown |
//! | `tip_force` | (T, 5, 3) N, optional | force of the world on each fingertip, in the frame of the keypoints |
//! | `force`, `contact` | (T, 778) or (T, 1556), optional | touch on the vertices |
//! | `object_pose` | (T, 7), optional | where the object is: origin, m, and quaternion w, x, y, z, in the frame of the keypoints; NaN = not there |
//!
//! Forces of the fingertips on the world are taken as well: which of both a file has is told by whether they point into
//! the fingers, and what comes out is meant as what went in.

use std::collections::HashMap;
use std::path::Path;

use glam::{DQuat, DVec3, Vec3};
use safetensors::tensor::{Dtype, SafeTensors, TensorView};

use super::goal::pad_normal;
use super::human::Hand;
use super::{Input, ObjectPose, Output, Pool, Retargeter, Status, Touch};
use crate::dataset::tensors::numbers;
use crate::error::{Error, Result};
use crate::file;
use crate::hand::{HandModel, HandParams, N_BETAS, N_KEYPOINTS, N_VERTICES, Side, Topology};
use crate::tactile::N_FIELD;

/// Hands, frame by frame.
#[derive(Debug, Clone, Default)]
pub struct Hands {
    /// (T) keypoints, m.
    pub keypoints: Vec<[DVec3; N_KEYPOINTS]>,
    /// (T) s; empty = not given.
    pub timestamps: Vec<f64>,
    /// (T) probability that each fingertip touches; empty = not given.
    pub tip_contact: Vec<[f64; 5]>,
    /// (T) N; empty = not given.
    pub tip_force: Vec<[DVec3; 5]>,
    /// (T, 778 or 1556) N; empty = not given.
    pub force: Vec<f32>,
    /// (T, 778 or 1556); empty = not given.
    pub contact: Vec<f32>,
    /// (T) where the object is; empty = not given, None = not there.
    pub object_pose: Vec<Option<ObjectPose>>,
    /// What vertex indices mean, if the file says.
    pub topology: Option<Topology>,
    /// Which hand it is, if the file says.
    pub side: Option<Side>,
}

impl Hands {
    /// Reads a file; `model` poses MANO parameters.
    ///
    /// # Errors
    /// If it is no safetensors file, holds no hand, or a tensor has another shape or dtype than its name demands.
    pub fn read(path: &Path, model: impl Fn(Option<Topology>, Option<Side>) -> Result<HandModel>) -> Result<Self> {
        let bytes = std::fs::read(path).map_err(Error::io(path))?;
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
        let get = |name: &str| tensors.tensor(name).ok();
        let keypoints = match (get("keypoints"), get("hand_pose")) {
            (Some(tensor), _) => {
                let frames = tensor.shape().first().copied().unwrap_or(0);
                let values = numbers("keypoints", &tensor, &[frames, N_KEYPOINTS, 3])?;
                let points: Vec<DVec3> = values.as_chunks::<3>().0.iter().map(|p| DVec3::from_array(*p)).collect();
                points.as_chunks::<N_KEYPOINTS>().0.to_vec()
            }
            (None, Some(pose)) => posed(&tensors, &pose, &model(topology, side)?)?,
            (None, None) => {
                let present = tensors.names().join(", ");
                let name = "keypoints (T, 21, 3) or hand_pose (T, 45)".into();
                return Err(Error::Missing { name, place: "the input".into(), present });
            }
        };
        let frames = keypoints.len();
        let optional = |name: &str, shapes: &[Vec<usize>]| -> Result<Vec<f64>> {
            let Some(tensor) = get(name) else { return Ok(Vec::new()) };
            let shape = shapes.iter().find(|shape| *shape == tensor.shape()).unwrap_or(&shapes[0]);
            numbers(name, &tensor, shape)
        };
        let field = |name| -> Result<Vec<f32>> {
            let values = optional(name, &[vec![frames, N_VERTICES], vec![frames, N_FIELD]])?;
            Ok(values.into_iter().map(|x| x as f32).collect())
        };
        let poses = optional("object_pose", &[vec![frames, 7]])?;
        let pose = |v: &[f64; 7]| ObjectPose {
            place: DVec3::new(v[0], v[1], v[2]),
            orientation: DQuat::from_xyzw(v[4], v[5], v[6], v[3]),
        };
        let there = |v: &[f64; 7]| (!v.iter().all(|x| x.is_nan())).then(|| pose(v));
        let tip_force = optional("tip_force", &[vec![frames, 5, 3]])?;
        let tip_force: Vec<DVec3> = tip_force.as_chunks::<3>().0.iter().map(|f| DVec3::from_array(*f)).collect();
        Ok(Self {
            timestamps: optional("timestamps", &[vec![frames]])?,
            tip_contact: optional("tip_contact", &[vec![frames, 5]])?.as_chunks::<5>().0.to_vec(),
            tip_force: tip_force.as_chunks::<5>().0.to_vec(),
            object_pose: poses.as_chunks::<7>().0.iter().map(there).collect(),
            force: field("force")?,
            contact: field("contact")?,
            keypoints,
            topology,
            side,
        })
    }

    /// Frames.
    pub fn len(&self) -> usize {
        self.keypoints.len()
    }

    /// Whether there is no frame.
    pub fn is_empty(&self) -> bool {
        self.keypoints.is_empty()
    }

    /// Whether anything is known of touch.
    pub fn has_touch(&self) -> bool {
        !(self.tip_contact.is_empty() && self.tip_force.is_empty() && self.force.is_empty() && self.contact.is_empty())
    }

    /// Whether the fingertips' forces are those on the world, not of the world: they point out of the pads.
    pub fn forces_point_out(&self, side: Side) -> bool {
        let mut out = 0.0;
        for (keypoints, forces) in self.keypoints.iter().zip(&self.tip_force) {
            let Ok(hand) = Hand::new(keypoints, side) else { continue };
            for (finger, force) in forces.iter().enumerate().filter(|(_, force)| force.is_finite()) {
                out += (hand.axes.transpose() * *force).dot(pad_normal(&hand.points, finger)).clamp(-10.0, 10.0);
            }
        }
        out > 0.0
    }

    /// When a frame is, s; `dt` is the time between two where the file has no timestamps.
    pub fn time(&self, frame: usize, dt: f64) -> f64 {
        self.timestamps.get(frame).copied().unwrap_or(frame as f64 * dt)
    }

    /// A frame; `dt` is the time between two where the file has no timestamps, and `sign` is -1 where forces point out.
    ///
    /// # Errors
    /// If a force of the frame is negative or infinite; the error names it.
    pub fn input(&self, frame: usize, dt: f64, side: Side, pool: Option<&Pool>, sign: f64) -> Result<Input> {
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
                    *contact = f64::from(u8::from(force.length() > 0.05));
                }
            }
        }
        if let Some(pool) = pool {
            pool.add(self.of_side(&self.force, frame, side), self.of_side(&self.contact, frame, side), &mut touch)?;
        }
        input.touch = Some(touch);
        Ok(input)
    }

    /// One hand's values of a frame.
    fn of_side<'a>(&self, values: &'a [f32], frame: usize, side: Side) -> &'a [f32] {
        let width = values.len() / self.len().max(1);
        let all = &values[frame * width..(frame + 1) * width];
        if width == N_FIELD { &all[side.range()] } else { all }
    }
}

/// Keypoints of MANO parameters.
fn posed(tensors: &SafeTensors, pose: &TensorView, model: &HandModel) -> Result<Vec<[DVec3; N_KEYPOINTS]>> {
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

/// What came out, frame by frame.
#[derive(Debug, Clone, Default)]
pub struct Followed {
    /// Names of the columns of `qpos`.
    pub joint_names: Vec<String>,
    /// Names of the columns of `ctrl`.
    pub ctrl_names: Vec<String>,
    /// Names of the columns of `link_force` and `link_contact`.
    pub link_names: Vec<String>,
    /// Names of the columns of `torque`.
    pub torque_names: Vec<String>,
    frames: usize,
    qpos: Vec<f64>,
    ctrl: Vec<f64>,
    tip_force: Vec<f32>,
    objective: Vec<f64>,
    solve_time_us: Vec<f32>,
    status: Vec<u8>,
    link_force: Vec<f32>,
    link_normal_force: Vec<f32>,
    link_contact: Vec<f32>,
    torque: Vec<f32>,
    clipped: Vec<u8>,
}

impl Followed {
    /// Without frames yet, with the names of a robot's columns.
    pub fn by(retargeter: &Retargeter) -> Self {
        let robot = retargeter.robot();
        let masters = robot.coupling.masters.iter().map(|joint| robot.parts.joints[*joint].name.clone());
        Self {
            joint_names: robot.joint_names().into_iter().map(str::to_owned).collect(),
            ctrl_names: robot.commands.names.clone(),
            link_names: retargeter.output().feel.links.iter().map(|link| link.name.clone()).collect(),
            torque_names: masters.collect(),
            ..Self::default()
        }
    }

    /// Adds a frame; `sign` as for [`Hands::input`].
    pub fn push(&mut self, output: &Output, sign: f64) {
        self.frames += 1;
        self.qpos.extend(&output.qpos);
        self.ctrl.extend(&output.ctrl);
        self.tip_force.extend(output.feel.tip_force.iter().flat_map(|f| (sign * *f).to_array()).map(|x| x as f32));
        self.objective.push(output.objective);
        self.solve_time_us.push((1e6 * output.solve_secs) as f32);
        self.status.push(output.status as u8);
        for link in &output.feel.links {
            self.link_force.extend((sign * link.force).to_array().map(|x| x as f32));
            self.link_normal_force.push(link.normal_force as f32);
            self.link_contact.push(link.contact as f32);
        }
        self.torque.extend(output.feel.torque.iter().map(|t| *t as f32));
        self.clipped.push(u8::from(output.feel.clipped));
    }

    /// Frames with a status.
    pub fn count(&self, status: Status) -> usize {
        self.status.iter().filter(|s| **s == status as u8).count()
    }

    /// Times, microseconds.
    pub fn times_us(&self) -> &[f32] {
        &self.solve_time_us
    }

    /// Writes the file whole or not at all.
    ///
    /// # Errors
    /// If it can't be written.
    pub fn write(&self, path: &Path, mut metadata: HashMap<String, String>) -> Result<()> {
        let json = |names: &[String]| serde_json::to_string(names).map_err(|error| Error::file(path, error));
        metadata.insert("joint_names".into(), json(&self.joint_names)?);
        metadata.insert("ctrl_names".into(), json(&self.ctrl_names)?);
        metadata.insert("link_names".into(), json(&self.link_names)?);
        metadata.insert("torque_names".into(), json(&self.torque_names)?);
        let codes: Vec<String> = Status::ALL.iter().map(|s| format!("{} {}", *s as u8, s.reason())).collect();
        metadata.insert("status".into(), codes.join("; "));
        let t = self.frames;
        let links = self.link_names.len();
        let f64s = |values: &[f64]| values.iter().flat_map(|x| x.to_le_bytes()).collect::<Vec<u8>>();
        let f32s = |values: &[f32]| values.iter().flat_map(|x| x.to_le_bytes()).collect::<Vec<u8>>();
        let tensors = [
            ("qpos", Dtype::F64, vec![t, self.joint_names.len()], f64s(&self.qpos)),
            ("ctrl", Dtype::F64, vec![t, self.ctrl_names.len()], f64s(&self.ctrl)),
            ("tip_force", Dtype::F32, vec![t, 5, 3], f32s(&self.tip_force)),
            ("objective", Dtype::F64, vec![t], f64s(&self.objective)),
            ("solve_time_us", Dtype::F32, vec![t], f32s(&self.solve_time_us)),
            ("status", Dtype::U8, vec![t], self.status.clone()),
            ("link_force", Dtype::F32, vec![t, links, 3], f32s(&self.link_force)),
            ("link_normal_force", Dtype::F32, vec![t, links], f32s(&self.link_normal_force)),
            ("link_contact", Dtype::F32, vec![t, links], f32s(&self.link_contact)),
            ("torque", Dtype::F32, vec![t, self.torque_names.len()], f32s(&self.torque)),
            ("clipped", Dtype::U8, vec![t], self.clipped.clone()),
        ];
        let mut views = Vec::new();
        for (name, dtype, shape, data) in &tensors {
            let view = TensorView::new(*dtype, shape.clone(), data);
            views.push((*name, view.map_err(|e| Error::file(path, format!("{name}: {e}")))?));
        }
        let content = safetensors::serialize(views, Some(metadata)).map_err(|e| Error::file(path, e))?;
        file::write(path, &content)
    }
}
