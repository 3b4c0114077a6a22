//! Live images and truth, paired and recorded into a bounded folder of episodes.

use std::path::Path;
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, TrySendError, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use ::image::RgbImage;

use super::exact_sync::Pairing;
use super::log::Log;
use super::{Shutdown, runtime};
use crate::dataset::ring::EpisodeRing;
use crate::dataset::{Attributes, Frame};
use crate::message::{Header, TactileTruth};
use crate::score::verify::episode_splitter::EpisodeSplitter;
use crate::tactile::CONTACT_FORCE_N;

/// Messages that may wait for their partner.
const WAITING: usize = 200;
/// Pairs that may wait for the disk.
const QUEUE: usize = 100;
/// Silence after which an open episode is ended.
const SILENCE: Duration = Duration::from_secs(2);

/// The ring as several threads see it.
pub type SharedRing = Arc<Mutex<EpisodeRing>>;

/// Pairs messages; those that found their partner go to a thread of its own, which writes.
pub struct Recording {
    pairing: Pairing<RgbImage, TactileTruth>,
    pairs: SyncSender<(RgbImage, TactileTruth)>,
    log: Log,
}

/// What comes out of opening.
pub struct Opened {
    /// Takes messages.
    pub recording: Recording,
    /// The episodes.
    pub ring: SharedRing,
    /// The thread that writes.
    pub writer: JoinHandle<anyhow::Result<()>>,
}

impl Recording {
    /// Opens the folder and starts the thread that writes.
    ///
    /// # Errors
    /// If the folder can't be used.
    pub fn open(
        folder: &Path,
        most_bytes: u64,
        episode_secs: f64,
        log: &Log,
        shutdown: &Shutdown,
    ) -> anyhow::Result<Opened> {
        let ring = Arc::new(Mutex::new(EpisodeRing::open(folder, most_bytes)?));
        let (pairs, received) = sync_channel(QUEUE);
        let writer = Writer {
            ring: Arc::clone(&ring),
            received,
            episode_secs,
            stretches: EpisodeSplitter::default(),
            open: None,
            log: log.clone(),
        };
        let stop = shutdown.clone();
        let writer = std::thread::Builder::new().name("recording".into()).spawn(move || {
            let _guard = stop.when_dropped();
            writer.work(&stop)
        })?;
        let recording = Self { pairing: Pairing::new(WAITING), pairs, log: log.clone() };
        Ok(Opened { recording, ring, writer })
    }

    /// An image came.
    pub fn image(&mut self, header: &Header, image: RgbImage) {
        let pair = self.pairing.left(header.stamp, image);
        self.keep(pair);
    }

    /// A truth came.
    pub fn truth(&mut self, truth: TactileTruth) {
        let pair = self.pairing.right(truth.frame.header.stamp, truth);
        self.keep(pair);
    }

    fn keep(&mut self, pair: Option<(RgbImage, TactileTruth)>) {
        let Some(pair) = pair else { return };
        if let Err(TrySendError::Full(_)) = self.pairs.try_send(pair) {
            self.log.warn_throttled("full", "a live frame is lost: the disk is slower than the topics");
        }
    }
}

/// Writes pairs as episodes.
struct Writer {
    ring: SharedRing,
    received: Receiver<(RgbImage, TactileTruth)>,
    episode_secs: f64,
    stretches: EpisodeSplitter,
    /// Stretch and first stamp of the open episode, and when its newest frame came.
    open: Option<(u64, f64, Instant)>,
    log: Log,
}

impl Writer {
    fn work(mut self, stop: &Shutdown) -> anyhow::Result<()> {
        loop {
            match self.received.recv_timeout(Duration::from_millis(100)) {
                Ok((image, truth)) => self.write(image, &truth),
                Err(RecvTimeoutError::Timeout) if !stop.requested() => {
                    if self.open.is_some_and(|(.., came)| came.elapsed() > SILENCE) {
                        self.end();
                    }
                }
                Err(_) => {
                    self.end();
                    return Ok(());
                }
            }
        }
    }

    fn write(&mut self, image: RgbImage, truth: &TactileTruth) {
        let stretch = self.stretches.episode_number(truth);
        let stamp = truth.frame.header.stamp.secs();
        let size = image.dimensions();
        let frame = match frame(image, truth) {
            Ok(frame) => frame,
            Err(error) => return self.log.warn_throttled("truth", format!("truth: frame left out: {error}")),
        };
        // Time stands still or goes back within a stretch only if somebody publishes twice.
        if self.open.is_some_and(|(of, first, _)| of != stretch || stamp - first >= self.episode_secs || stamp < first)
        {
            self.end();
        }
        let attributes = || Attributes {
            topology: frame.field.topology,
            sigma: 0.0,
            contact_force: CONTACT_FORCE_N.into(),
            producer: "egotac trainer".into(),
            version: env!("CARGO_PKG_VERSION").into(),
            scene: truth.frame.model_id.clone(),
            seed: 0,
        };
        let attributes = attributes();
        let mut ring = self.ring.lock().unwrap_or_else(PoisonError::into_inner);
        let pushed = match ring.push(frame.clone(), || attributes.clone()) {
            Ok(()) => Ok(()),
            // Another size of image or another topology begins another episode.
            Err(_) if ring.open_frames() > 0 => {
                self.open = None;
                ring.end_episode().and_then(|()| ring.push(frame, || attributes))
            }
            Err(error) => Err(error),
        };
        drop(ring);
        match pushed {
            Ok(()) => {
                let first = self.open.map_or(stamp, |(_, first, _)| first);
                self.open = Some((stretch, first, Instant::now()));
            }
            Err(error) => {
                self.log.warn_throttled("write", format!("a frame of {}x{} was not recorded: {error}", size.0, size.1));
            }
        }
    }

    fn end(&mut self) {
        self.open = None;
        let mut ring = self.ring.lock().unwrap_or_else(PoisonError::into_inner);
        if let Err(error) = ring.end_episode() {
            self.log.error(format!("an episode could not be written: {error}"));
        }
    }
}

/// A frame to learn from; what the truth leaves unknown is not supervised.
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

/// Waits for the writer.
///
/// # Errors
/// If it died.
pub fn join(writer: JoinHandle<anyhow::Result<()>>) -> anyhow::Result<()> {
    runtime::join(writer, "recording")
}
