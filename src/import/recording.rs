//! The typed intermediate that every reader of a data set fills, and from which labels are made.

use std::path::PathBuf;
use std::sync::Arc;

use ::image::RgbImage;
use glam::{DAffine3, DVec3, Vec3};
use serde_json::Value;

use super::glove::GloveMap;
use super::sensors::Sensor;
use super::shapes::MeshFile;
use crate::dataset::source::SourceFrames;
use crate::error::{Error, Result};
use crate::hand::{HandModel, N_BETAS, N_JOINTS, N_KEYPOINTS};
use crate::tactile::{ForceKind, TactileField};

/// The parts of a recording that do not change with time.
#[derive(Debug, Clone)]
pub struct Recording {
    /// Name within the data set; outputs are called by it.
    pub name: String,
    /// Path of the recording.
    pub path: PathBuf,
    /// Number of images, at least one.
    pub frames: usize,
    /// Objects that hands may touch.
    pub objects: Vec<RecordedObject>,
    /// Pairs of objects that a joint links, parts of one articulated object: indices, the smaller one first.
    pub joints: Vec<[usize; 2]>,
    /// Meaning of the hands' parameters.
    pub convention: Convention,
    /// True if a calibrated sensor measures force: contact then follows from it.
    pub measures_force: bool,
    /// Tactile sensors whose readings are kept, at most one per hand.
    pub sensors: Vec<Sensor>,
    /// Taxel map of these sensors, if they are gloves without a calibration: their readings become relative readings and contact.
    pub glove: Option<Arc<GloveMap>>,
    /// Place of the camera.
    pub view: View,
    /// Names of the arrays of further cameras' images, such as `data/left_wrist_camera_rgb`.
    pub further_views: Vec<&'static str>,
    /// (778) vertices of the left and the right hand at rest, in MANO's order, m, of a data set that scanned them; they
    /// replace the shape. `None` = the hand's shape follows from its betas.
    pub templates: [Option<Arc<Vec<Vec3>>>; 2],
    /// Camera: intrinsics and distortion as the data set states them; null if it does not.
    pub camera: Value,
    /// Facts about this recording for the store's attributes, such as the subject; an object.
    pub about: Value,
}

impl Default for Recording {
    /// Returns an ego recording without objects and sensors, whose hands are plain MANO.
    fn default() -> Self {
        Self {
            name: String::new(),
            path: PathBuf::new(),
            frames: 0,
            objects: Vec::new(),
            joints: Vec::new(),
            convention: Convention::PLAIN,
            measures_force: false,
            sensors: Vec::new(),
            glove: None,
            view: View::Ego,
            further_views: Vec::new(),
            templates: [None, None],
            camera: Value::Null,
            about: Value::Null,
        }
    }
}

/// Place of the camera that gives a recording's images.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum View {
    /// On the head or the chest of the person.
    Ego,
    /// Beside the person.
    ThirdPerson,
    /// No camera: images are black.
    None,
}

impl View {
    /// Name in the store's attributes.
    pub fn name(self) -> &'static str {
        match self {
            Self::Ego => "ego",
            Self::ThirdPerson => "third person",
            Self::None => "none",
        }
    }
}

/// An object of a recording, rigid; of an articulated object, one part.
#[derive(Debug, Clone)]
pub struct RecordedObject {
    /// Name.
    pub name: String,
    /// File with its mesh in the object's frame; `None` = unknown shape.
    pub mesh: Option<MeshFile>,
}

/// Meaning of MANO parameters in a data set.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Convention {
    /// True if MANO's mean pose is to be added to the joints' rotations.
    pub adds_mean: bool,
    /// Meaning of the translation.
    pub translation: Translation,
    /// True if the data set was made with the sign of x in the left hand's `shapedirs` corrected.
    pub fixes_left_shapedirs: bool,
}

impl Convention {
    /// Axis-angle rotations without a mean, rotation about the wrist before translation, left hand as filed.
    pub const PLAIN: Self =
        Self { adds_mean: false, translation: Translation::AfterRotation, fixes_left_shapedirs: false };
}

/// Meaning of a hand's translation. The two differ by the position of the wrist at rest, about 0.1 m.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Translation {
    /// The hand is rotated about its wrist at rest, then moved by the translation.
    AfterRotation,
    /// The wrist is moved to the translation.
    OfWrist,
}

impl Translation {
    /// Name in the store's attributes.
    pub fn name(self) -> &'static str {
        match self {
            Self::AfterRotation => "added after rotation about the wrist",
            Self::OfWrist => "position of the wrist",
        }
    }
}

