//! Overrides of quality of service: parameters `qos_overrides.<topic>.<publisher or subscription>.<policy>`, as in the other
//! client libraries.

use std::cell::Cell;
use std::time::Duration;

use anyhow::bail;
use r2r::qos::{DurabilityPolicy, HistoryPolicy, LivelinessPolicy, ReliabilityPolicy};
use r2r::{ParameterValue, QosProfile};

/// Start of the names of these parameters.
const PREFIX: &str = "qos_overrides.";
/// Policies that can be overridden.
const POLICIES: [&str; 8] = [
    "reliability",
    "durability",
    "history",
    "depth",
    "deadline",
    "lifespan",
    "liveliness",
    "liveliness_lease_duration",
];

/// Side of a topic.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Endpoint {
    /// Publisher.
    Publisher,
    /// Subscription.
    Subscription,
}

/// Overrides given at start.
#[derive(Debug, Default)]
pub(crate) struct QosOverrides(Vec<Override>);

#[derive(Debug)]
struct Override {
    /// Name of the parameter.
    name: String,
    /// Full name of the topic.
    topic: String,
    endpoint: Endpoint,
    policy: Policy,
    is_used: Cell<bool>,
}

#[derive(Debug)]
enum Policy {
    Reliability(ReliabilityPolicy),
    Durability(DurabilityPolicy),
    History(HistoryPolicy),
    Depth(usize),
    Deadline(Duration),
    Lifespan(Duration),
    Liveliness(LivelinessPolicy),
    LivelinessLease(Duration),
}

impl QosOverrides {
    /// Reads the overrides among the parameters given at start.
    ///
    /// # Errors
    /// If the name or the value of an override is not allowed; the error gives what is.
    pub(crate) fn new<'a>(given: impl IntoIterator<Item = (&'a str, &'a ParameterValue)>) -> anyhow::Result<Self> {
        let overrides = given.into_iter().filter(|(name, _)| is_override(name));
        Ok(Self(overrides.map(|(name, value)| parse(name, value)).collect::<anyhow::Result<_>>()?))
    }

    /// Returns `qos` with the overrides for this side of `topic`, which is a full name.
    pub(crate) fn apply(&self, topic: &str, endpoint: Endpoint, mut qos: QosProfile) -> QosProfile {
        for given in self.of(topic, endpoint) {
            given.is_used.set(true);
            match &given.policy {
                Policy::Reliability(policy) => qos.reliability = policy.clone(),
                Policy::Durability(policy) => qos.durability = policy.clone(),
                Policy::History(policy) => qos.history = policy.clone(),
                Policy::Depth(depth) => qos.depth = *depth,
                Policy::Deadline(time) => qos.deadline = *time,
                Policy::Lifespan(time) => qos.lifespan = *time,
                Policy::Liveliness(policy) => qos.liveliness = policy.clone(),
                Policy::LivelinessLease(time) => qos.liveliness_lease_duration = *time,
            }
        }
        qos
    }

    /// Returns true if the reliability of a subscription to `topic` is given: then it must not follow the publishers'.
    pub(crate) fn fix_reliability(&self, topic: &str) -> bool {
        self.of(topic, Endpoint::Subscription).any(|given| matches!(given.policy, Policy::Reliability(_)))
    }

    /// Returns the names of overrides that no publisher or subscription took.
    pub(crate) fn unused(&self) -> Vec<String> {
        self.0.iter().filter(|given| !given.is_used.get()).map(|given| given.name.clone()).collect()
    }

    fn of<'a>(&'a self, topic: &'a str, endpoint: Endpoint) -> impl Iterator<Item = &'a Override> {
        self.0.iter().filter(move |given| given.topic == topic && given.endpoint == endpoint)
    }
}

/// Returns true if a parameter overrides a quality of service.
pub(crate) fn is_override(name: &str) -> bool {
    name.starts_with(PREFIX)
}

fn parse(name: &str, value: &ParameterValue) -> anyhow::Result<Override> {
    let parts: Vec<&str> = name.strip_prefix(PREFIX).unwrap_or(name).split('.').collect();
    let [topic, endpoint, policy] = parts[..] else {
        bail!(
            "parameter {name}: expected qos_overrides./topic.subscription.POLICY or qos_overrides./topic.publisher.POLICY"
        );
    };
    // Further subscriptions to a topic carry an identifier after an underscore; our nodes have one each.
    let endpoint = match endpoint.split_once('_').map_or(endpoint, |(kind, _)| kind) {
        "publisher" => Endpoint::Publisher,
        "subscription" => Endpoint::Subscription,
        other => bail!("parameter {name}: expected publisher or subscription, got {other:?}"),
    };
    let policy = policy_of(name, policy, value)?;
    Ok(Override { name: name.to_owned(), topic: topic.to_owned(), endpoint, policy, is_used: Cell::new(false) })
}

