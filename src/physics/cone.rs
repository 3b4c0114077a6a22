//! Projection onto a friction cone that is cut off at the largest force of a hand.

use glam::{DMat3, DVec3};

/// Set of forces that a contact point can bear, in the frame (normal, tangent, tangent): the normal part is between 0 and
/// `limit`, N, the tangential part at most `friction` times the normal part.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Cone {
    /// Coefficient of friction.
    pub friction: f64,
    /// Largest normal force, N.
    pub limit: f64,
}

impl Cone {
    /// Returns the force of the set that is nearest to `v`, N, and the symmetric derivative of this projection.
    pub fn project(&self, v: DVec3) -> (DVec3, DMat3) {
        let tangential = DVec3::new(0.0, v.y, v.z);
        let size = tangential.length();
        let (mu, limit) = (self.friction, self.limit);
        let direction = if size > 0.0 { tangential / size } else { DVec3::ZERO };
        if size <= mu * v.x && v.x <= limit {
            return (v, DMat3::IDENTITY);
        }
        if mu * size <= -v.x {
            return (DVec3::ZERO, DMat3::ZERO);
        }
        let plane = DMat3::from_diagonal(DVec3::new(0.0, 1.0, 1.0));
        let across = plane - outer(direction);
        let on_surface = (v.x + mu * size) / (1.0 + mu * mu);
        if size > mu * v.x && on_surface <= limit {
            let along = (DVec3::X + mu * direction) / (1.0 + mu * mu).sqrt();
            let turn = if size > 0.0 { mu * on_surface / size } else { 0.0 };
            return (on_surface * (DVec3::X + mu * direction), outer(along) + across * turn);
        }
        // The disc at the limit.
        let most = mu * limit;
        match size <= most {
            true => (DVec3::new(limit, v.y, v.z), plane),
            false => (limit * DVec3::X + most * direction, across * (most / size)),
        }
    }
}

/// Returns the matrix `v vᵀ`.
fn outer(v: DVec3) -> DMat3 {
    DMat3::from_cols(v * v.x, v * v.y, v * v.z)
}
