//! Touch from images, streaming and batched.

use std::path::PathBuf;
use std::sync::{LazyLock, Mutex, MutexGuard, PoisonError};
use std::time::Instant;

use egotac::dataset::lerobot::{LabelColumn, policy_input, policy_input_names as names_of_input};
use egotac::hand::{HandModel, N_FIELD, N_KEYPOINTS, N_VERTICES, Region, Side, Topology};
use egotac::image::Square;
use egotac::model::{HandEstimate, Keypoint, Prediction, predictor, shipped};
use egotac::{TactileField, tactile::Certainty};
use numpy::{PyArrayDyn, PyReadonlyArrayDyn, PyUntypedArrayMethods};
use pyo3::prelude::*;
use rayon::prelude::*;

use crate::arrays::{give, take};
use crate::error::raise;

/// Number of images that are prepared at a time.
const PREPARED: usize = 16;

/// Network on a stream of images: each is encoded once, and touch follows from the frames of a window.
///
/// `checkpoint`: file; by default the one that comes with the package. `precision`: "f32", "bf16" or "int8". `unknown`: form of
/// touch that the network does not know, "nan" (mask False), "zero" (mask False) or "guess" (its output as it is, mask True).
/// `familiarity_threshold`, `presence_threshold`: 0 to 1; by default the checkpoint's. `max_gap`: longest interval of a stream, s.
/// `reuse_below`: mean change of a patch, grey levels of 8 bits, up to which an image takes the tokens of the last encoded one; 0 = encode
/// every image. `locator`: network of whole pictures that finds the hands, for a network that sees single hands; by default the one that
/// comes with the package.
/// Methods release the GIL; calls from several threads wait for each other.
///
/// >>> predictor = egotac.Predictor(unknown="guess")
/// >>> [predictor.push(image, 0.04 * index).warming_up for index, image in enumerate(numpy.zeros((3, 48, 64, 3), "u1"))]
/// [True, True, True]
#[pyclass(frozen, module = "egotac")]
pub struct Predictor {
    predictor: Mutex<egotac::Predictor>,
}

impl Predictor {
    fn lock(&self) -> MutexGuard<'_, egotac::Predictor> {
        self.predictor.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[pymethods]
impl Predictor {
    #[new]
    #[allow(clippy::too_many_arguments, reason = "keywords of Python")]
    #[pyo3(signature = (checkpoint=None, *, precision="f32", unknown="nan", familiarity_threshold=None, presence_threshold=None, max_gap=None, reuse_below=0.0, locator=None))]
    fn new(
        py: Python<'_>,
        checkpoint: Option<PathBuf>,
        precision: &str,
        unknown: &str,
        familiarity_threshold: Option<f32>,
        presence_threshold: Option<f32>,
        max_gap: Option<f64>,
        reuse_below: f32,
        locator: Option<PathBuf>,
    ) -> PyResult<Self> {
        let load = || {
            let options = predictor::Options {
                precision: precision.parse()?,
                unknown: unknown.parse()?,
                familiarity_threshold,
                presence_threshold,
                max_gap_secs: max_gap,
                reuse_below,
                locator,
                ..Default::default()
            };
            egotac::Predictor::load(&checkpoint.map_or_else(shipped::path, Ok)?, options)
        };
        Ok(Self { predictor: Mutex::new(py.detach(load).map_err(raise)?) })
    }

    /// Predicts touch at the instant of an image, and returns a `Touch`.
    ///
    /// `image`: (H, W, 3) uint8, RGB; read in place if its memory is contiguous, and not to be written meanwhile. `stamp`: time of the
    /// image, s; one before the last, or too long after it, starts a new stream. `keypoints`: (2, 21, 2) float64, pixels, of the left and
    /// the right hand by a tracker of yours, NaN = not found; a network that sees single hands looks there, others ignore them.
    #[pyo3(signature = (image, stamp, *, keypoints=None))]
    fn push(
        &self,
        py: Python<'_>,
        image: PyReadonlyArrayDyn<'_, u8>,
        stamp: f64,
        keypoints: Option<PyReadonlyArrayDyn<'_, f64>>,
    ) -> PyResult<Touch> {
        let (height, width) = sides(&image, 0)?;
        let pixels = take("image", &image, &[0, 0, 3])?;
        let places = keypoints.as_ref().map(|found| take("keypoints", found, &[2, N_KEYPOINTS, 2])).transpose()?;
        let square = |hand: usize| {
            let hand = places.as_ref()?.chunks_exact(2 * N_KEYPOINTS).nth(hand)?;
            Square::around_hand(hand.chunks_exact(2).map(|point| [point[0], point[1]]), width, height)
        };
        let squares = [square(0), square(1)];
        let predict = || {
            let mut predictor = self.lock();
            let started = Instant::now();
            let input = predictor.preparation().apply_pixels(&pixels, width, height)?.with_squares(squares);
            let prediction = predictor.push_prepared(input, stamp)?;
            Ok((prediction, started.elapsed().as_secs_f64()))
        };
        let (prediction, seconds) = py.detach(predict).map_err(raise)?;
        Touch::new(py, prediction, seconds)
    }

