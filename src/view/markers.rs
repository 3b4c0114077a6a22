//! Surfaces of hands, coloured by force, as markers that RViz and Foxglove draw.

use glam::Vec3;

use crate::hand::HandModel;
use crate::message::{ColorRGBA, Duration, Header, Marker, Point, Vector3};
use crate::render::force_colors;
use crate::tactile::TactileField;

/// Code `TRIANGLE_LIST` of `visualization_msgs/msg/Marker`.
const TRIANGLE_LIST: i32 = 11;
/// Code `DELETE` of an action.
#[cfg(feature = "ros")]
const DELETE: i32 = 2;
/// Time after which a hand disappears if no image follows.
const LIFETIME: Duration = Duration { sec: 1, nanosec: 0 };

/// Returns the triangles of the hand of `model` with these vertices, m, in `header.frame_id`; each corner has the colour of the
/// force on its vertex, `scale` (N) at the dark end of the colours.
pub(crate) fn surface(
    header: Header,
    field: &TactileField,
    vertices: &[Vec3],
    model: &HandModel,
    scale: f32,
) -> Marker {
    let colors = force_colors(&field.force[model.side.range()], scale);
    let corners = || model.faces.iter().flatten().map(|vertex| *vertex as usize);
    let point = |vertex: usize| {
        let [x, y, z] = vertices[vertex].as_dvec3().to_array();
        Point { x, y, z }
    };
    let color = |vertex: usize| {
        let [r, g, b] = colors[vertex].0.map(|byte| f32::from(byte) / 255.0);
        ColorRGBA { r, g, b, a: 1.0 }
    };
    Marker { points: corners().map(point).collect(), colors: corners().map(color).collect(), ..empty(header, model) }
}

/// Returns a marker that removes the hand of `model`.
#[cfg(feature = "ros")]
pub(crate) fn removed(header: Header, model: &HandModel) -> Marker {
    Marker { action: DELETE, ..empty(header, model) }
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
