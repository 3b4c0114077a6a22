//! Draws one posed hand.

use glam::Vec3;
use image::{Rgb, RgbImage};

use super::color::PAPER;
use super::raster::{self, Camera, ColoredMesh};
use super::smooth::tessellated;
use crate::hand::{HandModel, PosedHand, Side, vertex_normals};

/// Viewpoint of a picture of a hand.
#[derive(Debug, Clone, Copy)]
pub enum View {
    /// The palm with the fingers up. The view follows the wrist, and the hand fills the picture.
    Palmar,
    /// The back of the hand with the fingers up. The view follows the wrist, and the hand fills the picture.
    Dorsal,
}

/// Draws a posed hand with one colour per vertex.
///
/// `colors`: (778). `size`: width and height, pixels.
///
/// # Panics
/// If the numbers of `colors` and vertices differ.
pub fn hand_picture(
    model: &HandModel,
    posed: &PosedHand,
    colors: &[Rgb<u8>],
    view: View,
    size: (u32, u32),
) -> RgbImage {
    assert_eq!(colors.len(), posed.vertices.len(), "one colour per vertex");
    let normals = vertex_normals(&posed.vertices, &model.faces);
    let fine = tessellated(&posed.vertices, &normals, colors, &model.faces);
    let mesh =
        ColoredMesh { vertices: &fine.vertices, normals: &fine.normals, colors: &fine.colors, faces: &fine.faces };
    raster::draw(&mesh, &camera(model, posed, view, size), PAPER, size)
}

/// Returns the pixels of points in [`hand_picture`].
pub fn pixels(model: &HandModel, posed: &PosedHand, points: &[Vec3], view: View, size: (u32, u32)) -> Vec<(f32, f32)> {
    let camera = camera(model, posed, view, size);
    points.iter().map(|point| camera.pixel(*point, size)).collect()
}

fn camera(model: &HandModel, posed: &PosedHand, view: View, size: (u32, u32)) -> Camera {
    let fingers = match model.side {
        Side::Left => Vec3::X,
        Side::Right => Vec3::NEG_X,
    };
    let (toward, up) = match view {
        View::Palmar => (Vec3::NEG_Y, fingers),
        View::Dorsal => (Vec3::Y, fingers),
    };
    let wrist = posed.rotations[0];
    framed(&posed.vertices, wrist * toward, wrist * up, size)
}

/// Creates a camera whose picture the points fill, with a margin.
fn framed(points: &[Vec3], toward: Vec3, up: Vec3, (width, height): (u32, u32)) -> Camera {
    const MARGIN: f32 = 1.08;
    let camera = Camera::new(Vec3::ZERO, toward, up, 1.0);
    let seen = points.iter().map(|&point| camera.view_from_world * point);
    let (low, high) = seen.fold((Vec3::MAX, Vec3::MIN), |(low, high), point| (low.min(point), high.max(point)));
    let extent = (high - low) * MARGIN;
    let aspect = width.max(1) as f32 / height.max(1) as f32;
    Camera {
        target: camera.view_from_world.transpose() * (0.5 * (low + high)),
        height: extent.y.max(extent.x / aspect).max(1e-3),
        ..camera
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hand::HandParams;

    fn picture(side: Side, view: View) -> RgbImage {
        let model = HandModel::builtin(side);
        let posed = model.forward(&HandParams { global_orient: Vec3::new(0.4, 1.0, -2.0), ..HandParams::default() });
        let mut colors = vec![Rgb([200, 200, 200]); posed.vertices.len()];
        colors[model.tip_vertices[1] as usize] = Rgb([255, 0, 0]);
        hand_picture(&model, &posed, &colors, view, (100, 120))
    }

    fn red_centre(picture: &RgbImage) -> (u32, u32) {
        let redness = |(_, _, p): &(u32, u32, &Rgb<u8>)| i32::from(p.0[0]) - i32::from(p.0[1]);
        let (x, y, _) = picture.enumerate_pixels().max_by_key(redness).unwrap();
        (x, y)
    }

    #[test]
    fn fingers_point_up_and_sides_match_the_view() {
        // In the palmar view of a right hand, the index finger is in the right half; in the dorsal view, in the left
        // half. A left hand is the mirror image.
        for (side, view, right_half) in [
            (Side::Right, View::Palmar, true),
            (Side::Right, View::Dorsal, false),
            (Side::Left, View::Palmar, false),
            (Side::Left, View::Dorsal, true),
        ] {
            let (x, y) = red_centre(&picture(side, view));
            assert!(y < 30, "{side:?} {view:?}: fingertip at height {y}");
            assert_eq!(x > 45, right_half, "{side:?} {view:?}: fingertip at {x}");
        }
    }

    #[test]
    fn hand_fills_the_picture_without_being_clipped() {
        let picture = picture(Side::Right, View::Palmar);
        let inked = picture.pixels().filter(|pixel| **pixel != PAPER).count();
        assert!((2500..9000).contains(&inked), "{inked} pixels");
        let border = (0..100).flat_map(|x| [(x, 0), (x, 119)]).chain((0..120).flat_map(|y| [(0, y), (99, y)]));
        assert!(border.into_iter().all(|(x, y)| *picture.get_pixel(x, y) == PAPER));
    }
}
