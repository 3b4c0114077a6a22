//! ROS executor of a node: subscriptions, services, actions and timers, served on one thread.

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
use super::shutdown::Shutdown;
use super::topic_names::TopicNames;
use super::worker_thread::WorkerThread;
use crate::error::Result;
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
    /// Wraps an r2r node; [`super::create::create`] makes one with parameter services.
    pub(crate) fn new(
        node: r2r::Node,
        names: TopicNames,
        clock: RosClock,
        log: Log,
        parameters: Arc<Parameters>,
    ) -> Self {
        Self { node, names, polls: Vec::new(), timers: Vec::new(), clock, log, parameters }
    }

    /// Parameters of the node.
    pub(crate) fn parameters(&self) -> &Arc<Parameters> {
        &self.parameters
    }

    /// Log of the node.
    pub(crate) fn log(&self) -> &Log {
        &self.log
    }

    /// Clock of the node.
    pub(crate) fn clock(&self) -> &RosClock {
        &self.clock
    }

    /// Returns the node's name without namespace.
    ///
    /// # Errors
    /// If the ROS node is no longer valid.
    pub(crate) fn name(&self) -> anyhow::Result<String> {
        Ok(self.node.name()?)
    }

    /// Returns the full name of a topic after remapping.
    pub(crate) fn resolve(&self, topic: &str) -> String {
        self.names.resolve(topic)
    }

    /// Returns one entry per publisher on a resolved topic: true if that publisher is reliable.
    ///
    /// # Errors
    /// If ROS cannot list the publishers.
    pub(crate) fn publishers_are_reliable(&self, topic: &str) -> anyhow::Result<Vec<bool>> {
        let publishers = self.node.get_publishers_info_by_topic(topic, false)?;
        Ok(publishers.iter().map(|p| p.qos_profile.reliability != r2r::qos::ReliabilityPolicy::BestEffort).collect())
    }

    /// Creates a publisher on `topic` (relative, private or absolute; remappable).
    ///
    /// # Errors
    /// If ROS refuses the topic name or the quality of service.
    pub(crate) fn publisher<M: Message>(&mut self, topic: &str, qos: QosProfile) -> anyhow::Result<Publisher<M>> {
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
    ) -> anyhow::Result<()> {
        let stream = self.node.subscribe_raw(topic, M::TYPE, qos);
        let stream = stream.with_context(|| format!("cannot subscribe to {topic} as {}", M::TYPE))?;
        self.poll(stream, call);
        Ok(())
    }

    /// Subscribes to `topic` and calls `call` with each decoded message, or with the decoding error.
    ///
    /// # Errors
    /// If ROS refuses the topic name or the quality of service.
    pub(crate) fn subscribe<M: Message>(
        &mut self,
        topic: &str,
        qos: QosProfile,
        mut call: impl FnMut(Result<M>) + 'static,
    ) -> anyhow::Result<()> {
        self.subscribe_bytes::<M>(topic, qos, move |payload| call(M::from_cdr(&payload)))
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
        self.poll(requests, take);
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
        let client = self.node.create_client::<S>(name, QosProfile::services_default());
        let client = client.with_context(|| format!("cannot use the service {name}"))?;
        let mut response = Box::pin(client.request(request).with_context(|| format!("cannot call {name}"))?);
        let (mut done, deadline) = (Some(done), Instant::now() + timeout);
        self.polls.push(Box::new(move || {
            // Capture the client: without it the response never arrives.
            let _ = &client;
            if done.is_none() {
                return;
            }
            let outcome = match response.as_mut().now_or_never() {
                Some(response) => response.ok(),
                None if Instant::now() > deadline => None,
                None => return,
            };
            if let Some(done) = done.take() {
                done(outcome);
            }
        }));
        Ok(())
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
        self.poll(requests, take);
        Ok(())
    }

    /// Calls `call` every `period` of the wall clock; missed ticks are skipped.
    pub(crate) fn every(&mut self, period: Duration, call: impl FnMut(&mut Runtime) + 'static) {
        self.timers.push(Timer { period, next: Instant::now() + period, call: Box::new(call) });
    }

    /// Serves ROS until `shutdown`.
    pub(crate) fn spin(&mut self, shutdown: &Shutdown) {
        while !shutdown.requested() {
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
        for poll in &mut self.polls {
            poll();
        }
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
    /// `spin_once` fills, on this thread, so it needs no waker.
    fn poll<T>(&mut self, mut stream: impl Stream<Item = T> + Unpin + 'static, mut call: impl FnMut(T) + 'static) {
        self.polls.push(Box::new(move || {
            while let Some(Some(item)) = stream.next().now_or_never() {
                call(item);
            }
        }));
    }
}
