//! Labels (a) and (b) of a scene: how far the vertices of both hands are from everything that hands can touch.
//!
//! That is each object, the table, and the other hand's skin. A hand's touch on itself has no distance: each vertex lies
//! on its own skin. A soft object counts as it is at rest.

use glam::{DQuat, DVec3, Vec3};

use super::convex;
use super::mjcf::{TABLE_CENTRE, TABLE_HALF};
use super::observe::ObjectPose;
use super::randomize::Episode;
use crate::error::{Error, Result};
use crate::geometry::{HandSurface, SampledSurface, Sampling, Solid};
use crate::hand::{HandModel, N_VERTICES, Side};
use crate::tactile::N_FIELD;

/// Everything that hands can touch in one episode.
#[derive(Debug, Clone)]
pub struct Touchables {
    things: Vec<Thing>,
    table: Solid,
    hands: [HandSurface; 2],
}

#[derive(Debug, Clone)]
struct Thing {
    name: String,
    points: SampledSurface,
    solid: Solid,
    /// `world_from_object`, m, of what stands fast.
    fixed: Option<(DVec3, DQuat)>,
}

/// Distances of the 1556 vertices from the nearest thing, m; infinity beyond the cutoff.
#[derive(Debug, Clone, PartialEq)]
pub struct Distances {
    /// (1556) from the nearest point of a resampled surface: label (a) at any threshold.
    pub points: Vec<f32>,
    /// (1556) from the nearest surface, negative inside: label (b) at any threshold.
    pub surface: Vec<f32>,
}

impl Touchables {
    /// Prepares the surfaces of an episode and of both hands; points for label (a) are `spacing` apart, m.
    ///
    /// # Errors
    /// If the spacing is not a positive length, or a shape has no surface.
    pub fn new(episode: &Episode, hands: [&HandModel; 2], spacing: f32) -> Result<Self> {
        let mut things = Vec::new();
        for object in episode.objects.iter().filter(|object| object.solid) {
            let (points, solid) = (object.shape.sampled_surface(spacing)?, object.shape.solid()?);
            things.push(Thing { name: object.name.clone(), points, solid, fixed: None });
            if let Some(points) = object.shape.sampled_base(spacing)? {
                let fixed = Some((object.position, object.orientation));
                let (name, solid) = (format!("base of {}", object.name), object.shape.base_solid()?);
                things.push(Thing { name, points, solid, fixed });
            }
        }
        let mut table = Solid::default();
        table.add_cuboid(TABLE_HALF.as_vec3(), convex::pose(TABLE_CENTRE, DQuat::IDENTITY))?;
        let [left, right] = hands;
        Ok(Self { things, table, hands: [HandSurface::new(left, spacing)?, HandSurface::new(right, spacing)?] })
    }

    /// Distances up to `cutoff`, m.
    ///
    /// `vertices`: the posed (778) vertices of the left and the right hand in the world frame, m; None = absent, far from
    /// everything. `objects`: poses by name; an object without one, or with one that is not finite, is not there.
    ///
    /// # Errors
    /// If a hand has another number of vertices, or one is not finite.
    pub fn distances(
        &mut self,
        vertices: [Option<&[Vec3]>; 2],
        objects: &[ObjectPose],
        cutoff: f32,
    ) -> Result<Distances> {
        let mut distances = Distances { points: vec![f32::INFINITY; N_FIELD], surface: vec![f32::INFINITY; N_FIELD] };
        let both_near = match vertices {
            [Some(left), Some(right)] => gap(left, right) <= cutoff,
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
            for thing in &self.things {
                let moving = objects.iter().find(|object| object.name == thing.name);
                let pose = thing.fixed.or_else(|| moving.map(|object| (object.position, object.orientation)));
                let Some((position, orientation)) = pose else { continue };
                if position.is_finite() && orientation.is_finite() {
                    let local = |v: Vec3| (orientation.inverse() * (v.as_dvec3() - position)).as_vec3();
                    hand.take(vertices.iter().map(|v| local(*v)), &thing.points, |p, reach| {
                        thing.solid.distance(p, reach)
                    });
                }
            }
            hand.take_table(vertices, &self.table, self.hands[0].points().spacing());
            if both_near {
                let other = &self.hands[1 - side as usize];
                hand.take(vertices.iter().copied(), other.points(), |p, reach| other.surface().distance(p, reach));
            }
        }
        Ok(distances)
    }

    /// How finely objects and hands are sampled; the table is a lattice of that spacing.
    pub fn samplings(&self) -> Vec<Sampling> {
        let millimetres = |metres: f32| (f64::from(metres) * 1e6).round() / 1e3;
        let thing = |thing: &Thing| Sampling {
            name: thing.name.clone(),
            points: thing.points.points().len(),
            spacing_mm: millimetres(thing.points.spacing()),
            parts: thing.solid.n_parts(),
            sides: thing.solid.sides(),
        };
        let hand = |(hand, side): (&HandSurface, Side)| Sampling {
            name: format!("{} hand", side.name()),
            points: hand.points().points().len(),
            spacing_mm: millimetres(hand.points().spacing()),
            parts: 1,
            sides: hand.surface().sides(),
        };
        self.things.iter().map(thing).chain(self.hands.iter().zip(Side::BOTH).map(hand)).collect()
    }
}

/// Distances of one hand's vertices, as more things come.
struct HandDistances<'a> {
    points: &'a mut [f32],
    surface: &'a mut [f32],
    cutoff: f32,
}

impl HandDistances<'_> {
    /// Takes a thing, given the vertices in its frame; `distance` is that from its surface up to a reach.
    fn take(
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

    fn take_table(&mut self, vertices: &[Vec3], table: &Solid, spacing: f32) {
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

/// Distance between the boxes around two sets of points, m.
fn gap(a: &[Vec3], b: &[Vec3]) -> f32 {
    let [a, b] = [a, b].map(|points| {
        let fold = |start: Vec3, pick: fn(Vec3, Vec3) -> Vec3| points.iter().copied().fold(start, pick);
        [fold(Vec3::INFINITY, Vec3::min), fold(Vec3::NEG_INFINITY, Vec3::max)]
    });
    (a[0] - b[1]).max(b[0] - a[1]).max(Vec3::ZERO).length()
}
