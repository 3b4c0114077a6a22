//! Topic `~/points`: the field as a point cloud on the hands.

use crate::message::{Header, PointCloud2};
use crate::node::placed_hand::PlacedHand;
use crate::node::point_cloud::point_cloud;
use crate::node::publisher::Publisher;
use crate::node::qos;
use crate::node::runtime::Runtime;
use crate::tactile::TactileField;

/// Publishes the point cloud.
pub(super) struct Cloud(Publisher<PointCloud2>);

impl Cloud {
    /// Creates the publisher on `topic`.
    ///
    /// # Errors
    /// If ROS refuses the topic.
    pub(super) fn create(runtime: &mut Runtime, topic: &str) -> anyhow::Result<Self> {
        Ok(Self(runtime.publisher(topic, qos::output())?))
    }

    /// Returns true if the topic has a subscriber.
    pub(super) fn is_wanted(&self) -> bool {
        self.0.subscriber_count() > 0
    }

    /// Publishes `field` on `hands`, which are in `header.frame_id`.
    ///
    /// # Errors
    /// If the node is gone or the middleware refuses the message.
    pub(super) fn publish(
        &self,
        header: Header,
        field: &TactileField,
        hands: &[PlacedHand],
        threshold: f32,
    ) -> anyhow::Result<()> {
        self.0.publish(&point_cloud(header, field, hands, threshold))
    }
}
