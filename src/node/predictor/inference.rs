//! Inference loop of the predictor: decodes the newest image, predicts, and publishes the result.

use std::sync::{Arc, Mutex, MutexGuard};
use std::time::{Duration, Instant};

use ::image::RgbImage;

use super::certainty::Certainties;
use super::input::Input;
use super::load_model::{LoadedModel, PendingModel};
use super::views::Views;
use crate::message::{HandModelInfo, Header, TactileFrame};
use crate::model::predictor::{Prediction, Predictor};
use crate::node::clock::RosClock;
use crate::node::lock::lock;
use crate::node::log::Log;
use crate::node::params::Parameters;
use crate::node::publisher::Publisher;
use crate::node::rectify::Rectification;
use crate::node::shutdown::Shutdown;

/// Longest wait for an image; bounds the delay of shutdown and of a network exchange.
const IMAGE_TIMEOUT: Duration = Duration::from_millis(50);

/// Id of the network in use, for frames and diagnostics; clones share it.
#[derive(Clone)]
pub(super) struct ModelId(Arc<Mutex<String>>);

impl ModelId {
    /// Starts with the id of the first network.
    pub(super) fn new(model_id: String) -> Self {
        Self(Arc::new(Mutex::new(model_id)))
    }

    /// Locks the id.
    pub(super) fn get(&self) -> MutexGuard<'_, String> {
        lock(&self.0)
    }
}

/// Inference loop; runs on its own thread.
pub(super) struct Inference {
    pub(super) predictor: Predictor,
    pub(super) model_id: ModelId,
    /// Network that replaces the present one before the next image.
    pub(super) pending: PendingModel,
    /// True if the network was replaced after the last image.
    pub(super) replaced: bool,
    pub(super) input: Input,
    /// Rectification of the images, if it is wanted.
    pub(super) rectification: Option<Rectification>,
    /// Publisher of `~/tactile`.
    pub(super) frames: Publisher<TactileFrame>,
    /// Publisher of `~/model_info`.
    pub(super) info: Publisher<HandModelInfo>,
    /// Publishers of touch in other forms.
    pub(super) views: Views,
    /// Certainty about the newest images.
    pub(super) certainties: Certainties,
    /// Number of frames published.
    pub(super) sequence: u64,
    pub(super) parameters: Arc<Parameters>,
    pub(super) clock: RosClock,
    pub(super) log: Log,
}

impl Inference {
    /// Processes images until `shutdown`; an image that fails is logged and counted.
    pub(super) fn run(mut self, shutdown: &Shutdown) {
        while !shutdown.requested() {
            let payload = self.input.newest.take(IMAGE_TIMEOUT);
            if let Some(loaded) = self.pending.take() {
                self.replace(loaded);
            }
            if let Some(payload) = payload {
                self.process(&payload);
            }
        }
    }

    /// Replaces the network; the observation window of the new one is empty.
    fn replace(&mut self, LoadedModel { predictor, info }: LoadedModel) {
        self.predictor = predictor;
        self.replaced = true;
        self.model_id.get().clone_from(&info.model_id);
        if let Err(error) = self.info.publish(&info) {
            self.log.warn_throttled("publish", format!("~/model_info: {error:#}"));
        }
    }

    fn process(&mut self, payload: &[u8]) {
        let started = Instant::now();
        let Some((header, image)) = self.decode(payload) else { return };
        let Some(prediction) = self.predict(&header, &image) else { return };
        if let Err(error) = self.publish(header, &image, &prediction, started) {
            self.log.warn_throttled("publish", format!("cannot publish a result: {error:#}"));
        }
    }

    /// Decodes an image; None if it is malformed or too old.
    fn decode(&self, payload: &[u8]) -> Option<(Header, RgbImage)> {
        let (header, image) = match self.input.transport.decode(payload) {
            Ok(image) => image,
            Err(error) => {
                self.drop_image("malformed", &format!("malformed {}", cause(&error)), &error);
                return None;
            }
        };
        let max_age = self.parameters.get::<f64>("max_age_ms") * 1e-3;
        if max_age > 0.0 && self.clock.secs_since(header.stamp).is_some_and(|age| age > max_age) {
            self.input.tally.dropped("stale");
            return None;
        }
        let image = match self.rectification.as_ref().map(|rectification| rectification.apply(&image)) {
            None => image,
            Some(Ok(rectified)) => rectified,
            Some(Err(error)) => {
                self.drop_image("uncalibrated", "uncalibrated", &error);
                return None;
            }
        };
        Some((header, image))
    }

    fn predict(&mut self, header: &Header, image: &RgbImage) -> Option<Prediction> {
        // Images without a stamp are ordered by their arrival.
        let stamp = if header.stamp.is_zero() { self.clock.now() } else { header.stamp };
        let prediction = match self.predictor.push(image, stamp.secs()) {
            Ok(prediction) => prediction,
            Err(error) => {
                self.drop_image("failed", "failed", &error);
                return None;
            }
        };
        // The first image of a new network restarts its window, too; that deserves no warning.
        if prediction.restarted && self.sequence > 0 && !std::mem::take(&mut self.replaced) {
            self.log.warn_throttled("restart", "the image stream restarted: its stamps went back or paused");
        }
        Some(prediction)
    }

    fn publish(
        &mut self,
        header: Header,
        image: &RgbImage,
        prediction: &Prediction,
        started: Instant,
    ) -> anyhow::Result<()> {
        let frame = TactileFrame {
            sequence: self.sequence,
            inference_secs: started.elapsed().as_secs_f64(),
            model_id: self.model_id.get().clone(),
            warming_up: prediction.warming_up,
            ..TactileFrame::from_field(header.clone(), &prediction.field)?.with_certainty(&prediction.certainty)
        };
        self.certainties.push(&prediction.certainty, &self.log);
        self.frames.publish(&frame)?;
        self.sequence += 1;
        self.input.tally.processed(self.clock.secs_since(header.stamp));
        self.views.publish(&frame, &prediction.field, image)
    }

    fn drop_image(&self, counter: &'static str, warning_kind: &str, error: &crate::Error) {
        self.input.tally.dropped(counter);
        self.log.warn_throttled(warning_kind, format!("image on {} dropped: {error}", self.input.topic));
    }
}

/// Returns the field of an image message that is wrong, so that warnings are throttled per field.
fn cause(error: &crate::Error) -> &str {
    match error {
        crate::Error::Value { name, .. } | crate::Error::Shape { name, .. } => name,
        crate::Error::Unknown { kind, .. } => kind,
        _ => "image",
    }
}
