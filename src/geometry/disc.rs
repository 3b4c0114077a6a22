//! Flat discs around triangles: a lower bound of their distance that is close for points above a flat patch of a surface.

use glam::Vec3;

/// Allowance for the rounding of a disc and of distances from it: relative, and in m for points on it.
const ROUNDING: [f32; 2] = [3e-6, 1e-7];

/// A disc that holds triangles.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Disc {
    centre: Vec3,
    radius: f32,
    /// Unit normal; zero where triangles have none.
    normal: Vec3,
    /// Half of the thickness, m.
    half: f32,
}

impl Disc {
    /// A disc that holds all triangles.
    pub(super) const EVERYTHING: Self =
        Self { centre: Vec3::ZERO, radius: f32::MAX, normal: Vec3::ZERO, half: f32::MAX };

    /// Returns a disc around triangles, by their corners.
    pub(super) fn around(triangles: &[[Vec3; 3]]) -> Self {
        let corners = || triangles.iter().flatten();
        let centre = corners().sum::<Vec3>() / (3 * triangles.len()).max(1) as f32;
        let normal = triangles.iter().map(|[a, b, c]| (*b - *a).cross(*c - *a)).sum::<Vec3>().normalize_or_zero();
        let largest = |of: &dyn Fn(Vec3) -> f32| {
            let most = corners().map(|corner| of(*corner - centre)).fold(0.0, f32::max);
            most * (1.0 + ROUNDING[0]) + ROUNDING[1]
        };
        Self { centre, radius: largest(&|away| away.length()), normal, half: largest(&|away| away.dot(normal).abs()) }
    }

    /// Returns a lower bound of the squared distance of `point` from the triangles, m².
    #[inline]
    pub(super) fn least_square(&self, point: Vec3) -> f64 {
        let away = point - self.centre;
        let (square, height) = (away.length_squared(), away.dot(self.normal).abs());
        let slack = ROUNDING[0] * (square.sqrt() + point.abs().max_element() + self.radius) + ROUNDING[1];
        let above = (height - self.half - slack).max(0.0);
        let beside = ((square - height * height).max(0.0).sqrt() - self.radius - slack).max(0.0);
        f64::from(above * above + beside * beside)
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::super::mesh::distance_squared;
    use super::*;

    fn point(scale: f32) -> impl Strategy<Value = Vec3> {
        prop::array::uniform3(-1f32..1.0).prop_map(move |p| scale * Vec3::from_array(p))
    }

    proptest! {
        #[test]
        fn the_bound_is_never_above_the_distance(
            corners in prop::array::uniform3(point(0.01)), more in prop::array::uniform3(point(0.01)), at in point(0.1), far in point(3.0),
        ) {
            // Far from the origin the coordinates are coarse.
            for (moved, triangles) in [(Vec3::ZERO, vec![corners]), (far, vec![corners, more]), (far, vec![[corners[0]; 3]])] {
                let triangles: Vec<[Vec3; 3]> = triangles.into_iter().map(|t| t.map(|corner| corner + moved)).collect();
                let disc = Disc::around(&triangles);
                let point = at + moved;
                let exact = |t: &[Vec3; 3]| distance_squared(t.map(|corner| corner.as_dvec3()), point.as_dvec3());
                let nearest = triangles.iter().map(exact).fold(f64::INFINITY, f64::min);
                prop_assert!(disc.least_square(point) <= nearest, "{} above {nearest}", disc.least_square(point));
                prop_assert_eq!(Disc::EVERYTHING.least_square(point), 0.0);
            }
        }
    }
}
