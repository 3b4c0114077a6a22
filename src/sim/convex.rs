//! Convex shapes against each other: the one place where our vectors meet the collision library's.

use glam::{DQuat, DVec3};
use parry3d::math::{Pose, Rotation, Vector};
use parry3d::shape::SharedShape;

/// Where and how deep one shape is in another.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Overlap {
    /// Depth, m; of shapes grown by the margin.
    pub depth: f64,
    /// Deepest point of the first shape, in the common frame, m.
    pub point: DVec3,
    /// Unit direction in which the first shape leaves the second the shortest way.
    pub out: DVec3,
}

/// Overlap of two shapes with a margin between them; `None` where they are farther apart than that.
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

/// Convex hull of points; `None` if they span no volume.
pub fn hull(points: &[DVec3]) -> Option<SharedShape> {
    let points: Vec<Vector> = points.iter().copied().map(single).collect();
    if points.len() < 4 { None } else { SharedShape::convex_hull(&points) }
}

/// A pose in the library's form.
pub fn pose(position: DVec3, orientation: DQuat) -> Pose {
    let [x, y, z, w] = orientation.to_array().map(|v| v as f32);
    Pose::from_parts(single(position), Rotation::from_xyzw(x, y, z, w))
}

/// A vector in the library's form.
pub fn single(v: DVec3) -> Vector {
    Vector::new(v.x as f32, v.y as f32, v.z as f32)
}

/// A vector in ours.
pub fn double(v: Vector) -> DVec3 {
    DVec3::new(v.x.into(), v.y.into(), v.z.into())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_cubes_overlap_by_what_is_asked_and_part_along_out() {
        let cube = SharedShape::cuboid(0.02, 0.02, 0.02);
        let at = |x: f64| pose(DVec3::new(x, 0.0, 0.0), DQuat::IDENTITY);
        let deep = overlap((&cube, &at(0.035)), (&cube, &at(0.0)), 0.0).unwrap();
        assert!((deep.depth - 0.005).abs() < 1e-5 && deep.out.distance(DVec3::X) < 1e-4, "{deep:?}");
        let near = overlap((&cube, &at(0.041)), (&cube, &at(0.0)), 0.003).unwrap();
        assert!((near.depth - 0.002).abs() < 1e-5 && near.out.distance(DVec3::X) < 1e-4, "{near:?}");
        assert_eq!(overlap((&cube, &at(0.05)), (&cube, &at(0.0)), 0.003), None);
    }
}
