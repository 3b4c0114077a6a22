//! Bag recorder: writes the messages of topics into a bag, byte for byte.

use std::cell::RefCell;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::rc::Rc;
use std::sync::mpsc::{Sender, channel};
use std::sync::{Arc, Mutex};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use anyhow::{Context, Result, anyhow};
use r2r::QosProfile;

use super::create::create;
use super::lock::lock;
use super::params::Parameter;
use super::qos;
use super::runtime::Runtime;
use super::shutdown::Shutdown;
use super::worker_thread::WorkerThread;
use crate::dataset::mcap::BagWriter;
use crate::message::Message;

/// Time between two updates of the list of published topics.
const PUBLISHER_POLL_INTERVAL: Duration = Duration::from_millis(100);

/// Topic to record.
pub(crate) struct RecordedTopic {
    name: String,
    type_name: &'static str,
    schema: String,
    qos: QosProfile,
    latched: bool,
    subscribe: Subscribe,
}

type Subscribe = fn(&mut Runtime, &str, QosProfile, Box<dyn FnMut(Vec<u8>)>) -> Result<()>;

impl RecordedTopic {
    /// Names a topic of messages of type `M` by its full name.
    pub(crate) fn of<M: Message>(name: &str) -> Self {
        Self {
            name: name.to_owned(),
            type_name: M::TYPE,
            schema: M::schema(),
            qos: qos::every_input(),
            latched: false,
            subscribe: |runtime, name, qos, call| runtime.subscribe_bytes::<M>(name, qos, call).map(drop),
        }
    }

    /// Marks the topic as latched: its publisher keeps the last message for late subscribers.
    pub(crate) fn latched(self) -> Self {
        Self { qos: qos::latched(), latched: true, ..self }
    }
}

/// Records topics into a bag, on its own thread.
#[derive(Debug)]
pub(crate) struct BagRecorder {
    bag: PathBuf,
    shutdown: Shutdown,
    status: Arc<Mutex<Status>>,
    worker: Option<WorkerThread>,
}

/// Status of a recording.
#[derive(Debug, Default)]
struct Status {
    /// Messages recorded, by topic.
    counts: BTreeMap<String, u64>,
    /// Topics that have a publisher.
    published: Vec<String>,
}

impl BagRecorder {
    /// Records `topics` into the folder `bag`, which must not exist yet; returns once all topics are subscribed.
    ///
    /// # Errors
    /// If the node, a subscription or the bag cannot be created.
    pub(crate) fn start(bag: &Path, topics: Vec<RecordedTopic>) -> Result<Self> {
        let (shutdown, status) = (Shutdown::default(), Arc::<Mutex<Status>>::default());
        let (ready_sender, ready) = channel();
        let recording = Recording { bag: bag.to_path_buf(), topics, status: Arc::clone(&status) };
        let worker =
            WorkerThread::spawn("recorder", &shutdown, move |shutdown| recording.run(shutdown, &ready_sender))?;
        let mut recorder = Self { bag: bag.to_path_buf(), shutdown, status, worker: Some(worker) };
        if ready.recv().is_err() {
            // The thread ended before it was ready; its result gives the reason.
            recorder.join()?;
            return Err(anyhow!("the recorder ended before it started"));
        }
        Ok(recorder)
    }

    /// Returns the number of messages recorded so far on `topic`.
    pub(crate) fn count(&self, topic: &str) -> u64 {
        lock(&self.status).counts.get(topic).copied().unwrap_or(0)
    }

    /// Returns the recorded topics that have a publisher at present.
    pub(crate) fn published(&self) -> Vec<String> {
        lock(&self.status).published.clone()
    }

    /// Returns true if the recording ended by itself, which happens only after an error.
    pub(crate) fn has_failed(&self) -> bool {
        self.worker.as_ref().is_none_or(WorkerThread::is_finished)
    }

