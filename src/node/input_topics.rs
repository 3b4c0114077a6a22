//! Input topics of a node: subscriptions whose reliability fits the publishers, and a warning where no publisher is.
//!
//! DDS does not connect a reliable subscription to a best-effort publisher, and says nothing. A node therefore looks which
//! publishers a topic has before it subscribes, and again later.

use std::cell::RefCell;
use std::rc::Rc;
use std::time::{Duration, Instant};

use r2r::QosProfile;
use r2r::qos::{DurabilityPolicy, ReliabilityPolicy};

use super::params::{Allowed, Parameter};
use super::runtime::{PublisherQos, Runtime, Subscription};
use super::topic_statistics::TopicStatistics;
use crate::error::Result;
use crate::message::Message;

/// Time between two looks at the publishers of an input that waits for one.
const WAITING_INTERVAL: Duration = Duration::from_millis(100);
/// Time between two looks at the publishers of an input that is subscribed.
const WATCH_INTERVAL: Duration = Duration::from_secs(1);
/// Time without a publisher after which a warning names other topics.
const PATIENCE: Duration = Duration::from_secs(3);

/// An input topic.
#[derive(Debug, Clone)]
pub(crate) struct InputTopic {
    /// Name: relative, private or absolute; remappable.
    pub(crate) name: String,
    /// Content in the log, for instance `images`.
    pub(crate) content: &'static str,
    /// Quality of service; its reliability is used unless the input matches publishers.
    pub(crate) qos: QosProfile,
    /// True to take the reliability of the publishers.
    pub(crate) matches: bool,
    /// Meaning of a topic without publishers.
    pub(crate) need: Need,
}

/// Meaning of a topic without publishers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Need {
    /// The node can't work.
    Required,
    /// The node can't work if no topic of this group has a publisher.
    OneOf(&'static str),
    /// The node works without it.
    Optional,
}

impl InputTopic {
    /// Describes an input of a node that has the parameter `reliability`, which decides the reliability.
    pub(crate) fn new(runtime: &Runtime, name: &str, content: &'static str, qos: QosProfile, need: Need) -> Self {
        let wanted = runtime.parameters().get::<String>("reliability");
        let reliability = match wanted.as_str() {
            "best_effort" => ReliabilityPolicy::BestEffort,
            _ => ReliabilityPolicy::Reliable,
        };
        Self {
            name: name.to_owned(),
            content,
            qos: QosProfile { reliability, ..qos },
            matches: wanted == "match",
            need,
        }
    }
}

/// Declares the parameter `reliability`.
pub(crate) fn reliability_parameter(default: &'static str) -> Parameter {
    Parameter::fixed(
        "reliability",
        default,
        Allowed::OneOf(&["match", "best_effort", "reliable"]),
        "Reliability of the subscriptions; match = that of the publishers, once there is one. qos_overrides.* of a topic come \
         first.",
    )
}

/// Inputs of a node, which [`watch`] looks at.
struct InputTopics(Vec<Input>);

/// State of the warning about a topic without publishers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Warned {
    No,
    /// No other topic had the type: a second warning names the first one that has it.
    WithoutTopics,
    /// The warning has named other topics, and does not come again.
    WithTopics,
}

type Call = Rc<RefCell<dyn FnMut(Vec<u8>)>>;

struct Input {
    topic: InputTopic,
    /// Full name.
    full_name: String,
    type_name: &'static str,
    /// Creates a subscription.
    subscribe: fn(&mut Runtime, &str, QosProfile, Call) -> anyhow::Result<Subscription>,
    call: Call,
    subscription: Option<Subscription>,
    /// Quality of service of the subscription.
    qos: QosProfile,
    next_look: Instant,
    publishers: usize,
    warned: Warned,
    next_warning: Instant,
    /// Publishers that can't reach the subscription.
    fault: Option<String>,
}

