//! Convex hulls and their overlap, with conversions between glam's and parry's vectors.

use glam::{DQuat, DVec3};
use parry3d::math::{Pose, Rotation, Vector};
use parry3d::shape::SharedShape;

/// Overlap of a first shape with a second one.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Overlap {
    /// Penetration depth plus margin, m.
    pub depth: f64,
    /// Deepest point of the first shape in the common frame, m.
    pub point: DVec3,
    /// Unit direction of the shortest way of the first shape out of the second.
    pub out: DVec3,
}

/// Computes the overlap of two shapes with a margin, m, between them; `None` if they are farther apart.
pub fn overlap(
    (first, first_pose): (&SharedShape, &Pose),
    (second, second_pose): (&SharedShape, &Pose),
    margin: f64,
) -> Option<Overlap> {
    let contact = parry3d::query::contact(first_pose, &**first, second_pose, &**second, margin as f32).ok()??;
    let depth = margin - f64::from(contact.dist);
    let out = -double(contact.normal1);
    (depth > 0.0 && out.is_normalized()).then(|| Overlap { depth, point: double(contact.point1), out })
}

/// Computes the convex hull of points; `None` if they span no volume.
pub fn hull(points: &[DVec3]) -> Option<SharedShape> {
    let points: Vec<Vector> = points.iter().copied().map(single).collect();
    if points.len() < 4 { None } else { SharedShape::convex_hull(&points) }
}

/// Converts a pose to parry's type.
pub fn pose(position: DVec3, orientation: DQuat) -> Pose {
    let [x, y, z, w] = orientation.to_array().map(|v| v as f32);
    Pose::from_parts(single(position), Rotation::from_xyzw(x, y, z, w))
}

/// Converts a vector to parry's type.
pub fn single(v: DVec3) -> Vector {
    Vector::new(v.x as f32, v.y as f32, v.z as f32)
}

/// Converts a vector from parry's type.
pub fn double(v: Vector) -> DVec3 {
    DVec3::new(v.x.into(), v.y.into(), v.z.into())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn overlap_of_two_cubes_has_known_depth_and_direction() {
        let cube = SharedShape::cuboid(0.02, 0.02, 0.02);
        let at = |x: f64| pose(DVec3::new(x, 0.0, 0.0), DQuat::IDENTITY);
        let deep = overlap((&cube, &at(0.035)), (&cube, &at(0.0)), 0.0).unwrap();
        assert!((deep.depth - 0.005).abs() < 1e-5 && deep.out.distance(DVec3::X) < 1e-4, "{deep:?}");
        let near = overlap((&cube, &at(0.041)), (&cube, &at(0.0)), 0.003).unwrap();
        assert!((near.depth - 0.002).abs() < 1e-5 && near.out.distance(DVec3::X) < 1e-4, "{near:?}");
        assert_eq!(overlap((&cube, &at(0.05)), (&cube, &at(0.0)), 0.003), None);
    }
}
