//! The ROS side of a node: topics as bytes of [`crate::message`], services, timers, and the loop that serves them.

use std::fmt;
use std::marker::PhantomData;
use std::panic;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use anyhow::{Context as _, anyhow, bail};
use futures::{FutureExt, Stream, StreamExt};
use r2r::{
    ActionServerGoalRequest, QosProfile, ServiceRequest, WrappedActionTypeSupport, WrappedServiceTypeSupport,
    WrappedTypesupport,
};

use super::log::Log;
use super::names::Names;
use super::params::{Parameter, Parameters};
use super::{Shutdown, parameter_services, qos};
use crate::error::Result;
use crate::message::{Message, Time};

/// How long the loop waits for ROS before it looks at timers and the shutdown flag: the longest delay of either.
const SPIN: Duration = Duration::from_millis(10);

/// A ROS node with its parameters and log.
///
/// Callbacks run on the thread that calls [`Runtime::spin`] and must be short. They take each message right after
/// `spin_once` put it into r2r's queue, so that this queue, which drops the newest when full, never fills.
pub struct Runtime {
    node: r2r::Node,
    names: Names,
    polls: Vec<Box<dyn FnMut()>>,
    timers: Vec<Timer>,
    clock: RosClock,
    log: Log,
    parameters: Arc<Parameters>,
}

struct Timer {
    period: Duration,
    next: Instant,
    call: Box<dyn FnMut(&mut Runtime)>,
}

impl Runtime {
    /// Creates the node `name` (remappable) with parameter services for `table`, `/rosout` and `/parameter_events`.
    ///
    /// # Errors
    /// If ROS refuses its arguments, or a parameter given at start is unfit; the error names it and its range.
    pub fn create(name: &str, table: &[Parameter]) -> anyhow::Result<Self> {
        let context = context()?;
        let mut node = r2r::Node::create(context, name, "").with_context(|| format!("cannot create node {name}"))?;
        let full_name = node.fully_qualified_name()?;
        let names = Names::new(&node.namespace()?, &node.name()?, std::env::args().skip(1));

        let given = Arc::clone(&node.params);
        let given = given.lock().unwrap_or_else(PoisonError::into_inner);
        let given = given.iter().map(|(name, given)| (name.as_str(), &given.value));
        let (parameters, unknown) = Parameters::new(table, given)?;
        let parameters = Arc::new(parameters);
        if parameters.get::<bool>("use_sim_time") {
            let time_source = node.get_time_source();
            time_source.enable_sim_time(&mut node)?;
        }
        let clock = RosClock(node.get_ros_clock());
        let rosout = Publisher::create(&mut node, "/rosout", qos::rosout())?;
        let log = Log::new(logger_name(&full_name), clock.clone(), rosout);
        for name in unknown {
            log.warn(format!("parameter {name} is unknown and ignored; known: {}", parameters.names()));
        }
        let mut runtime = Self { node, names, polls: Vec::new(), timers: Vec::new(), clock, log, parameters };
        parameter_services::serve(&mut runtime, full_name)?;
        Ok(runtime)
    }

    /// The node's parameters.
    pub fn parameters(&self) -> &Arc<Parameters> {
        &self.parameters
    }

    /// The node's log.
    pub fn log(&self) -> &Log {
        &self.log
    }

    /// The node's clock.
    pub fn clock(&self) -> &RosClock {
        &self.clock
    }

    /// The node's name without namespace.
    ///
    /// # Errors
    /// If ROS lost the node.
    pub fn name(&self) -> anyhow::Result<String> {
        Ok(self.node.name()?)
    }

    /// The full name of a topic after remapping.
    pub fn resolve(&self, topic: &str) -> String {
        self.names.resolve(topic)
    }

    /// Whether the publishers on a resolved topic are reliable, one entry each.
    ///
    /// # Errors
    /// If ROS can't say.
    pub fn publishers_are_reliable(&self, topic: &str) -> anyhow::Result<Vec<bool>> {
        let publishers = self.node.get_publishers_info_by_topic(topic, false)?;
        Ok(publishers.iter().map(|p| p.qos_profile.reliability != r2r::qos::ReliabilityPolicy::BestEffort).collect())
    }

    /// Publishes on `topic` (relative, private or absolute; remappable).
    ///
    /// # Errors
    /// If ROS refuses the name or the quality of service.
    pub fn publisher<M: Message>(&mut self, topic: &str, qos: QosProfile) -> anyhow::Result<Publisher<M>> {
        Publisher::create(&mut self.node, topic, qos)
    }

    /// Publishes r2r's own form of a message.
    pub(super) fn native_publisher<T: WrappedTypesupport>(
        &mut self,
        topic: &str,
        qos: QosProfile,
    ) -> anyhow::Result<r2r::Publisher<T>> {
        self.node.create_publisher(topic, qos).with_context(|| format!("cannot publish {topic}"))
    }

