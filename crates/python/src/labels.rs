//! Touch over time: read from and written to recordings, and scored.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use egotac::dataset::zarr::{Contact, ZarrWriter};
use egotac::dataset::{Attributes, EpisodeWriter, Frame, Labelled, tensors};
use egotac::hand::{N_FIELD, Topology};
use egotac::metrics::{EvalOptions, evaluate};
use egotac::tactile::CONTACT_FORCE_N;
use egotac::{TactileField, TactileSequence, Validity};
use image::RgbImage;
use numpy::{PyArrayDyn, PyReadonlyArrayDyn, PyUntypedArrayMethods};
use pyo3::prelude::*;

use crate::arrays::{give, take};
use crate::error::{Error, raise};

/// Touch on both hands over T frames.
///
/// `force`: (T, 1556) float32, N; `contact`: (T, 1556) float32, by default force > 0.05 N; NaN = unknown. `timestamps`: (T,) float64,
/// s. `episode_ends`: exclusive ends of the episodes, by default one. Masks: (T, 1556) bool, True = known.
///
/// >>> labels = egotac.Labels(numpy.zeros((4, 1556), numpy.float32), timestamps=numpy.arange(4) * 0.04, episode_ends=[1, 4])
/// >>> labels, labels.episodes
/// (Labels(4 frames, 2 episodes), [(0, 1), (1, 4)])
#[pyclass(frozen, module = "egotac")]
pub struct Labels {
    sequence: TactileSequence,
    truth: Option<TactileSequence>,
}

#[pymethods]
impl Labels {
    #[new]
    #[pyo3(signature = (force, contact=None, *, timestamps=None, episode_ends=None, mask_force=None, mask_contact=None, topology="egotac-hand-1"))]
    #[allow(clippy::too_many_arguments, reason = "keywords of Python")]
    fn new(
        force: PyReadonlyArrayDyn<'_, f32>,
        contact: Option<PyReadonlyArrayDyn<'_, f32>>,
        timestamps: Option<PyReadonlyArrayDyn<'_, f64>>,
        episode_ends: Option<Vec<usize>>,
        mask_force: Option<PyReadonlyArrayDyn<'_, bool>>,
        mask_contact: Option<PyReadonlyArrayDyn<'_, bool>>,
        topology: &str,
    ) -> PyResult<Self> {
        let topology = Some(Topology::from_id(topology).map_err(raise)?);
        let frames = force.shape().first().copied().unwrap_or(0);
        let rows = [frames, N_FIELD];
        let force = take("force", &force, &[0, N_FIELD])?.into_owned();
        let mut sequence = match &contact {
            Some(contact) => {
                let contact = take("contact", contact, &rows)?.into_owned();
                TactileSequence { topology, force, contact, ..Default::default() }
            }
            None => TactileSequence::from_force(topology, force),
        };
        if let Some(stamps) = &timestamps {
            sequence.timestamps = take("timestamps", stamps, &[frames])?.into_owned();
        }
        sequence.episode_ends = episode_ends.unwrap_or_default();
        let masks = [(mask_force, "mask_force"), (mask_contact, "mask_contact")];
        for ((mask, name), to) in masks.iter().zip([&mut sequence.mask_force, &mut sequence.mask_contact]) {
            if let Some(mask) = mask {
                *to = take(name, mask, &rows)?.iter().map(|known| u8::from(*known)).collect();
            }
        }
        sequence.check().map_err(raise)?;
        Ok(Self { sequence, truth: None })
    }

    /// (T, 1556) normal force, N; NaN = unknown.
    #[getter]
    fn force(&self, py: Python<'_>) -> PyResult<Py<PyArrayDyn<f32>>> {
        give(py, "force", self.sequence.force.clone(), [self.sequence.n_frames(), N_FIELD])
    }

    /// (T, 1556) contact probability, or truth as 0 and 1; NaN = unknown.
    #[getter]
    fn contact(&self, py: Python<'_>) -> PyResult<Py<PyArrayDyn<f32>>> {
        give(py, "contact", self.sequence.contact.clone(), [self.sequence.n_frames(), N_FIELD])
    }

    /// (T, 1556) True where the force is known and counts.
    #[getter]
    fn mask_force(&self, py: Python<'_>) -> PyResult<Py<PyArrayDyn<bool>>> {
        known(py, &self.sequence.counted_force(), &self.sequence.force)
    }

    /// (T, 1556) True where the contact is known and counts.
    #[getter]
    fn mask_contact(&self, py: Python<'_>) -> PyResult<Py<PyArrayDyn<bool>>> {
        known(py, &self.sequence.counted_contact(), &self.sequence.contact)
    }

    /// (T,) s; the index where a source has none.
    #[getter]
    fn timestamps(&self, py: Python<'_>) -> PyResult<Py<PyArrayDyn<f64>>> {
        let stamps = (0..self.sequence.n_frames()).map(|frame| self.sequence.stamp_or_index(frame)).collect();
        give(py, "timestamps", stamps, [self.sequence.n_frames()])
    }

    /// First frame, and frame behind the last, of each episode.
    #[getter]
    fn episodes(&self) -> Vec<(usize, usize)> {
        self.sequence.episodes().into_iter().map(|frames| (frames.start, frames.end)).collect()
    }