fn policy_of(name: &str, policy: &str, value: &ParameterValue) -> anyhow::Result<Policy> {
    Ok(match policy {
        "reliability" => Policy::Reliability(one_of(
            name,
            value,
            &[
                ("reliable", ReliabilityPolicy::Reliable),
                ("best_effort", ReliabilityPolicy::BestEffort),
                ("system_default", ReliabilityPolicy::SystemDefault),
            ],
        )?),
        "durability" => Policy::Durability(one_of(
            name,
            value,
            &[
                ("volatile", DurabilityPolicy::Volatile),
                ("transient_local", DurabilityPolicy::TransientLocal),
                ("system_default", DurabilityPolicy::SystemDefault),
            ],
        )?),
        "history" => Policy::History(one_of(
            name,
            value,
            &[
                ("keep_last", HistoryPolicy::KeepLast),
                ("keep_all", HistoryPolicy::KeepAll),
                ("system_default", HistoryPolicy::SystemDefault),
            ],
        )?),
        "liveliness" => Policy::Liveliness(one_of(
            name,
            value,
            &[
                ("automatic", LivelinessPolicy::Automatic),
                ("manual_by_topic", LivelinessPolicy::ManualByTopic),
                ("system_default", LivelinessPolicy::SystemDefault),
            ],
        )?),
        "depth" => Policy::Depth(usize::try_from(whole(name, value)?)?),
        "deadline" => Policy::Deadline(Duration::from_nanos(whole(name, value)?)),
        "lifespan" => Policy::Lifespan(Duration::from_nanos(whole(name, value)?)),
        "liveliness_lease_duration" => Policy::LivelinessLease(Duration::from_nanos(whole(name, value)?)),
        other => bail!("parameter {name}: expected a policy of {}, got {other:?}", POLICIES.join(", ")),
    })
}

fn one_of<T: Clone>(name: &str, value: &ParameterValue, known: &[(&str, T)]) -> anyhow::Result<T> {
    if let ParameterValue::String(text) = value
        && let Some((_, policy)) = known.iter().find(|(word, _)| word == text)
    {
        return Ok(policy.clone());
    }
    let words: Vec<&str> = known.iter().map(|(word, _)| *word).collect();
    bail!("parameter {name}: expected one of {}, got {value:?}", words.join(", "))
}

/// Returns a number of messages, or nanoseconds.
fn whole(name: &str, value: &ParameterValue) -> anyhow::Result<u64> {
    match value {
        ParameterValue::Integer(number) if *number >= 0 => Ok(number.unsigned_abs()),
        _ => bail!("parameter {name}: expected a whole number from 0 (nanoseconds for times), got {value:?}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn text(text: &str) -> ParameterValue {
        ParameterValue::String(text.into())
    }

    #[test]
    fn an_override_applies_to_its_side_of_its_topic_only() {
        let (best_effort, depth) = (text("best_effort"), ParameterValue::Integer(7));
        let given = [
            ("qos_overrides./image.subscription.reliability", &best_effort),
            ("qos_overrides./image.subscription.depth", &depth),
            ("qos_overrides./out.publisher.reliability", &best_effort),
            ("threshold", &depth),
        ];
        let overrides = QosOverrides::new(given).unwrap();
        let base = QosProfile::default();
        let image = overrides.apply("/image", Endpoint::Subscription, base.clone());
        assert_eq!((image.reliability, image.depth), (ReliabilityPolicy::BestEffort, 7));
        assert_eq!(image.durability, base.durability);
        assert_eq!(overrides.apply("/image", Endpoint::Publisher, base.clone()), base);
        assert_eq!(overrides.apply("/other", Endpoint::Subscription, base.clone()), base);
        assert!(overrides.fix_reliability("/image") && !overrides.fix_reliability("/out"));
        assert_eq!(overrides.unused(), ["qos_overrides./out.publisher.reliability"]);
    }

    #[test]
    fn a_value_or_name_that_is_not_allowed_is_refused_with_what_is() {
        let refused = |name: &str, value: ParameterValue, said: &str| {
            let error = QosOverrides::new([(name, &value)]).unwrap_err().to_string();
            assert!(error.contains(name) && error.contains(said), "{error}");
        };
        refused("qos_overrides./image.subscription.reliability", text("sure"), "reliable, best_effort");
        refused("qos_overrides./image.subscription.depth", ParameterValue::Integer(-1), "from 0");
        refused("qos_overrides./image.subscription.colour", text("red"), "history, depth");
        refused("qos_overrides./image.service.depth", ParameterValue::Integer(1), "publisher or subscription");
        refused("qos_overrides.depth", ParameterValue::Integer(1), "POLICY");
    }
}
