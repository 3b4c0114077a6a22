//! Simulated scenes whose touch is known.

use egotac::hand::{HandParams, N_FIELD};
use egotac::sim::{self, RolloutOptions, SHIPPED};
use numpy::PyArrayDyn;
use pyo3::prelude::*;

use crate::arrays::give;
use crate::error::raise;

/// Scene of hands and objects: a name of `Scene.names()`, or a YAML file. Needs MuJoCo: `pip install egotac[sim]`.
#[pyclass(frozen, module = "egotac")]
pub struct Scene {
    scene: sim::Scene,
}

#[pymethods]
impl Scene {
    #[new]
    fn new(name_or_path: &str) -> PyResult<Self> {
        Ok(Self { scene: sim::Scene::load(name_or_path).map_err(raise)? })
    }

    /// Names of the shipped scenes.
    #[staticmethod]
    fn names() -> Vec<&'static str> {
        SHIPPED.iter().map(|(name, _)| *name).collect()
    }

    /// Name of the scene.
    #[getter]
    fn name(&self) -> &str {
        &self.scene.name
    }

    /// Frames per second.
    #[getter]
    fn rate(&self) -> f64 {
        self.scene.spec.rate
    }
}

/// Running episode of a scene: an iterator over its `SimFrame`s, used by the thread that made it.
///
/// `seed` draws the episode. `size`: width and height of the images; None needs no OpenGL. The same scene, seed and size give the same
/// frames, bit for bit.
#[pyclass(unsendable, module = "egotac")]
pub struct Rollout {
    rollout: sim::Rollout,
}

#[pymethods]
impl Rollout {
    #[new]
    #[pyo3(signature = (scene, seed=0, *, size=Some((224, 224))))]
    fn new(scene: &Scene, seed: u64, size: Option<(u32, u32)>) -> PyResult<Self> {
        let options = RolloutOptions { picture: size, ..RolloutOptions::default() };
        Ok(Self { rollout: sim::Rollout::new(&scene.scene, seed, &options).map_err(raise)? })
    }

    fn __iter__(this: PyRef<'_, Self>) -> PyRef<'_, Self> {
        this
    }

    fn __next__(&mut self, py: Python<'_>) -> PyResult<Option<SimFrame>> {
        let frame = self.rollout.next_frame().map_err(raise)?;
        frame.map(|frame| SimFrame::new(py, frame)).transpose()
    }

    fn __len__(&self) -> usize {
        self.rollout.frame_count()
    }
}

/// One frame of a rollout: `stamp` s, `image` (H, W, 3) uint8, `force` (1556,) N, `contact` (1556,) 0 or 1, `validity`: the finding of
/// the guard that refused the frame, empty = valid; `left_hand_pose`, `right_hand_pose`: (61,) transl 3 m, global_orient 3, hand_pose 45,
/// betas 10; None = absent.
#[pyclass(frozen, get_all, module = "egotac")]
pub struct SimFrame {
    stamp: f64,
    image: Py<PyArrayDyn<u8>>,
    force: Py<PyArrayDyn<f32>>,
    contact: Py<PyArrayDyn<f32>>,
    validity: &'static str,
    left_hand_pose: Option<Py<PyArrayDyn<f32>>>,
    right_hand_pose: Option<Py<PyArrayDyn<f32>>>,
}

impl SimFrame {
    fn new(py: Python<'_>, sim::SimFrame { frame, .. }: sim::SimFrame) -> PyResult<Self> {
        let (width, height) = frame.camera_ego_rgb.dimensions();
        let pose = |params: Option<HandParams>| {
            params.map(|params| give(py, "hand_pose", params.to_array().to_vec(), [61])).transpose()
        };
        Ok(Self {
            stamp: frame.timestamp,
            image: give(py, "image", frame.camera_ego_rgb.into_raw(), [height as usize, width as usize, 3])?,
            force: give(py, "force", frame.field.force, [N_FIELD])?,
            contact: give(py, "contact", frame.field.contact, [N_FIELD])?,
            validity: frame.validity.reason(),
            left_hand_pose: pose(frame.left_hand_pose)?,
            right_hand_pose: pose(frame.right_hand_pose)?,
        })
    }
}
