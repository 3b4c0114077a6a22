//! Looks beyond plain colours: textures, clutter, the wearer, more lamps, shade in creases, other cameras, picture processing,
//! and a user's own photographs and meshes.
//!
//! An episode draws all of it from its seed, in random streams of its own, whether it is shown or not; so an effect that is
//! switched on changes nothing else. Touch and motion are the same in all looks.

mod cover;
mod material;
mod noise;
mod own;
mod processing;
mod shade;
mod shutter;
mod wearer;

use std::sync::Arc;

use glam::{DQuat, DVec3};
use rand::Rng;
use rand_chacha::ChaCha8Rng;

use super::appearance::{Rgb, colour};
use super::object::TriangleMesh;
use super::randomize::camera::CameraDraw;
use crate::camera::Distortion;

pub use cover::Cover;
pub(crate) use cover::Flat;
pub use material::Material;
pub use own::{Backgrounds, OwnPictures, PropMeshes};
pub use processing::Processing;
pub(crate) use shade::shade;
pub(crate) use shutter::mix_rows;
pub use wearer::{Tracker, Wearer};

/// Largest number of objects in the background.
const MAX_PROPS: usize = 14;
/// Range of the time in which the rows of a picture are read, s.
const READOUT: std::ops::Range<f64> = 0.008..0.03;
/// Part of the table, in metres from its middle, that clutter leaves free: hands and objects act there.
const FREE: DVec3 = DVec3::new(0.36, 0.3, 0.0);

/// Drawn looks of an episode.
#[derive(Debug, Clone, PartialEq)]
pub struct PhotoDraw {
    /// Cover of the hands.
    pub cover: Cover,
    /// Seed of the hands' texture.
    pub skin_seed: u64,
    /// Textures of table, floor and walls.
    pub table: Material,
    /// Texture of the floor.
    pub floor: Material,
    /// Texture of the walls.
    pub wall: Material,
    /// Textures of the scene's objects, in their order; objects beyond the list repeat it.
    pub objects: Vec<Material>,
    /// Objects in the background.
    pub props: Vec<Prop>,
    /// The wearer of the camera.
    pub wearer: Wearer,
    /// Lamps: position, m, and colour with brightness.
    pub lamps: Vec<(DVec3, Rgb)>,
    /// Another head camera.
    pub camera: CameraDraw,
    /// Processing of the pictures.
    pub processing: Processing,
    /// Time from the reading of the first row of a picture to that of the last, s.
    pub readout: f64,
    /// Photographs of the user on walls, floor and table.
    pub own: OwnPictures,
    /// Meshes of the user, which objects in the background refer to.
    pub meshes: Vec<Arc<TriangleMesh>>,
}

/// Object in the background.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Prop {
    /// Shape.
    pub shape: PropShape,
    /// Half sizes, m; a cylinder takes radius and half height from the first and the last.
    pub half_size: DVec3,
    /// Position of the centre, m.
    pub position: DVec3,
    /// Orientation.
    pub orientation: DQuat,
    /// Texture.
    pub material: Material,
}

/// Shape of an object in the background.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PropShape {
    /// Box: books, screens, boxes.
    Box,
    /// Cylinder: cups, bottles, cans.
    Cylinder,
    /// Ellipsoid: fruit, cushions.
    Ellipsoid,
    /// The mesh of this index in [`PhotoDraw::meshes`], as large as the half sizes say.
    Mesh(usize),
}

impl PhotoDraw {
    /// Draws looks; `camera` is the scene's camera, whose place the other one varies.
    pub(super) fn sample(camera: &CameraDraw, stream: impl Fn(u64) -> ChaCha8Rng) -> Self {
        let [mut hands, mut surfaces, mut things, mut light, mut optics] = [20, 21, 22, 23, 24].map(stream);
        let count = things.random_range(0..=MAX_PROPS);
        Self {
            cover: Cover::sample(&mut hands),
            skin_seed: hands.random(),
            wearer: Wearer::sample(&mut hands),
            table: Material::table(&mut surfaces),
            floor: Material::floor(&mut surfaces),
            wall: Material::wall(&mut surfaces),
            objects: (0..8).map(|_| Material::object(&mut surfaces)).collect(),
            props: (0..count).map(|_| Prop::sample(&mut things)).collect(),
            lamps: (0..light.random_range(1..4)).map(|_| lamp(&mut light)).collect(),
            camera: other_camera(camera, &mut optics),
            processing: Processing::sample(&mut optics),
            readout: optics.random_range(READOUT),
            own: OwnPictures::default(),
            meshes: Vec::new(),
        }
    }

