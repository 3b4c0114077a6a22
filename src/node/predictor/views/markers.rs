//! Topic `~/markers`: the surfaces of the hands, coloured by force.

use crate::hand::HandModel;
use crate::message::{ColorRGBA, Duration, Header, Marker, MarkerArray, Point, Vector3};
use crate::node::placed_hand::PlacedHand;
use crate::node::publisher::Publisher;
use crate::node::qos;
use crate::node::runtime::Runtime;
use crate::render::force_colors;
use crate::tactile::TactileField;

use crate::render::color::MAX_COLOR_FORCE;

/// Code `TRIANGLE_LIST` of `visualization_msgs/msg/Marker`.
const TRIANGLE_LIST: i32 = 11;
/// Code `DELETE` of an action.
const DELETE: i32 = 2;
/// Time after which a hand disappears if no image follows.
const LIFETIME: Duration = Duration { sec: 1, nanosec: 0 };

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
            Some(hand) => surface(header.clone(), field, hand, model),
            None => Marker { action: DELETE, ..empty(header.clone(), model) },
        });
        self.0.publish(&MarkerArray { markers: markers.collect() })
    }
}

/// Returns a marker of the hand of `model`, without points.
fn empty(header: Header, model: &HandModel) -> Marker {
    let one = Vector3 { x: 1.0, y: 1.0, z: 1.0 };
    let opaque = ColorRGBA { r: 1.0, g: 1.0, b: 1.0, a: 1.0 };
    Marker {
        header,
        ns: model.side.name().to_owned(),
        kind: TRIANGLE_LIST,
        scale: one,
        color: opaque,
        lifetime: LIFETIME,
        ..Marker::default()
    }
}

/// Returns the triangles of a hand; each corner has the colour of the force on its vertex.
fn surface(header: Header, field: &TactileField, hand: &PlacedHand, model: &HandModel) -> Marker {
    let colors = force_colors(&field.force[hand.side.range()], MAX_COLOR_FORCE);
    let corners = || model.faces.iter().flatten().map(|vertex| *vertex as usize);
    let point = |vertex: usize| {
        let [x, y, z] = hand.posed.vertices[vertex].as_dvec3().to_array();
        Point { x, y, z }
    };
    let color = |vertex: usize| {
        let [r, g, b] = colors[vertex].0.map(|byte| f32::from(byte) / 255.0);
        ColorRGBA { r, g, b, a: 1.0 }
    };
    Marker { points: corners().map(point).collect(), colors: corners().map(color).collect(), ..empty(header, model) }
}
