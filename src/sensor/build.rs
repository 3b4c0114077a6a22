//! Taxel maps built from a layout and a hand.

use glam::{Vec2, Vec3};

use super::layout::{self, Layout, Pad};
use super::map::{HandTaxels, TaxelMap};
use super::shares::{LEAST_AREA, factors};
use crate::error::{Error, Result};
use crate::hand::{HandModel, HandParams, N_VERTICES, Side, vertex_areas, vertex_normals};

/// Smallest cosine between a vertex's normal and the direction of a pad that covers it.
const FACING: f32 = 0.05;

impl TaxelMap {
    /// Places a layout's pads on a pair of hands, left first.
    ///
    /// # Errors
    /// If the layout is not valid, the hands differ in topology, or a pad covers nothing of the hand.
    pub fn build(layout: &Layout, hands: &[HandModel; 2]) -> Result<Self> {
        layout.check()?;
        hands[0].topology.must_match(hands[1].topology)?;
        let [left, right] = hands.each_ref().map(|hand| Surface::new(hand).taxels(layout));
        Ok(Self { layout: layout.clone(), topology: hands[0].topology, hands: [left?, right?] })
    }
}

/// A hand at rest, as a right hand: a left hand is mirrored in x.
struct Surface {
    left: bool,
    vertices: Vec<Vec3>,
    normals: Vec<Vec3>,
    areas: Vec<f32>,
    faces: Vec<[u32; 3]>,
    keypoints: Vec<Vec3>,
    links: Vec<usize>,
}

/// Coordinates of a pad on the hand.
struct PadFrame<'a> {
    pad: &'a Pad,
    origin: Vec3,
    /// Unit vectors along u, along v, and out of the hand.
    axes: [Vec3; 3],
    /// Lengths of one unit of u and v, m.
    units: Vec2,
    links: Vec<usize>,
}

impl Surface {
    fn new(hand: &HandModel) -> Self {
        let posed = hand.forward(&HandParams::default());
        let left = hand.side == Side::Left;
        let seen = |point: Vec3| if left { Vec3::new(-point.x, point.y, point.z) } else { point };
        Self {
            left,
            normals: vertex_normals(&posed.vertices, &hand.faces).into_iter().map(seen).collect(),
            areas: vertex_areas(&posed.vertices, &hand.faces),
            faces: hand.faces.clone(),
            keypoints: hand.keypoints(&posed).into_iter().map(seen).collect(),
            links: hand.strongest_joints(),
            vertices: posed.vertices.into_iter().map(seen).collect(),
        }
    }

    fn taxels(&self, layout: &Layout) -> Result<HandTaxels> {
        let mut weights: Vec<Vec<(u32, f32)>> = vec![Vec::new(); N_VERTICES];
        // Corners of the triangle below each taxel, with barycentric weights; empty = no taxel.
        let mut places: Vec<Vec<(u32, f32)>> = vec![Vec::new(); layout.channels];
        for pad in &layout.pads {
            let frame = self.frame(pad)?;
            let (taxels, below) = (pad.taxels(self.left)?, self.below(&frame));
            if below.is_empty() {
                let expected = "an outline over the hand's surface";
                return Err(Error::value(format!("pad {}", pad.name), expected, "no vertex in its direction"));
            }
            for vertex in below {
                let Some(cell) = frame.cell(self.vertices[vertex]) else { continue };
                for (taxel, weight) in bilinear(cell, pad.grid) {
                    if let Some(channel) = taxels[taxel] {
                        weights[vertex].push((channel as u32, weight));
                    }
                }
            }
            for (taxel, channel) in taxels.iter().enumerate() {
                let Some(channel) = channel else { continue };
                places[*channel] = self.place(&frame, frame.point(taxel));
            }
        }
        // Vertices may lie between a taxel of the hand and one beside it.
        for list in &mut weights {
            list.retain(|(channel, _)| !places[*channel as usize].is_empty());
        }
        // A taxel between vertices gives its reading to the corners of its triangle.
        let mut has_vertex = vec![false; layout.channels];
        weights.iter().flatten().for_each(|&(channel, weight)| has_vertex[channel as usize] |= weight > 1e-3);
        for (channel, corners) in places.iter().enumerate().filter(|(channel, _)| !has_vertex[*channel]) {
            corners.iter().for_each(|&(vertex, weight)| weights[vertex as usize].push((channel as u32, weight)));
        }
        weights.iter_mut().for_each(normalise);
        Ok(self.finished(weights, places))
    }

