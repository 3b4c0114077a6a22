//! The qualities of service that the nodes use.

use r2r::QosProfile;
use r2r::qos::{DurabilityPolicy, ReliabilityPolicy};

/// Sensor data to take: keep the newest, lose rather than wait unless `reliable`.
pub fn sensor_input(reliable: bool) -> QosProfile {
    let reliability = if reliable { ReliabilityPolicy::Reliable } else { ReliabilityPolicy::BestEffort };
    QosProfile { depth: 1, reliability, ..QosProfile::sensor_data() }
}

/// Messages that are all wanted, such as pairs to compare: reliable, with room for a stall of a second.
pub fn every_input() -> QosProfile {
    QosProfile { depth: 50, ..QosProfile::default() }
}

/// Results: reliable, so that subscribers of either kind get them.
pub fn output() -> QosProfile {
    QosProfile::default()
}

/// Results that are all wanted, even by a subscriber that stalls for some seconds.
pub fn every_output() -> QosProfile {
    QosProfile { depth: 100, ..QosProfile::default() }
}

/// Raw images: reliable, with room for a stall of a second.
pub fn image_output() -> QosProfile {
    QosProfile { depth: 30, ..QosProfile::default() }
}

/// What is published once and kept for those who come later.
pub fn latched() -> QosProfile {
    QosProfile { depth: 1, durability: DurabilityPolicy::TransientLocal, ..QosProfile::default() }
}

/// `/rosout`, as the other client libraries have it.
pub fn rosout() -> QosProfile {
    QosProfile {
        depth: 1000,
        durability: DurabilityPolicy::TransientLocal,
        lifespan: std::time::Duration::from_secs(10),
        ..QosProfile::default()
    }
}
