//! Image subscription of the predictor.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use crate::node::diagnostics::Tally;
use crate::node::images::ImageTransport;
use crate::node::mailbox::Mailbox;
use crate::node::qos;
use crate::node::runtime::Runtime;

/// Time between two looks for publishers with the reliability `match`.
const PUBLISHER_POLL_INTERVAL: Duration = Duration::from_millis(100);

/// Image subscription; clones share it.
#[derive(Clone)]
pub(super) struct Input {
    /// Message type of the images.
    pub(super) transport: ImageTransport,
    /// Resolved image topic.
    pub(super) topic: String,
    /// Bytes of the newest image that was not taken yet.
    pub(super) newest: Arc<Mailbox<Vec<u8>>>,
    /// Counts of images.
    pub(super) tally: Tally,
    /// True if the subscription exists and is reliable.
    reliable: Arc<AtomicBool>,
}

impl Input {
    /// Reads the transport and the topic from the node; subscribes to nothing yet.
    pub(super) fn new(runtime: &Runtime) -> Self {
        let transport = ImageTransport::of(runtime.parameters());
        Self {
            transport,
            topic: transport.topic(runtime),
            newest: Arc::default(),
            tally: Tally::default(),
            reliable: Arc::default(),
        }
    }

    /// Subscribes now, or with reliability `match` as soon as the topic has a publisher.
    ///
    /// # Errors
    /// If ROS refuses the topic name or the quality of service.
    pub(super) fn subscribe(&self, runtime: &mut Runtime) -> anyhow::Result<()> {
        let reliability = runtime.parameters().get::<String>("reliability");
        if reliability != "match" {
            return self.subscribe_as(runtime, reliability == "reliable");
        }
        let mut waiting = Some(self.clone());
        runtime.every(PUBLISHER_POLL_INTERVAL, move |runtime| {
            let Some(input) = &waiting else { return };
            let reliable = match runtime.publishers_are_reliable(&input.topic) {
                Ok(publishers) if publishers.is_empty() => return,
                Ok(publishers) => publishers.iter().all(|reliable| *reliable),
                Err(error) => return runtime.log().warn_throttled("match", format!("{}: {error:#}", input.topic)),
            };
            if let Err(error) = input.subscribe_as(runtime, reliable) {
                runtime.log().error(format!("{}: {error:#}", input.topic));
            }
            waiting = None;
        });
        Ok(())
    }

    fn subscribe_as(&self, runtime: &mut Runtime, reliable: bool) -> anyhow::Result<()> {
        self.reliable.store(reliable, Ordering::Relaxed);
        let parameters = Arc::clone(runtime.parameters());
        let (newest, tally) = (Arc::clone(&self.newest), self.tally.clone());
        let take = move |payload: Vec<u8>| {
            tally.received();
            match parameters.get("enabled") {
                true => newest.put(payload),
                false => tally.dropped("disabled"),
            }
        };
        let kind = if reliable { "reliable" } else { "best effort" };
        runtime.log().info(format!("images from {}, {kind}", self.topic));
        self.transport.subscribe(runtime, qos::sensor_input(reliable), take)
    }

    /// Returns true if a publisher on the topic is best effort while the subscription is reliable: DDS does not connect
    /// the two.
    pub(super) fn has_incompatible_publisher(&self, runtime: &Runtime) -> bool {
        self.reliable.load(Ordering::Relaxed)
            && runtime.publishers_are_reliable(&self.topic).is_ok_and(|all| all.contains(&false))
    }
}
