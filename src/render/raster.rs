//! Software rasteriser: shaded triangles with a depth buffer.

use glam::{Mat3, Vec3};
use image::{Rgb, RgbImage};

use super::color::{encoded, linear};

/// Number of samples per pixel along each axis.
const SUPERSAMPLING: u32 = 3;

/// An orthographic camera.
#[derive(Debug, Clone, Copy)]
pub(super) struct Camera {
    /// Point at the centre of the picture, m.
    pub target: Vec3,
    /// Rotation to the view frame; its rows are the world directions right, up and towards the viewer.
    pub view_from_world: Mat3,
    /// Height of the picture, m.
    pub height: f32,
}

/// Triangles with a normal and a colour per vertex.
#[derive(Debug, Clone, Copy)]
pub(super) struct ColoredMesh<'a> {
    /// Vertices, m.
    pub vertices: &'a [Vec3],
    /// Unit normals, one per vertex.
    pub normals: &'a [Vec3],
    /// Colours, one per vertex.
    pub colors: &'a [Rgb<u8>],
    /// Triangles, counter-clockwise seen from outside.
    pub faces: &'a [[u32; 3]],
}

/// A vertex in screen coordinates.
#[derive(Clone, Copy)]
struct Corner {
    /// Pixels right, pixels down, metres towards the viewer.
    at: Vec3,
    normal: Vec3,
    color: Vec3,
}

impl Camera {
    /// Creates a camera that looks along `-toward_viewer`, with `up` upwards in the picture.
    pub fn new(target: Vec3, toward_viewer: Vec3, up: Vec3, height: f32) -> Self {
        let toward = toward_viewer.normalize();
        let up = up.reject_from_normalized(toward).normalize();
        let right = up.cross(toward);
        Self { target, view_from_world: Mat3::from_cols(right, up, toward).transpose(), height }
    }

    /// Returns the pixel of a point in a picture of this size: right and down.
    pub fn pixel(&self, point: Vec3, (width, height): (u32, u32)) -> (f32, f32) {
        let (view, scale) = (self.view_from_world * (point - self.target), height as f32 / self.height);
        (0.5 * width as f32 + view.x * scale, 0.5 * height as f32 - view.y * scale)
    }
}

/// Draws a mesh on `background`, lit from the upper left of the viewer.
pub(super) fn draw(mesh: &ColoredMesh, camera: &Camera, background: Rgb<u8>, (width, height): (u32, u32)) -> RgbImage {
    let (fine_width, fine_height) = (width * SUPERSAMPLING, height * SUPERSAMPLING);
    let mut canvas = Canvas::new(fine_width, fine_height, linear(background));
    let scale = fine_height as f32 / camera.height;
    let corner = |vertex: u32| {
        let vertex = vertex as usize;
        let view = camera.view_from_world * (mesh.vertices[vertex] - camera.target);
        Corner {
            at: Vec3::new(0.5 * fine_width as f32 + view.x * scale, 0.5 * fine_height as f32 - view.y * scale, view.z),
            normal: camera.view_from_world * mesh.normals[vertex],
            color: linear(mesh.colors[vertex]),
        }
    };
    for face in mesh.faces {
        canvas.triangle(face.map(corner));
    }
    canvas.downsampled(width, height)
}

struct Canvas {
    width: u32,
    height: u32,
    depth: Vec<f32>,
    color: Vec<Vec3>,
}

impl Canvas {
    fn new(width: u32, height: u32, background: Vec3) -> Self {
        let pixels = (width * height) as usize;
        Self { width, height, depth: vec![f32::NEG_INFINITY; pixels], color: vec![background; pixels] }
    }

    fn triangle(&mut self, [a, b, c]: [Corner; 3]) {
        let area = edge(a.at, b.at, c.at);
        if area.abs() < 1e-12 {
            return;
        }
        let low = a.at.min(b.at).min(c.at).floor().max(Vec3::ZERO);
        let high = a.at.max(b.at).max(c.at).ceil();
        for y in low.y as u32..(high.y.max(0.0) as u32).min(self.height) {
            for x in low.x as u32..(high.x.max(0.0) as u32).min(self.width) {
                let pixel = Vec3::new(x as f32 + 0.5, y as f32 + 0.5, 0.0);
                let weights =
                    [edge(b.at, c.at, pixel), edge(c.at, a.at, pixel), edge(a.at, b.at, pixel)].map(|w| w / area);
                if weights.iter().any(|&w| w < 0.0) {
                    continue;
                }
                let mix = |get: fn(&Corner) -> Vec3| get(&a) * weights[0] + get(&b) * weights[1] + get(&c) * weights[2];
                let slot = (y * self.width + x) as usize;
                let depth = mix(|corner| corner.at).z;
                if depth > self.depth[slot] {
                    self.depth[slot] = depth;
                    self.color[slot] =
                        shade(mix(|corner| corner.color), mix(|corner| corner.normal).normalize_or_zero());
                }
            }
        }
    }