impl Runtime {
    /// Subscribes to an input, now or, if it matches publishers, once there is one; calls `call` with the bytes of each message.
    ///
    /// # Errors
    /// If ROS refuses the topic name or the quality of service.
    pub(crate) fn input_bytes<M: Message>(
        &mut self,
        topic: InputTopic,
        mut call: impl FnMut(Vec<u8>) + 'static,
    ) -> anyhow::Result<()> {
        let full_name = self.resolve(&topic.name);
        let statistics = TopicStatistics::start::<M>(self, &full_name)?;
        let call = move |payload: Vec<u8>| {
            if let Some(statistics) = &statistics {
                statistics.received(&payload);
            }
            call(payload);
        };
        let qos = self.subscription_qos(&full_name, topic.qos.clone());
        let matches = topic.matches && !self.overrides_reliability(&full_name);
        let mut input = Input {
            topic: InputTopic { matches, ..topic },
            full_name,
            type_name: M::TYPE,
            subscribe: |runtime, name, qos, call| {
                runtime.subscribe_bytes::<M>(name, qos, move |payload| (call.borrow_mut())(payload))
            },
            call: Rc::new(RefCell::new(call)),
            subscription: None,
            qos,
            next_look: Instant::now(),
            publishers: 0,
            warned: Warned::No,
            next_warning: Instant::now() + PATIENCE,
            fault: None,
        };
        if !matches {
            input.subscribe(self)?;
        }
        match self.extension_mut::<InputTopics>() {
            Some(topics) => topics.0.push(input),
            None => {
                self.set_extension(InputTopics(vec![input]));
                self.every(WAITING_INTERVAL, watch);
            }
        }
        Ok(())
    }

    /// Subscribes as [`Self::input_bytes`]; calls `call` with each decoded message, or with the decoding error.
    ///
    /// # Errors
    /// As [`Self::input_bytes`].
    pub(crate) fn input<M: Message>(
        &mut self,
        topic: InputTopic,
        mut call: impl FnMut(Result<M>) + 'static,
    ) -> anyhow::Result<()> {
        self.input_bytes::<M>(topic, move |payload| call(M::from_cdr(&payload)))
    }

    /// Describes the first input that a publisher can't reach; None if there is none.
    pub(crate) fn input_fault(&self) -> Option<String> {
        self.extension::<InputTopics>()?.0.iter().find_map(|input| input.fault.clone())
    }
}

/// Looks at the publishers of all inputs.
fn watch(runtime: &mut Runtime) {
    let now = Instant::now();
    // The inputs leave the runtime while it subscribes for them.
    let Some(topics) = runtime.extension_mut::<InputTopics>() else { return };
    let mut inputs = std::mem::take(&mut topics.0);
    for input in inputs.iter_mut().filter(|input| now >= input.next_look) {
        input.look(runtime, now);
    }
    let is_heard = |group| inputs.iter().any(|other| other.topic.need == Need::OneOf(group) && other.publishers > 0);
    let silent: Vec<bool> = inputs
        .iter()
        .map(|input| {
            let is_alone = !matches!(input.topic.need, Need::OneOf(group) if is_heard(group));
            input.publishers == 0 && input.warned != Warned::WithTopics && is_alone && now > input.next_warning
        })
        .collect();
    for (input, _) in inputs.iter_mut().zip(silent).filter(|(_, is_silent)| *is_silent) {
        input.next_warning = now + WATCH_INTERVAL;
        input.warn_of_silence(runtime);
    }
    if let Some(topics) = runtime.extension_mut::<InputTopics>() {
        topics.0.append(&mut inputs);
    }
}

impl Input {
    fn subscribe(&mut self, runtime: &mut Runtime) -> anyhow::Result<()> {
        if let Some(old) = self.subscription.take() {
            old.cancel();
        }
        let subscription = (self.subscribe)(runtime, &self.topic.name, self.qos.clone(), Rc::clone(&self.call))?;
        let kind = if is_reliable(&self.qos) { "reliable" } else { "best effort" };
        runtime.log().info(format!("{} from {}, {kind}", self.topic.content, self.full_name));
        self.subscription = Some(subscription);
        Ok(())
    }

