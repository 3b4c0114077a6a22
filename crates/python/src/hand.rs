//! The hand: parameters to vertices, joints and keypoints; regions, colours, faces.

use std::path::PathBuf;

use egotac::crates::glam::Vec3;
use egotac::hand::{HandModel, HandParams, N_JOINTS, N_VERTICES, Region, Side};
use egotac::render::color;
use numpy::{PyArrayDyn, PyReadonlyArrayDyn};
use pyo3::prelude::*;

use crate::arrays::{give, points, take};
use crate::error::raise;

/// Names of the regions of a hand, by their index.
pub fn region_names() -> Vec<&'static str> {
    Region::ALL.map(Region::name).to_vec()
}

/// Parses `left` or `right`.
pub fn side(name: &str) -> PyResult<Side> {
    let found = Side::BOTH.into_iter().find(|side| side.name() == name);
    found.ok_or_else(|| raise(egotac::Error::unknown("side", name, Side::BOTH.map(Side::name))))
}

/// The built-in hand, or with `mano` a MANO file (the published pickle, read as data, or .npz) of this side.
///
/// Frame and parameters are MANO's: full axis-angle pose with flat mean. `fix_left_shapedirs` negates x of a left hand's
/// `shapedirs`, which the published file has wrong.
///
/// >>> hand = egotac.Hand("right")
/// >>> pose = numpy.zeros((15, 3), numpy.float32)
/// >>> pose[0] = 0, 0, 1.2  # bends the index finger at its base, rad
/// >>> posed = hand.forward(hand_pose=pose)
/// >>> posed.vertices.shape, posed.keypoints.shape
/// ((778, 3), (21, 3))
/// >>> sorted({egotac.REGIONS[region] for region in hand.regions})[:2]
/// ['dorsal', 'index_middle']
#[pyclass(frozen, module = "egotac")]
pub struct Hand {
    model: HandModel,
    regions: Vec<Region>,
}

#[pymethods]
impl Hand {
    #[new]
    #[pyo3(signature = (side="right", *, mano=None, fix_left_shapedirs=false))]
    fn new(side: &str, mano: Option<PathBuf>, fix_left_shapedirs: bool) -> PyResult<Self> {
        let side = self::side(side)?;
        let mut model = match mano {
            Some(path) => HandModel::load(&path, side).map_err(raise)?,
            None => HandModel::builtin(side),
        };
        if fix_left_shapedirs {
            model.fix_left_shapedirs();
        }
        Ok(Self { regions: model.regions(), model })
    }

    /// Poses the hand, and returns a `PosedHand`. All float32, zeros where absent: `hand_pose` (15, 3) rad, `global_orient` (3,) rad,
    /// `betas` (10,), `transl` (3,) m.
    #[pyo3(signature = (*, hand_pose=None, global_orient=None, betas=None, transl=None))]
    fn forward(
        &self,
        py: Python<'_>,
        hand_pose: Option<PyReadonlyArrayDyn<'_, f32>>,
        global_orient: Option<PyReadonlyArrayDyn<'_, f32>>,
        betas: Option<PyReadonlyArrayDyn<'_, f32>>,
        transl: Option<PyReadonlyArrayDyn<'_, f32>>,
    ) -> PyResult<PosedHand> {
        let mut params = HandParams::default();
        if let Some(array) = &hand_pose {
            let values = take("hand_pose", array, &[N_JOINTS - 1, 3])?;
            params
                .hand_pose
                .iter_mut()
                .zip(values.chunks_exact(3))
                .for_each(|(joint, value)| *joint = Vec3::from_slice(value));
        }
        if let Some(array) = &global_orient {
            params.global_orient = Vec3::from_slice(&take("global_orient", array, &[3])?);
        }
        if let Some(array) = &betas {
            let values = take("betas", array, &[params.betas.len()])?;
            params.betas.copy_from_slice(&values);
        }
        if let Some(array) = &transl {
            params.transl = Vec3::from_slice(&take("transl", array, &[3])?);
        }
        let (posed, keypoints) = py.detach(|| {
            let posed = self.model.forward(&params);
            let keypoints = self.model.keypoints(&posed);
            (posed, keypoints)
        });
        let rotations = posed.rotations.iter().flat_map(|rotation| rotation.transpose().to_cols_array()).collect();
        Ok(PosedHand {
            vertices: points(py, &posed.vertices)?,
            joints: points(py, &posed.joints)?,
            keypoints: points(py, &keypoints)?,
            rotations: give(py, "rotations", rotations, [N_JOINTS, 3, 3])?,
        })
    }

    /// Colours of the vertices for forces on this hand, (778, 3) uint8; grey where they are unknown. `force`: (778,) N. `max`: force of the last colour, N.
    #[pyo3(signature = (force, max=1.0))]
    fn colours(&self, py: Python<'_>, force: PyReadonlyArrayDyn<'_, f32>, max: f32) -> PyResult<Py<PyArrayDyn<u8>>> {
        let force = take("force", &force, &[N_VERTICES])?;
        colours(py, color::force_colors(&force, max).into_iter().map(|colour| colour.0))
    }

    /// Colours of the regions at the vertices, (778, 3) uint8.
    #[getter]
    fn region_colours(&self, py: Python<'_>) -> PyResult<Py<PyArrayDyn<u8>>> {
        colours(py, color::region_colors(&self.regions).into_iter().map(|colour| colour.0))
    }

    /// Region of each vertex, (778,) index in `REGIONS`.
    #[getter]
    fn regions(&self, py: Python<'_>) -> PyResult<Py<PyArrayDyn<u8>>> {
        give(py, "regions", self.regions.iter().map(|region| region.index() as u8).collect(), [N_VERTICES])
    }

    /// Triangles, (F, 3) vertex indices, counter-clockwise seen from outside.
    #[getter]
    fn faces(&self, py: Python<'_>) -> PyResult<Py<PyArrayDyn<u32>>> {
        give(py, "faces", self.model.faces.concat(), [self.model.faces.len(), 3])
    }

    /// Vertices at rest, (778, 3) m.
    #[getter]
    fn v_template(&self, py: Python<'_>) -> PyResult<Py<PyArrayDyn<f32>>> {
        points(py, &self.model.v_template)
    }

    /// "left" or "right".
    #[getter]
    fn side(&self) -> &'static str {
        self.model.side.name()
    }

    /// Meaning of vertex indices: "egotac-hand-1" or "mano".
    #[getter]
    fn topology(&self) -> &'static str {
        self.model.topology.id()
    }
}

/// Gives colours of vertices to Python, (778, 3).
fn colours(py: Python<'_>, colours: impl Iterator<Item = [u8; 3]>) -> PyResult<Py<PyArrayDyn<u8>>> {
    give(py, "colours", colours.flatten().collect(), [N_VERTICES, 3])
}

/// A posed hand: `vertices` (778, 3) m, `joints` (16, 3) m in MANO's order, `rotations` (16, 3, 3) from rest, `keypoints` (21, 3) m:
/// wrist, then thumb, index, middle, ring, little, each from base to tip.
#[pyclass(frozen, get_all, module = "egotac")]
pub struct PosedHand {
    vertices: Py<PyArrayDyn<f32>>,
    joints: Py<PyArrayDyn<f32>>,
    rotations: Py<PyArrayDyn<f32>>,
    keypoints: Py<PyArrayDyn<f32>>,
}
