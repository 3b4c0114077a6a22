//! Remeshes to an exact number of vertices by edge collapse, edge flips and smoothing on the surface.

use std::cmp::Reverse;
use std::collections::{BTreeSet, BinaryHeap};

use glam::DVec3;

/// Largest valence (number of edges) of a vertex that a collapse or flip may create.
const MAX_VALENCE: usize = 8;
/// Smallest angle of a triangle that an edit may create, rad.
const MIN_ANGLE: f64 = 0.12;
/// Smallest cosine between a triangle's normal and the surface normals at its corners that an edit may create.
const MIN_FACING: f64 = 0.3;

/// Surface that the mesh approximates.
pub trait TargetSurface {
    /// Returns the nearest point of the surface.
    fn project(&self, point: DVec3) -> DVec3;
    /// Returns the outward unit normal at a point of the surface.
    fn normal(&self, point: DVec3) -> DVec3;
    /// Returns the target edge length at a point of the surface, up to a common factor.
    fn edge_length(&self, point: DVec3) -> f64;
}

/// A closed manifold triangle mesh under edit; deleted vertices and faces stay until [`EditableMesh::compact`].
pub struct EditableMesh<'a, T: TargetSurface> {
    target: &'a T,
    points: Vec<DVec3>,
    normals: Vec<DVec3>,
    /// Target edge length at each vertex.
    wanted: Vec<f64>,
    /// Triangles; `None` after deletion.
    faces: Vec<Option<[u32; 3]>>,
    /// Indices of the faces at each vertex; empty after the vertex is deleted.
    faces_at: Vec<Vec<u32>>,
    n_alive: usize,
}

impl<'a, T: TargetSurface> EditableMesh<'a, T> {
    /// Creates an editable mesh from a closed manifold mesh near the target surface.
    pub fn new(target: &'a T, points: Vec<DVec3>, faces: &[[u32; 3]]) -> Self {
        let points: Vec<DVec3> = points.into_iter().map(|point| target.project(point)).collect();
        let mut faces_at = vec![Vec::new(); points.len()];
        for (face, corners) in faces.iter().enumerate() {
            for &vertex in corners {
                faces_at[vertex as usize].push(face as u32);
            }
        }
        let normals = points.iter().map(|&point| target.normal(point)).collect();
        let wanted = points.iter().map(|&point| target.edge_length(point)).collect();
        let n_alive = points.len();
        Self { target, points, normals, wanted, faces: faces.iter().copied().map(Some).collect(), faces_at, n_alive }
    }

    /// Collapses the relatively shortest edges until `n_vertices` are left or no collapse is allowed.
    pub fn collapse_to(&mut self, n_vertices: usize) {
        let mut queue: BinaryHeap<_> = self.edges().into_iter().map(|edge| Reverse(self.keyed(edge))).collect();
        while self.n_alive > n_vertices {
            let Some(Reverse((key, a, b))) = queue.pop() else { break };
            // An entry is stale if an end was deleted or moved since.
            if self.faces_at[a as usize].is_empty() || self.faces_at[b as usize].is_empty() {
                continue;
            }
            if self.keyed((a, b)).0 != key || !self.collapse(a, b) {
                continue;
            }
            for neighbour in self.ring(a) {
                queue.push(Reverse(self.keyed((a.min(neighbour), a.max(neighbour)))));
            }
        }
    }

    /// Splits the `count` relatively longest edges at their midpoints.
    pub fn split_longest(&mut self, count: usize) {
        for _ in 0..count {
            let Some((_, a, b)) = self.edges().into_iter().map(|edge| self.keyed(edge)).max() else { return };
            self.split(a, b);
        }
    }

    /// Flips each edge if that improves the worse of its two triangles; one sweep.
    pub fn flip(&mut self) {
        for (a, b) in self.edges() {
            self.flip_edge(a, b);
        }
    }