    /// Predicts touch for images one behind the other, and returns a `TouchBatch`: the same numbers as `push` gives, with images
    /// prepared on several threads. `images`: (T, H, W, 3) uint8, RGB. `stamps`: (T,) float64, s.
    fn predict(
        &self,
        py: Python<'_>,
        images: PyReadonlyArrayDyn<'_, u8>,
        stamps: PyReadonlyArrayDyn<'_, f64>,
    ) -> PyResult<TouchBatch> {
        let (height, width) = sides(&images, 1)?;
        let pixels = take("images", &images, &[0, 0, 0, 3])?;
        let stamps = take("stamps", &stamps, &[images.shape().first().copied().unwrap_or(0)])?;
        let bytes = (3 * height as usize * width as usize).max(1);
        let predict = || -> egotac::Result<Vec<Prediction>> {
            let mut predictor = self.lock();
            let preparation = predictor.preparation();
            let mut predictions = Vec::with_capacity(stamps.len());
            for (pixels, stamps) in pixels.chunks(PREPARED * bytes).zip(stamps.chunks(PREPARED)) {
                let prepare = |pixels| preparation.apply_pixels(pixels, width, height);
                let inputs: Vec<_> = pixels.par_chunks(bytes).map(prepare).collect::<egotac::Result<_>>()?;
                for (input, stamp) in inputs.into_iter().zip(stamps) {
                    predictions.push(predictor.push_prepared(input, *stamp)?);
                }
            }
            Ok(predictions)
        };
        TouchBatch::new(py, py.detach(predict).map_err(raise)?)
    }

    /// Drops all frames: the next image starts a new stream.
    fn reset(&self, py: Python<'_>) {
        py.detach(|| self.lock().reset());
    }

    /// Name of the network.
    #[getter]
    fn name(&self, py: Python<'_>) -> String {
        py.detach(|| self.lock().metadata().name.clone())
    }

    /// SHA-256 of the checkpoint.
    #[getter]
    fn sha256(&self, py: Python<'_>) -> String {
        py.detach(|| self.lock().sha256().to_string())
    }

