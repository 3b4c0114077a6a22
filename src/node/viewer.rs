//! Topics as a source of `egotac view`: images, with the touch that a network or the node `predictor` sees in them.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use super::create::create;
use super::images::ImageTransport;
use super::input_topics::{InputTopic, Need, reliability_parameter};
use super::lock::lock;
use super::log::Log;
use super::mailbox::Mailbox;
use super::params::Parameter;
use super::runtime::Runtime;
use super::shutdown::Shutdown;
use super::worker_thread::WorkerThread;
use super::{qos, topic_statistics};
use crate::hand::HandModel;
use crate::message::{CompressedImage, HandPose, HandPoses, HandTactile, Image, TactileFrame, TactileTruth, Time};
use crate::view::{LiveInput, Moment};

/// Number of images, fields and poses that wait for others of their stamp: half a second at 60 Hz.
const WAITING: usize = 32;
/// Largest difference between the stamps of an image and of a hand pose that is drawn for it, s: five frames at 25 Hz.
const MAX_POSE_AGE_SECS: f64 = 0.2;
/// Longest wait for an image, after which the thread looks whether it is to end.
const PAUSE: Duration = Duration::from_millis(200);

/// Topics that are shown.
#[derive(Debug, Clone, Default)]
pub(crate) struct ViewTopics {
    /// Images; a name that ends in `/compressed` carries compressed ones.
    pub(crate) image: String,
    /// Touch by a node `predictor`; None = a network of our own.
    pub(crate) tactile: Option<String>,
    /// True touch.
    pub(crate) truth: Option<String>,
    /// Poses of one hand per message.
    pub(crate) hand_pose: Option<String>,
    /// Poses of both hands per message.
    pub(crate) hand_poses: Option<String>,
}

/// Newest messages by their stamp.
#[derive(Debug)]
struct Recent<T>(Mutex<BTreeMap<Time, T>>);

impl<T> Default for Recent<T> {
    fn default() -> Self {
        Self(Mutex::default())
    }
}

impl<T: Clone> Recent<T> {
    fn put(&self, stamp: Time, value: T) {
        let mut values = lock(&self.0);
        values.insert(stamp, value);
        if values.len() > WAITING {
            values.pop_first();
        }
    }

    fn get(&self, stamp: &Time) -> Option<T> {
        lock(&self.0).get(stamp).cloned()
    }

    /// Returns the value whose stamp is the nearest, if it is at most `most` seconds away.
    fn nearest(&self, stamp: &Time, most: f64) -> Option<T> {
        let distance = |other: &Time| (other.secs() - stamp.secs()).abs();
        let values = lock(&self.0);
        let nearest = values.iter().min_by(|a, b| distance(a.0).total_cmp(&distance(b.0)));
        nearest.filter(|(other, _)| distance(other) <= most).map(|(_, value)| value.clone())
    }
}

/// Messages that are shown beside an image.
#[derive(Debug, Default)]
struct Beside {
    truth: Recent<TactileTruth>,
    /// Poses of each hand, left first.
    poses: [Recent<HandPose>; 2],
}

/// Bytes of an image, and the touch in it if another node predicted it.
type Seen = (Vec<u8>, Option<TactileFrame>);

/// Creates a flag that nothing sets: the program ends with the page.
pub(crate) fn shutdown() -> Shutdown {
    Shutdown::default()
}

/// Shows the topics until `shutdown`.
///
/// # Errors
/// If ROS refuses a topic, or the network fails.
pub(crate) fn run(
    topics: &ViewTopics,
    models: [HandModel; 2],
    input: LiveInput,
    shutdown: &Shutdown,
) -> anyhow::Result<()> {
    let table = [reliability_parameter("match"), topic_statistics::parameter(), Parameter::use_sim_time()];
    let mut runtime = create("egotac_view", &table, None)?;
    let transport = match topics.image.ends_with("/compressed") {
        true => ImageTransport::Compressed,
        false => ImageTransport::Raw,
    };
    let (newest, beside) = (Arc::new(Mailbox::<Seen>::new(1)), Arc::new(Beside::default()));
    subscribe_images(&mut runtime, topics, transport, &newest)?;
    subscribe_others(&mut runtime, topics, &beside)?;
    let log = runtime.log().clone();
    let worker = WorkerThread::spawn("view", shutdown, move |shutdown| {
        let mut shown = Shown { transport, models, beside, input, log };
        while !shutdown.requested() && !shown.input.has_ended() {
            for (_, seen) in newest.take(PAUSE) {
                shown.show(seen)?;
            }
        }
        Ok(())
    })?;
    runtime.spin(shutdown);
    runtime.finish(worker)
}

fn topic(runtime: &Runtime, name: &str, content: &'static str, need: Need) -> InputTopic {
    InputTopic {
        name: name.to_owned(),
        ..InputTopic::new(runtime, name, content, qos::newest_input().keep_last(8), need)
    }
}

