//! From the newest image to messages.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use super::load_model::{Loaded, Slot};
use crate::hand::{HandModel, Topology};
use crate::message::{HandModelInfo, HandPose, Header, PointCloud2, TactileFrame};
use crate::model::predictor::Predictor;
use crate::node::diagnostics::Tally;
use crate::node::log::Log;
use crate::node::mailbox::Mailbox;
use crate::node::params::Parameters;
use crate::node::points::{self, Posed};
use crate::node::runtime::{Publisher, RosClock};
use crate::node::{Shutdown, images};
use crate::tactile::TactileField;

/// A hand pose counts for an image whose stamp differs by at most this, s.
const POSE_SLOP: f64 = 0.2;

/// Id of the network in use: frames and diagnostics name it.
pub type ModelId = Arc<Mutex<String>>;

/// The id, whatever became of other threads that held it.
pub fn locked(model_id: &ModelId) -> MutexGuard<'_, String> {
    model_id.lock().unwrap_or_else(PoisonError::into_inner)
}

/// The newest pose of each hand.
pub type Poses = Arc<Mutex<[Option<HandPose>; 2]>>;

/// Turns the newest image into messages, on a thread of its own.
pub struct Worker {
    /// The network.
    pub predictor: Predictor,
    /// Its id.
    pub model_id: ModelId,
    /// Both hands, left first, to pose the points.
    pub hands: [HandModel; 2],
    /// Where the points lie without a pose.
    pub rest: Vec<Posed>,
    /// Where images come from, for warnings.
    pub topic: String,
    /// Where the newest image waits.
    pub input: Arc<Mailbox<Vec<u8>>>,
    /// The newest pose of each hand.
    pub poses: Poses,
    /// What became of each image.
    pub tally: Tally,
    /// The node's.
    pub parameters: Arc<Parameters>,
    /// The node's.
    pub clock: RosClock,
    /// The node's.
    pub log: Log,
    /// `~/tactile`
    pub frames: Publisher<TactileFrame>,
    /// `~/points`
    pub points: Publisher<PointCloud2>,
    /// `~/model_info`
    pub info: Publisher<HandModelInfo>,
    /// Where another network waits.
    pub slot: Slot,
    /// Whether the network is another one since the last image.
    pub exchanged: bool,
    /// Images answered.
    pub sequence: u64,
}

impl Worker {
    /// Works until `stop`; what goes wrong with an image is logged and counted.
    pub fn work(mut self, stop: &Shutdown) {
        while !stop.requested() {
            let payload = self.input.take(Duration::from_millis(50));
            if let Some(loaded) = self.slot.take() {
                self.exchange(loaded);
            }
            if let Some(payload) = payload {
                self.process(&payload);
            }
        }
    }

    /// Goes on with another network; its window fills anew.
    fn exchange(&mut self, Loaded { predictor, info }: Loaded) {
        self.predictor = predictor;
        self.exchanged = true;
        locked(&self.model_id).clone_from(&info.model_id);
        if let Err(error) = self.info.publish(&info) {
            self.log.warn_throttled("publish", format!("~/model_info: {error:#}"));
        }
    }

    fn process(&mut self, payload: &[u8]) {
        let started = Instant::now();
        let (header, image) = match images::decode(payload, &self.parameters) {
            Ok(image) => image,
            Err(error) => {
                self.tally.dropped("malformed");
                let kind = format!("malformed {}", cause(&error));
                return self.log.warn_throttled(&kind, format!("image on {} left out: {error}", self.topic));
            }
        };
        let max_age = self.parameters.get::<f64>("max_age_ms") * 1e-3;
        if max_age > 0.0 && self.clock.secs_since(header.stamp).is_some_and(|age| age > max_age) {
            return self.tally.dropped("stale");
        }
        // Without a stamp the order of arrival is all there is.
        let stamp = if header.stamp.is_zero() { self.clock.now() } else { header.stamp };
        let prediction = match self.predictor.push(&image, stamp.secs()) {
            Ok(prediction) => prediction,
            Err(error) => {
                self.tally.dropped("failed");
                return self.log.warn_throttled("failed", format!("image on {} left out: {error}", self.topic));
            }
        };
        // Another network has seen nothing yet.
        if prediction.restarted && self.sequence > 0 && !std::mem::take(&mut self.exchanged) {
            self.log.warn_throttled("restart", "the image stream restarted: its stamps went back or paused");
        }
        let sent = self.frame(&header, &prediction.field, prediction.warming_up, started).and_then(|frame| {
            self.frames.publish(&frame)?;
            self.sequence += 1;
            self.tally.processed(self.clock.secs_since(header.stamp));
            self.publish_points(header, &prediction.field)
        });
        if let Err(error) = sent {
            self.log.warn_throttled("publish", format!("a result could not be sent: {error:#}"));
        }
    }

    fn frame(
        &self,
        header: &Header,
        field: &TactileField,
        warming_up: bool,
        started: Instant,
    ) -> anyhow::Result<TactileFrame> {
        Ok(TactileFrame {
            sequence: self.sequence,
            inference_secs: started.elapsed().as_secs_f64(),
            model_id: locked(&self.model_id).clone(),
            warming_up,
            ..TactileFrame::from_field(header.clone(), field)?
        })
    }

    fn publish_points(&self, header: Header, field: &TactileField) -> anyhow::Result<()> {
        let wanted = self.parameters.get::<bool>("publish_points") && self.points.is_heard();
        if !wanted || field.topology != Topology::EgotacHand1 {
            return Ok(());
        }
        let threshold = self.parameters.get::<f64>("contact_threshold") as f32;
        let cloud = match self.posed(&header) {
            Some((frame_id, hands)) => {
                points::cloud(Header { stamp: header.stamp, frame_id }, field, &hands, threshold)
            }
            None => points::cloud(header, field, &self.rest, threshold),
        };
        self.points.publish(&cloud)
    }

    /// The hands whose pose is known at the image's time, and the frame they are in.
    fn posed(&self, image: &Header) -> Option<(String, Vec<Posed>)> {
        let poses = self.poses.lock().unwrap_or_else(PoisonError::into_inner).clone();
        let mut frame_id = None;
        let mut hands = Vec::new();
        for (pose, model) in poses.iter().zip(&self.hands) {
            let Some(pose) = pose else { continue };
            if (pose.header.stamp.secs() - image.stamp.secs()).abs() > POSE_SLOP {
                continue;
            }
            if *frame_id.get_or_insert_with(|| pose.header.frame_id.clone()) != pose.header.frame_id {
                self.log.warn_throttled("frames", "hand_pose: the hands are in different frames; only one is drawn");
                continue;
            }
            match pose.to_params(model) {
                Ok(params) => hands.push(Posed { side: model.side, vertices: model.forward(&params).vertices }),
                Err(error) => self.log.warn_throttled("hand_pose", format!("hand_pose: {error}")),
            }
        }
        (!hands.is_empty()).then(|| (frame_id.unwrap_or_default(), hands))
    }
}

/// What is wrong with an image, without what came: each cause has warnings of its own.
fn cause(error: &crate::Error) -> &str {
    match error {
        crate::Error::Value { name, .. } | crate::Error::Shape { name, .. } => name,
        crate::Error::Unknown { kind, .. } => kind,
        _ => "image",
    }
}
