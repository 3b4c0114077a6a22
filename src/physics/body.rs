//! Bodies that hands touch: shape, mass, centre and inertia.

use glam::{DMat3, DVec3, Vec3};

use crate::error::{Error, Result};
use crate::geometry::{Solid, Surface, resample};

/// Spacing of the surface points that find supports, m.
const SUPPORT_SPACING: f32 = 0.004;
/// Largest number of such points.
const MOST_SAMPLES: usize = 4000;
/// Number of cells along the longest edge of a shape, for its volume.
const CELLS: usize = 28;

/// A rigid body with its shape in its own frame.
#[derive(Debug, Clone)]
pub struct RigidBody {
    /// Name.
    pub name: String,
    /// Shape; `None` = unknown.
    pub solid: Option<Solid>,
    /// Points of the surface, m.
    pub samples: Vec<Vec3>,
    /// Mass; `None` = unknown.
    pub mass: Option<Mass>,
    /// Coefficient of sliding friction.
    pub friction: f64,
    /// Reason why the motion does not tell the forces on this body, such as a hinge; `None` = it moves freely.
    pub held: Option<String>,
    /// Index of the body that a joint links this one to, a part of the same articulated object; always a smaller one.
    pub joined_to: Option<usize>,
}

/// Mass of a body.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Mass {
    /// Mass, kg.
    pub kilograms: f64,
    /// Standard deviation of the mass's logarithm; 0 = known.
    pub relative_sd: f64,
    /// Centre of mass in the body's frame, m.
    pub centre: DVec3,
    /// Inertia about the centre of mass in the axes of the body's frame, kg m².
    pub inertia: DMat3,
}

/// Volume, centre and second moments of a shape of uniform density.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Volume {
    /// Volume, m³.
    pub cubic_metres: f64,
    /// Centre, m.
    pub centre: DVec3,
    /// Inertia about the centre per kilogram, m².
    pub gyration: DMat3,
}

/// Class of objects by density.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DensityClass {
    /// Name.
    pub name: &'static str,
    /// Median density of the volume that the mesh encloses, kg/m³.
    pub density: f64,
    /// Standard deviation of the density's logarithm.
    pub relative_sd: f64,
}

/// Known classes. The densities are those of materials; hollow things enclose air, so their classes are wide.
pub const DENSITY_CLASSES: [DensityClass; 7] = [
    DensityClass { name: "household", density: 450.0, relative_sd: 0.6 },
    DensityClass { name: "filled", density: 900.0, relative_sd: 0.25 },
    DensityClass { name: "wood", density: 650.0, relative_sd: 0.25 },
    DensityClass { name: "plastic", density: 1050.0, relative_sd: 0.15 },
    DensityClass { name: "ceramic", density: 2300.0, relative_sd: 0.12 },
    DensityClass { name: "glass", density: 2500.0, relative_sd: 0.06 },
    DensityClass { name: "metal", density: 5500.0, relative_sd: 0.5 },
];

impl DensityClass {
    /// Returns a class by name.
    ///
    /// # Errors
    /// If it is unknown; the error lists the known ones.
    pub fn by_name(name: &str) -> Result<Self> {
        let known = || DENSITY_CLASSES.iter().map(|class| class.name);
        let found = DENSITY_CLASSES.iter().find(|class| class.name == name);
        found.copied().ok_or_else(|| Error::unknown("density class", name, known()))
    }
}

impl RigidBody {
    /// Creates a free body of unknown mass from a mesh: `vertices`, m, and triangles, counter-clockwise seen from outside.
    ///
    /// # Errors
    /// If the mesh is empty or invalid.
    pub fn from_mesh(name: &str, vertices: Vec<Vec3>, triangles: Vec<[u32; 3]>) -> Result<Self> {
        let samples = [1.0, 4.0, 16.0].map(|factor| SUPPORT_SPACING * factor);
        let samples = samples.into_iter().find_map(|spacing| resample(&vertices, &triangles, spacing).ok());
        let solid = Solid::from_mesh(Surface::new(vertices, triangles)?);
        Ok(Self::from_solid(name, solid, samples.unwrap_or_default()))
    }

    /// Creates a free body of unknown mass from a solid and points of its surface, m.
    pub fn from_solid(name: &str, solid: Solid, mut samples: Vec<Vec3>) -> Self {
        if samples.len() > MOST_SAMPLES {
            // Multiples of the golden ratio: a fixed stride through sorted points could take one face of a box and never the other.
            const GOLDEN: f64 = 0.618_033_988_749_895;
            let share = MOST_SAMPLES as f64 / samples.len() as f64;
            let kept = samples.into_iter().enumerate().filter(|(index, _)| (GOLDEN * *index as f64).fract() < share);
            samples = kept.map(|(_, point)| point).collect();
        }
        Self { name: name.into(), solid: Some(solid), samples, mass: None, friction: 0.8, held: None, joined_to: None }
    }

    /// Creates a free ball of unknown mass around the origin of its frame; `radius` in m.
    ///
    /// # Errors
    /// If the radius is not a positive length.
    pub fn ball(name: &str, radius: f64) -> Result<Self> {
        /// Number of points of the surface, and the golden angle between them along a spiral from pole to pole.
        const POINTS: u32 = 1200;
        const TURN: f64 = 2.399_963_229_728_653;
        let mut solid = Solid::default();
        solid.add_ball(radius as f32, parry3d::math::Pose::IDENTITY)?;
        let point = |k: u32| {
            let z = 1.0 - 2.0 * (f64::from(k) + 0.5) / f64::from(POINTS);
            let (angle, around) = (TURN * f64::from(k), (1.0 - z * z).sqrt());
            (DVec3::new(around * angle.cos(), around * angle.sin(), z) * radius).as_vec3()
        };
        Ok(Self::from_solid(name, solid, (0..POINTS).map(point).collect()))
    }

