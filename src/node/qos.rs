//! Qualities of service of the nodes' topics.

use r2r::QosProfile;
use r2r::qos::{DurabilityPolicy, ReliabilityPolicy};

/// Subscription that needs only the newest message. Best effort, so that it hears every publisher.
pub(crate) fn newest_input() -> QosProfile {
    QosProfile { depth: 1, reliability: ReliabilityPolicy::BestEffort, ..QosProfile::sensor_data() }
}

/// Subscription that needs every message, such as pairs to compare: a queue for a stall of one second.
pub(crate) fn every_input() -> QosProfile {
    QosProfile { depth: 50, ..QosProfile::default() }
}

/// Publisher of results: reliable, which both reliable and best-effort subscriptions can receive.
pub(crate) fn output() -> QosProfile {
    QosProfile::default()
}

/// Publisher of results that no subscriber may lose: reliable, with a queue for a stall of a few seconds.
#[cfg(feature = "sim")]
pub(crate) fn every_output() -> QosProfile {
    QosProfile { depth: 100, ..QosProfile::default() }
}

/// Publisher of raw images: reliable, with a queue for a stall of one second; raw images are too large for more.
#[cfg(feature = "sim")]
pub(crate) fn image_output() -> QosProfile {
    QosProfile { depth: 30, ..QosProfile::default() }
}

/// Topic that is published once and kept for late subscribers.
pub(crate) fn latched() -> QosProfile {
    QosProfile { depth: 1, durability: DurabilityPolicy::TransientLocal, ..QosProfile::default() }
}

/// Quality of service of `/rosout` in the other client libraries.
pub(crate) fn rosout() -> QosProfile {
    QosProfile {
        depth: 1000,
        durability: DurabilityPolicy::TransientLocal,
        lifespan: std::time::Duration::from_secs(10),
        ..QosProfile::default()
    }
}

/// Quality of service of `/tf` in the other client libraries.
pub(crate) fn transforms() -> QosProfile {
    QosProfile { depth: 100, ..QosProfile::default() }
}
