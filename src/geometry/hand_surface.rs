//! Surface of a posed hand, for labelling contact with the other hand.

use std::collections::HashMap;

use glam::Vec3;

use super::proximity::{Sample, SampledSurface, samples};
use super::surface::Surface;
use crate::error::{Error, Result};
use crate::hand::{HandModel, HandParams, N_VERTICES};

/// Surface of a hand, sampled for label (a) and closed for label (b); it moves from frame to frame.
#[derive(Debug, Clone)]
pub struct HandSurface {
    surface: Surface,
    samples: Vec<Sample>,
    points: SampledSurface,
}

impl HandSurface {
    /// Creates the surface of `model`, with sample points at most `spacing` apart in the rest pose, m.
    ///
    /// A fan of triangles closes the open boundary that MANO has at the wrist; it is not sampled.
    ///
    /// # Errors
    /// If the spacing is not a positive length, or the model's mesh is invalid.
    pub fn new(model: &HandModel, spacing: f32) -> Result<Self> {
        let rest = model.forward(&HandParams::default()).vertices;
        let samples = samples(&rest, &model.faces, spacing)?;
        let points = SampledSurface::from_points(samples.iter().map(|s| s.at(&rest)).collect(), spacing)?;
        let triangles = model.faces.iter().copied().chain(caps(&model.faces)).collect();
        Ok(Self { surface: Surface::new(rest, triangles)?, samples, points })
    }

    /// Moves the surface to (778) posed `vertices`, m.
    ///
    /// # Errors
    /// If the number of vertices is wrong, or a coordinate is not finite.
    pub fn set_vertices(&mut self, vertices: &[Vec3]) -> Result<()> {
        if vertices.len() != N_VERTICES {
            return Err(Error::shape("vertices", format!("[{N_VERTICES}, 3]"), [vertices.len(), 3]));
        }
        self.surface.set_vertices(vertices)?;
        self.points.set_points(&self.samples.iter().map(|sample| sample.at(vertices)).collect::<Vec<_>>())
    }

    /// Returns the closed surface.
    pub fn surface(&self) -> &Surface {
        &self.surface
    }

    /// Returns the sampled surface.
    pub fn points(&self) -> &SampledSurface {
        &self.points
    }
}

/// Returns triangles that close each boundary loop.
fn caps(faces: &[[u32; 3]]) -> Vec<[u32; 3]> {
    let edges = || faces.iter().flat_map(|&[a, b, c]| [(a, b), (b, c), (c, a)]);
    let directed: std::collections::HashSet<(u32, u32)> = edges().collect();
    // The cap traverses each boundary edge in the opposite direction.
    let mut next: HashMap<u32, u32> =
        edges().filter(|(from, to)| !directed.contains(&(*to, *from))).map(|(from, to)| (to, from)).collect();
    let mut caps = Vec::new();
    while let Some(start) = next.keys().min().copied() {
        let mut at = next.remove(&start);
        let mut before = None;
        while let Some(vertex) = at.filter(|vertex| *vertex != start) {
            caps.extend(before.map(|before| [start, before, vertex]));
            before = Some(vertex);
            at = next.remove(&vertex);
        }
    }
    caps
}