    /// Computes volume, centre and second moments of the shape, of cells that it fills; `None` if the shape is unknown or
    /// has no inside.
    pub fn volume(&self) -> Option<Volume> {
        let solid = self.solid.as_ref().filter(|solid| solid.sides().is_known())?;
        let fold = |start: Vec3, pick: fn(Vec3, Vec3) -> Vec3| self.samples.iter().copied().fold(start, pick);
        let (low, high) = (fold(Vec3::INFINITY, Vec3::min), fold(Vec3::NEG_INFINITY, Vec3::max));
        let extent = high - low;
        if !extent.is_finite() {
            return None;
        }
        // Cells fit each edge: a thin plate has as many cells through it as along it.
        let cells = Vec3::splat(CELLS as f32);
        let edge = (extent / cells).max(Vec3::splat(1e-6));
        let cell = f64::from(edge.x) * f64::from(edge.y) * f64::from(edge.z);
        let (mut count, mut first, mut second) = (0.0, DVec3::ZERO, DMat3::ZERO);
        for index in 0..CELLS * CELLS * CELLS {
            let [i, j, k] = [index % CELLS, index / CELLS % CELLS, index / CELLS / CELLS].map(|n| n as f32 + 0.5);
            let place = low + edge * Vec3::new(i, j, k);
            if solid.distance(place, 0.0) < 0.0 {
                let place = place.as_dvec3();
                count += 1.0;
                first += place;
                second += DMat3::from_cols(place * place.x, place * place.y, place * place.z);
            }
        }
        if count == 0.0 {
            return None;
        }
        let centre = first / count;
        let spread = second * (1.0 / count) - DMat3::from_cols(centre * centre.x, centre * centre.y, centre * centre.z);
        let own = edge.as_dvec3() * edge.as_dvec3() / 12.0;
        let spread = spread + DMat3::from_diagonal(own);
        let trace = spread.x_axis.x + spread.y_axis.y + spread.z_axis.z;
        Some(Volume {
            cubic_metres: count * cell,
            centre,
            gyration: DMat3::from_diagonal(DVec3::splat(trace)) - spread,
        })
    }

    /// Sets the mass, kg, and the standard deviation of its logarithm; centre and inertia follow from the shape, or from its
    /// surface if it has no inside.
    ///
    /// # Errors
    /// If the mass is not positive, or the shape is unknown.
    pub fn with_mass(mut self, kilograms: f64, relative_sd: f64) -> Result<Self> {
        if !(kilograms.is_finite() && kilograms > 0.0) {
            return Err(Error::value(format!("mass of {}", self.name), "a positive number of kilograms", kilograms));
        }
        let Some(Volume { centre, gyration, .. }) = self.volume().or_else(|| self.shell()) else {
            return Err(Error::value(format!("shape of {}", self.name), "a mesh, for its centre of mass", "none"));
        };
        self.mass = Some(Mass { kilograms, relative_sd, centre, inertia: gyration * kilograms });
        Ok(self)
    }

    /// Sets the mass from the volume and a class of density. The mass of a shape without an inside stays unknown.
    #[must_use]
    pub fn with_density(mut self, class: DensityClass) -> Self {
        self.mass = self.volume().map(|Volume { cubic_metres, centre, gyration }| {
            let kilograms = class.density * cubic_metres;
            Mass { kilograms, relative_sd: class.relative_sd, centre, inertia: gyration * kilograms }
        });
        self
    }

    /// Returns centre and second moments of the surface points, for a shape without an inside.
    fn shell(&self) -> Option<Volume> {
        let n = self.samples.len() as f64;
        if n == 0.0 {
            return None;
        }
        let centre = self.samples.iter().map(|p| p.as_dvec3()).sum::<DVec3>() / n;
        let mut gyration = DMat3::ZERO;
        for point in &self.samples {
            let r = point.as_dvec3() - centre;
            let outer = DMat3::from_cols(r * r.x, r * r.y, r * r.z);
            gyration += (DMat3::from_diagonal(DVec3::splat(r.length_squared())) - outer) * (1.0 / n);
        }
        Some(Volume { cubic_metres: 0.0, centre, gyration })
    }
}

/// Returns the signed distance of a point from a solid, m, and the outward unit normal there; `None` beyond `reach`, or where
/// the distance has no gradient.
pub(super) fn distance_and_normal(solid: &Solid, point: DVec3, reach: f64) -> Option<(f64, DVec3)> {
    /// Half width of the central difference, m: beyond the rounding of single precision, below the size of features.
    const H: f32 = 2e-4;
    let at = |offset: Vec3| solid.distance(point.as_vec3() + offset, reach as f32 + 2.0 * H);
    let distance = at(Vec3::ZERO);
    if distance.is_nan() || f64::from(distance) > reach {
        return None;
    }
    let slope = |axis: Vec3| f64::from(at(axis * H) - at(axis * -H));
    let gradient = DVec3::new(slope(Vec3::X), slope(Vec3::Y), slope(Vec3::Z));
    let normal = gradient.try_normalize()?;
    normal.is_finite().then_some((f64::from(distance), normal))
}