    /// Moves each vertex along the surface towards the centre of its triangles, weighted by target density; one sweep.
    pub fn smooth(&mut self) {
        for vertex in 0..self.points.len() {
            if self.faces_at[vertex].is_empty() {
                continue;
            }
            let (mut sum, mut weights) = (DVec3::ZERO, 0.0);
            for &face in &self.faces_at[vertex] {
                let Some(corners) = self.faces[face as usize] else { continue };
                let [p, q, r] = corners.map(|corner| self.points[corner as usize]);
                let wanted: f64 = corners.iter().map(|&corner| self.wanted[corner as usize]).sum();
                let weight = (q - p).cross(r - p).length() / wanted.powi(3);
                sum += (p + q + r) / 3.0 * weight;
                weights += weight;
            }
            let step = (sum / weights - self.points[vertex]).reject_from_normalized(self.normals[vertex]);
            let moved = self.target.project(self.points[vertex] + step * 0.7);
            let normal = self.target.normal(moved);
            let faces = self.faces_at[vertex].iter().filter_map(|&face| self.faces[face as usize]);
            if faces.into_iter().all(|corners| self.faces_outwards(corners, vertex as u32, moved, normal)) {
                self.place(vertex as u32, moved, normal);
            }
        }
    }

    /// Returns the remaining vertices and faces, renumbered in order.
    pub fn compact(&self) -> (Vec<DVec3>, Vec<[u32; 3]>) {
        let mut number = vec![0; self.points.len()];
        let mut points = Vec::new();
        for (vertex, &point) in self.points.iter().enumerate() {
            if !self.faces_at[vertex].is_empty() {
                number[vertex] = points.len() as u32;
                points.push(point);
            }
        }
        (points, self.faces.iter().flatten().map(|face| face.map(|vertex| number[vertex as usize])).collect())
    }

    /// Returns the remaining edges, lower index first, in ascending order.
    fn edges(&self) -> BTreeSet<(u32, u32)> {
        let sides = |&[a, b, c]: &[u32; 3]| [(a, b), (b, c), (c, a)];
        self.faces.iter().flatten().flat_map(sides).map(|(a, b)| (a.min(b), a.max(b))).collect()
    }

    /// Returns an edge with its sort key: length over target length as float bits, which order positive numbers
    /// correctly.
    fn keyed(&self, (a, b): (u32, u32)) -> (u64, u32, u32) {
        let length = self.points[a as usize].distance(self.points[b as usize]);
        let wanted = 0.5 * (self.wanted[a as usize] + self.wanted[b as usize]);
        ((length / wanted).to_bits(), a, b)
    }

    /// Returns the neighbours of a vertex in ascending order.
    fn ring(&self, vertex: u32) -> BTreeSet<u32> {
        let faces = self.faces_at[vertex as usize].iter().filter_map(|&face| self.faces[face as usize]);
        faces.flatten().filter(|&other| other != vertex).collect()
    }

    /// Returns the faces at an edge with the corner opposite of it, as `(face, opposite)`.
    fn faces_at_edge(&self, a: u32, b: u32) -> Vec<(u32, u32)> {
        let opposite = |&face: &u32| {
            let corners = self.faces[face as usize]?;
            let other = corners.into_iter().find(|&corner| corner != a && corner != b)?;
            corners.contains(&b).then_some((face, other))
        };
        self.faces_at[a as usize].iter().filter_map(opposite).collect()
    }

    /// Merges `b` into `a`. Returns false, and changes nothing, if that would change the topology or fold the surface.
    fn collapse(&mut self, a: u32, b: u32) -> bool {
        let sides = self.faces_at_edge(a, b);
        // Link condition: the ends share only the two opposite corners. Opposite corners keep a valence of at least 4.
        let shared = self.ring(a).intersection(&self.ring(b)).count();
        if sides.len() != 2 || shared != 2 || sides.iter().any(|&(_, corner)| self.ring(corner).len() < 5) {
            return false;
        }
        if self.ring(a).union(&self.ring(b)).count() - 2 > MAX_VALENCE {
            return false;
        }
        let middle = self.target.project(0.5 * (self.points[a as usize] + self.points[b as usize]));
        let normal = self.target.normal(middle);
        let touched = |vertex: u32, other: u32| {
            let faces = self.faces_at[vertex as usize].iter().filter_map(|&face| self.faces[face as usize]);
            let kept = faces.filter(move |corners| !corners.contains(&other));
            kept.map(move |corners| corners.map(|corner| if corner == vertex { a } else { corner }))
        };
        if !touched(a, b).chain(touched(b, a)).all(|corners| self.faces_outwards(corners, a, middle, normal)) {
            return false;
        }
        for (face, corner) in sides {
            self.faces[face as usize] = None;
            self.faces_at[corner as usize].retain(|&other| other != face);
        }
        for face in std::mem::take(&mut self.faces_at[b as usize]) {
            if let Some(corners) = &mut self.faces[face as usize] {
                *corners = corners.map(|corner| if corner == b { a } else { corner });
                self.faces_at[a as usize].push(face);
            }
        }
        let faces = &self.faces;
        self.faces_at[a as usize].retain(|&face| faces[face as usize].is_some());
        self.place(a, middle, normal);
        self.n_alive -= 1;
        true
    }