    /// Stops recording and closes the bag; returns its folder.
    ///
    /// # Errors
    /// If a message could not be written or the bag cannot be closed.
    pub(crate) fn finish(mut self) -> Result<PathBuf> {
        self.join()?;
        Ok(self.bag.clone())
    }

    fn join(&mut self) -> Result<()> {
        self.shutdown.request();
        self.worker.take().context("the recorder was stopped before")?.join()
    }
}

impl Drop for BagRecorder {
    fn drop(&mut self) {
        if self.worker.is_some() {
            // Ignore the error: the caller returns with an error of its own.
            let _ = self.join();
        }
    }
}

/// Work of the recorder's thread: one node, spun there; each message is written before the next one is taken.
struct Recording {
    bag: PathBuf,
    topics: Vec<RecordedTopic>,
    status: Arc<Mutex<Status>>,
}

/// Bag with the first error of writing it; the subscriptions of one thread share it.
struct OpenBag {
    writer: BagWriter,
    error: Option<crate::Error>,
}

impl Recording {
    /// Records until `shutdown`; sends to `ready` once all topics are subscribed.
    fn run(self, shutdown: &Shutdown, ready: &Sender<()>) -> Result<()> {
        let mut runtime = create("recorder", &[Parameter::use_sim_time()], None)?;
        let file = Rc::new(RefCell::new(OpenBag { writer: self.create_bag()?, error: None }));
        for topic in &self.topics {
            self.subscribe(&mut runtime, topic, &file, shutdown)?;
        }
        self.watch_publishers(&mut runtime);
        // Ignore the error: without a receiver the shutdown is requested, too.
        let _ = ready.send(());
        runtime.spin(shutdown);
        drop(runtime);
        let file = Rc::try_unwrap(file).map_err(|_| anyhow!("a subscription outlived its node"))?;
        let OpenBag { writer, error } = file.into_inner();
        if let Some(error) = error {
            return Err(error).with_context(|| self.bag.display().to_string());
        }
        writer.finish()?;
        Ok(())
    }

    fn create_bag(&self) -> Result<BagWriter> {
        let mut writer = BagWriter::create(&self.bag)?;
        for topic in &self.topics {
            writer.add_topic(&topic.name, topic.type_name, &topic.schema, topic.latched)?;
        }
        Ok(writer)
    }

    /// Writes each message of a topic; the first error requests shutdown.
    fn subscribe(
        &self,
        runtime: &mut Runtime,
        topic: &RecordedTopic,
        file: &Rc<RefCell<OpenBag>>,
        shutdown: &Shutdown,
    ) -> Result<()> {
        let (name, status, file, shutdown) =
            (topic.name.clone(), Arc::clone(&self.status), Rc::clone(file), shutdown.clone());
        let write = move |payload: Vec<u8>| {
            let now = nanos_now();
            let mut file = file.borrow_mut();
            match file.writer.write(&name, &payload, now, now) {
                Ok(()) => *lock(&status).counts.entry(name.clone()).or_default() += 1,
                Err(error) => {
                    file.error.get_or_insert(error);
                    shutdown.request();
                }
            }
        };
        (topic.subscribe)(runtime, &topic.name, topic.qos.clone(), Box::new(write))
    }

    /// Keeps the list of published topics up to date.
    fn watch_publishers(&self, runtime: &mut Runtime) {
        let names: Vec<String> = self.topics.iter().map(|topic| topic.name.clone()).collect();
        let status = Arc::clone(&self.status);
        runtime.every(PUBLISHER_POLL_INTERVAL, move |runtime| {
            let has_publisher = |name: &&String| runtime.publishers(name).is_ok_and(|all| !all.is_empty());
            let published = names.iter().filter(has_publisher).cloned().collect();
            lock(&status).published = published;
        });
    }
}

/// Returns the wall time, nanoseconds since 1970.
fn nanos_now() -> u64 {
    let elapsed = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    u64::try_from(elapsed.as_nanos()).unwrap_or(u64::MAX)
}
