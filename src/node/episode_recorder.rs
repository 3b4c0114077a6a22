//! Episode recorder: pairs live images with their truth and records them into a bounded folder of episodes.

use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use ::image::RgbImage;

use super::diagnostics::Tally;
use super::exact_sync::ExactSync;
use super::images::ImageTransport;
use super::lock::lock;
use super::log::Log;
use super::rectify::Rectification;
use super::shutdown::Shutdown;
use super::worker_thread::WorkerThread;
use crate::dataset::ring::EpisodeRing;
use crate::dataset::{Attributes, Frame};
use crate::message::TactileTruth;
use crate::score::verify::episode_splitter::EpisodeSplitter;
use crate::tactile::CONTACT_FORCE_N;

/// Most images and truths that wait for their partner; more than three seconds of any camera.
const MAX_UNPAIRED: usize = 200;
/// Most pairs that wait to be written; bounds the memory while the disk is slow.
const MAX_QUEUED_PAIRS: usize = 100;
/// Seconds after which an image or truth that waits for its partner counts as lost.
const UNMATCHED_AFTER_SECS: f64 = 2.0;
/// Silence after which the open episode ends.
const EPISODE_TIMEOUT: Duration = Duration::from_secs(2);
/// Longest wait of the writer for a pair; bounds the delay of shutdown.
const PAIR_TIMEOUT: Duration = Duration::from_millis(100);

/// Folder of episodes that several threads share.
pub(crate) type SharedRing = Arc<Mutex<EpisodeRing>>;

/// Bytes of an image message, and its truth.
type Pair = (Vec<u8>, TactileTruth);

/// Form of the images, and their counts.
#[derive(Debug, Clone)]
pub(crate) struct ImageSource {
    /// Message type of the images.
    pub(crate) transport: ImageTransport,
    /// Rectification of the images, if it is wanted.
    pub(crate) rectification: Option<Rectification>,
    /// Counts of the images.
    pub(crate) tally: Tally,
}

/// Limits of the recorded episodes.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Limits {
    /// Largest size of all episodes on disk, bytes.
    pub(crate) bytes: u64,
    /// Longest duration of an episode, s.
    pub(crate) episode_secs: f64,
    /// Largest size of the images that wait in memory, bytes.
    pub(crate) waiting_bytes: usize,
}

/// Pairs images with truths of equal stamps and passes the pairs to the writer thread, which decodes the images: that takes too
/// long for the thread that serves ROS.
pub(crate) struct EpisodeRecorder {
    sync: ExactSync<Vec<u8>, TactileTruth>,
    pairs: SyncSender<Pair>,
    images: ImageSource,
    /// Size of the images in the queue of the writer, and its limit, bytes.
    queued_bytes: Arc<AtomicUsize>,
    most_queued_bytes: usize,
    log: Log,
}

impl EpisodeRecorder {
    /// Opens the folder and starts the writer thread, which ends the open episode at `shutdown`. Returns the recorder, the
    /// recorded episodes and the thread.
    ///
    /// # Errors
    /// If the folder cannot be created or read.
    pub(crate) fn open(
        folder: &Path,
        limits: Limits,
        images: ImageSource,
        log: &Log,
        shutdown: &Shutdown,
    ) -> anyhow::Result<(Self, SharedRing, WorkerThread)> {
        let ring = Arc::new(Mutex::new(EpisodeRing::open(folder, limits.bytes)?));
        let (pairs, received) = sync_channel(MAX_QUEUED_PAIRS);
        let queued_bytes = Arc::new(AtomicUsize::new(0));
        let writer = Writer {
            ring: Arc::clone(&ring),
            received,
            images: images.clone(),
            queued_bytes: Arc::clone(&queued_bytes),
            episode_secs: limits.episode_secs,
            splitter: EpisodeSplitter::default(),
            open: None,
            log: log.clone(),
        };
        let thread = WorkerThread::spawn("recording", shutdown, move |shutdown| {
            writer.run(shutdown);
            Ok(())
        })?;
        let half = limits.waiting_bytes / 2;
        let sync = ExactSync::with_budget(MAX_UNPAIRED, half, Vec::len);
        let recorder = Self { sync, pairs, images, queued_bytes, most_queued_bytes: half, log: log.clone() };
        Ok((recorder, ring, thread))
    }

    /// Takes the bytes of an image message.
    pub(crate) fn push_image(&mut self, payload: Vec<u8>) {
        match self.images.transport.header(&payload) {
            Ok(header) => {
                let pair = self.sync.push_left(header.stamp, payload);
                self.queue(pair);
            }
            Err(error) => self.images.refuse(&error, &self.log),
        }
        let (unmatched_images, unmatched_truths) = self.sync.unmatched(UNMATCHED_AFTER_SECS);
        self.images.tally.set_dropped("unmatched", unmatched_images);
        self.images.tally.set_dropped("unmatched_truths", unmatched_truths);
    }

    /// Takes a truth.
    pub(crate) fn push_truth(&mut self, truth: TactileTruth) {
        let pair = self.sync.push_right(truth.frame.header.stamp, truth);
        self.queue(pair);
    }

    fn queue(&mut self, pair: Option<Pair>) {
        let Some(pair) = pair else { return };
        let bytes = pair.0.len();
        // Count before sending: the writer subtracts as soon as it has the pair.
        let queued = self.queued_bytes.fetch_add(bytes, Ordering::SeqCst) + bytes;
        if queued > self.most_queued_bytes || self.pairs.try_send(pair).is_err() {
            self.queued_bytes.fetch_sub(bytes, Ordering::SeqCst);
            self.images.tally.dropped("queue_full");
            self.log.warn_throttled("full", "a live frame is lost: the disk is slower than the topics");
        }
    }
}