    /// Calls `call` with each payload on `topic`, still as bytes, so that one which is displaced costs nothing.
    ///
    /// # Errors
    /// If ROS refuses the name or the quality of service.
    pub fn subscribe_bytes<M: Message>(
        &mut self,
        topic: &str,
        qos: QosProfile,
        call: impl FnMut(Vec<u8>) + 'static,
    ) -> anyhow::Result<()> {
        let stream = self.node.subscribe_raw(topic, M::TYPE, qos);
        let stream = stream.with_context(|| format!("cannot subscribe to {topic} as {}", M::TYPE))?;
        self.poll(stream, call);
        Ok(())
    }

    /// Calls `call` with each message on `topic`, or with what is wrong with it.
    ///
    /// # Errors
    /// If ROS refuses the name or the quality of service.
    pub fn subscribe<M: Message>(
        &mut self,
        topic: &str,
        qos: QosProfile,
        mut call: impl FnMut(Result<M>) + 'static,
    ) -> anyhow::Result<()> {
        self.subscribe_bytes::<M>(topic, qos, move |payload| call(M::from_cdr(&payload)))
    }

    /// Answers the service `name`.
    ///
    /// # Errors
    /// If ROS refuses the name.
    pub fn service<S: WrappedServiceTypeSupport + 'static>(
        &mut self,
        name: &str,
        mut answer: impl FnMut(&S::Request) -> S::Response + 'static,
    ) -> anyhow::Result<()> {
        let requests = self.node.create_service::<S>(name, QosProfile::services_default());
        let requests = requests.with_context(|| format!("cannot offer the service {name}"))?;
        let log = self.log.clone();
        let name = name.to_owned();
        self.poll(requests, move |request| {
            let response = answer(&request.message);
            if let Err(error) = request.respond(response) {
                log.warn_throttled(&name, format!("{name}: the answer could not be sent: {error}"));
            }
        });
        Ok(())
    }

    /// As [`Runtime::service`]; `take` answers later, by its `respond`, from whatever thread it likes.
    ///
    /// # Errors
    /// If ROS refuses the name.
    pub(super) fn service_later<S: WrappedServiceTypeSupport + 'static>(
        &mut self,
        name: &str,
        take: impl FnMut(ServiceRequest<S>) + 'static,
    ) -> anyhow::Result<()> {
        let requests = self.node.create_service::<S>(name, QosProfile::services_default());
        let requests = requests.with_context(|| format!("cannot offer the service {name}"))?;
        self.poll(requests, take);
        Ok(())
    }

    /// Calls the service `name` once; `done` gets the answer, or None if none comes in time.
    ///
    /// # Errors
    /// If ROS refuses the name or the request.
    pub(super) fn call<S: WrappedServiceTypeSupport + 'static>(
        &mut self,
        name: &str,
        request: &S::Request,
        patience: Duration,
        done: impl FnOnce(Option<S::Response>) + 'static,
    ) -> anyhow::Result<()> {
        let client = self.node.create_client::<S>(name, QosProfile::services_default());
        let client = client.with_context(|| format!("cannot use the service {name}"))?;
        let mut answer = Box::pin(client.request(request).with_context(|| format!("cannot call {name}"))?);
        let (mut done, deadline) = (Some(done), Instant::now() + patience);
        self.polls.push(Box::new(move || {
            // The client lives as long as its answer is awaited.
            let _ = &client;
            if done.is_none() {
                return;
            }
            match answer.as_mut().now_or_never() {
                Some(answer) => {
                    if let Some(done) = done.take() {
                        done(answer.ok());
                    }
                }
                None if Instant::now() > deadline => {
                    if let Some(done) = done.take() {
                        done(None);
                    }
                }
                None => {}
            }
        }));
        Ok(())
    }

    /// Serves the action `name`.
    ///
    /// # Errors
    /// If ROS refuses the name.
    pub(super) fn action_server<A: WrappedActionTypeSupport + 'static>(
        &mut self,
        name: &str,
        take: impl FnMut(ActionServerGoalRequest<A>) + 'static,
    ) -> anyhow::Result<()> {
        let requests = self.node.create_action_server::<A>(name);
        let requests = requests.with_context(|| format!("cannot offer the action {name}"))?;
        self.poll(requests, take);
        Ok(())
    }

    /// Calls `call` every `period` of the wall clock; ticks that were missed are left out.
    pub fn every(&mut self, period: Duration, call: impl FnMut(&mut Runtime) + 'static) {
        self.timers.push(Timer { period, next: Instant::now() + period, call: Box::new(call) });
    }

    /// Serves ROS until `shutdown`.
    pub fn spin(&mut self, shutdown: &Shutdown) {
        while !shutdown.requested() {
            self.spin_once();
        }
    }

    /// Serves what ROS has now, waiting a moment for it.
    pub fn spin_once(&mut self) {
        self.node.spin_once(SPIN);
        for poll in &mut self.polls {
            poll();
        }
        // A timer may add subscriptions and timers, so they leave the runtime while they run.
        let mut timers = std::mem::take(&mut self.timers);
        for timer in &mut timers {
            let now = Instant::now();
            if now >= timer.next {
                timer.next = (timer.next + timer.period).max(now);
                (timer.call)(self);
            }
        }
        timers.append(&mut self.timers);
        self.timers = timers;
    }

    /// Hands on whatever a stream of r2r holds after each spin. Such a stream is a channel that only `spin_once` fills,
    /// on this thread, so no waker is needed.
    fn poll<T>(&mut self, mut stream: impl Stream<Item = T> + Unpin + 'static, mut call: impl FnMut(T) + 'static) {
        self.polls.push(Box::new(move || {
            while let Some(Some(item)) = stream.next().now_or_never() {
                call(item);
            }
        }));
    }
}

