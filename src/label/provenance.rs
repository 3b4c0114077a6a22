//! What every labelled data set says about its labels.

use serde::{Deserialize, Serialize};

use crate::hand::Topology;
use crate::model::{Precision, Predictor};
use crate::tactile::CONTACT_FORCE_N;

/// Name under which outputs hold a [`Provenance`]: an attribute of a store, a metadata record of a bag, and so on.
pub const NAME: &str = "egotac_labels";
/// A vertex counts as touched above this probability.
pub const CONTACT_THRESHOLD: f64 = 0.5;

/// Where labels come from and what they mean. Equal provenance means equal labels of equal images.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Provenance {
    /// Program that made the labels.
    pub producer: String,
    /// Its version.
    pub version: String,
    /// The network's name.
    pub model: String,
    /// SHA-256 of its file.
    pub model_sha256: String,
    /// Number format that it ran in.
    pub precision: String,
    /// What a vertex index means.
    pub topology: Topology,
    /// The hand model's name, for people.
    pub hand_model: String,
    /// Images per observation window.
    pub horizon: usize,
    /// Time between two images of the window, s.
    pub frame_dt: f64,
    /// Whether forces are known; if not, they are NaN.
    pub has_force: bool,
    /// What counts as touch.
    pub thresholds: Thresholds,
    /// What was labelled: the input's name, and the choices that decide which images were read and how.
    pub source: Vec<String>,
}

/// What counts as touch.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Thresholds {
    /// A vertex is predicted as touched above this probability.
    pub contact: f64,
    /// A vertex is touched in truth above this force, N.
    pub contact_force: f64,
}

impl Provenance {
    /// Of labels by `predictor`.
    pub fn of(predictor: &Predictor, precision: Precision, source: Vec<String>) -> Self {
        let metadata = predictor.metadata();
        let hand_model = match metadata.topology {
            Topology::EgotacHand1 => "egotac built-in hand",
            Topology::Mano => "MANO",
        };
        Self {
            producer: "egotac label".into(),
            version: env!("CARGO_PKG_VERSION").into(),
            model: metadata.name.clone(),
            model_sha256: predictor.sha256().to_string(),
            precision: precision.to_string(),
            topology: metadata.topology,
            hand_model: hand_model.into(),
            horizon: predictor.config().horizon,
            frame_dt: metadata.frame_dt,
            has_force: metadata.has_force,
            thresholds: Thresholds {
                contact: CONTACT_THRESHOLD,
                // By its shortest decimal: 0.05, not the f32 nearest to it.
                contact_force: CONTACT_FORCE_N.to_string().parse().unwrap_or(f64::from(CONTACT_FORCE_N)),
            },
            source,
        }
    }

    /// The id that messages carry: name and first digits of the hash.
    pub fn model_id(&self) -> String {
        format!("{}/{}", self.model, self.model_sha256.get(..12).unwrap_or(&self.model_sha256))
    }
}