    /// Moves a vertex.
    fn place(&mut self, vertex: u32, point: DVec3, normal: DVec3) {
        self.points[vertex as usize] = point;
        self.normals[vertex as usize] = normal;
        self.wanted[vertex as usize] = self.target.edge_length(point);
    }

    /// Inserts a vertex in the middle of an edge.
    fn split(&mut self, a: u32, b: u32) {
        let middle = self.target.project(0.5 * (self.points[a as usize] + self.points[b as usize]));
        let new = self.points.len() as u32;
        self.points.push(middle);
        self.normals.push(self.target.normal(middle));
        self.wanted.push(self.target.edge_length(middle));
        self.faces_at.push(Vec::new());
        for (face, corner) in self.faces_at_edge(a, b) {
            let Some(corners) = self.faces[face as usize] else { continue };
            let half = self.faces.len() as u32;
            self.faces.push(Some(corners.map(|old| if old == a { new } else { old })));
            self.faces[face as usize] = Some(corners.map(|old| if old == b { new } else { old }));
            self.faces_at[b as usize].retain(|&other| other != face);
            self.faces_at[b as usize].push(half);
            self.faces_at[corner as usize].push(half);
            self.faces_at[new as usize].extend([face, half]);
        }
        self.n_alive += 1;
    }

    /// Replaces edge `ab` by the other diagonal if that makes better triangles.
    fn flip_edge(&mut self, a: u32, b: u32) {
        let [(left, c), (right, d)] = self.faces_at_edge(a, b)[..] else { return };
        if self.ring(a).len() < 5 || self.ring(b).len() < 5 || self.ring(c).contains(&d) {
            return;
        }
        if self.ring(c).len() >= MAX_VALENCE || self.ring(d).len() >= MAX_VALENCE {
            return;
        }
        // `left` is the face whose boundary runs from a to b.
        let runs =
            |face: u32| self.faces[face as usize].is_some_and(|f| (0..3).any(|i| f[i] == a && f[(i + 1) % 3] == b));
        let (left, c, right, d) = if runs(left) { (left, c, right, d) } else { (right, d, left, c) };
        let (new_left, new_right) = ([a, d, c], [d, b, c]);
        let before = self.quality([a, b, c]).min(self.quality([b, a, d]));
        let after = self.quality(new_left).min(self.quality(new_right));
        if after <= before + 1e-9 {
            return;
        }
        self.faces[left as usize] = Some(new_left);
        self.faces[right as usize] = Some(new_right);
        self.faces_at[b as usize].retain(|&face| face != left);
        self.faces_at[a as usize].retain(|&face| face != right);
        self.faces_at[d as usize].push(left);
        self.faces_at[c as usize].push(right);
    }

    /// Returns the smallest angle times the smallest cosine between the triangle and the surface at its corners.
    fn quality(&self, corners: [u32; 3]) -> f64 {
        let at = corners.map(|corner| self.points[corner as usize]);
        let facing = (at[1] - at[0]).cross(at[2] - at[0]).normalize_or_zero();
        let aligned = corners.map(|corner| self.normals[corner as usize].dot(facing));
        smallest_angle(at) * aligned.into_iter().fold(1.0, f64::min)
    }

    /// Returns true if a triangle, with `vertex` moved to `place`, is no sliver and faces outwards.
    fn faces_outwards(&self, corners: [u32; 3], vertex: u32, place: DVec3, normal: DVec3) -> bool {
        let point = |corner: u32| if corner == vertex { place } else { self.points[corner as usize] };
        let at = corners.map(point);
        let facing = (at[1] - at[0]).cross(at[2] - at[0]).normalize_or_zero();
        let outward = |corner: u32| if corner == vertex { normal } else { self.normals[corner as usize] };
        smallest_angle(at) > MIN_ANGLE && corners.iter().all(|&corner| outward(corner).dot(facing) > MIN_FACING)
    }
}

/// Computes the smallest angle of a triangle, rad.
fn smallest_angle([a, b, c]: [DVec3; 3]) -> f64 {
    let angle = |at: DVec3, p: DVec3, q: DVec3| (p - at).cross(q - at).length().atan2((p - at).dot(q - at));
    angle(a, b, c).min(angle(b, c, a)).min(angle(c, a, b))
}
