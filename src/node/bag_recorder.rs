//! The recorder: takes topics as they come, byte for byte, into a bag.

use std::cell::RefCell;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::rc::Rc;
use std::sync::mpsc::{Sender, channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use anyhow::{Context, Result, anyhow};
use r2r::QosProfile;

use super::{Runtime, Shutdown, qos};
use crate::dataset::mcap::BagWriter;
use crate::message::Message;

/// A topic to record: what it adds to the recorder's node and bag.
pub struct Topic {
    name: String,
    type_name: &'static str,
    schema: String,
    qos: QosProfile,
    latched: bool,
    subscribe: Subscribe,
}

/// Between two looks at who publishes.
const LOOK: Duration = Duration::from_millis(100);

type Subscribe = fn(&mut Runtime, &str, QosProfile, Box<dyn FnMut(Vec<u8>)>) -> Result<()>;
type Counts = Arc<Mutex<BTreeMap<String, u64>>>;
type Names = Arc<Mutex<Vec<String>>>;

impl Topic {
    /// A topic of messages of type `M`, by its full name.
    pub fn of<M: Message>(name: &str) -> Self {
        Self {
            name: name.to_owned(),
            type_name: M::TYPE,
            schema: M::schema(),
            qos: qos::every_input(),
            latched: false,
            subscribe: |runtime, name, qos, call| runtime.subscribe_bytes::<M>(name, qos, call),
        }
    }

    /// The same topic, whose publisher keeps its last message for late subscribers.
    pub fn latched(self) -> Self {
        Self { qos: qos::latched(), latched: true, ..self }
    }
}

/// A recording under way, on a thread of its own.
#[derive(Debug)]
pub struct Recorder {
    stop: Shutdown,
    counts: Counts,
    published: Names,
    thread: Option<JoinHandle<Result<PathBuf>>>,
}

impl Recorder {
    /// Starts to record `topics` into the bag folder `bag`, which must not exist yet; returns once all are subscribed.
    ///
    /// # Errors
    /// If the node, a subscription or the bag can't be made.
    pub fn start(bag: &Path, topics: Vec<Topic>) -> Result<Self> {
        let (stop, counts, published) = (Shutdown::default(), Counts::default(), Names::default());
        let (ready_sender, ready) = channel();
        let thread = {
            let (bag, stop, counts, published) = (bag.to_path_buf(), stop.clone(), counts.clone(), published.clone());
            std::thread::Builder::new()
                .name("recorder".into())
                .spawn(move || record(&bag, &topics, &stop, &counts, published, &ready_sender))?
        };
        let mut recorder = Self { stop, counts, published, thread: Some(thread) };
        if ready.recv().is_err() {
            // The thread ended before it was ready: its result says why.
            recorder.join()?;
            return Err(anyhow!("the recorder ended before it started"));
        }
        Ok(recorder)
    }

    /// Messages recorded so far on `topic`.
    pub fn count(&self, topic: &str) -> u64 {
        lock(&self.counts).get(topic).copied().unwrap_or(0)
    }

    /// Topics of the recording that somebody publishes at present.
    pub fn published(&self) -> Vec<String> {
        lock(&self.published).clone()
    }

    /// Whether the recording ended by itself, which only an error makes it do.
    pub fn has_failed(&self) -> bool {
        self.thread.as_ref().is_none_or(JoinHandle::is_finished)
    }

    /// Stops and closes the bag; returns its folder.
    ///
    /// # Errors
    /// If recording failed on the way or the bag can't be closed.
    pub fn finish(mut self) -> Result<PathBuf> {
        self.join()
    }

    fn join(&mut self) -> Result<PathBuf> {
        self.stop.request();
        let thread = self.thread.take().context("the recorder was stopped before")?;
        thread.join().map_err(|_| anyhow!("the recorder's thread panicked"))?
    }
}

impl Drop for Recorder {
    fn drop(&mut self) {
        if self.thread.is_some() {
            // The caller is on its way out with an error of its own.
            let _ = self.join();
        }
    }
}

/// The recorder's thread: one node, spun here; each message is written before the next look at ROS.
fn record(
    bag: &Path,
    topics: &[Topic],
    stop: &Shutdown,
    counts: &Counts,
    published: Names,
    ready: &Sender<()>,
) -> Result<PathBuf> {
    let mut runtime = Runtime::create("recorder", &[super::params::Parameter::use_sim_time()])?;
    let mut writer = BagWriter::create(bag)?;
    for topic in topics {
        writer.add_topic(&topic.name, topic.type_name, &topic.schema, topic.latched)?;
    }
    let writer = Rc::new(RefCell::new(writer));
    let failure = Rc::new(RefCell::new(None));
    for topic in topics {
        let (name, counts, stop) = (topic.name.clone(), counts.clone(), stop.clone());
        let (writer, failure) = (Rc::clone(&writer), Rc::clone(&failure));
        let write = move |payload: Vec<u8>| {
            let now = nanos_now();
            match writer.borrow_mut().write(&name, &payload, now, now) {
                Ok(()) => *lock(&counts).entry(name.clone()).or_default() += 1,
                Err(error) => {
                    failure.borrow_mut().get_or_insert(error);
                    stop.request();
                }
            }
        };
        (topic.subscribe)(&mut runtime, &topic.name, topic.qos.clone(), Box::new(write))?;
    }
    let names: Vec<String> = topics.iter().map(|topic| topic.name.clone()).collect();
    runtime.every(LOOK, move |runtime| {
        let has_publisher = |name: &&String| runtime.publishers_are_reliable(name).is_ok_and(|all| !all.is_empty());
        *lock(&published) = names.iter().filter(has_publisher).cloned().collect();
    });
    let _ = ready.send(());
    runtime.spin(stop);
    drop(runtime);
    if let Some(error) = failure.borrow_mut().take() {
        return Err(error).with_context(|| bag.display().to_string());
    }
    let writer = Rc::try_unwrap(writer).map_err(|_| anyhow!("a subscription outlived its node"))?;
    writer.into_inner().finish()?;
    Ok(bag.to_path_buf())
}

fn nanos_now() -> u64 {
    let elapsed = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    u64::try_from(elapsed.as_nanos()).unwrap_or(u64::MAX)
}

fn lock<T>(mutex: &Mutex<T>) -> std::sync::MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
