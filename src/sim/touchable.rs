//! Labels (a) and (b) of a scene: distances of the hands' vertices from all that the hands can touch.
//!
//! Hands can touch the objects, the table and the other hand's skin. The touch of a hand on itself has no distance,
//! since each vertex lies on its own skin. A soft object has its shape at rest.

use glam::{DQuat, DVec3, Vec3};

use super::convex;
use super::frame::ObjectPose;
use super::mjcf::{TABLE_CENTRE, TABLE_HALF};
use super::randomize::EpisodeDraw;
use crate::error::{Error, Result};
use crate::geometry::{HandSurface, SampledSurface, Sampling, Solid};
use crate::hand::{HandModel, N_VERTICES, Side};
use crate::tactile::N_FIELD;

/// Surfaces that hands can touch in one episode.
#[derive(Debug, Clone)]
pub struct Touchables {
    parts: Vec<ObjectPart>,
    table: Solid,
    hands: [HandSurface; 2],
}

#[derive(Debug, Clone)]
struct ObjectPart {
    name: String,
    points: SampledSurface,
    solid: Solid,
    /// `world_from_object` of a fixed part, m; `None` for a part that moves with its object.
    fixed: Option<(DVec3, DQuat)>,
}

/// Distances of the 1556 vertices from the nearest surface, m; infinity beyond the cutoff.
#[derive(Debug, Clone, PartialEq)]
pub struct Distances {
    /// (1556) distance from the nearest point of a resampled surface: label (a) at any threshold.
    pub points: Vec<f32>,
    /// (1556) signed distance from the nearest surface, negative inside: label (b) at any threshold.
    pub surface: Vec<f32>,
}

impl Touchables {
    /// Samples the surfaces of an episode and of both hands; points for label (a) are `spacing`, m, apart.
    ///
    /// # Errors
    /// If the spacing is not a positive length, or a shape has no surface.
    pub fn new(episode: &EpisodeDraw, hands: [&HandModel; 2], spacing: f32) -> Result<Self> {
        let mut parts = Vec::new();
        for object in episode.objects.iter().filter(|object| object.solid) {
            let (points, solid) = (object.shape.sampled_surface(spacing)?, object.shape.solid()?);
            parts.push(ObjectPart { name: object.name.clone(), points, solid, fixed: None });
            if let Some(points) = object.shape.sampled_base(spacing)? {
                let fixed = Some((object.position, object.orientation));
                let (name, solid) = (format!("base of {}", object.name), object.shape.base_solid()?);
                parts.push(ObjectPart { name, points, solid, fixed });
            }
        }
        let mut table = Solid::default();
        table.add_cuboid(TABLE_HALF.as_vec3(), convex::pose(TABLE_CENTRE, DQuat::IDENTITY))?;
        let [left, right] = hands;
        Ok(Self { parts, table, hands: [HandSurface::new(left, spacing)?, HandSurface::new(right, spacing)?] })
    }

    /// Computes distances up to `cutoff`, m.
    ///
    /// `vertices`: posed (778) vertices of the left and the right hand in the world frame, m; `None` = absent,
    /// infinitely far. `objects`: poses by name; an object without a pose, or whose pose is not finite, does not exist.
    ///
    /// # Errors
    /// If a hand has another number of vertices, or a vertex is not finite.
    pub fn distances(
        &mut self,
        vertices: [Option<&[Vec3]>; 2],
        objects: &[ObjectPose],
        cutoff: f32,
    ) -> Result<Distances> {
        let mut distances = Distances { points: vec![f32::INFINITY; N_FIELD], surface: vec![f32::INFINITY; N_FIELD] };
        let both_near = match vertices {
            [Some(left), Some(right)] => box_distance(left, right) <= cutoff,
            _ => false,
        };
        for side in Side::BOTH {
            let Some(vertices) = vertices[side as usize] else { continue };
            if vertices.len() != N_VERTICES {
                return Err(Error::shape("vertices", format!("[{N_VERTICES}, 3]"), [vertices.len(), 3]));
            }
            if let Some(bad) = vertices.iter().position(|v| !v.is_finite()) {
                return Err(Error::value(format!("vertex {bad} of the {} hand", side.name()), "finite", vertices[bad]));
            }
            if both_near {
                self.hands[side as usize].set_vertices(vertices)?;
            }
        }
        for side in Side::BOTH {
            let Some(vertices) = vertices[side as usize] else { continue };
            let mut hand = HandDistances {
                points: &mut distances.points[side.range()],
                surface: &mut distances.surface[side.range()],
                cutoff,
            };
            for part in &self.parts {
                let moving = objects.iter().find(|object| object.name == part.name);
                let pose = part.fixed.or_else(|| moving.map(|object| (object.position, object.orientation)));
                let Some((position, orientation)) = pose else { continue };
                if position.is_finite() && orientation.is_finite() {
                    let local = |v: Vec3| (orientation.inverse() * (v.as_dvec3() - position)).as_vec3();
                    hand.add(vertices.iter().map(|v| local(*v)), &part.points, |p, reach| {
                        part.solid.distance(p, reach)
                    });
                }
            }
            hand.add_table(vertices, &self.table, self.hands[0].points().spacing());
            if both_near {
                let other = &self.hands[1 - side as usize];
                hand.add(vertices.iter().copied(), other.points(), |p, reach| other.surface().distance(p, reach));
            }
        }
        Ok(distances)
    }

