//! Trajectory of a robot hand, the output of `egotac retarget run`.

use std::collections::BTreeMap;
use std::path::Path;

use safetensors::tensor::{Dtype, TensorView};

use crate::error::{Error, Result};
use crate::file;
use crate::retarget::output::{Output, Status};
use crate::retarget::retargeter::Retargeter;

/// Output of a retargeter, frame by frame.
#[derive(Debug, Clone, Default)]
pub struct RobotTrajectory {
    /// Names of the columns of `qpos`.
    joint_names: Vec<String>,
    /// Names of the columns of `ctrl`.
    ctrl_names: Vec<String>,
    /// Names of the columns of `link_force` and `link_contact`.
    link_names: Vec<String>,
    /// Names of the columns of `torque`.
    torque_names: Vec<String>,
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

impl RobotTrajectory {
    /// Creates a trajectory without frames.
    pub fn of(retargeter: &Retargeter) -> Self {
        let robot = retargeter.robot();
        let masters = robot.coupling.masters.iter().map(|joint| robot.parts.joints[*joint].name.clone());
        Self {
            joint_names: robot.joint_names().into_iter().map(str::to_owned).collect(),
            ctrl_names: robot.commands.names.clone(),
            link_names: retargeter.output().expected_touch.links.iter().map(|link| link.name.clone()).collect(),
            torque_names: masters.collect(),
            ..Self::default()
        }
    }

    /// Adds a frame; `sign`: -1 to write the forces on the world instead of those of the world.
    pub fn push(&mut self, output: &Output, sign: f64) {
        self.frames += 1;
        self.qpos.extend(&output.qpos);
        self.ctrl.extend(&output.ctrl);
        let touch = &output.expected_touch;
        self.tip_force.extend(touch.tip_force.iter().flat_map(|f| (sign * *f).to_array()).map(|x| x as f32));
        self.objective.push(output.objective);
        self.solve_time_us.push((1e6 * output.solve_secs) as f32);
        self.status.push(output.status as u8);
        for link in &touch.links {
            self.link_force.extend((sign * link.force).to_array().map(|x| x as f32));
            self.link_normal_force.push(link.normal_force as f32);
            self.link_contact.push(link.contact as f32);
        }
        self.torque.extend(touch.torque.iter().map(|t| *t as f32));
        self.clipped.push(u8::from(touch.clipped));
    }

    /// Counts the frames with a status.
    pub fn count(&self, status: Status) -> usize {
        self.status.iter().filter(|s| **s == status as u8).count()
    }

    /// Times to solve each frame, microseconds.
    pub fn times_us(&self) -> &[f32] {
        &self.solve_time_us
    }

    /// Writes the file atomically. Equal content gives equal bytes.
    ///
    /// # Errors
    /// If it can't be written.
    pub fn write(&self, path: &Path, mut metadata: BTreeMap<String, String>) -> Result<()> {
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
        file::write(path, &file::tensors::to_bytes(path, views, &metadata)?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn equal_trajectories_give_equal_bytes() {
        let folder = tempfile::tempdir().unwrap();
        let write = |name: &str| {
            let path = folder.path().join(name);
            RobotTrajectory::default().write(&path, BTreeMap::from([("robot".into(), "r".into())])).unwrap();
            std::fs::read(path).unwrap()
        };
        assert_eq!(write("a"), write("b"));
    }
}
