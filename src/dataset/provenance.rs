//! Origin and meaning of labels.

use serde::{Deserialize, Serialize};

use super::identity::InputIdentity;
use crate::hand::Topology;
use crate::image::Resize;
use crate::model::{DoubtThresholds, Precision, Predictor, Unknown};
use crate::tactile::{CONTACT_FORCE_N, Certainty, ForceKind, TactileField};
use crate::text;

/// Name under which outputs hold a [`super::LabelInfo`]: an attribute of a store, a metadata record of a bag, and so on.
pub const PROVENANCE_KEY: &str = "egotac_labels";
/// Probability above which a vertex is predicted as touched.
pub const CONTACT_THRESHOLD: f64 = 0.5;

/// Origin and meaning of labels. Equal provenance means equal labels of equal images.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Provenance {
    /// Program that made the labels.
    pub producer: String,
    /// Version of the program.
    pub version: String,
    /// Name of the network.
    pub model: String,
    /// SHA-256 of the network's file.
    pub model_sha256: String,
    /// Number format of the network.
    pub precision: String,
    /// Meaning of vertex indices.
    pub topology: Topology,
    /// Name of the hand model, for people.
    pub hand_model: String,
    /// SHA-256 of the MANO files that the network's fields were carried over to, left first; empty = none.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub mano_sha256: Vec<String>,
    /// Number of images in the observation window.
    pub horizon: usize,
    /// Time between two images of the window, s.
    pub frame_dt: f64,
    /// Meaning of the forces.
    #[serde(default)]
    pub force_kind: ForceKind,
    /// True if forces are known; otherwise they are NaN.
    pub has_force: bool,
    /// Thresholds of contact.
    pub thresholds: Thresholds,
    /// Rule for touch that is unknown; None = whoever made the labels judges no images.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub doubt: Option<DoubtRule>,
    /// Conversion of pictures that replaces the checkpoint's; None = that of the checkpoint.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub view: Option<Resize>,
    /// True if the labels hold keypoints of the hands.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub keypoints: bool,
    /// The input's name, and the choices that decide which images are read and how.
    pub source: Vec<String>,
    /// Identity of the input; None in outputs of versions before this field.
    #[serde(default)]
    pub input: Option<InputIdentity>,
}

/// Thresholds of contact.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Thresholds {
    /// Probability above which a vertex is predicted as touched.
    pub contact: f64,
    /// True force above which a vertex is touched, N.
    pub contact_force: f64,
}

/// Rule for touch that is unknown.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct DoubtRule {
    /// Familiarity of an image below which touch is unknown; None = not estimated.
    pub familiarity: Option<f32>,
    /// Presence of a hand below which its touch is unknown; None = not estimated.
    pub presence: Option<f32>,
    /// Form of touch that is unknown.
    pub unknown: Unknown,
}

impl DoubtRule {
    /// Returns the rule of a predictor; None if it judges no images.
    pub fn of(predictor: &Predictor) -> Option<Self> {
        let (doubt, unknown) = (predictor.metadata().doubt, predictor.unknown());
        let familiarity = predictor.estimates_familiarity().then_some(doubt.familiarity);
        let presence = predictor.estimates_presence().then_some(doubt.presence);
        (familiarity.is_some() || presence.is_some()).then_some(Self { familiarity, presence, unknown })
    }

    /// True if familiarity and if presence are estimated, and so stand beside the labels.
    pub(crate) fn estimates(rule: Option<&Self>) -> [bool; 2] {
        rule.map_or([false; 2], |rule| [rule.familiarity.is_some(), rule.presence.is_some()])
    }

    /// Makes touch NaN where it is unknown but written in another form, given a frame's estimates (NaN = not estimated):
    /// zeros, which formats without a mask can't tell from the absence of touch.
    pub(crate) fn hide(&self, field: &mut TactileField, familiarity: f32, presence: [f32; 2]) {
        if self.unknown == Unknown::Zero {
            Unknown::Nan.apply(field, &mut self.judge(familiarity, presence));
        }
    }

    /// Returns the certainty that follows from a frame's estimates; NaN = not estimated.
    pub(crate) fn judge(&self, familiarity: f32, presence: [f32; 2]) -> Certainty {
        let estimate = |value: f32| (!value.is_nan()).then_some(value);
        let Self { familiarity: least_familiarity, presence: least_presence, .. } = *self;
        let thresholds =
            DoubtThresholds { familiarity: least_familiarity.unwrap_or(0.0), presence: least_presence.unwrap_or(0.0) };
        thresholds.judge(estimate(familiarity), presence.map(estimate))
    }
}

impl Provenance {
    /// Creates the provenance of labels by `predictor`; a [`crate::label::Job`] adds the identity of its input.
    pub fn of(predictor: &Predictor, precision: Precision, source: Vec<String>) -> Self {
        let metadata = predictor.metadata();
        Self {
            producer: "egotac label".into(),
            version: env!("CARGO_PKG_VERSION").into(),
            model: metadata.name.clone(),
            model_sha256: predictor.sha256().to_string(),
            precision: precision.to_string(),
            topology: predictor.topology(),
            hand_model: predictor.topology().hand_model().into(),
            mano_sha256: predictor.mano().map(|mano| mano.sha256().to_vec()).unwrap_or_default(),
            horizon: predictor.config().horizon,
            frame_dt: metadata.frame_dt,
            force_kind: metadata.force_kind,
            has_force: metadata.has_force,
            thresholds: Thresholds {
                contact: CONTACT_THRESHOLD,
                // The shortest decimal: 0.05, not the f32 nearest to it.
                contact_force: CONTACT_FORCE_N.to_string().parse().unwrap_or(f64::from(CONTACT_FORCE_N)),
            },
            doubt: DoubtRule::of(predictor),
            view: predictor.other_view(),
            keypoints: false,
            source,
            input: None,
        }
    }

    /// Returns name and identity of the input for messages.
    pub fn input_text(&self) -> String {
        let name = self.source.first().map_or("an input without a name", String::as_str);
        let name = text::printable_name(name);
        match &self.input {
            Some(identity) => format!("{name} ({identity})"),
            None => name.into_owned(),
        }
    }

    /// True if both are of the same input.
    pub fn has_input_of(&self, other: &Self) -> bool {
        self.input == other.input && self.source.first() == other.source.first()
    }

    /// Returns the model id of messages: name and first digits of the hash.
    pub fn model_id(&self) -> String {
        format!("{}/{}", self.model, self.model_sha256.get(..12).unwrap_or(&self.model_sha256))
    }
}
