//! Text files of numbers, and rigid motions.

use std::path::Path;

use glam::{DAffine3, DMat3, DMat4, DVec3, Vec3};

use crate::error::{Error, Result};
use crate::file::{input, limits};
use crate::hand::N_KEYPOINTS;

/// Largest deviation of a rotation matrix from orthonormal: files hold four digits at least.
const MAX_SKEW: f64 = 2e-3;

/// Reads all numbers of a text file, separated by white space or commas.
///
/// # Errors
/// If the file can't be read, or a word is not a finite number.
pub fn read(path: &Path) -> Result<Vec<f64>> {
    parse(path, &input::read_text(path, limits::TEXT)?)
}

/// Reads the numbers of one line or text of the file at `path`.
///
/// # Errors
/// If a word is not a finite number.
pub fn parse(path: &Path, text: &str) -> Result<Vec<f64>> {
    let words = text.split(|c: char| c.is_whitespace() || c == ',').filter(|word| !word.is_empty());
    let number = |(index, word): (usize, &str)| match word.parse::<f64>() {
        Ok(number) if number.is_finite() => Ok(number),
        _ => Err(Error::file(path, format!("number {index}: expected a finite number, got {word:?}"))),
    };
    words.enumerate().map(number).collect()
}

/// Checks the number of values of a field.
///
/// # Errors
/// If it is not `N`.
pub fn exactly<const N: usize>(path: &Path, field: &str, values: &[f64]) -> Result<[f64; N]> {
    values.try_into().map_err(|_| Error::file(path, format!("{field}: expected {N} numbers, got {}", values.len())))
}

/// Returns three numbers as a vector.
pub fn vec3(values: &[f64]) -> Vec3 {
    Vec3::new(values[0] as f32, values[1] as f32, values[2] as f32)
}

/// Returns 21 keypoints, m; `None` if a number is not finite: the tracker did not see the hand.
pub fn keypoints(values: &[f64]) -> Option<[Vec3; N_KEYPOINTS]> {
    let points: Vec<Vec3> =
        values.as_chunks::<3>().0.iter().map(|[x, y, z]| Vec3::new(*x as f32, *y as f32, *z as f32)).collect();
    let points: [Vec3; N_KEYPOINTS] = points.try_into().ok()?;
    points.iter().all(|point| point.is_finite()).then_some(points)
}

/// Creates a rigid motion from a row-major 4 x 4 matrix. `to_metres` is the unit of its translation, m.
///
/// # Errors
/// If the matrix is not a rotation and translation.
pub fn rigid(path: &Path, field: &str, rows: &[f64; 16], to_metres: f64) -> Result<DAffine3> {
    let matrix = DMat4::from_cols_array(rows).transpose();
    let last = matrix.row(3);
    if (last - DMat4::IDENTITY.row(3)).abs().max_element() > MAX_SKEW {
        return Err(Error::file(path, format!("{field}: expected the last row 0 0 0 1, got {last}")));
    }
    let rotation = DMat3::from_mat4(matrix);
    motion(path, field, rotation, matrix.w_axis.truncate() * to_metres)
}

/// Creates a rigid motion from rotation matrix and translation, m.
///
/// # Errors
/// If the matrix is not a rotation, or a number is not finite.
pub fn motion(path: &Path, field: &str, rotation: DMat3, translation: DVec3) -> Result<DAffine3> {
    let skew = (rotation * rotation.transpose() - DMat3::IDENTITY).to_cols_array();
    let skew =
        skew.into_iter().fold(0.0f64, |most, entry| if entry.is_nan() { f64::NAN } else { most.max(entry.abs()) });
    let is_rotation = skew <= MAX_SKEW && rotation.determinant() > 0.0;
    if !is_rotation || !translation.is_finite() {
        let got = format!("{field}: expected a rotation and a finite translation, got {rotation} and {translation}");
        return Err(Error::file(path, got));
    }
    Ok(DAffine3::from_mat3_translation(rotation, translation))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn matrices_that_scale_mirror_or_project_are_refused() {
        let path = Path::new("pose.txt");
        let identity = [1.0, 0.0, 0.0, 1.0, 0.0, 1.0, 0.0, 2.0, 0.0, 0.0, 1.0, 3.0, 0.0, 0.0, 0.0, 1.0];
        let moved = rigid(path, "pose", &identity, 0.001).unwrap();
        assert_eq!(moved.translation, DVec3::new(0.001, 0.002, 0.003));
        for (entry, value) in [(0, 1.1), (0, -1.0), (5, f64::NAN), (3, f64::INFINITY), (15, 0.5), (1, 0.1)] {
            let mut rows = identity;
            rows[entry] = value;
            let error = rigid(path, "pose", &rows, 1.0).unwrap_err().to_string();
            assert!(error.starts_with("pose.txt: pose: expected"), "{error}");
        }
    }
}