/// Subscribes to images, and, where another node predicts, to its touch: then an image is shown once its touch is there.
fn subscribe_images(
    runtime: &mut Runtime,
    topics: &ViewTopics,
    transport: ImageTransport,
    newest: &Arc<Mailbox<Seen>>,
) -> anyhow::Result<()> {
    let waiting = Arc::new(Recent::<Vec<u8>>::default());
    let log = runtime.log().clone();
    let call = {
        let (newest, waiting, pairs) = (Arc::clone(newest), Arc::clone(&waiting), topics.tactile.is_some());
        move |payload: Vec<u8>| match (pairs, transport.header(&payload)) {
            (false, _) => newest.put(0, (payload, None)),
            (true, Ok(header)) => waiting.put(header.stamp, payload),
            (true, Err(error)) => log.warn_throttled("image", format!("image: {error}")),
        }
    };
    let input = topic(runtime, &topics.image, "images", Need::Required);
    match transport {
        ImageTransport::Raw => runtime.input_bytes::<Image>(input, call)?,
        ImageTransport::Compressed => runtime.input_bytes::<CompressedImage>(input, call)?,
    }
    let Some(tactile) = &topics.tactile else { return Ok(()) };
    let (newest, log) = (Arc::clone(newest), runtime.log().clone());
    let input = topic(runtime, tactile, "touch", Need::Required);
    runtime.input::<TactileFrame>(input, move |frame| match frame {
        Ok(frame) => match waiting.get(&frame.header.stamp) {
            Some(payload) => newest.put(0, (payload, Some(frame))),
            None => log.warn_throttled("pair", "touch without an image of its stamp is not shown"),
        },
        Err(error) => log.warn_throttled("tactile", format!("touch: {error}")),
    })
}

/// Subscribes to truth and to poses of hands.
fn subscribe_others(runtime: &mut Runtime, topics: &ViewTopics, beside: &Arc<Beside>) -> anyhow::Result<()> {
    if let Some(name) = &topics.truth {
        let (beside, log) = (Arc::clone(beside), runtime.log().clone());
        let input = topic(runtime, name, "truth", Need::Optional);
        runtime.input::<TactileTruth>(input, move |truth| match truth {
            Ok(truth) => beside.truth.put(truth.frame.header.stamp, truth),
            Err(error) => log.warn_throttled("truth", format!("truth: {error}")),
        })?;
    }
    if let Some(name) = &topics.hand_pose {
        let (beside, log) = (Arc::clone(beside), runtime.log().clone());
        let input = topic(runtime, name, "poses of the hands", Need::Optional);
        runtime.input::<HandPose>(input, move |pose| match pose.and_then(|pose| Ok((pose.side()?, pose))) {
            Ok((side, pose)) => beside.poses[side as usize].put(pose.header.stamp, pose),
            Err(error) => log.warn_throttled("hand_pose", format!("hand pose: {error}")),
        })?;
    }
    if let Some(name) = &topics.hand_poses {
        let (beside, log) = (Arc::clone(beside), runtime.log().clone());
        let input = topic(runtime, name, "poses of the hands", Need::Optional);
        runtime.input::<HandPoses>(input, move |poses| match poses.and_then(HandPoses::into_poses) {
            Ok(poses) => {
                poses.into_iter().for_each(|(side, pose)| beside.poses[side as usize].put(pose.header.stamp, pose))
            }
            Err(error) => log.warn_throttled("hand_poses", format!("hand poses: {error}")),
        })?;
    }
    Ok(())
}

/// The worker's state.
struct Shown {
    transport: ImageTransport,
    models: [HandModel; 2],
    beside: Arc<Beside>,
    input: LiveInput,
    log: Log,
}

impl Shown {
    /// Shows an image. One that can't be decoded, and touch on other vertices, are left out with a warning.
    fn show(&mut self, (payload, touch): Seen) -> anyhow::Result<()> {
        let (header, image) = match self.transport.decode(&payload) {
            Ok(decoded) => decoded,
            Err(error) => {
                self.log.warn_throttled("image", format!("image: {error}"));
                return Ok(());
            }
        };
        let stamp_secs = header.stamp.secs();
        let mut moment = self.input.predict(stamp_secs, image)?;
        if let Some(frame) = touch
            && let Err(error) = self.take_over(&mut moment, &frame)
        {
            self.log.warn_throttled("tactile", format!("touch: {error}"));
        }
        if let Some(truth) = self.beside.truth.get(&header.stamp).filter(|truth| truth.validity == 0) {
            moment.truth = truth.frame.to_field().ok().filter(|field| field.topology == self.input.topology());
        }
        for ((poses, model), params) in self.beside.poses.iter().zip(&self.models).zip(&mut moment.hands) {
            let pose = poses.nearest(&header.stamp, MAX_POSE_AGE_SECS);
            *params = pose.and_then(|pose| pose.to_params(model).ok());
        }
        Ok(self.input.show(moment)?)
    }

    /// Takes over the touch that another node predicted.
    fn take_over(&self, moment: &mut Moment, frame: &TactileFrame) -> crate::Result<()> {
        // A message without hands means that this image has no result.
        if !frame.hands.is_empty() {
            let field = frame.to_field()?;
            self.input.topology().must_match(field.topology)?;
            moment.touch = field;
        }
        let known = |value: f32| (!value.is_nan()).then_some(value);
        let score = |side: u8| frame.hands.iter().find(|hand| hand.side == side).and_then(|hand| known(hand.score));
        (moment.familiarity, moment.warming_up) = (known(frame.familiarity), frame.warming_up);
        moment.presence = [HandTactile::LEFT, HandTactile::RIGHT].map(score);
        moment.reason.clone_from(&frame.reason);
        Ok(())
    }
}