impl ImageSource {
    /// Decodes an image and rectifies it if that is wanted.
    fn decode(&self, payload: &[u8]) -> crate::Result<RgbImage> {
        let (_, image) = self.transport.decode(payload)?;
        match &self.rectification {
            Some(rectification) => rectification.apply(&image),
            None => Ok(image),
        }
    }

    /// Counts and logs a malformed image.
    fn refuse(&self, error: &crate::Error, log: &Log) {
        self.tally.dropped("malformed");
        log.warn_throttled("image", format!("image dropped: {error}"));
    }
}

/// Writes pairs as episodes.
struct Writer {
    ring: SharedRing,
    received: Receiver<Pair>,
    images: ImageSource,
    queued_bytes: Arc<AtomicUsize>,
    episode_secs: f64,
    splitter: EpisodeSplitter,
    open: Option<OpenEpisode>,
    log: Log,
}

#[derive(Debug, Clone, Copy)]
struct OpenEpisode {
    /// Number of the truth's episode.
    number: u64,
    /// Stamp of the first frame, s.
    first_stamp: f64,
    /// Arrival of the newest frame.
    last_arrival: Instant,
}

impl Writer {
    /// Writes until `shutdown` and the queue is empty, or the recorder is dropped.
    fn run(mut self, shutdown: &Shutdown) {
        loop {
            match self.received.recv_timeout(PAIR_TIMEOUT) {
                Ok((payload, truth)) => {
                    let bytes = payload.len();
                    match self.images.decode(&payload) {
                        Ok(image) => self.write(image, &truth),
                        Err(error) => self.images.refuse(&error, &self.log),
                    }
                    self.queued_bytes.fetch_sub(bytes, Ordering::SeqCst);
                }
                Err(RecvTimeoutError::Timeout) if !shutdown.requested() => {
                    if self.open.is_some_and(|open| open.last_arrival.elapsed() > EPISODE_TIMEOUT) {
                        self.end_episode();
                    }
                }
                Err(_) => return self.end_episode(),
            }
        }
    }

    fn write(&mut self, image: RgbImage, truth: &TactileTruth) {
        let number = self.splitter.episode_number(truth);
        let stamp = truth.frame.header.stamp.secs();
        let (width, height) = image.dimensions();
        let frame = match frame(image, truth) {
            Ok(frame) => frame,
            Err(error) => {
                self.images.tally.dropped("bad_truth");
                return self.log.warn_throttled("truth", format!("truth: frame dropped: {error}"));
            }
        };
        if self.open.is_some_and(|open| self.must_end(open, number, stamp)) {
            self.end_episode();
        }
        if let Err(error) = self.push(frame, &truth.frame.model_id) {
            let line = format!("a frame of {width}x{height} was not recorded: {error}");
            self.images.tally.dropped("not_recorded");
            return self.log.warn_throttled("write", line);
        }
        self.images.tally.processed(None);
        let first_stamp = self.open.map_or(stamp, |open| open.first_stamp);
        self.open = Some(OpenEpisode { number, first_stamp, last_arrival: Instant::now() });
    }

    /// Returns true if a frame cannot belong to the open episode. Stamps before the first one within an episode mean that
    /// two publishers send.
    fn must_end(&self, open: OpenEpisode, number: u64, stamp: f64) -> bool {
        open.number != number || stamp - open.first_stamp >= self.episode_secs || stamp < open.first_stamp
    }

    /// Writes a frame; another image size or topology starts another episode, and an episode that fails to take a frame ends.
    fn push(&mut self, frame: Frame, scene: &str) -> crate::Result<()> {
        let attributes = attributes(&frame, scene);
        let ring = Arc::clone(&self.ring);
        let mut ring = lock(&ring);
        if !ring.fits(&frame) {
            self.open = None;
            ring.end_episode()?;
        }
        let pushed = ring.push(frame, || attributes);
        if pushed.is_err() && ring.open_frames() > 0 {
            self.open = None;
            ring.end_episode()?;
        }
        pushed
    }

    fn end_episode(&mut self) {
        self.open = None;
        if let Err(error) = lock(&self.ring).end_episode() {
            self.log.error(format!("cannot write an episode: {error}"));
        }
    }
}

fn attributes(frame: &Frame, scene: &str) -> Attributes {
    Attributes {
        topology: frame.field.topology,
        sigma: 0.0,
        contact_force: CONTACT_FORCE_N.into(),
        producer: "egotac trainer".into(),
        version: env!("CARGO_PKG_VERSION").into(),
        scene: scene.to_owned(),
        seed: 0,
    }
}

/// Returns a training frame; unknown values of the truth are not supervised.
fn frame(image: RgbImage, truth: &TactileTruth) -> crate::Result<Frame> {
    let mut field = truth.frame.to_field()?;
    let known = |values: &[f32]| values.iter().map(|value| u8::from(!value.is_nan())).collect::<Vec<_>>();
    let (force_valid, contact_valid) = (known(&field.force), known(&field.contact));
    field.contact.iter_mut().filter(|c| !c.is_nan()).for_each(|c| *c = f32::from(u8::from(*c > 0.5)));
    Ok(Frame {
        timestamp: truth.frame.header.stamp.secs(),
        camera_ego_rgb: image,
        field,
        force_valid,
        contact_valid,
        validity: truth.validity()?,
        left_hand_pose: None,
        right_hand_pose: None,
    })
}