    /// Meaning of vertex indices; None = the source does not say.
    #[getter]
    fn topology(&self) -> Option<&'static str> {
        self.sequence.topology.map(Topology::id)
    }

    /// Truth beside labels; None = there is none.
    #[getter]
    fn truth(&self) -> Option<Self> {
        self.truth.clone().map(|sequence| Self { sequence, truth: None })
    }

    fn __len__(&self) -> usize {
        self.sequence.n_frames()
    }

    fn __repr__(&self) -> String {
        format!("Labels({} frames, {} episodes)", self.sequence.n_frames(), self.sequence.episodes().len())
    }
}

/// Mask of values, (T, 1556): true where they count and are known. `mask` is empty if all count.
fn known(py: Python<'_>, mask: &[u8], values: &[f32]) -> PyResult<Py<PyArrayDyn<bool>>> {
    let of = |(entry, value): (usize, &f32)| !value.is_nan() && mask.get(entry).is_none_or(|mask| *mask != 0);
    give(py, "mask", values.iter().enumerate().map(of).collect(), [values.len() / N_FIELD, N_FIELD])
}

/// Reads the labels of a Zarr store, a bag, a LeRobot data set or a tensor file, and returns `Labels`.
#[pyfunction]
pub fn read(py: Python<'_>, path: PathBuf) -> PyResult<Labels> {
    let Labelled { labels, truth, .. } = py.detach(|| Labelled::read(&path)).map_err(raise)?;
    Ok(Labels { sequence: labels, truth })
}

/// Writes labels: to PATH.safetensors, or with `images`, (T, H, W, 3) uint8, to the store PATH.zarr.
///
/// >>> import pathlib, tempfile
/// >>> path = pathlib.Path(tempfile.mkdtemp()) / "fields.safetensors"
/// >>> egotac.write(path, egotac.Labels(numpy.ones((2, 1556), numpy.float32)))
/// >>> float(egotac.read(path).force.sum())
/// 3112.0
#[pyfunction]
#[pyo3(signature = (path, labels, images=None))]
pub fn write(
    py: Python<'_>,
    path: PathBuf,
    labels: &Labels,
    images: Option<PyReadonlyArrayDyn<'_, u8>>,
) -> PyResult<()> {
    let sequence = &labels.sequence;
    match (&images, path.extension().and_then(|extension| extension.to_str())) {
        (None, Some("safetensors")) => py.detach(|| tensors::write(&path, sequence, BTreeMap::new())).map_err(raise),
        (Some(images), Some("zarr")) => {
            let pixels = take("images", images, &[sequence.n_frames(), 0, 0, 3])?;
            let size = (images.shape()[2] as u32, images.shape()[1] as u32);
            py.detach(|| write_store(&path, sequence, &pixels, size)).map_err(raise)
        }
        (None, Some("zarr")) => Err(Error::new_err(format!("{}: a store needs images, (T, H, W, 3)", path.display()))),
        _ => {
            let expected = "the extension .safetensors without images, or .zarr with images";
            Err(raise(egotac::Error::value("path", expected, path.display())))
        }
    }
}

/// Writes a store of predictions. `pixels`: (T, H, W, 3) of width and height `size`.
fn write_store(path: &Path, sequence: &TactileSequence, pixels: &[u8], size: (u32, u32)) -> egotac::Result<()> {
    let topology = sequence.topology.unwrap_or_default();
    let attributes = Attributes {
        topology,
        sigma: 0.0,
        contact_force: f64::from(CONTACT_FORCE_N),
        producer: "egotac".into(),
        version: egotac::VERSION.into(),
        scene: String::new(),
        seed: 0,
    };
    let mut writer = ZarrWriter::create(path, attributes, Contact::Score, Vec::new())?;
    let (force_known, contact_known) = (sequence.counted_force(), sequence.counted_contact());
    let bytes = 3 * size.0 as usize * size.1 as usize;
    let mut images = pixels.chunks_exact(bytes.max(1));
    for episode in sequence.episodes() {
        for frame in episode {
            let rows = frame * N_FIELD..(frame + 1) * N_FIELD;
            let valid = |mask: &[u8], values: &[f32]| -> Vec<u8> {
                let of = |(entry, value): (usize, &f32)| {
                    u8::from(!value.is_nan() && mask.get(rows.start + entry).is_none_or(|mask| *mask != 0))
                };
                values.iter().enumerate().map(of).collect()
            };
            let (force, contact) = (sequence.force_at(frame), sequence.contact_at(frame));
            let image = images.next().and_then(|pixels| RgbImage::from_raw(size.0, size.1, pixels.to_vec()));
            writer.push(Frame {
                timestamp: sequence.stamp_or_index(frame),
                camera_ego_rgb: image.unwrap_or_default(),
                force_valid: valid(&force_known, force),
                contact_valid: valid(&contact_known, contact),
                field: TactileField { topology, force: force.to_vec(), contact: contact.to_vec() },
                validity: Validity::Valid,
                left_hand_pose: None,
                right_hand_pose: None,
            })?;
        }
        writer.end_episode()?;
    }
    writer.finish().map(drop)
}

/// Scores predictions against truth; returns the scores as JSON.
#[pyfunction]
#[pyo3(signature = (predicted, truth, fps=None))]
pub fn metrics(py: Python<'_>, predicted: &Labels, truth: &Labels, fps: Option<f64>) -> PyResult<String> {
    let options = EvalOptions { fps, ..EvalOptions::default() };
    let score = || evaluate(&predicted.sequence, &truth.sequence, &options);
    let scores = py.detach(score).map_err(raise)?;
    serde_json::to_string(&scores).map_err(|error| Error::new_err(error.to_string()))
}
