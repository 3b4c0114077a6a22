//! Touch seen by one camera: its observation window, and the topics of its results.

use super::certainty::Certainties;
use super::input::{Input, Seen};
use super::model_id::ModelId;
use super::views::Views;
use crate::hand::HandModel;
use crate::message::TactileFrame;
use crate::model::{Prediction, Predictor};
use crate::node::clock::RosClock;
use crate::node::log::Log;
use crate::node::publisher::Publisher;
use crate::node::qos;
use crate::node::runtime::Runtime;

/// Stream of one camera.
pub(super) struct CameraStream {
    pub(super) input: Input,
    /// Observation window, on the network that all cameras share.
    pub(super) predictor: Predictor,
    /// True if the network was replaced after the last image.
    replaced: bool,
    model_id: ModelId,
    /// Publisher of `~/tactile`, or `~/NAME/tactile`.
    frames: Publisher<TactileFrame>,
    /// Publishers of touch in other forms.
    views: Views,
    /// Certainty about the newest images.
    pub(super) certainties: Certainties,
    /// Number of frames published.
    sequence: u64,
    clock: RosClock,
    log: Log,
}

impl CameraStream {
    /// Creates the publishers of a camera.
    ///
    /// # Errors
    /// If ROS refuses a topic.
    pub(super) fn create(
        runtime: &mut Runtime,
        input: Input,
        predictor: Predictor,
        model_id: ModelId,
        hands: [HandModel; 2],
    ) -> anyhow::Result<Self> {
        Ok(Self {
            predictor,
            replaced: false,
            model_id,
            frames: runtime.publisher(&input.camera.output("tactile"), qos::output())?,
            views: Views::create(runtime, &input.camera, hands)?,
            certainties: Certainties::default(),
            sequence: 0,
            clock: runtime.clock().clone(),
            log: runtime.log().clone(),
            input,
        })
    }

    /// Replaces the network; the observation window of the new one is empty.
    pub(super) fn replace(&mut self, predictor: Predictor) {
        self.predictor = predictor;
        self.replaced = true;
    }

    /// Counts and publishes the result of an image; returns the frame unless the image failed. `secs`: time that it took.
    pub(super) fn finish(&mut self, seen: &Seen, result: crate::Result<Prediction>, secs: f64) -> Option<TactileFrame> {
        let prediction = match result {
            Ok(prediction) => prediction,
            Err(error) => {
                self.input.drop_image("failed", "failed", &error);
                return None;
            }
        };
        // The first image of a new network restarts its window, too; that deserves no warning.
        if prediction.restarted && self.sequence > 0 && !std::mem::take(&mut self.replaced) {
            let topic = &self.input.topic;
            let line = format!("the image stream on {topic} restarted: its stamps went back or paused");
            self.log.warn_throttled(&format!("restart {}", self.input.camera.name()), line);
        }
        match self.publish(seen, &prediction, secs) {
            Ok(frame) => Some(frame),
            Err(error) => {
                self.log.warn_throttled("publish", format!("cannot publish a result: {error:#}"));
                None
            }
        }
    }

    fn publish(&mut self, seen: &Seen, prediction: &Prediction, secs: f64) -> anyhow::Result<TactileFrame> {
        let frame = TactileFrame {
            sequence: self.sequence,
            inference_secs: secs,
            model_id: self.model_id.get().clone(),
            warming_up: prediction.warming_up,
            ..TactileFrame::from_field(seen.header.clone(), &prediction.field)?.with_certainty(&prediction.certainty)
        };
        self.certainties.push(prediction, &self.log);
        self.frames.publish(&frame)?;
        self.sequence += 1;
        self.input.tally.processed(self.clock.secs_since(frame.header.stamp));
        let preparation = self.predictor.preparation().whole;
        self.views.publish(&frame, prediction, &seen.image, &preparation)?;
        Ok(frame)
    }
}