impl fmt::Debug for Runtime {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Runtime").field("names", &self.names).finish_non_exhaustive()
    }
}

/// Publishes messages of one type; can move to another thread, and fails once the node is gone.
pub struct Publisher<M> {
    inner: r2r::PublisherUntyped,
    message: PhantomData<fn(&M)>,
}

impl<M: Message> Publisher<M> {
    fn create(node: &mut r2r::Node, topic: &str, qos: QosProfile) -> anyhow::Result<Self> {
        let inner = node.create_publisher_untyped(topic, M::TYPE, qos);
        let inner = inner.with_context(|| format!("cannot publish {topic} as {}", M::TYPE))?;
        Ok(Self { inner, message: PhantomData })
    }

    /// Sends a message.
    ///
    /// # Errors
    /// If the node is gone or the middleware refuses.
    pub fn publish(&self, message: &M) -> anyhow::Result<()> {
        Ok(self.inner.publish_raw(&message.to_cdr())?)
    }

    /// How many subscribers are connected; 0 when ROS can't say.
    pub fn listeners(&self) -> usize {
        self.inner.get_inter_process_subscription_count().unwrap_or(0)
    }

    /// Whether anybody listens.
    pub fn is_heard(&self) -> bool {
        self.listeners() > 0
    }
}

impl<M> fmt::Debug for Publisher<M> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.inner.fmt(f)
    }
}

/// The node's clock: the wall clock, or `/clock` when the parameter `use_sim_time` is set.
#[derive(Clone)]
pub struct RosClock(Arc<Mutex<r2r::Clock>>);

impl RosClock {
    /// Now; zero while simulated time is wanted and has not come yet.
    pub fn now(&self) -> Time {
        let now = self.0.lock().unwrap_or_else(PoisonError::into_inner).get_now();
        let nanos = now.map_or(0, |now| i64::try_from(now.as_nanos()).unwrap_or(i64::MAX));
        Time::from_nanos(nanos)
    }

    /// Seconds from `stamp` to now; None when either is unset.
    pub fn secs_since(&self, stamp: Time) -> Option<f64> {
        let now = self.now();
        (!stamp.is_zero() && !now.is_zero()).then(|| (now.nanos() - stamp.nanos()) as f64 * 1e-9)
    }
}

impl fmt::Debug for RosClock {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("RosClock")
    }
}

/// The process's ROS context. r2r panics on arguments that ROS refuses; that becomes an error.
fn context() -> anyhow::Result<r2r::Context> {
    let hook = panic::take_hook();
    panic::set_hook(Box::new(|_| {}));
    let created = panic::catch_unwind(r2r::Context::create);
    panic::set_hook(hook);
    match created {
        Ok(context) => Ok(context.context("cannot start ROS")?),
        Err(reason) => {
            let reason = reason.downcast_ref::<String>().map_or("ROS refused its arguments", String::as_str);
            // What comes after the first comma is the place in ROS's own source.
            bail!("ROS arguments: {}", reason.split(", at /").next().unwrap_or(reason))
        }
    }
}

/// A logger's name: the node's full name with dots.
fn logger_name(full_name: &str) -> String {
    full_name.trim_start_matches('/').replace('/', ".")
}

/// Joins a worker thread; its panic becomes an error.
pub(super) fn join(worker: std::thread::JoinHandle<anyhow::Result<()>>, what: &str) -> anyhow::Result<()> {
    worker.join().map_err(|_| anyhow!("the {what} thread panicked"))?
}
