//! ROS executor of a node: subscriptions, services, actions and timers, served on one thread.

use std::any::{Any, TypeId};
use std::cell::Cell;
use std::collections::{BTreeMap, HashMap};
use std::rc::Rc;
use std::sync::Arc;
use std::time::{Duration, Instant};

use anyhow::Context as _;
use futures::{FutureExt, Stream, StreamExt};
use r2r::{
    ActionServerGoalRequest, QosProfile, ServiceRequest, WrappedActionTypeSupport, WrappedServiceTypeSupport,
    WrappedTypesupport,
};

use super::clock::RosClock;
use super::log::Log;
use super::params::Parameters;
use super::publisher::Publisher;
use super::qos_overrides::{Endpoint, QosOverrides};
use super::shutdown::Shutdown;
use super::topic_names::TopicNames;
use super::worker_thread::WorkerThread;
use crate::message::Message;

/// Longest wait for ROS in one cycle of the loop; bounds the delay of timers and of the shutdown flag.
const SPIN_TIMEOUT: Duration = Duration::from_millis(10);

/// A ROS node with its parameters and log. Messages travel as the bytes that [`crate::message`] reads and writes.
///
/// Callbacks run on the thread that calls [`Runtime::spin`] and must be short. They take each message right after
/// `spin_once` put it into r2r's queue: that queue drops the newest message when it is full, so it must stay empty.
pub(crate) struct Runtime {
    node: r2r::Node,
    names: TopicNames,
    /// Each returns false once it is not needed any longer.
    polls: Vec<Box<dyn FnMut() -> bool>>,
    /// Clients of services that were called; r2r keeps each until the node ends.
    clients: HashMap<(TypeId, String), Rc<dyn Any>>,
    qos_overrides: QosOverrides,
    /// State of the modules that build on this one, one value of each type.
    extensions: HashMap<TypeId, Box<dyn Any>>,
    follower: Option<Box<dyn Follower>>,
    timers: Vec<Timer>,
    clock: RosClock,
    log: Log,
    parameters: Arc<Parameters>,
}

/// Follower of a node's course.
pub(crate) trait Follower {
    /// Learns that all topics and services of the node exist.
    fn configured(&self, log: &Log);

    /// Learns that the node ends; returns true if a response must still leave.
    fn ended(&self, log: &Log) -> bool;
}

/// Quality of service of a publisher on a topic.
#[derive(Debug, Clone, Copy)]
pub(crate) struct PublisherQos {
    /// True unless it is best effort.
    pub(crate) reliable: bool,
    /// True if late subscribers get its last messages.
    pub(crate) transient_local: bool,
}

/// A subscription; lasts until [`Self::cancel`] or the end of the node.
pub(crate) struct Subscription(Rc<Cell<bool>>);

impl Subscription {
    /// Ends the subscription.
    pub(crate) fn cancel(self) {
        self.0.set(false);
    }
}

struct Timer {
    period: Duration,
    next: Instant,
    call: Box<dyn FnMut(&mut Runtime)>,
}

impl Runtime {
    /// Wraps an r2r node; [`super::create::create`] makes one with parameter services.
    pub(crate) fn new(
        node: r2r::Node,
        names: TopicNames,
        clock: RosClock,
        log: Log,
        parameters: Arc<Parameters>,
        qos_overrides: QosOverrides,
    ) -> Self {
        Self {
            node,
            names,
            polls: Vec::new(),
            clients: HashMap::new(),
            qos_overrides,
            extensions: HashMap::new(),
            follower: None,
            timers: Vec::new(),
            clock,
            log,
            parameters,
        }
    }

    /// Parameters of the node.
    pub(crate) fn parameters(&self) -> &Arc<Parameters> {
        &self.parameters
    }