    /// Meaning of vertex indices: "egotac-hand-1", or "mano".
    #[getter]
    fn topology(&self, py: Python<'_>) -> &'static str {
        py.detach(|| self.lock().topology().id())
    }

    /// Time between the frames of a window, s.
    #[getter]
    fn frame_dt(&self, py: Python<'_>) -> f64 {
        py.detach(|| self.lock().metadata().frame_dt)
    }

    /// Warning about a checkpoint that can't tell unfamiliar images; None = it can.
    #[getter]
    fn warning(&self, py: Python<'_>) -> Option<String> {
        py.detach(|| self.lock().warning())
    }
}

/// Height and width of images whose sides are the axes from `first` on, pixels; 0 where an axis is absent.
fn sides(images: &PyReadonlyArrayDyn<'_, u8>, first: usize) -> PyResult<(u32, u32)> {
    let side = |axis: usize| {
        let length = images.shape().get(axis).copied().unwrap_or(0);
        u32::try_from(length).map_err(|_| raise(egotac::Error::value("image", "sides below 2^32 pixels", length)))
    };
    Ok((side(first)?, side(first + 1)?))
}

/// Touch on both hands at the instant of one image.
///
/// `stamp`: s. `force`: (1556,) N, `contact`: (1556,) probability; left hand first, NaN = unknown. `mask`: (1556,) True where
/// touch is known. `familiarity` of the image and `presence` of both hands: 0 to 1, NaN = not estimated. `keypoints`: (2, 21, 3)
/// x and y as shares of the sides of the network's square input, and confidence, NaN = not estimated. `warming_up`: the window is not full. `restarted`: a new stream began.
/// `reused`: the image took the tokens of an earlier one. `total_force`: N on the left and the right hand. `region_force`: (2, 17) N, by `REGIONS`.
/// `reason`: why touch is unknown; empty = it is known. `seconds`: time that the image's preparation and the network took, s.
#[pyclass(frozen, module = "egotac")]
pub struct Touch {
    #[pyo3(get)]
    stamp: f64,
    #[pyo3(get)]
    force: Py<PyArrayDyn<f32>>,
    #[pyo3(get)]
    contact: Py<PyArrayDyn<f32>>,
    #[pyo3(get)]
    mask: Py<PyArrayDyn<bool>>,
    #[pyo3(get)]
    familiarity: f32,
    #[pyo3(get)]
    presence: (f32, f32),
    #[pyo3(get)]
    keypoints: Py<PyArrayDyn<f32>>,
    #[pyo3(get)]
    warming_up: bool,
    #[pyo3(get)]
    restarted: bool,
    #[pyo3(get)]
    reused: bool,
    #[pyo3(get)]
    total_force: (f32, f32),
    #[pyo3(get)]
    region_force: Py<PyArrayDyn<f32>>,
    #[pyo3(get)]
    reason: String,
    #[pyo3(get)]
    seconds: f64,
    field: TactileField,
    certainty: Certainty,
}

impl Touch {
    fn new(py: Python<'_>, prediction: Prediction, seconds: f64) -> PyResult<Self> {
        let reused = prediction.is_reused();
        let Prediction { stamp_secs, field, certainty, hands, warming_up, restarted, .. } = prediction;
        let keypoints = keypoints(hands.as_ref());
        let known = mask(&field, &certainty);
        let regions = region_forces(&field);
        let [left, right] = Side::BOTH.map(|side| field.total_force(side));
        let number = |estimate: Option<f32>| estimate.unwrap_or(f32::NAN);
        Ok(Self {
            stamp: stamp_secs,
            mask: give(py, "mask", known, [N_FIELD])?,
            force: give(py, "force", field.force.clone(), [N_FIELD])?,
            contact: give(py, "contact", field.contact.clone(), [N_FIELD])?,
            familiarity: number(certainty.familiarity),
            presence: (number(certainty.presence[0]), number(certainty.presence[1])),
            keypoints: give(py, "keypoints", keypoints, [2, N_KEYPOINTS, 3])?,
            warming_up,
            restarted,
            reused,
            total_force: (left, right),
            region_force: give(py, "region_force", regions, [2, Region::ALL.len()])?,
            reason: certainty.reason(),
            seconds,
            field,
            certainty,
        })
    }
}

/// Returns x, y and confidence of the keypoints of both hands, (2, 21, 3); NaN = not estimated.
fn keypoints(hands: Option<&[HandEstimate; 2]>) -> Vec<f32> {
    let Some(hands) = hands else { return vec![f32::NAN; 2 * N_KEYPOINTS * 3] };
    let of = |keypoint: &Keypoint| [keypoint.place[0], keypoint.place[1], keypoint.confidence];
    hands.iter().flat_map(|hand| hand.keypoints.iter().flat_map(of)).collect()
}

#[pymethods]
impl Touch {
    /// Returns columns as an input of policies, (n,) float32: the values that `egotac label --as environment_state` writes.
    ///
    /// `columns`: "region_force" (34, N), "force" (1556, N), "contact" (1556), "total" (2, N), one behind the other. What is unknown is
    /// 0; the last two elements are 1 where touch of the left and of the right hand is known.
    #[pyo3(signature = (columns=vec!["region_force".into()]))]
    fn policy_input(&self, py: Python<'_>, columns: Vec<String>) -> PyResult<Py<PyArrayDyn<f32>>> {
        let columns = parse(&columns)?;
        self.field.topology.must_match(Topology::EgotacHand1).map_err(raise)?;
        let values = policy_input(&columns, Some((&self.field, &self.certainty)), &REGIONS);
        let length = values.len();
        give(py, "policy input", values, [length])
    }

