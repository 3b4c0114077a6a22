//! A user's own photographs and meshes in the background.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use glam::DVec3;
use image::RgbImage;
use rand::seq::IndexedRandom;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::material::TEXTURE_SIDE;
use super::{PhotoDraw, Prop, PropShape};
use crate::dataset::image_folder::image_files;
use crate::error::{Error, Result};
use crate::file::{input, limits};
use crate::image::{Filter, Resize, decode, resize};
use crate::sim::object::{TriangleMesh, load_mesh};

/// Largest number of triangles of a mesh in the background: the software renderer draws each of them in each picture.
const MAX_TRIANGLES: usize = 50_000;
/// Mixed into the seed of the hands' texture, so that own pictures are drawn from a stream of their own.
const STREAM: u64 = 0x6261_636b;

/// Photographs for walls, floor and table.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Backgrounds(Vec<PathBuf>);

/// Meshes for the clutter, each with the centre of its bounding box at the origin and a largest side of 1.
#[derive(Debug, Clone, PartialEq)]
pub struct PropMeshes(Vec<Arc<TriangleMesh>>);

/// Photographs of an episode in place of drawn textures.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct OwnPictures {
    /// Walls and what lies beyond.
    pub wall: Option<RgbImage>,
    /// Floor.
    pub floor: Option<RgbImage>,
    /// Table.
    pub table: Option<RgbImage>,
}

impl Backgrounds {
    /// Lists the PNG and JPEG files of a folder.
    ///
    /// # Errors
    /// If the folder can't be read or holds no such file.
    pub fn open(folder: &Path) -> Result<Self> {
        let files = image_files(folder)?;
        if files.is_empty() {
            return Err(Error::file(folder, "expected PNG or JPEG files in the folder, got none"));
        }
        Ok(Self(files))
    }

    /// Draws a photograph: the square in its middle, with as many pixels as a drawn texture has.
    fn sample(&self, rng: &mut impl Rng) -> Result<RgbImage> {
        let path = self.0.choose(rng).ok_or_else(|| Error::value("backgrounds", "at least one picture", "none"))?;
        let bytes = input::read(path, limits::FILE)?;
        let picture = decode(&bytes).map_err(|error| Error::file(path, error))?;
        resize(&picture, 2 * TEXTURE_SIDE as usize, Resize::Crop, Filter::Triangle)
    }
}

impl PropMeshes {
    /// Reads the OBJ and STL files of a folder.
    ///
    /// # Errors
    /// If the folder holds no such file, or one of them can't be read, is flat or has too many triangles.
    pub fn open(folder: &Path) -> Result<Self> {
        let mut files = Vec::new();
        for entry in std::fs::read_dir(folder).map_err(Error::io(folder))? {
            let path = entry.map_err(Error::io(folder))?.path();
            let ending = path.extension().map(|ending| ending.to_string_lossy().to_lowercase());
            if ending.is_some_and(|ending| ["obj", "stl"].contains(&ending.as_str())) {
                files.push(path);
            }
        }
        // The same seed takes the same file on each machine.
        files.sort();
        if files.is_empty() {
            return Err(Error::file(folder, "expected OBJ or STL files in the folder, got none"));
        }
        Ok(Self(files.iter().map(|path| unit_mesh(path).map(Arc::new)).collect::<Result<_>>()?))
    }
}

impl PhotoDraw {
    /// Puts own photographs on the walls, and in half of the episodes each on floor and table; puts own meshes in place of the
    /// drawn shapes of the clutter.
    ///
    /// # Errors
    /// If a photograph can't be read.
    pub(crate) fn furnish(&mut self, backgrounds: Option<&Backgrounds>, meshes: Option<&PropMeshes>) -> Result<()> {
        let mut rng = ChaCha8Rng::seed_from_u64(self.skin_seed ^ STREAM);
        if let Some(backgrounds) = backgrounds {
            self.own.wall = Some(backgrounds.sample(&mut rng)?);
            for place in [&mut self.own.floor, &mut self.own.table] {
                if rng.random::<bool>() {
                    *place = Some(backgrounds.sample(&mut rng)?);
                }
            }
        }
        if let Some(PropMeshes(meshes)) = meshes {
            self.meshes.clone_from(meshes);
            for prop in &mut self.props {
                replace(prop, rng.random_range(0..meshes.len()), meshes);
            }
        }
        Ok(())
    }

