//! Image subscription of one camera, and decoding of its images.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};

use ::image::RgbImage;

use super::camera::Camera;
use crate::image::Preparation;
use crate::message::Header;
use crate::model::Predictor;
use crate::model::predictor::Prepared;
use crate::node::clock::RosClock;
use crate::node::diagnostics::Tally;
use crate::node::images::ImageTransport;
use crate::node::input_topics::{InputTopic, Need};
use crate::node::lock::lock;
use crate::node::log::Log;
use crate::node::mailbox::Mailbox;
use crate::node::params::Parameters;
use crate::node::qos;
use crate::node::rectify::Rectification;
use crate::node::runtime::Runtime;

/// Bytes of the newest images of all cameras that were not taken yet; the source is the camera's place in the list.
pub(super) type NewestImages = Arc<Mailbox<Vec<u8>>>;

/// Images of one camera; clones share the counts.
#[derive(Clone)]
pub(super) struct Input {
    /// The camera.
    pub(super) camera: Camera,
    /// Resolved image topic.
    pub(super) topic: String,
    /// Counts of images.
    pub(super) tally: Tally,
    /// Place of the camera in the list of cameras.
    source: usize,
    newest: NewestImages,
    /// Message type of the images.
    transport: ImageTransport,
    /// Rectification of the images, if it is wanted.
    rectification: Option<Rectification>,
    parameters: Arc<Parameters>,
    /// True once the log has told that the network does not see the whole picture.
    view_told: Arc<AtomicBool>,
    /// Memory of an image that nobody needs any more, for the next one.
    spare: Arc<Mutex<Vec<u8>>>,
    clock: RosClock,
    log: Log,
}

/// A decoded image.
pub(super) struct Seen {
    pub(super) header: Header,
    pub(super) image: RgbImage,
    /// Time of the image for the network, s.
    pub(super) stamp_secs: f64,
    /// Image as the network takes it; taken out for the network.
    pub(super) prepared: Prepared,
}

impl Input {
    /// Reads transport and topic from the node, and subscribes to the calibration if images are to be rectified. Subscribes to no
    /// images yet.
    ///
    /// # Errors
    /// If ROS refuses the topic of the calibration.
    pub(super) fn create(
        runtime: &mut Runtime,
        camera: Camera,
        source: usize,
        newest: &NewestImages,
    ) -> anyhow::Result<Self> {
        let transport = ImageTransport::of(runtime.parameters());
        Ok(Self {
            topic: transport.topic(runtime, &camera.input("image")),
            tally: Tally::default(),
            source,
            newest: Arc::clone(newest),
            transport,
            rectification: Rectification::subscribe(runtime, &camera.input("camera_info"))?,
            parameters: Arc::clone(runtime.parameters()),
            view_told: Arc::default(),
            spare: Arc::default(),
            clock: runtime.clock().clone(),
            log: runtime.log().clone(),
            camera,
        })
    }

    /// Subscribes to the images.
    ///
    /// # Errors
    /// If ROS refuses the topic name or the quality of service.
    pub(super) fn subscribe(&self, runtime: &mut Runtime) -> anyhow::Result<()> {
        let (parameters, newest) = (Arc::clone(&self.parameters), Arc::clone(&self.newest));
        let (tally, source) = (self.tally.clone(), self.source);
        let topic = self.camera.input("image");
        let input = InputTopic::new(runtime, &topic, "images", qos::newest_input(), Need::Required);
        self.transport.subscribe(runtime, input, move |payload| {
            tally.received();
            match parameters.get("enabled") {
                true => newest.put(source, payload),
                false => tally.dropped("disabled"),
            }
        })
    }

    /// Number of images that a newer one replaced before they were taken.
    pub(super) fn superseded(&self) -> u64 {
        self.newest.superseded(self.source)
    }

    /// Decodes an image for the network of `predictor`; counts and logs one that is malformed, too old or not usable, and
    /// returns None.
    pub(super) fn decode(&self, payload: &[u8], predictor: &Predictor) -> Option<Seen> {
        let spare = std::mem::take(&mut *lock(&self.spare));
        let (header, image) = match self.transport.decode_in(payload, spare) {
            Ok(image) => image,
            Err(error) => {
                self.drop_image("malformed", &format!("malformed {}", cause(&error)), &error);
                return None;
            }
        };
        let max_age = self.parameters.get::<f64>("max_age_ms") * 1e-3;
        if max_age > 0.0 && self.clock.secs_since(header.stamp).is_some_and(|age| age > max_age) {
            self.tally.dropped("stale");
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
        let preparation = predictor.preparation();
        self.tell_view(&preparation.whole, &image);
        let prepared = match preparation.apply(&image) {
            Ok(prepared) => prepared,
            Err(error) => {
                self.drop_image("failed", "failed", &error);
                return None;
            }
        };
        // Images without a stamp are ordered by their arrival.
        let stamp = if header.stamp.is_zero() { self.clock.now() } else { header.stamp };
        Some(Seen { stamp_secs: stamp.secs(), header, image, prepared })
    }

    /// Takes back the memory of an image.
    pub(super) fn give_back(&self, image: RgbImage) {
        *lock(&self.spare) = image.into_raw();
    }

    /// Warns once if more than a tenth of the camera's pictures lies outside of the network's view.
    fn tell_view(&self, preparation: &Preparation, image: &RgbImage) {
        let Some(warning) = preparation.warning(image.width() as usize, image.height() as usize) else { return };
        if !self.view_told.swap(true, Ordering::Relaxed) {
            self.log.warn(format!("{}: {warning} (parameter view)", self.topic));
        }
    }

    /// Counts an image that was dropped, and logs it; warnings of one kind are throttled together.
    pub(super) fn drop_image(&self, counter: &'static str, warning_kind: &str, error: &crate::Error) {
        self.tally.dropped(counter);
        // Cameras fail independently of each other.
        let kind = format!("{warning_kind} {}", self.camera.name());
        self.log.warn_throttled(&kind, format!("image on {} dropped: {error}", self.topic));
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
