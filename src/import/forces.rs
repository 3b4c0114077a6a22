//! Forces of a sensor's cells, distributed over the vertices of a hand.

use glam::Vec3;

use super::recording::SensedForce;
use crate::error::Result;
use crate::geometry::{ForceSpreader, LinkContact, SIGMA};
use crate::hand::HandModel;
use crate::tactile::CONTACT_FORCE_N;

/// Largest distance of a loaded cell from the hand that loads it, m: annotated hands hover up to a centimetre above what
/// they touch. The force of farther cells is lost.
const REACH: f32 = 0.02;

/// Distributor of a sensor's forces over one hand.
pub struct HandForces {
    spreader: ForceSpreader,
    /// (778) link of each vertex.
    links: Vec<usize>,
}

/// Force on the vertices of one hand.
#[derive(Debug, Clone, PartialEq)]
pub struct VertexForces {
    /// (778) normal force, N; NaN where it was not measured.
    pub newtons: Vec<f32>,
    /// Measured force that is on no vertex, N.
    pub lost: f32,
}

impl HandForces {
    /// Prepares a hand.
    ///
    /// # Errors
    /// If a link of the hand has no vertex.
    pub fn new(model: &HandModel) -> Result<Self> {
        Ok(Self { spreader: ForceSpreader::new(model, SIGMA)?, links: model.strongest_joints() })
    }

    /// Distributes the force of each cell around the nearest of the (778) `vertices`, m, on the link of that vertex. The sum
    /// over vertices and the lost force is that of the cells.
    ///
    /// # Errors
    /// If a force or a vertex is not finite.
    pub fn spread(&self, vertices: &[Vec3], sensed: &SensedForce) -> Result<VertexForces> {
        let (mut contacts, mut lost) = (Vec::new(), 0.0);
        for point in &sensed.points {
            let position = point.position.as_vec3();
            let distances = vertices.iter().map(|vertex| vertex.distance_squared(position)).enumerate();
            match distances.min_by(|a, b| a.1.total_cmp(&b.1)) {
                Some((vertex, square)) if square <= REACH * REACH => {
                    let (link, normal, force) = (self.links[vertex], point.normal, point.newtons);
                    contacts.push(LinkContact { link, position: point.position, normal, force });
                }
                _ => lost += point.newtons,
            }
        }
        let mut newtons = self.spreader.spread(vertices, &contacts)?.force;
        for (force, unmeasured) in newtons.iter_mut().zip(&sensed.unmeasured) {
            // A vertex that the sensor loads is measured wherever it lies.
            if *unmeasured && *force <= CONTACT_FORCE_N {
                lost += f64::from(*force);
                *force = f32::NAN;
            }
        }
        Ok(VertexForces { newtons, lost: lost as f32 })
    }
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;
    use crate::hand::{HandParams, Side};
    use crate::import::recording::PointForce;

    #[test]
    fn vertices_and_lost_force_sum_to_the_cells() {
        let model = HandModel::builtin(Side::Right);
        let vertices = model.forward(&HandParams::default()).vertices;
        let at = |vertex: usize, newtons: f64| PointForce {
            position: vertices[vertex].as_dvec3() + DVec3::new(0.0, -0.003, 0.0),
            normal: DVec3::Y,
            newtons,
        };
        let far = PointForce { position: DVec3::splat(1.0), normal: DVec3::Y, newtons: 0.25 };
        let mut sensed = SensedForce { points: vec![at(320, 1.5), at(100, 2.0), far], unmeasured: vec![false; 778] };
        let hand = HandForces::new(&model).unwrap();
        let all = hand.spread(&vertices, &sensed).unwrap();
        assert!((all.newtons.iter().sum::<f32>() - 3.5).abs() < 1e-5 && all.lost == 0.25, "{}", all.lost);
        sensed.unmeasured.fill(true);
        let loaded = hand.spread(&vertices, &sensed).unwrap();
        let known: Vec<f32> = loaded.newtons.iter().copied().filter(|force| !force.is_nan()).collect();
        assert!(known.iter().all(|force| *force > CONTACT_FORCE_N) && known.len() > 2);
        assert!((known.iter().sum::<f32>() + loaded.lost - 3.75).abs() < 1e-5);
    }
}