/// Everything that is known about one instant, in one frame of reference.
#[derive(Debug, Clone)]
pub struct Moment {
    /// Stamp of the image, s.
    pub stamp_secs: f64,
    /// `world_from_reference`: the frame that hands and objects are given in.
    pub world_from_reference: DAffine3,
    /// `world_from_camera`: pose of the camera's optical frame; `None` = unknown.
    pub world_from_camera: Option<DAffine3>,
    /// Left and right hand; `None` = unknown.
    pub hands: [Option<RecordedHand>; 2],
    /// `reference_from_object` of each object of the recording; `None` = unknown.
    pub objects: Vec<Option<DAffine3>>,
    /// Forces on the left and the right hand; `None` = not measured.
    pub forces: [Option<SensedForce>; 2],
    /// Reading of each sensor of the recording, of its number of values; `None` = unknown.
    pub readings: Vec<Option<Vec<f32>>>,
}

/// Forces on one hand by a calibrated sensor.
#[derive(Debug, Clone)]
pub struct SensedForce {
    /// Forces of the sensor's cells that are loaded.
    pub points: Vec<PointForce>,
    /// (778) true where a vertex may touch something that the sensor does not measure.
    pub unmeasured: Vec<bool>,
}

/// Force at a point.
#[derive(Debug, Clone, Copy)]
pub struct PointForce {
    /// Position in the reference frame, m.
    pub position: DVec3,
    /// Unit normal into the hand.
    pub normal: DVec3,
    /// Normal force, N.
    pub newtons: f64,
}

/// Pose of one hand as its data set gives it.
#[derive(Debug, Clone, PartialEq)]
pub enum RecordedHand {
    /// MANO parameters.
    Mano(ManoParams),
    /// MANO parameters, and a rigid motion that then places the posed hand in the reference frame.
    Placed(ManoParams, DAffine3),
    /// 21 keypoints, m: wrist, then thumb to little finger, each from base to tip.
    Keypoints([Vec3; N_KEYPOINTS]),
    /// MANO parameters for MANO's files, and 21 keypoints for the built-in hand.
    Either(ManoParams, [Vec3; N_KEYPOINTS]),
    /// 778 vertices in MANO's order, m, and the parameters nearest to them.
    Vertices(ManoParams, Vec<Vec3>),
    /// 778 vertices in MANO's order and 21 keypoints, m, to which parameters are fitted.
    Mesh(Vec<Vec3>, [Vec3; N_KEYPOINTS]),
}

/// MANO parameters of one hand; [`Convention`] tells their meaning.
#[derive(Debug, Clone, PartialEq)]
pub struct ManoParams {
    /// Shape coefficients.
    pub betas: [f32; N_BETAS],
    /// Rotation of the wrist, axis-angle, rad.
    pub global_orient: Vec3,
    /// Rotations of joints 1 to 15.
    pub hand_pose: PoseParams,
    /// Translation, m.
    pub transl: Vec3,
}

/// Rotations of joints 1 to 15.
#[derive(Debug, Clone, PartialEq)]
pub enum PoseParams {
    /// Axis-angle, rad.
    AxisAngle([Vec3; N_JOINTS - 1]),
    /// Coefficients of MANO's components.
    Coefficients(Vec<f32>),
}

/// Reader of one recording.
pub trait Reader: Send + Sync {
    /// Returns the parts that do not change with time.
    fn recording(&self) -> &Recording;

    /// Lists the files that are read, without the objects' meshes; some may not exist.
    ///
    /// # Errors
    /// If a folder can't be listed.
    fn files(&self) -> Result<Vec<PathBuf>>;

    /// Reads what is known about the instant of image `index`.
    ///
    /// # Errors
    /// If an annotation is damaged; the error names file and field, and other instants may still be read.
    fn moment(&self, index: usize) -> Result<Moment>;

    /// Reads the image `index` of a further view of the recording.
    ///
    /// # Errors
    /// If it is damaged, or the recording has no such view.
    fn further_image(&self, view: &'static str, index: usize) -> Result<RgbImage> {
        Err(Error::value(view, "a view of the recording", format!("image {index} of {}", self.recording().name)))
    }

    /// Returns force and contact at the instant of image `index` on the vertices of `hands`, left first, of a recording whose
    /// gloves measure them; `None` = labels follow from geometry.
    ///
    /// # Errors
    /// As [`Reader::moment`].
    fn touch(&self, index: usize, hands: [&HandModel; 2]) -> Result<Option<TactileField>> {
        let _ = (index, hands);
        Ok(None)
    }

    /// Returns the meaning of the forces of [`Reader::touch`].
    fn force_kind(&self) -> Option<ForceKind> {
        None
    }

    /// Frees what was read for moments: many recordings are open at the same time.
    fn release(&self) {}

    /// Returns the damage that hides a part of the recording, if there is any.
    fn damage(&self) -> Option<String> {
        None
    }

    /// Returns the images from index `from` on, with the stamps of their moments.
    ///
    /// # Errors
    /// If the container can't be opened.
    fn images(&self, from: usize) -> Result<SourceFrames<'_>>;
}