    /// Adds the shares of force to the weights of the readings.
    fn finished(&self, reading: Vec<Vec<(u32, f32)>>, places: Vec<Vec<(u32, f32)>>) -> HandTaxels {
        let factor = factors(&reading, &self.areas, places.len());
        // A taxel loads the vertices around it by their areas. The factors of the conversion would keep its sum as well, but where
        // taxels are finer than the mesh they are far from the areas, and move force to other vertices.
        let area = |vertex: usize, weight: f32| f64::from(self.areas[vertex].max(LEAST_AREA)) * f64::from(weight);
        let mut sums = vec![0.0; places.len()];
        for (vertex, list) in reading.iter().enumerate() {
            list.iter().for_each(|&(taxel, weight)| sums[taxel as usize] += area(vertex, weight));
        }
        let mut spread: Vec<Vec<(u32, f32)>> = vec![Vec::new(); places.len()];
        for (vertex, list) in reading.iter().enumerate() {
            for &(taxel, weight) in list {
                let share = area(vertex, weight) / sums[taxel as usize];
                spread[taxel as usize].push((vertex as u32, share as f32));
            }
        }
        let mirrored = |p: Vec3| if self.left { Vec3::new(-p.x, p.y, p.z) } else { p };
        let position = |corners: &Vec<(u32, f32)>| match corners.as_slice() {
            [] => Vec3::NAN,
            corners => mirrored(corners.iter().map(|&(vertex, w)| self.vertices[vertex as usize] * w).sum()),
        };
        HandTaxels {
            positions: places.iter().map(position).collect(),
            factors: factor.into_iter().map(|factor| factor as f32).collect(),
            reading,
            spread,
        }
    }

    fn frame<'a>(&self, pad: &'a Pad) -> Result<PadFrame<'a>> {
        let [from, to] = [&pad.from, &pad.to].map(|name| layout::keypoint(name).map(|index| self.keypoints[index]));
        let (from, to) = (from?, to?);
        let out = Vec3::from_array(pad.facing).normalize();
        let along = (to - from).reject_from_normalized(out);
        let width = self.keypoints[5].distance(self.keypoints[17]);
        if along.length() < 1e-4 || width < 1e-4 {
            let expected = "keypoints that are apart, seen along `facing`";
            return Err(Error::value(format!("pad {}", pad.name), expected, "one point"));
        }
        let u = along.normalize();
        let links = pad.links.iter().map(|name| layout::link(name)).collect::<Result<_>>()?;
        Ok(PadFrame { pad, origin: from, axes: [u, u.cross(out), out], units: Vec2::new(along.length(), width), links })
    }

    /// Returns the vertices of the pad's links that face its way.
    fn below(&self, frame: &PadFrame) -> Vec<usize> {
        let faces = |vertex: &usize| {
            frame.links.contains(&self.links[*vertex]) && self.normals[*vertex].dot(frame.axes[2]) > FACING
        };
        (0..N_VERTICES).filter(faces).collect()
    }

    /// Returns the point of the surface over the (u, v) of a pad: corners of its triangle with barycentric weights. Beside the
    /// hand, the nearest vertex.
    fn place(&self, frame: &PadFrame, at: Vec2) -> Vec<(u32, f32)> {
        let below = self.below(frame);
        let mut best: Option<(f32, Vec<(u32, f32)>)> = None;
        for face in self.faces.iter().filter(|face| face.iter().all(|vertex| below.contains(&(*vertex as usize)))) {
            let corners = face.map(|vertex| frame.uv(self.vertices[vertex as usize]));
            let Some(weights) = barycentric(at, corners) else { continue };
            let list: Vec<(u32, f32)> = face.iter().copied().zip(weights).collect();
            let height = list.iter().map(|&(v, w)| self.vertices[v as usize].dot(frame.axes[2]) * w).sum();
            if best.as_ref().is_none_or(|(highest, _)| height > *highest) {
                best = Some((height, list));
            }
        }
        let distance = |vertex: &usize| ((frame.uv(self.vertices[*vertex]) - at) * frame.units).length_squared();
        let nearest = || below.iter().copied().min_by(|a, b| distance(a).total_cmp(&distance(b)));
        match best {
            Some((_, list)) => list,
            None if frame.pad.clip => Vec::new(),
            None => nearest().map(|vertex| vec![(vertex as u32, 1.0)]).unwrap_or_default(),
        }
    }
}

