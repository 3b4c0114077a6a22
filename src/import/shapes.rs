//! Shapes of objects, for the distances of hands from them.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

use glam::{DAffine3, Vec3};
use rayon::prelude::*;

use crate::error::{Error, Result};
use crate::file::{self, mesh::Mesh};
use crate::geometry::{PROXIMITY, SPACING, SampledSurface, Surface};

/// Spacing of the points that stand for an object's vertices in the 1 cm rule, m. The paper's meshes are scans about this
/// fine; a coarser spacing misses contact, a finer one costs memory.
pub const POINT_SPACING: f32 = 0.002;
/// Largest distance from an object that is computed, m; vertices farther away have this distance.
pub const FAR: f32 = 0.05;
/// Number of vertices that one thread takes at a time: few parts, because the first vertex of each lacks a neighbour's bound.
const PART: usize = 130;
/// Number of shapes that stay in memory between recordings.
const KEPT: usize = 64;

/// A file that holds a mesh, and the length of its unit.
#[derive(Debug, Clone)]
pub struct MeshFile {
    /// Path of the file.
    pub path: PathBuf,
    /// Length of the file's unit, m.
    pub to_metres: f32,
    /// Reader of the mesh, of a file that holds more than a mesh.
    pub part: Option<fn(&Path) -> Result<Mesh>>,
}

/// Shape of a rigid object, in its own frame.
#[derive(Debug)]
pub struct Shape {
    points: SampledSurface,
    surface: Surface,
}

/// Distances of vertices from all objects, m.
#[derive(Debug, Clone, PartialEq)]
pub struct Gaps {
    /// Distance from the nearest point of a resampled surface; infinity beyond [`PROXIMITY`].
    pub points: Vec<f32>,
    /// Distance from the nearest surface, negative inside of a closed one; infinity beyond [`FAR`].
    pub surface: Vec<f32>,
}

/// Shapes by file, the latest ones.
#[derive(Debug, Default)]
pub struct ShapeCache(Mutex<ShapeList>);

#[derive(Debug, Default)]
struct ShapeList {
    shapes: BTreeMap<PathBuf, (u64, Arc<Shape>)>,
    uses: u64,
}

impl MeshFile {
    /// Creates the description of a mesh file whose unit has a length of `to_metres`, m.
    pub fn new(path: PathBuf, to_metres: f32) -> Self {
        Self { path, to_metres, part: None }
    }

    /// Reads the mesh, m.
    ///
    /// # Errors
    /// If the file can't be read, or its mesh is invalid.
    pub fn read(&self) -> Result<Mesh> {
        let (mut vertices, triangles) = self.part.unwrap_or(file::mesh::read)(&self.path)?;
        vertices.iter_mut().for_each(|vertex| *vertex *= self.to_metres);
        Ok((vertices, triangles))
    }
}

impl Shape {
    /// Reads a mesh and prepares it for distances.
    ///
    /// # Errors
    /// If the file can't be read, or its mesh is invalid.
    pub fn read(file: &MeshFile) -> Result<Self> {
        let (vertices, triangles) = file.read()?;
        let named = |error: Error| Error::file(&file.path, error);
        // A large object, such as furniture, would have too many points at the fine spacing.
        let points = SampledSurface::new(&vertices, &triangles, POINT_SPACING)
            .or_else(|_| SampledSurface::new(&vertices, &triangles, SPACING));
        Ok(Self { points: points.map_err(named)?, surface: Surface::new(vertices, triangles).map_err(named)? })
    }
}

impl ShapeCache {
    /// Returns the shape of a file, which is read at its first use.
    ///
    /// # Errors
    /// As [`Shape::read`].
    pub fn get(&self, file: &MeshFile) -> Result<Arc<Shape>> {
        let mut list = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        list.uses += 1;
        let uses = list.uses;
        if let Some((used, shape)) = list.shapes.get_mut(&file.path) {
            *used = uses;
            return Ok(Arc::clone(shape));
        }
        let shape = Arc::new(Shape::read(file)?);
        if list.shapes.len() == KEPT {
            let oldest = list.shapes.iter().min_by_key(|(_, (used, _))| *used).map(|(path, _)| path.clone());
            oldest.and_then(|oldest| list.shapes.remove(&oldest));
        }
        list.shapes.insert(file.path.clone(), (uses, Arc::clone(&shape)));
        Ok(shape)
    }
}

impl Gaps {
    /// Creates the distances of `n` vertices from nothing.
    pub fn new(n: usize) -> Self {
        Self { points: vec![f32::INFINITY; n], surface: vec![f32::INFINITY; n] }
    }

    /// Adds an object at `reference_from_object` to the distances of `vertices`, m, in the reference frame. Runs on all threads.
    pub fn add(&mut self, vertices: &[Vec3], shape: &Shape, reference_from_object: DAffine3) {
        let object_from_reference = reference_from_object.inverse();
        let parts = self.surface.par_chunks_mut(PART).zip(self.points.par_chunks_mut(PART));
        parts.zip(vertices.par_chunks(PART)).for_each(|((surface, points), vertices)| {
            // Neighbours in the numbering are neighbours on the hand, mostly: one's distance bounds the next one's.
            let mut beside = None;
            for ((surface, points), vertex) in surface.iter_mut().zip(points).zip(vertices) {
                let point = object_from_reference.transform_point3(vertex.as_dvec3()).as_vec3();
                // Nothing farther than the nearest object so far matters; the rule of points asks within its own distance.
                let distance = shape.surface.distance_beside(point, FAR.min(surface.max(PROXIMITY)), &mut beside);
                if distance < *surface {
                    *surface = distance;
                }
                // Points lie on the surface, and the nearest of them within its spacing of the nearest place.
                if distance.abs() <= PROXIMITY {
                    let most = PROXIMITY.min(*points).min(distance.abs() + shape.points.spacing());
                    let nearest = shape.points.distance(point, most);
                    if nearest < *points {
                        *points = nearest;
                    }
                }
            }
        });
    }
}
