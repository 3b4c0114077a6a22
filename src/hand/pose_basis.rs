//! The basis of hand poses in a MANO file.

use std::path::Path;

use glam::Vec3;

use super::{N_JOINTS, mano};
use crate::error::{Error, Result};

/// Numbers of a hand pose: 15 rotations as axis-angle.
const N_ANGLES: usize = 3 * (N_JOINTS - 1);

/// Mean and principal components of hand poses, as MANO files hold them: `hands_mean` and `hands_components`.
#[derive(Debug, Clone)]
pub struct PoseBasis {
    mean: Vec<f32>,       // (45) rad
    components: Vec<f32>, // (45, 45) row-major, rad per unit
}

impl PoseBasis {
    /// Loads the basis from a MANO file: the published pickle or an `.npz` variant.
    ///
    /// # Errors
    /// If the file can't be read, or an array is missing or has the wrong shape.
    pub fn load(path: &Path) -> Result<Self> {
        let (mean, components) = mano::load_basis(path)?;
        Ok(Self { mean, components })
    }

    /// Returns the mean pose, axis-angle of joints 1 to 15, rad.
    pub fn mean(&self) -> [Vec3; N_JOINTS - 1] {
        rotations(&self.mean)
    }

    /// Computes the pose mean + coefficients x components, axis-angle of joints 1 to 15, rad.
    ///
    /// # Errors
    /// If there are more coefficients than components.
    pub fn pose(&self, coefficients: &[f32]) -> Result<[Vec3; N_JOINTS - 1]> {
        if coefficients.len() > N_ANGLES {
            return Err(Error::shape("coefficients of the hand pose", "[1 to 45]", [coefficients.len()]));
        }
        let mut angles = self.mean.clone();
        for (coefficient, component) in coefficients.iter().zip(self.components.chunks_exact(N_ANGLES)) {
            angles.iter_mut().zip(component).for_each(|(angle, part)| *angle += coefficient * part);
        }
        Ok(rotations(&angles))
    }
}

fn rotations(angles: &[f32]) -> [Vec3; N_JOINTS - 1] {
    std::array::from_fn(|joint| Vec3::from_slice(&angles[3 * joint..]))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pose_is_the_mean_and_each_coefficient_times_its_component() {
        let mut components = vec![0.0; N_ANGLES * N_ANGLES];
        (components[4], components[N_ANGLES + 44]) = (2.0, -1.0);
        let basis = PoseBasis { mean: (0..N_ANGLES).map(|k| k as f32).collect(), components };
        let pose = basis.pose(&[0.5, 3.0]).unwrap();
        assert_eq!(pose[1], Vec3::new(3.0, 5.0, 5.0));
        assert_eq!(pose[14], Vec3::new(42.0, 43.0, 41.0));
        assert_eq!(basis.pose(&[]).unwrap(), basis.mean());
        assert!(basis.pose(&[0.0; 46]).is_err());
    }
}
