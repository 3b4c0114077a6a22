//! Sources of the page: packets of a recording on request, and the newest packet of a live source.

use std::sync::{Arc, Mutex, PoisonError};

use tokio::sync::{mpsc, oneshot};

use super::about::About;
use super::cache::Cache;
use super::clip::Clip;
use super::live::LiveFeed;
use super::packet::{Encoder, meshes};
use crate::error::{Error, Result};
use crate::text::tell;

/// Memory for packets of a recording that were made before, bytes: about a minute of VGA at 25 Hz.
const CACHE: usize = 96 << 20;
/// Number of requests that wait for a recording.
const WAITING: usize = 32;

/// A source of the page.
pub enum Feed {
    /// A recording.
    Recording(RecordingFeed),
    /// A camera or topic.
    Live(LiveFeed),
}

/// Answer to a request for a frame.
#[derive(Debug, Clone)]
pub(super) enum Answer {
    /// The packet.
    Packet(Arc<[u8]>),
    /// There is no such frame.
    End,
    /// The frame can't be read, for this reason.
    Failed(String),
}

struct Request {
    frame: usize,
    reply: oneshot::Sender<Answer>,
}

/// A recording, read by a thread of its own.
pub struct RecordingFeed {
    about: About,
    hands: serde_json::Value,
    requests: mpsc::Sender<Request>,
    cache: Arc<Mutex<Cache>>,
}

impl Feed {
    /// Starts the thread that reads `clip`; it ends when the feed is dropped.
    ///
    /// # Errors
    /// If no thread can be started.
    pub fn recording(clip: Clip) -> Result<Self> {
        let (requests, taken) = mpsc::channel(WAITING);
        let cache = Arc::new(Mutex::new(Cache::new(CACHE)));
        let (about, hands) = (clip.about().clone(), meshes(clip.hands()));
        let of_thread = Arc::clone(&cache);
        let thread = std::thread::Builder::new().name("recording".into());
        thread.spawn(move || serve(clip, taken, &of_thread)).map_err(Error::io("thread"))?;
        Ok(Self::Recording(RecordingFeed { about, hands, requests, cache }))
    }

    /// Description for the page.
    pub(super) fn about(&self) -> &About {
        match self {
            Self::Recording(feed) => &feed.about,
            Self::Live(feed) => feed.about(),
        }
    }

    /// Hands for the page, as [`meshes`] describes them.
    pub(super) fn hands(&self) -> &serde_json::Value {
        match self {
            Self::Recording(feed) => &feed.hands,
            Self::Live(feed) => feed.hands(),
        }
    }
}

impl RecordingFeed {
    /// Returns the packet of a frame.
    pub(super) async fn packet(&self, frame: usize) -> Answer {
        if let Some(packet) = lock(&self.cache).get(frame) {
            return Answer::Packet(packet);
        }
        let (reply, answer) = oneshot::channel();
        let gone = || Answer::Failed("the thread that reads the recording has ended".into());
        if self.requests.send(Request { frame, reply }).await.is_err() {
            return gone();
        }
        answer.await.unwrap_or_else(|_| gone())
    }
}

/// Answers requests until the feed is dropped.
fn serve(mut clip: Clip, mut requests: mpsc::Receiver<Request>, cache: &Mutex<Cache>) {
    let encoder = Encoder::new(clip.hands().clone());
    let name = clip.about().name.clone();
    let mut player = clip.player();
    while let Some(Request { frame, reply }) = requests.blocking_recv() {
        // The page has gone.
        if reply.is_closed() {
            continue;
        }
        let known = lock(cache).get(frame);
        let answer = match known {
            Some(packet) => Answer::Packet(packet),
            None => match player.moment(frame).and_then(|moment| {
                Ok(match moment {
                    Some(moment) => Answer::Packet(encoder.encode(&moment, 0)?.into()),
                    None => Answer::End,
                })
            }) {
                Ok(answer) => {
                    if let Answer::Packet(packet) = &answer {
                        lock(cache).put(frame, Arc::clone(packet));
                    }
                    answer
                }
                Err(error) => {
                    tell(format_args!("{name}, image {frame}: {error}"));
                    Answer::Failed(error.to_string())
                }
            },
        };
        // An error means that the page has gone meanwhile.
        let _ = reply.send(answer);
    }
}

fn lock(cache: &Mutex<Cache>) -> std::sync::MutexGuard<'_, Cache> {
    cache.lock().unwrap_or_else(PoisonError::into_inner)
}
