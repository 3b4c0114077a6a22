//! Live sources: the newest image of a camera or topic, with its touch.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use ::image::RgbImage;
use tokio::sync::watch;

use super::about::{About, Kind};
use super::moment::{Moment, unknown_field};
use super::packet::{Encoder, meshes};
use crate::dataset::DoubtRule;
use crate::error::Result;
use crate::hand::{HandModel, Side, Topology};
use crate::model::Predictor;
use crate::render::color::MAX_COLOR_FORCE;

/// Number of a live source's newest moment, from 1, and its packet.
pub(super) type Newest = Option<(u64, Arc<[u8]>)>;

/// The pages' side of a live source.
pub struct LiveFeed {
    about: About,
    hands: serde_json::Value,
    newest: watch::Receiver<Newest>,
    ended: Arc<AtomicBool>,
}

/// The source's side of a live source.
pub struct LiveInput {
    encoder: Encoder,
    predictor: Option<Predictor>,
    topology: Topology,
    sequence: u64,
    newest: watch::Sender<Newest>,
    ended: Arc<AtomicBool>,
}

impl LiveFeed {
    /// Creates both sides of a live source. `touch` is the origin of the touch if there is no predictor.
    pub fn new(name: String, predictor: Option<Predictor>, hands: [HandModel; 2], touch: &str) -> (Self, LiveInput) {
        let (sender, newest) = watch::channel(None);
        let ended = Arc::new(AtomicBool::new(false));
        let rule = predictor.as_ref().and_then(DoubtRule::of);
        let about = About {
            name,
            kind: Kind::Live,
            frames: None,
            fps: None,
            scale: MAX_COLOR_FORCE,
            touch: match &predictor {
                Some(predictor) => format!("predicted by {}", predictor.metadata().name),
                None => touch.to_owned(),
            },
            truth: false,
            familiarity_threshold: rule.and_then(|rule| rule.familiarity),
            presence_threshold: rule.and_then(|rule| rule.presence),
            course: None,
        };
        let topology = hands[Side::Left as usize].topology;
        let described = meshes(&hands);
        let encoder = Encoder::new(hands);
        let input = LiveInput { encoder, predictor, topology, sequence: 0, newest: sender, ended: Arc::clone(&ended) };
        (Self { about, hands: described, newest, ended }, input)
    }

    pub(super) fn about(&self) -> &About {
        &self.about
    }

    pub(super) fn hands(&self) -> &serde_json::Value {
        &self.hands
    }

    /// Waits for a moment behind number `after`; None once the source has ended.
    pub(super) async fn next(&self, after: u64) -> Newest {
        let mut newest = self.newest.clone();
        let is_new = |newest: &Newest| newest.as_ref().is_some_and(|(sequence, _)| *sequence > after);
        newest.wait_for(is_new).await.ok().and_then(|newest| newest.clone())
    }
}

impl Drop for LiveFeed {
    fn drop(&mut self) {
        self.ended.store(true, Ordering::Relaxed);
    }
}

impl LiveInput {
    /// True once no page can come any more.
    pub fn has_ended(&self) -> bool {
        self.ended.load(Ordering::Relaxed)
    }

    /// Vertex numbering of the hands.
    pub fn topology(&self) -> Topology {
        self.topology
    }

    /// Predicts the touch in an image; without a network it is unknown.
    ///
    /// # Errors
    /// If the network's device fails.
    pub fn predict(&mut self, stamp_secs: f64, image: RgbImage) -> Result<Moment> {
        let mut moment = Moment::unknown(self.sequence as usize, 0, stamp_secs, unknown_field(self.topology));
        match self.predictor.as_mut().map(|predictor| predictor.push(&image, stamp_secs)) {
            Some(Ok(prediction)) => moment.predicted(prediction),
            Some(Err(error)) if error.is_recoverable() => moment.reason = error.to_string(),
            Some(Err(error)) => return Err(error),
            None => moment.reason = "no prediction for this image".into(),
        }
        moment.image = Ok(image);
        Ok(moment)
    }

    /// Shows a moment, in place of the one before.
    ///
    /// # Errors
    /// If the image can't be encoded.
    pub fn show(&mut self, moment: Moment) -> Result<()> {
        self.sequence += 1;
        // Without a page nothing is encoded; the feed itself holds one receiver.
        if self.newest.receiver_count() > 1 {
            let packet = self.encoder.encode(&moment, self.sequence)?;
            self.newest.send_replace(Some((self.sequence, packet.into())));
        }
        Ok(())
    }
}