    /// Returns the picture on the walls.
    pub(crate) fn wall_picture(&self) -> RgbImage {
        self.own.wall.clone().unwrap_or_else(|| self.wall.paint())
    }

    /// Returns the picture on the floor.
    pub(crate) fn floor_picture(&self) -> RgbImage {
        self.own.floor.clone().unwrap_or_else(|| self.floor.paint())
    }

    /// Returns the picture on the table.
    pub(crate) fn table_picture(&self) -> RgbImage {
        self.own.table.clone().unwrap_or_else(|| self.table.paint())
    }
}

/// Gives a prop the shape of a mesh, as large as fits into the shape that was drawn, and standing on the same ground.
fn replace(prop: &mut Prop, index: usize, meshes: &[Arc<TriangleMesh>]) {
    let half = half_size(&meshes[index].0);
    let ground = prop.position.z - prop.half_size.z;
    let reach = prop.half_size.truncate().length() / half.truncate().length();
    let scale = reach.min(prop.half_size.max_element() / half.z);
    prop.shape = PropShape::Mesh(index);
    prop.half_size = scale * half;
    prop.position.z = ground + prop.half_size.z;
}

/// Half sides of the bounding box, which lies around the origin.
fn half_size(vertices: &[DVec3]) -> DVec3 {
    vertices.iter().fold(DVec3::ZERO, |half, vertex| half.max(vertex.abs()))
}

/// Reads a mesh, centres it, and scales it to a largest side of 1.
fn unit_mesh(path: &Path) -> Result<TriangleMesh> {
    let (mut vertices, triangles) = load_mesh(path)?;
    if triangles.len() > MAX_TRIANGLES {
        let expected = format!("expected at most {MAX_TRIANGLES} triangles of an object in the background");
        return Err(Error::file(path, format!("{expected}, got {}", triangles.len())));
    }
    let low = vertices.iter().copied().fold(DVec3::INFINITY, DVec3::min);
    let high = vertices.iter().copied().fold(DVec3::NEG_INFINITY, DVec3::max);
    let size = high - low;
    if size.min_element() <= 1e-4 * size.max_element() {
        return Err(Error::file(path, format!("expected a surface that spans a volume, got one of {size}")));
    }
    vertices.iter_mut().for_each(|vertex| *vertex = (*vertex - 0.5 * (low + high)) / size.max_element());
    Ok((vertices, triangles))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_mesh_stays_within_the_place_of_the_shape_and_on_its_ground() {
        let mut rng = ChaCha8Rng::seed_from_u64(9);
        for _ in 0..500 {
            let mut prop = Prop::sample(&mut rng);
            let drawn = prop;
            let half = DVec3::from_array(std::array::from_fn(|_| rng.random_range(0.05..0.5)));
            let corners = [-1.0, 1.0].map(|sign| sign * half).to_vec();
            replace(&mut prop, 0, &[Arc::new((corners, Vec::new()))]);
            let [reach, drawn_reach] = [prop, drawn].map(|prop| prop.half_size.truncate().length());
            assert!(reach <= drawn_reach * (1.0 + 1e-12));
            let [ground, drawn_ground] = [prop, drawn].map(|prop| prop.position.z - prop.half_size.z);
            assert!((ground - drawn_ground).abs() < 1e-12);
            assert!((prop.half_size / half - prop.half_size.x / half.x).abs().max_element() < 1e-12, "distorted");
        }
    }
}