    fn __repr__(&self) -> String {
        let (left, right) = self.total_force;
        let unknown = if self.reason.is_empty() { String::new() } else { format!(", {}", self.reason) };
        format!("Touch({:.3} s, left {left:.2} N, right {right:.2} N{unknown})", self.stamp)
    }
}

/// Names of the elements of `Touch.policy_input`, in order.
///
/// >>> egotac.policy_input_names(["total"])
/// ['left_total', 'right_total', 'left_known', 'right_known']
#[pyfunction]
#[pyo3(signature = (columns=vec!["region_force".into()]))]
pub fn policy_input_names(columns: Vec<String>) -> PyResult<Vec<String>> {
    Ok(names_of_input(&parse(&columns)?))
}

fn parse(columns: &[String]) -> PyResult<Vec<LabelColumn>> {
    columns.iter().map(|name| LabelColumn::from_name(name)).collect::<egotac::Result<_>>().map_err(raise)
}

/// Touch on both hands at the instants of T images, one row each: `stamps` (T,) s, `force` (T, 1556) N, `contact` (T, 1556), `mask`
/// (T, 1556), `familiarity` (T,), `presence` (T, 2), `warming_up` (T,), `region_force` (T, 2, 17) N; as in `Touch`.
#[pyclass(frozen, get_all, module = "egotac")]
pub struct TouchBatch {
    stamps: Py<PyArrayDyn<f64>>,
    force: Py<PyArrayDyn<f32>>,
    contact: Py<PyArrayDyn<f32>>,
    mask: Py<PyArrayDyn<bool>>,
    familiarity: Py<PyArrayDyn<f32>>,
    presence: Py<PyArrayDyn<f32>>,
    warming_up: Py<PyArrayDyn<bool>>,
    region_force: Py<PyArrayDyn<f32>>,
}

impl TouchBatch {
    fn new(py: Python<'_>, predictions: Vec<Prediction>) -> PyResult<Self> {
        let n = predictions.len();
        let number = |estimate: Option<f32>| estimate.unwrap_or(f32::NAN);
        let (mut force, mut contact, mut known, mut region) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
        for Prediction { field, certainty, .. } in &predictions {
            known.extend(mask(field, certainty));
            region.extend(region_forces(field));
            force.extend_from_slice(&field.force);
            contact.extend_from_slice(&field.contact);
        }
        let of = |value: &dyn Fn(&Prediction) -> f32| predictions.iter().map(value).collect::<Vec<_>>();
        let presence = predictions.iter().flat_map(|prediction| prediction.certainty.presence.map(number)).collect();
        Ok(Self {
            stamps: give(py, "stamps", predictions.iter().map(|one| one.stamp_secs).collect(), [n])?,
            force: give(py, "force", force, [n, N_FIELD])?,
            contact: give(py, "contact", contact, [n, N_FIELD])?,
            mask: give(py, "mask", known, [n, N_FIELD])?,
            familiarity: give(py, "familiarity", of(&|one| number(one.certainty.familiarity)), [n])?,
            presence: give(py, "presence", presence, [n, 2])?,
            warming_up: give(py, "warming_up", predictions.iter().map(|one| one.warming_up).collect(), [n])?,
            region_force: give(py, "region_force", region, [n, 2, Region::ALL.len()])?,
        })
    }
}

/// Mask of a field, (1556): true where force or contact is known.
fn mask(field: &TactileField, certainty: &Certainty) -> Vec<bool> {
    let counts = Side::BOTH.iter().flat_map(|side| std::iter::repeat_n(certainty.counts(*side), N_VERTICES));
    let known = field.force.iter().zip(&field.contact).map(|(force, contact)| !(force.is_nan() && contact.is_nan()));
    counts.zip(known).map(|(counts, known)| counts && known).collect()
}

/// Regions of the vertices of both built-in hands; computed once, since a frame must not wait for it.
static REGIONS: LazyLock<[Vec<Region>; 2]> =
    LazyLock::new(|| Side::BOTH.map(|side| HandModel::builtin(side).regions()));

/// Forces of the regions of both hands, (34) N; NaN on MANO's vertices, whose regions only MANO's files tell.
fn region_forces(field: &TactileField) -> Vec<f32> {
    match field.topology {
        Topology::EgotacHand1 => field.region_forces(&REGIONS),
        Topology::Mano => vec![f32::NAN; 2 * Region::ALL.len()],
    }
}
