//! Topic `~/regions`: touch on the 17 regions of each hand, for policies.

use crate::hand::{HandModel, Region};
use crate::message::{TactileFrame, TactileRegions};
use crate::node::publisher::Publisher;
use crate::node::qos;
use crate::node::runtime::Runtime;

/// Publishes the touch on regions.
pub(in super::super) struct Regions {
    publisher: Publisher<TactileRegions>,
    /// Region of each vertex of the left and the right hand.
    regions: [Vec<Region>; 2],
}

impl Regions {
    /// Creates the publisher on `topic`.
    ///
    /// # Errors
    /// If ROS refuses the topic.
    pub(in super::super) fn create(
        runtime: &mut Runtime,
        topic: &str,
        models: &[HandModel; 2],
    ) -> anyhow::Result<Self> {
        let publisher = runtime.publisher(topic, qos::output())?;
        Ok(Self { publisher, regions: [0, 1].map(|side: usize| models[side].regions()) })
    }

    /// Publishes the regions of a frame if the topic has a subscriber.
    ///
    /// # Errors
    /// If the node is gone or the middleware refuses the message.
    pub(in super::super) fn publish(&self, frame: &TactileFrame) -> anyhow::Result<()> {
        match self.publisher.subscriber_count() {
            0 => Ok(()),
            _ => self.publisher.publish(&TactileRegions::from_frame(frame, &self.regions)?),
        }
    }
}