    /// Returns the sampling of objects and hands; the table is a lattice of the same spacing.
    pub fn samplings(&self) -> Vec<Sampling> {
        let millimetres = |metres: f32| (f64::from(metres) * 1e6).round() / 1e3;
        let part = |part: &ObjectPart| Sampling {
            name: part.name.clone(),
            points: part.points.points().len(),
            spacing_mm: millimetres(part.points.spacing()),
            parts: part.solid.n_parts(),
            sides: part.solid.sides(),
        };
        let hand = |(hand, side): (&HandSurface, Side)| Sampling {
            name: format!("{} hand", side.name()),
            points: hand.points().points().len(),
            spacing_mm: millimetres(hand.points().spacing()),
            parts: 1,
            sides: hand.surface().sides(),
        };
        self.parts.iter().map(part).chain(self.hands.iter().zip(Side::BOTH).map(hand)).collect()
    }
}

/// Distances of one hand's vertices, reduced over the surfaces so far.
struct HandDistances<'a> {
    points: &'a mut [f32],
    surface: &'a mut [f32],
    cutoff: f32,
}

impl HandDistances<'_> {
    /// Adds a surface, given the vertices in its frame; `distance` computes the distance from it up to a cutoff.
    fn add(
        &mut self,
        vertices: impl Iterator<Item = Vec3>,
        points: &SampledSurface,
        distance: impl Fn(Vec3, f32) -> f32,
    ) {
        for ((vertex, point), surface) in vertices.zip(self.points.iter_mut()).zip(self.surface.iter_mut()) {
            *point = point.min(points.distance(vertex, self.cutoff.min(*point)));
            *surface = surface.min(distance(vertex, self.cutoff.min(surface.max(0.0))));
        }
    }

    /// Adds the table, whose points are a lattice on its top.
    fn add_table(&mut self, vertices: &[Vec3], table: &Solid, spacing: f32) {
        let (low, high) = (TABLE_CENTRE - TABLE_HALF, TABLE_CENTRE + TABLE_HALF);
        let (low, high) = (low.as_vec3(), high.as_vec3());
        for ((vertex, point), surface) in vertices.iter().zip(self.points.iter_mut()).zip(self.surface.iter_mut()) {
            let lattice = (*vertex / spacing).round() * spacing;
            let distance = lattice.clamp(low, high).with_z(high.z).distance(*vertex);
            if distance <= self.cutoff {
                *point = point.min(distance);
            }
            *surface = surface.min(table.distance(*vertex, self.cutoff));
        }
    }
}

/// Returns the distance between the bounding boxes of two sets of points, m.
fn box_distance(a: &[Vec3], b: &[Vec3]) -> f32 {
    let [a, b] = [a, b].map(|points| {
        let fold = |start: Vec3, pick: fn(Vec3, Vec3) -> Vec3| points.iter().copied().fold(start, pick);
        [fold(Vec3::INFINITY, Vec3::min), fold(Vec3::NEG_INFINITY, Vec3::max)]
    });
    (a[0] - b[1]).max(b[0] - a[1]).max(Vec3::ZERO).length()
}