impl PadFrame<'_> {
    fn uv(&self, point: Vec3) -> Vec2 {
        let from = point - self.origin;
        Vec2::new(from.dot(self.axes[0]), from.dot(self.axes[1])) / self.units
    }

    /// Returns the (u, v) of the centre of a taxel.
    fn point(&self, taxel: usize) -> Vec2 {
        let [rows, columns] = self.pad.grid;
        let s = ((taxel / columns) as f32 + 0.5) / rows as f32;
        let t = ((taxel % columns) as f32 + 0.5) / columns as f32;
        let [a, b, c, d] = self.pad.corners.map(Vec2::from_array);
        (a * (1.0 - t) + b * t) * (1.0 - s) + (d * (1.0 - t) + c * t) * s
    }

    /// Returns the row and column of a point, as shares of the outline; `None` outside of it.
    fn cell(&self, point: Vec3) -> Option<Vec2> {
        let [a, b, c, d] = self.pad.corners.map(Vec2::from_array);
        let at = self.uv(point);
        // Newton's method on the bilinear map, which is smooth and one-to-one inside of a convex outline.
        let mut st = Vec2::splat(0.5);
        for _ in 0..20 {
            let (s, t) = (st.x, st.y);
            let value = (a * (1.0 - t) + b * t) * (1.0 - s) + (d * (1.0 - t) + c * t) * s;
            let by_s = (d - a) * (1.0 - t) + (c - b) * t;
            let by_t = (b - a) * (1.0 - s) + (c - d) * s;
            let (miss, determinant) = (at - value, by_s.perp_dot(by_t));
            if determinant.abs() < 1e-12 {
                return None;
            }
            let step = Vec2::new(miss.perp_dot(by_t), by_s.perp_dot(miss)) / determinant;
            st = (st + step).clamp(Vec2::splat(-1.0), Vec2::splat(2.0));
        }
        (st.min_element() >= 0.0 && st.max_element() <= 1.0).then_some(st)
    }
}

/// Returns the taxels around a place of a grid with their bilinear weights; beyond the outermost centres, the outermost taxels.
fn bilinear(cell: Vec2, [rows, columns]: [usize; 2]) -> Vec<(usize, f32)> {
    let axis = |share: f32, count: usize| {
        let place = (share * count as f32 - 0.5).clamp(0.0, (count - 1) as f32);
        let first = (place as usize).min(count.saturating_sub(2));
        let rest = place - first as f32;
        [(first, 1.0 - rest), ((first + 1).min(count - 1), rest)]
    };
    let mut found: Vec<(usize, f32)> = Vec::new();
    for (row, of_row) in axis(cell.x, rows) {
        for (column, of_column) in axis(cell.y, columns) {
            if of_row * of_column > 0.0 {
                found.push((row * columns + column, of_row * of_column));
            }
        }
    }
    found
}

/// Returns the barycentric coordinates of a point in a triangle; `None` outside.
fn barycentric(at: Vec2, [a, b, c]: [Vec2; 3]) -> Option<[f32; 3]> {
    let area = (b - a).perp_dot(c - a);
    if area.abs() < 1e-12 {
        return None;
    }
    let weights = [(b - at).perp_dot(c - at), (c - at).perp_dot(a - at), (a - at).perp_dot(b - at)].map(|w| w / area);
    weights.iter().all(|weight| *weight >= 0.0).then_some(weights)
}

/// Joins the entries of equal taxels, sorts them, and makes the weights sum to 1.
fn normalise(list: &mut Vec<(u32, f32)>) {
    list.sort_by_key(|entry| entry.0);
    list.dedup_by(|next, kept| {
        let same = next.0 == kept.0;
        kept.1 += if same { next.1 } else { 0.0 };
        same
    });
    list.retain(|entry| entry.1 > 1e-6);
    let total: f32 = list.iter().map(|entry| entry.1).sum();
    list.iter_mut().for_each(|entry| entry.1 /= total);
}