    /// Downsamples with a box filter in linear light.
    fn downsampled(&self, width: u32, height: u32) -> RgbImage {
        RgbImage::from_fn(width, height, |x, y| {
            let mut sum = Vec3::ZERO;
            for (dx, dy) in (0..SUPERSAMPLING).flat_map(|dy| (0..SUPERSAMPLING).map(move |dx| (dx, dy))) {
                sum += self.color[((y * SUPERSAMPLING + dy) * self.width + x * SUPERSAMPLING + dx) as usize];
            }
            encoded(sum / (SUPERSAMPLING * SUPERSAMPLING) as f32)
        })
    }
}

/// Computes twice the signed area of the triangle a, b, p on the screen.
fn edge(a: Vec3, b: Vec3, p: Vec3) -> f32 {
    (b.x - a.x) * (p.y - a.y) - (b.y - a.y) * (p.x - a.x)
}

/// Shades with diffuse light from the upper left and a fill light; grazing surfaces are darker.
fn shade(color: Vec3, normal: Vec3) -> Vec3 {
    const KEY: Vec3 = Vec3::new(-0.43, 0.52, 0.74);
    const FILL: Vec3 = Vec3::new(0.63, -0.21, 0.75);
    let light = 0.22 + 0.68 * normal.dot(KEY).max(0.0) + 0.22 * normal.dot(FILL).max(0.0);
    color * light * (0.65 + 0.35 * normal.z.clamp(0.0, 1.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    const RED: Rgb<u8> = Rgb([255, 0, 0]);
    const BLUE: Rgb<u8> = Rgb([0, 0, 255]);
    const PAPER: Rgb<u8> = Rgb([255, 255, 255]);

    /// Draws two squares facing +z, the smaller blue one in front of the red one.
    fn picture() -> RgbImage {
        let square = |z: f32, half: f32| {
            [(-half, -half), (half, -half), (half, half), (-half, half)].map(|(x, y)| Vec3::new(x, y, z))
        };
        let vertices = [square(0.0, 0.4), square(0.1, 0.2)].concat();
        let colors = [[RED; 4], [BLUE; 4]].concat();
        // The nearer square comes first, so that only the depth buffer can put it in front.
        let faces = [[4, 5, 6], [4, 6, 7], [0, 1, 2], [0, 2, 3]];
        let camera = Camera::new(Vec3::ZERO, Vec3::Z, Vec3::Y, 1.0);
        let mesh = ColoredMesh { vertices: &vertices, normals: &[Vec3::Z; 8], colors: &colors, faces: &faces };
        draw(&mesh, &camera, PAPER, (50, 50))
    }

    #[test]
    fn nearer_surface_hides_the_farther() {
        let picture = picture();
        let strongest =
            |x: u32, y: u32| picture.get_pixel(x, y).0.iter().enumerate().max_by_key(|(_, v)| **v).unwrap().0;
        assert_eq!(strongest(25, 25), 2);
        assert_eq!(strongest(8, 25), 0);
        assert_eq!(*picture.get_pixel(2, 25), PAPER);
    }

    #[test]
    fn drawn_area_equals_the_projected_area() {
        let inked = picture().pixels().filter(|pixel| **pixel != PAPER).count();
        assert_eq!(inked, 40 * 40);
    }

    #[test]
    fn surfaces_outside_the_picture_are_clipped() {
        let vertices = [Vec3::new(-9.0, -9.0, 0.0), Vec3::new(9.0, -9.0, 0.0), Vec3::new(0.0, 9.0, f32::NAN)];
        let camera = Camera::new(Vec3::ZERO, Vec3::Z, Vec3::Y, 1.0);
        let mesh = ColoredMesh { vertices: &vertices, normals: &[Vec3::Z; 3], colors: &[RED; 3], faces: &[[0, 1, 2]] };
        assert_eq!(draw(&mesh, &camera, PAPER, (8, 8)).dimensions(), (8, 8));
    }
}
