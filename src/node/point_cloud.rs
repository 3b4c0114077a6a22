//! Point cloud of a touch field for RViz: each vertex at its place on the posed hand, or on a hand at rest.

use super::placed_hand::PlacedHand;
use crate::message::{Header, PointCloud2, PointField};
use crate::tactile::TactileField;

/// Fields of each point, all single precision.
const FIELDS: [&str; 6] = ["x", "y", "z", "force", "contact", "touching"];
/// Code `FLOAT32` of `sensor_msgs/msg/PointField`.
const FLOAT32: u8 = 7;

/// Creates the point cloud of `field` on `hands`, whose vertices are in `header.frame_id`. The point field `touching` is 1
/// where the contact probability is above `threshold`, else 0.
pub(crate) fn point_cloud(header: Header, field: &TactileField, hands: &[PlacedHand], threshold: f32) -> PointCloud2 {
    let mut data = Vec::new();
    let mut points = 0;
    for PlacedHand { side, posed } in hands {
        let force = &field.force[side.range()];
        let contact = &field.contact[side.range()];
        for ((vertex, force), contact) in posed.vertices.iter().zip(force).zip(contact) {
            let touching = f32::from(*contact > threshold);
            for number in [vertex.x, vertex.y, vertex.z, *force, *contact, touching] {
                data.extend_from_slice(&number.to_le_bytes());
            }
            points += 1;
        }
    }
    let is_dense = field.force.iter().chain(&field.contact).all(|value| !value.is_nan());
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
        // Force and contact of a hand whose touch is unknown are NaN.
        is_dense,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hand::{HandModel, HandParams, N_VERTICES, Side, Topology};
    use glam::Vec3;

    #[test]
    fn each_vertex_is_a_point_with_its_force_and_contact() {
        let mut field = TactileField::zeros(Topology::EgotacHand1);
        field.force[N_VERTICES + 2] = 1.5;
        field.contact[N_VERTICES + 2] = 0.75;
        let mut posed = HandModel::builtin(Side::Right).forward(&HandParams::default());
        posed.vertices = (0..N_VERTICES).map(|i| Vec3::new(i as f32, 0.0, -1.0)).collect();
        let cloud = point_cloud(Header::default(), &field, &[PlacedHand { side: Side::Right, posed }], 0.5);
        assert_eq!((cloud.width as usize, cloud.data.len()), (N_VERTICES, N_VERTICES * cloud.point_step as usize));
        let point: Vec<f32> = cloud.data[2 * 24..3 * 24]
            .chunks_exact(4)
            .map(|bytes| f32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]))
            .collect();
        assert_eq!(point, [2.0, 0.0, -1.0, 1.5, 0.75, 1.0]);
    }

    #[test]
    fn a_cloud_with_unknown_touch_is_not_dense_and_touches_nowhere_there() {
        let mut field = TactileField::zeros(Topology::EgotacHand1);
        let hand = || {
            let posed = HandModel::builtin(Side::Right).forward(&HandParams::default());
            PlacedHand { side: Side::Right, posed }
        };
        assert!(point_cloud(Header::default(), &field, &[hand()], 0.5).is_dense);
        for values in [&mut field.force, &mut field.contact] {
            values[Side::Right.range()].fill(f32::NAN);
        }
        let cloud = point_cloud(Header::default(), &field, &[hand()], 0.5);
        assert!(!cloud.is_dense);
        let touching =
            cloud.data.chunks_exact(24).map(|point| f32::from_le_bytes([point[20], point[21], point[22], point[23]]));
        assert!(touching.into_iter().all(|touching| touching == 0.0));
    }
}
