//! A human hand carried over to a robot hand.

use std::path::PathBuf;

use egotac::crates::glam::DVec3;
use egotac::hand::{N_KEYPOINTS, N_VERTICES, Side};
use egotac::retarget::{Input, Options, Output, Robot, Touch, TouchPooling};
use numpy::{PyArrayDyn, PyReadonlyArrayDyn};
use pyo3::prelude::*;

use crate::arrays::{give, take};
use crate::error::raise;
use crate::hand::side;

/// Follows one human hand with one robot hand; used by the thread that made it. Needs MuJoCo: `pip install egotac[sim]`.
///
/// `robot`: a name of `egotac retarget list`, a YAML file, or an MJCF or URDF model. `model`: model in place of the YAML file's. `side`
/// of the human hand; by default the robot's.
#[pyclass(unsendable, module = "egotac")]
pub struct Retargeter {
    retargeter: egotac::Retargeter,
    side: Side,
    pooling: TouchPooling,
}

#[pymethods]
impl Retargeter {
    #[new]
    #[pyo3(signature = (robot="four_finger", *, model=None, side=None))]
    fn new(robot: &str, model: Option<PathBuf>, side: Option<&str>) -> PyResult<Self> {
        let side = side.map(self::side).transpose()?;
        let load = || {
            let robot = Robot::load(robot, model.as_deref())?;
            let side = side.unwrap_or(robot.side());
            let options = Options { side: Some(side), ..Options::default() };
            let retargeter = egotac::Retargeter::with_options(robot, options)?;
            Ok(Self { retargeter, side, pooling: TouchPooling::builtin(side)? })
        };
        load().map_err(raise)
    }

    /// Follows a frame, and returns a `RobotPose`. `keypoints`: (21, 3) float64, m, in any right-handed frame: wrist, then thumb, index,
    /// middle, ring, little, each from base to tip. `time`: s. `force` (778,) N and `contact` (778,) on the built-in hand of the human: the forces are carried over.
    #[pyo3(signature = (keypoints, time, *, force=None, contact=None))]
    fn push(
        &mut self,
        py: Python<'_>,
        keypoints: PyReadonlyArrayDyn<'_, f64>,
        time: f64,
        force: Option<PyReadonlyArrayDyn<'_, f32>>,
        contact: Option<PyReadonlyArrayDyn<'_, f32>>,
    ) -> PyResult<RobotPose> {
        let points = take("keypoints", &keypoints, &[N_KEYPOINTS, 3])?;
        let mut input =
            Input::new(std::array::from_fn(|index| DVec3::from_slice(&points[3 * index..3 * index + 3])), time);
        if force.is_some() || contact.is_some() {
            let of = |name, array: &Option<PyReadonlyArrayDyn<'_, f32>>| -> PyResult<Vec<f32>> {
                Ok(match array {
                    Some(array) => take(name, array, &[N_VERTICES])?.into_owned(),
                    None => vec![f32::NAN; N_VERTICES],
                })
            };
            let (force, contact) = (of("force", &force)?, of("contact", &contact)?);
            let mut touch = Touch::default();
            self.pooling.pool_into(&force, &contact, &mut touch).map_err(raise)?;
            input.touch = Some(touch);
        }
        let output = self.retargeter.push(&input).map_err(raise)?.clone();
        RobotPose::new(py, output)
    }

    /// Forgets all past frames, but keeps the pose.
    fn reset(&mut self) {
        self.retargeter.reset();
    }

    /// Names of hinges and slides, in the order of `qpos`.
    #[getter]
    fn joint_names(&self) -> Vec<String> {
        self.retargeter.robot().joint_names().into_iter().map(String::from).collect()
    }

    /// Names of the drivers, in the order of `ctrl`.
    #[getter]
    fn command_names(&self) -> Vec<String> {
        self.retargeter.robot().commands.names.clone()
    }

    /// Side of the human hand.
    #[getter]
    fn side(&self) -> &'static str {
        self.side.name()
    }
}

/// Pose, commands and expected touch of a robot hand: `qpos` of hinges and slides, rad or m; `ctrl` for the drivers; `status` in words;
/// `objective`, cost of the pose, m^2; `solve_time`, s; `link_names` and `link_force`, normal force that each link should measure, N.
#[pyclass(frozen, get_all, module = "egotac")]
pub struct RobotPose {
    qpos: Py<PyArrayDyn<f64>>,
    ctrl: Py<PyArrayDyn<f64>>,
    status: &'static str,
    objective: f64,
    solve_time: f64,
    link_names: Vec<String>,
    link_force: Py<PyArrayDyn<f64>>,
}

impl RobotPose {
    fn new(py: Python<'_>, output: Output) -> PyResult<Self> {
        let (joints, commands, links) = (output.qpos.len(), output.ctrl.len(), output.expected_touch.links);
        Ok(Self {
            qpos: give(py, "qpos", output.qpos, [joints])?,
            ctrl: give(py, "ctrl", output.ctrl, [commands])?,
            status: output.status.reason(),
            objective: output.objective,
            solve_time: output.solve_secs,
            link_force: give(py, "link_force", links.iter().map(|link| link.normal_force).collect(), [links.len()])?,
            link_names: links.into_iter().map(|link| link.name).collect(),
        })
    }
}
