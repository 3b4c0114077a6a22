//! A field as a point cloud that RViz shows: each vertex where the hand is, or on a hand at rest.

use glam::Vec3;

use crate::hand::{HandModel, HandParams, Side};
use crate::message::{Header, PointCloud2, PointField};
use crate::tactile::TactileField;

/// Numbers of each point, all single precision.
const FIELDS: [&str; 6] = ["x", "y", "z", "force", "contact", "touching"];
/// `sensor_msgs/msg/PointField.FLOAT32`.
const FLOAT32: u8 = 7;

/// Where one hand's vertices are drawn.
#[derive(Debug, Clone)]
pub(super) struct Posed {
    pub(super) side: Side,
    pub(super) vertices: Vec<Vec3>,
}

/// Both hands at rest, half a metre before the camera, in its optical frame: palms to the camera, fingers up, the right
/// hand on the right. A picture of the field, not of where the hands are.
pub(super) fn at_rest(hands: &[HandModel; 2]) -> Vec<Posed> {
    let place = |hand: &HandModel| {
        let posed = hand.forward(&HandParams::default());
        let wrist = posed.joints[0];
        // At rest the right hand's fingers point along -x, its palm faces -y; the left hand mirrors it in x.
        let (sign, side) = match hand.side {
            Side::Right => (1.0, hand.side),
            Side::Left => (-1.0, hand.side),
        };
        let optical = |v: Vec3| Vec3::new(sign * v.z, sign * v.x, v.y) + Vec3::new(sign * 0.12, 0.09, 0.5);
        Posed { side, vertices: posed.vertices.iter().map(|v| optical(*v - wrist)).collect() }
    };
    hands.iter().map(place).collect()
}

/// The cloud of `field` on `hands`, whose vertices are in `header.frame_id`; `touching` is 1 where the contact
/// probability is above `threshold`.
pub(super) fn cloud(header: Header, field: &TactileField, hands: &[Posed], threshold: f32) -> PointCloud2 {
    let mut data = Vec::new();
    let mut points = 0;
    for Posed { side, vertices } in hands {
        let force = &field.force[side.range()];
        let contact = &field.contact[side.range()];
        for ((vertex, force), contact) in vertices.iter().zip(force).zip(contact) {
            let touching = f32::from(*contact > threshold);
            for number in [vertex.x, vertex.y, vertex.z, *force, *contact, touching] {
                data.extend_from_slice(&number.to_le_bytes());
            }
            points += 1;
        }
    }
    let point_step = 4 * FIELDS.len() as u32;
    let field = |(index, name): (u32, &str)| PointField {
        name: name.to_owned(),
        offset: 4 * index,
        datatype: FLOAT32,
        count: 1,
    };
    PointCloud2 {
        header,
        height: 1,
        width: points,
        fields: (0..).zip(FIELDS).map(field).collect(),
        is_bigendian: false,
        point_step,
        row_step: point_step * points,
        data,
        is_dense: true,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hand::{N_VERTICES, Topology};

    #[test]
    fn each_vertex_is_a_point_with_its_touch() {
        let mut field = TactileField::zeros(Topology::EgotacHand1);
        field.force[N_VERTICES + 2] = 1.5;
        field.contact[N_VERTICES + 2] = 0.75;
        let vertices = (0..N_VERTICES).map(|i| Vec3::new(i as f32, 0.0, -1.0)).collect();
        let cloud = cloud(Header::default(), &field, &[Posed { side: Side::Right, vertices }], 0.5);
        assert_eq!((cloud.width as usize, cloud.data.len()), (N_VERTICES, N_VERTICES * cloud.point_step as usize));
        let point: Vec<f32> = cloud.data[2 * 24..3 * 24]
            .chunks_exact(4)
            .map(|bytes| f32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]))
            .collect();
        assert_eq!(point, [2.0, 0.0, -1.0, 1.5, 0.75, 1.0]);
    }

    #[test]
    fn hands_at_rest_do_not_overlap_and_point_up() {
        let hands = at_rest(&Side::BOTH.map(HandModel::builtin));
        let xs = |hand: &Posed| {
            let xs = hand.vertices.iter().map(|v| v.x);
            (xs.clone().fold(f32::MAX, f32::min), xs.fold(f32::MIN, f32::max))
        };
        assert!(xs(&hands[0]).1 < 0.0 && xs(&hands[1]).0 > 0.0);
        for hand in &hands {
            // Fingers, the longest part, lie above the wrist; y points down.
            let highest = hand.vertices.iter().map(|v| v.y).fold(f32::MAX, f32::min);
            let lowest = hand.vertices.iter().map(|v| v.y).fold(f32::MIN, f32::max);
            assert!(0.09 - highest > 0.12 && lowest - 0.09 < 0.06, "{highest} {lowest}");
        }
    }
}