    /// Subscribes as the publishers ask for, and notes which of them can't reach the subscription.
    fn look(&mut self, runtime: &mut Runtime, now: Instant) {
        let publishers = match runtime.publishers(&self.full_name) {
            Ok(publishers) => publishers,
            Err(error) => return runtime.log().warn_throttled("match", format!("{}: {error:#}", self.full_name)),
        };
        self.publishers = publishers.len();
        if self.topic.matches && !publishers.is_empty() {
            let all_reliable = publishers.iter().all(|publisher| publisher.reliable);
            if self.subscription.is_none() || is_reliable(&self.qos) && !all_reliable {
                self.qos.reliability =
                    if all_reliable { ReliabilityPolicy::Reliable } else { ReliabilityPolicy::BestEffort };
                if let Err(error) = self.subscribe(runtime) {
                    runtime.log().error(format!("{}: {error:#}", self.full_name));
                }
            }
        }
        self.next_look = now + if self.subscription.is_some() { WATCH_INTERVAL } else { WAITING_INTERVAL };
        let fault = self.fault_of(&publishers);
        if let Some(fault) = fault.as_ref().filter(|fault| self.fault.as_ref() != Some(fault)) {
            runtime.log().error(fault);
        }
        self.fault = fault;
    }

    /// Describes the publishers that DDS does not connect to the subscription.
    fn fault_of(&self, publishers: &[PublisherQos]) -> Option<String> {
        self.subscription.as_ref()?;
        let topic = &self.full_name;
        if is_reliable(&self.qos) && publishers.iter().any(|publisher| !publisher.reliable) {
            return Some(format!(
                "a best-effort publisher on {topic} cannot reach a reliable subscription; set reliability to match or best_effort"
            ));
        }
        let is_latched = self.qos.durability == DurabilityPolicy::TransientLocal;
        (is_latched && publishers.iter().any(|publisher| !publisher.transient_local)).then(|| {
            format!("a volatile publisher on {topic} cannot reach a transient local subscription; set its durability to volatile")
        })
    }

    /// Warns that the topic has no publisher, with the topics that may be meant. Says it again only to name topics that appeared later.
    fn warn_of_silence(&mut self, runtime: &Runtime) {
        let topics = runtime.topics().unwrap_or_default();
        let same_type: Vec<&str> = topics
            .iter()
            .filter(|(name, types)| **name != self.full_name && types.iter().any(|of| of == self.type_name))
            .filter(|(name, _)| runtime.publishers(name).is_ok_and(|publishers| !publishers.is_empty()))
            .map(|(name, _)| name.as_str())
            .filter(|name| !name.starts_with(&runtime.resolve("~/")))
            .collect();
        if same_type.is_empty() && self.warned == Warned::WithoutTopics {
            return;
        }
        self.warned = if same_type.is_empty() { Warned::WithoutTopics } else { Warned::WithTopics };
        let Self { full_name, type_name, .. } = self;
        let others = topics.get(full_name).into_iter().flatten().filter(|of| *of != type_name);
        let other_types: Vec<&str> = others.map(String::as_str).collect();
        let mut line = format!("no publisher of {type_name} on {full_name} ({})", self.topic.content);
        if !other_types.is_empty() {
            line += &format!("; this topic has the type {}", other_types.join(", "));
        }
        match same_type.is_empty() {
            true => line += "; no topic of this type has a publisher",
            false => {
                line += &format!(
                    "; topics of this type: {} (remap with -r {}:=TOPIC)",
                    same_type.join(", "),
                    self.topic.name
                )
            }
        }
        match (self.topic.need, same_type.is_empty()) {
            (Need::Optional, true) => {}
            (Need::Optional, false) => runtime.log().info(line),
            _ => runtime.log().warn(line),
        }
    }
}

fn is_reliable(qos: &QosProfile) -> bool {
    qos.reliability != ReliabilityPolicy::BestEffort
}