    /// Keeps a value for a module that builds on this one, in place of an earlier one of its type.
    pub(crate) fn set_extension<T: 'static>(&mut self, value: T) {
        self.extensions.insert(TypeId::of::<T>(), Box::new(value));
    }

    /// Returns the value of a type that [`Self::set_extension`] kept; None if there is none.
    pub(crate) fn extension<T: 'static>(&self) -> Option<&T> {
        self.extensions.get(&TypeId::of::<T>())?.downcast_ref()
    }

    /// Returns the value of a type that [`Self::set_extension`] kept, for changes; None if there is none.
    pub(crate) fn extension_mut<T: 'static>(&mut self) -> Option<&mut T> {
        self.extensions.get_mut(&TypeId::of::<T>())?.downcast_mut()
    }

    /// Keeps the follower of this node's course.
    pub(crate) fn set_follower(&mut self, follower: impl Follower + 'static) {
        self.follower = Some(Box::new(follower));
    }

    /// Log of the node.
    pub(crate) fn log(&self) -> &Log {
        &self.log
    }

    /// Clock of the node.
    pub(crate) fn clock(&self) -> &RosClock {
        &self.clock
    }

    /// Takes the time from `/clock`, or from the wall clock.
    ///
    /// # Errors
    /// If ROS refuses the subscription to `/clock`.
    pub(crate) fn simulate_time(&mut self, from_clock: bool) -> anyhow::Result<()> {
        let time_source = self.node.get_time_source();
        match from_clock {
            true => time_source.enable_sim_time(&mut self.node)?,
            false => time_source.disable_sim_time(),
        }
        Ok(())
    }

    /// Returns the node's full name without the first slash, for instance `robot/predictor`.
    ///
    /// # Errors
    /// If the ROS node is no longer valid.
    pub(crate) fn full_name(&self) -> anyhow::Result<String> {
        Ok(self.node.fully_qualified_name()?.trim_start_matches('/').to_owned())
    }

    /// Returns `qos` with the overrides for a subscription to `topic`, which is a full name.
    pub(crate) fn subscription_qos(&self, topic: &str, qos: QosProfile) -> QosProfile {
        self.qos_overrides.apply(topic, Endpoint::Subscription, qos)
    }

    /// Returns true if an override gives the reliability of a subscription to `topic`, which is a full name.
    pub(crate) fn overrides_reliability(&self, topic: &str) -> bool {
        self.qos_overrides.fix_reliability(topic)
    }

    /// Returns the full name of a topic after remapping.
    pub(crate) fn resolve(&self, topic: &str) -> String {
        self.names.resolve(topic)
    }

    /// Returns one entry per publisher on a resolved topic.
    ///
    /// # Errors
    /// If ROS cannot list the publishers.
    pub(crate) fn publishers(&self, topic: &str) -> anyhow::Result<Vec<PublisherQos>> {
        use r2r::qos::{DurabilityPolicy, ReliabilityPolicy};
        let publishers = self.node.get_publishers_info_by_topic(topic, false)?;
        let qos = |profile: &QosProfile| PublisherQos {
            reliable: profile.reliability != ReliabilityPolicy::BestEffort,
            transient_local: profile.durability == DurabilityPolicy::TransientLocal,
        };
        Ok(publishers.iter().map(|publisher| qos(&publisher.qos_profile)).collect())
    }

    /// Returns the types of all topics, by their full names.
    ///
    /// # Errors
    /// If ROS cannot list the topics.
    pub(crate) fn topics(&self) -> anyhow::Result<BTreeMap<String, Vec<String>>> {
        Ok(self.node.get_topic_names_and_types()?.into_iter().collect())
    }

    /// Creates a publisher on `topic` (relative, private or absolute; remappable).
    ///
    /// # Errors
    /// If ROS refuses the topic name or the quality of service.
    pub(crate) fn publisher<M: Message>(&mut self, topic: &str, qos: QosProfile) -> anyhow::Result<Publisher<M>> {
        let qos = self.qos_overrides.apply(&self.names.resolve(topic), Endpoint::Publisher, qos);
        Publisher::create(&mut self.node, topic, qos)
    }

    /// Creates a publisher of r2r's own message types.
    ///
    /// # Errors
    /// If ROS refuses the topic name or the quality of service.
    pub(crate) fn native_publisher<T: WrappedTypesupport>(
        &mut self,
        topic: &str,
        qos: QosProfile,
    ) -> anyhow::Result<r2r::Publisher<T>> {
        self.node.create_publisher(topic, qos).with_context(|| format!("cannot publish {topic}"))
    }

    /// Subscribes to `topic` and calls `call` with the bytes of each message. Decoding is left to the receiver, so that a
    /// message which a newer one replaces costs nothing.
    ///
    /// # Errors
    /// If ROS refuses the topic name or the quality of service.
    pub(crate) fn subscribe_bytes<M: Message>(
        &mut self,
        topic: &str,
        qos: QosProfile,
        call: impl FnMut(Vec<u8>) + 'static,
    ) -> anyhow::Result<Subscription> {
        let stream = self.node.subscribe_raw(topic, M::TYPE, qos);
        let stream = stream.with_context(|| format!("cannot subscribe to {topic} as {}", M::TYPE))?;
        let is_wanted = Rc::new(Cell::new(true));
        self.poll(stream, Rc::clone(&is_wanted), call);
        Ok(Subscription(is_wanted))
    }

    /// Offers the service `name`; `answer` runs on the spinning thread.
    ///
    /// # Errors
    /// If ROS refuses the service name.
    pub(crate) fn service<S: WrappedServiceTypeSupport + 'static>(
        &mut self,
        name: &str,
        mut answer: impl FnMut(&S::Request) -> S::Response + 'static,
    ) -> anyhow::Result<()> {
        let log = self.log.clone();
        let service = name.to_owned();
        self.deferred_service::<S>(name, move |request| {
            let response = answer(&request.message);
            if let Err(error) = request.respond(response) {
                log.warn_throttled(&service, format!("{service}: cannot send the response: {error}"));
            }
        })
    }

    /// Offers the service `name`; `take` may respond later and from any thread.
    ///
    /// # Errors
    /// If ROS refuses the service name.
    pub(crate) fn deferred_service<S: WrappedServiceTypeSupport + 'static>(
        &mut self,
        name: &str,
        take: impl FnMut(ServiceRequest<S>) + 'static,
    ) -> anyhow::Result<()> {
        let requests = self.node.create_service::<S>(name, QosProfile::services_default());
        let requests = requests.with_context(|| format!("cannot offer the service {name}"))?;
        self.poll(requests, Rc::new(Cell::new(true)), take);
        Ok(())
    }

    /// Calls the service `name` once; `done` gets the response, or None if none arrives within `timeout`.
    ///
    /// # Errors
    /// If ROS refuses the service name or the request.
    pub(crate) fn call<S: WrappedServiceTypeSupport + 'static>(
        &mut self,
        name: &str,
        request: &S::Request,
        timeout: Duration,
        done: impl FnOnce(Option<S::Response>) + 'static,
    ) -> anyhow::Result<()> {
        let client = self.client::<S>(name)?;
        let mut response = Box::pin(client.request(request).with_context(|| format!("cannot call {name}"))?);
        let (mut done, deadline) = (Some(done), Instant::now() + timeout);
        self.polls.push(Box::new(move || {
            let outcome = match response.as_mut().now_or_never() {
                Some(response) => response.ok(),
                None if Instant::now() > deadline => None,
                None => return true,
            };
            if let Some(done) = done.take() {
                done(outcome);
            }
            false
        }));
        Ok(())
    }

    /// Returns the client of a service, which is created once.
    fn client<S: WrappedServiceTypeSupport + 'static>(&mut self, name: &str) -> anyhow::Result<Rc<r2r::Client<S>>> {
        let key = (TypeId::of::<S>(), name.to_owned());
        if let Some(Ok(client)) = self.clients.get(&key).map(|client| Rc::clone(client).downcast()) {
            return Ok(client);
        }
        let client = self.node.create_client::<S>(name, QosProfile::services_default());
        let client = Rc::new(client.with_context(|| format!("cannot use the service {name}"))?);
        self.clients.insert(key, Rc::clone(&client) as Rc<dyn Any>);
        Ok(client)
    }

    /// Offers the action `name`; `take` gets each goal request.
    ///
    /// # Errors
    /// If ROS refuses the action name.
    pub(crate) fn action_server<A: WrappedActionTypeSupport + 'static>(
        &mut self,
        name: &str,
        take: impl FnMut(ActionServerGoalRequest<A>) + 'static,
    ) -> anyhow::Result<()> {
        let requests = self.node.create_action_server::<A>(name);
        let requests = requests.with_context(|| format!("cannot offer the action {name}"))?;
        self.poll(requests, Rc::new(Cell::new(true)), take);
        Ok(())
    }

    /// Calls `call` every `period` of the wall clock; missed ticks are skipped.
    pub(crate) fn every(&mut self, period: Duration, call: impl FnMut(&mut Runtime) + 'static) {
        self.timers.push(Timer { period, next: Instant::now() + period, call: Box::new(call) });
    }

    /// Serves ROS until `shutdown`; the node's topics and services exist now.
    pub(crate) fn spin(&mut self, shutdown: &Shutdown) {
        if let Some(follower) = &self.follower {
            follower.configured(&self.log);
        }
        for name in self.qos_overrides.unused() {
            self.log.warn(format!("parameter {name} is ignored: the node has no such publisher or subscription"));
        }
        while !shutdown.requested() {
            self.spin_once();
        }
    }

    /// Serves ROS for some time, also after shutdown was requested, so that last responses leave.
    pub(crate) fn spin_for(&mut self, time: Duration) {
        let end = Instant::now() + time;
        while Instant::now() < end {
            self.spin_once();
        }
    }

    /// Joins the worker thread, then drops the ROS node, in this order: DDS crashes if a node is dropped while another
    /// thread publishes, or left to process exit.
    ///
    /// # Errors
    /// If the worker failed or panicked.
    pub(crate) fn finish(self, worker: WorkerThread) -> anyhow::Result<()> {
        let result = worker.join();
        drop(self);
        result
    }

    fn spin_once(&mut self) {
        self.node.spin_once(SPIN_TIMEOUT);
        self.polls.retain_mut(|poll| poll());
        // A timer may add subscriptions and timers, so the timers leave the runtime while they run.
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

    /// Passes everything that an r2r stream holds to `call` after each spin. Such a stream is a channel that only
    /// `spin_once` fills, on this thread, so it needs no waker. Ends once `is_wanted` is false.
    fn poll<T>(
        &mut self,
        mut stream: impl Stream<Item = T> + Unpin + 'static,
        is_wanted: Rc<Cell<bool>>,
        mut call: impl FnMut(T) + 'static,
    ) {
        self.polls.push(Box::new(move || {
            while is_wanted.get()
                && let Some(Some(item)) = stream.next().now_or_never()
            {
                call(item);
            }
            is_wanted.get()
        }));
    }
}

/// Time for a last response to leave: the middleware drops those that wait when their service ends.
const FAREWELL: Duration = Duration::from_millis(300);

impl Drop for Runtime {
    /// Tells who asked for a configuration that failed, and waits until last answers have left.
    fn drop(&mut self) {
        if self.follower.take().is_some_and(|follower| follower.ended(&self.log)) {
            // The middleware's own threads send; timers and subscriptions of a node that ended must not run again.
            std::thread::sleep(FAREWELL);
        }
    }
}