    /// Returns the texture of the scene's object with this index.
    pub(crate) fn object(&self, index: usize) -> &Material {
        &self.objects[index % self.objects.len()]
    }
}

impl Prop {
    /// Draws an object on the table's rim, on the floor around it, or before the walls.
    fn sample(rng: &mut impl Rng) -> Self {
        let shape = [PropShape::Box, PropShape::Box, PropShape::Cylinder, PropShape::Ellipsoid][rng.random_range(0..4)];
        let on_table = rng.random::<f64>() < 0.55;
        let size = if on_table { 0.02..0.12 } else { 0.08..0.5 };
        let half_size = DVec3::from_array([0; 3].map(|_: i32| 0.5 * rng.random_range(size.clone())));
        let reach = half_size.truncate().length();
        let angle = rng.random_range(0.15 * std::f64::consts::PI..0.85 * std::f64::consts::PI);
        let beyond = DVec3::new(angle.cos(), angle.sin(), 0.0);
        // On the table beside and behind the free part; on the floor behind and beside the table.
        let (inner, outer, ground) = if on_table { (1.0, 1.5, 0.0) } else { (2.4, 5.0, -0.75) };
        let place = beyond * rng.random_range(inner..outer) * FREE + beyond * reach;
        Self {
            shape,
            half_size,
            position: DVec3::new(place.x, 0.1 + place.y, ground + half_size.z),
            orientation: DQuat::from_rotation_z(rng.random_range(0.0..std::f64::consts::TAU)),
            material: Material::object(rng),
        }
    }
}

/// Draws a lamp of a warm or cold colour.
fn lamp(rng: &mut impl Rng) -> (DVec3, Rgb) {
    let position = DVec3::new(rng.random_range(-1.5..1.5), rng.random_range(-0.6..1.8), rng.random_range(0.8..2.2));
    (position, colour(rng, 0.0..0.25, 0.1..0.35))
}

/// Draws the camera of another headset: higher, and with a wider lens.
fn other_camera(camera: &CameraDraw, rng: &mut impl Rng) -> CameraDraw {
    let rise = rng.random_range(0.0..0.18);
    let fovy: f64 = rng.random_range(42.0_f64..85.0);
    let bend = rng.random_range(-0.12..0.0);
    CameraDraw {
        eye: camera.eye + DVec3::new(rng.random_range(-0.03..0.03), -0.25 * rise, rise),
        target: camera.target + DVec3::new(0.0, rng.random_range(-0.05..0.08), 0.0),
        fovy: fovy.to_radians(),
        // Only where the lens is simulated at all.
        distortion: if camera.distortion == Distortion::default() {
            camera.distortion
        } else {
            Distortion([bend, 0.0])
        },
        sway: camera.sway.max(rng.random_range(0.0..0.015)),
        ..*camera
    }
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;

    use super::*;

    #[test]
    fn clutter_leaves_the_place_of_hands_and_objects_free() {
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        for _ in 0..2000 {
            let Prop { half_size, position, .. } = Prop::sample(&mut rng);
            let from_middle = (position - DVec3::new(0.0, 0.1, 0.0)).truncate();
            let reach = half_size.truncate().length();
            // Along its direction, the free part is an ellipse.
            let direction = from_middle.normalize();
            let free = 1.0 / (direction / FREE.truncate()).length();
            assert!(from_middle.length() - reach >= 0.99 * free, "{position} {half_size}");
        }
    }
}
