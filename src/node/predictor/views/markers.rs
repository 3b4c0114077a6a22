//! Topic `~/markers`: the surfaces of the hands, coloured by force.

use crate::hand::HandModel;
use crate::message::{Header, MarkerArray};
use crate::node::placed_hand::PlacedHand;
use crate::node::publisher::Publisher;
use crate::node::qos;
use crate::node::runtime::Runtime;
use crate::render::color::MAX_COLOR_FORCE;
use crate::tactile::TactileField;
use crate::view::{removed, surface};

/// Publishes the surfaces.
pub(super) struct Markers(Publisher<MarkerArray>);

impl Markers {
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

    /// Publishes the surfaces of `hands`, which are in `header.frame_id`, if the topic has a subscriber.
    ///
    /// # Errors
    /// If the node is gone or the middleware refuses the message.
    pub(super) fn publish(
        &self,
        header: &Header,
        field: &TactileField,
        hands: &[PlacedHand],
        models: &[HandModel; 2],
    ) -> anyhow::Result<()> {
        if !self.is_wanted() {
            return Ok(());
        }
        let markers = models.iter().map(|model| match hands.iter().find(|hand| hand.side == model.side) {
            Some(hand) => surface(header.clone(), field, &hand.posed.vertices, model, MAX_COLOR_FORCE),
            None => removed(header.clone(), model),
        });
        self.0.publish(&MarkerArray { markers: markers.collect() })
    }
}
