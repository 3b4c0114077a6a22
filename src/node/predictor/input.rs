//! Image subscription of the predictor.

use std::sync::Arc;

use crate::node::diagnostics::Tally;
use crate::node::images::ImageTransport;
use crate::node::input_topics::{InputTopic, Need};
use crate::node::mailbox::Mailbox;
use crate::node::qos;
use crate::node::runtime::Runtime;

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
}

impl Input {
    /// Reads the transport and the topic from the node; subscribes to nothing yet.
    pub(super) fn new(runtime: &Runtime) -> Self {
        let transport = ImageTransport::of(runtime.parameters());
        Self { transport, topic: transport.topic(runtime), newest: Arc::default(), tally: Tally::default() }
    }

    /// Subscribes to the images.
    ///
    /// # Errors
    /// If ROS refuses the topic name or the quality of service.
    pub(super) fn subscribe(&self, runtime: &mut Runtime) -> anyhow::Result<()> {
        let parameters = Arc::clone(runtime.parameters());
        let (newest, tally) = (Arc::clone(&self.newest), self.tally.clone());
        let input = InputTopic::new(runtime, "image", "images", qos::newest_input(), Need::Required);
        self.transport.subscribe(runtime, input, move |payload| {
            tally.received();
            match parameters.get("enabled") {
                true => newest.put(payload),
                false => tally.dropped("disabled"),
            }
        })
    }
}
