//! Implicit surface of the built-in hand: swept fingers on a palm of blended bones.

use glam::DVec3;

use super::anatomy::{self, Finger, Section, WRIST};

/// Width of the blend between the parts of the palm, m.
const PALM_BLEND: f64 = 0.012;
/// Width of the blend between palm and finger, m.
const FINGER_BLEND: f64 = 0.010;
/// Width of the blend between fingers, m; smaller than their gap, so that neighbours do not merge.
const NEIGHBOUR_BLEND: f64 = 0.003;

/// The skin as a scalar field: negative inside, and close to the distance in metres near the surface.
#[derive(Debug, Clone)]
pub struct ImplicitHand {
    /// Index, middle, little, ring, thumb.
    pub fingers: [Finger; 5],
    swept_fingers: [Sweep; 5],
    bones: Vec<Capsule>,
    webs: Vec<Web>,
    wrist: Sweep,
}

/// A capsule whose radius varies linearly from one end to the other.
#[derive(Debug, Clone, Copy)]
struct Capsule {
    from: DVec3,
    to: DVec3,
    radii: [f64; 2],
}

/// A triangle with thickness: the web of skin between two bones.
#[derive(Debug, Clone, Copy)]
struct Web {
    corners: [DVec3; 3],
    radius: f64,
}

/// Elliptic sections along a straight axis, rounded at both ends.
#[derive(Debug, Clone)]
struct Sweep {
    base: DVec3,
    axis: DVec3,
    palmar: DVec3,
    sections: Vec<Section>,
    cap: f64,
}

impl ImplicitHand {
    /// Creates the surface from the anatomy tables.
    pub fn new() -> Self {
        let fingers = anatomy::fingers();
        Self {
            swept_fingers: fingers.each_ref().map(Sweep::of_finger),
            bones: palm_bones(&fingers),
            webs: webs(&fingers),
            wrist: wrist(),
            fingers,
        }
    }

    /// Returns the field at `point`: negative inside.
    pub fn value(&self, point: DVec3) -> f64 {
        let mut palm = self.wrist.value(point);
        for bone in &self.bones {
            palm = smooth_min(palm, bone.value(point), PALM_BLEND);
        }
        for web in &self.webs {
            palm = smooth_min(palm, web.value(point), PALM_BLEND);
        }
        let fingers = self.swept_fingers.iter().map(|finger| finger.value(point));
        let fingers = fingers.fold(f64::INFINITY, |nearest, finger| smooth_min(nearest, finger, NEIGHBOUR_BLEND));
        smooth_min(palm, fingers, FINGER_BLEND)
    }

    /// Computes the gradient by central differences.
    pub fn gradient(&self, point: DVec3) -> DVec3 {
        const STEP: f64 = 1e-5;
        let along = |axis: DVec3| self.value(point + axis * STEP) - self.value(point - axis * STEP);
        DVec3::new(along(DVec3::X), along(DVec3::Y), along(DVec3::Z)) / (2.0 * STEP)
    }

    /// Moves `point` to the surface by Newton steps along the gradient.
    pub fn project(&self, mut point: DVec3) -> DVec3 {
        const MAX_STEP: f64 = 0.003;
        for _ in 0..12 {
            let value = self.value(point);
            if value.abs() < 1e-9 {
                break;
            }
            let gradient = self.gradient(point);
            let step = gradient * (-value / gradient.length_squared().max(1e-6));
            point += step.clamp_length_max(MAX_STEP);
        }
        point
    }
}

impl Default for ImplicitHand {
    fn default() -> Self {
        Self::new()
    }
}

impl Capsule {
    fn value(&self, point: DVec3) -> f64 {
        let along = self.to - self.from;
        let t = ((point - self.from).dot(along) / along.length_squared()).clamp(0.0, 1.0);
        (point - self.from - along * t).length() - (self.radii[0] + (self.radii[1] - self.radii[0]) * t)
    }
}

impl Web {
    fn value(&self, point: DVec3) -> f64 {
        let [a, b, c] = self.corners;
        let normal = (b - a).cross(c - a);
        let inside = |from: DVec3, to: DVec3| (to - from).cross(normal).dot(point - from) <= 0.0;
        let distance = if inside(a, b) && inside(b, c) && inside(c, a) {
            (point - a).dot(normal.normalize()).abs()
        } else {
            [(a, b), (b, c), (c, a)]
                .map(|(from, to)| segment_distance(point, from, to))
                .into_iter()
                .fold(f64::MAX, f64::min)
        };
        distance - self.radius
    }
}

impl Sweep {
    fn of_finger(finger: &Finger) -> Self {
        Self {
            base: finger.base,
            axis: finger.axis,
            palmar: finger.palmar,
            sections: finger.sections.clone(),
            cap: finger.cap,
        }
    }

    /// Computes the first-order distance to the ellipsoid that fits the section at `point`: k0 (k0 - 1) / k1, with
    /// k0 = |p / r| and k1 = |p / r²|.
    fn value(&self, point: DVec3) -> f64 {
        let local = point - self.base;
        let (first, last) = (self.sections[0], self.sections[self.sections.len() - 1]);
        let at = local.dot(self.axis);
        let section = self.section(at.clamp(first.at, last.at));
        let beyond = at - at.clamp(first.at, last.at);
        let up = local.dot(self.palmar);
        let thickness = if up > 0.0 { section.palmar } else { section.dorsal };
        let p = DVec3::new(local.dot(self.axis.cross(self.palmar)), up, beyond);
        let r = DVec3::new(section.width, thickness, self.cap);
        let (k0, k1) = ((p / r).length(), (p / (r * r)).length());
        if k1 < 1e-6 { -section.width.min(thickness) } else { k0 * (k0 - 1.0) / k1 }
    }

    /// Interpolates the section at `at` by cubic Hermite splines.
    fn section(&self, at: f64) -> Section {
        let sections = &self.sections;
        let last = sections.len() - 1;
        let i = sections.windows(2).position(|pair| at <= pair[1].at).unwrap_or(last - 1);
        let h = sections[i + 1].at - sections[i].at;
        let t = ((at - sections[i].at) / h).clamp(0.0, 1.0);
        let blend = |get: fn(&Section) -> f64| {
            let slope = |k: usize| {
                let (before, after) = (&sections[k.saturating_sub(1)], &sections[(k + 1).min(last)]);
                (get(after) - get(before)) / (after.at - before.at)
            };
            let (t2, t3) = (t * t, t * t * t);
            (2.0 * t3 - 3.0 * t2 + 1.0) * get(&sections[i])
                + (t3 - 2.0 * t2 + t) * h * slope(i)
                + (3.0 * t2 - 2.0 * t3) * get(&sections[i + 1])
                + (t3 - t2) * h * slope(i + 1)
        };
        Section { at, width: blend(|s| s.width), dorsal: blend(|s| s.dorsal), palmar: blend(|s| s.palmar) }
    }
}

/// Returns metacarpals, balls of thumb and little finger, pads below the knuckles, and webs between the fingers.
fn palm_bones(fingers: &[Finger; 5]) -> Vec<Capsule> {
    let bone = |from: [f64; 3], to: DVec3, radii| Capsule { from: DVec3::from_array(from), to, radii };
    let [index, middle, little, ring, thumb] = fingers;
    let below = DVec3::new(0.0, -0.001, 0.0);
    let mut bones = vec![
        bone([0.086, 0.0060, 0.0190], index.base + below, [0.0150, 0.0108]),
        bone([0.086, 0.0070, 0.0090], middle.base + below, [0.0150, 0.0112]),
        bone([0.086, 0.0060, -0.0020], ring.base + below, [0.0150, 0.0108]),
        bone([0.086, 0.0040, -0.0110], little.base + below, [0.0145, 0.0098]),
        // Ball of the thumb, ball of the little finger.
        bone([0.080, -0.0060, 0.0230], thumb.base, [0.0150, 0.0118]),
        bone([0.080, -0.0020, -0.0120], DVec3::new(0.0380, -0.0030, -0.0330), [0.0140, 0.0125]),
        // Pads below the knuckles.
        bone([0.0150, -0.0050, 0.0270], DVec3::new(0.0240, -0.0060, -0.0310), [0.0085, 0.0085]),
    ];
    for [a, b] in [[index, middle], [middle, ring], [ring, little]] {
        let at = |finger: &Finger| finger.base + finger.axis * (0.18 * finger.marks[1]) + finger.palmar * 0.0025;
        bones.push(Capsule { from: at(a), to: at(b), radii: [0.0052; 2] });
    }
    bones
}

/// Returns the web between thumb and index finger.
fn webs(fingers: &[Finger; 5]) -> Vec<Web> {
    let [index, .., thumb] = fingers;
    let corners = [thumb.joints[0], thumb.base + thumb.axis * 0.006, index.base + DVec3::new(0.010, -0.004, 0.002)];
    vec![Web { corners, radius: 0.0048 }]
}

/// Returns the wrist: a stub that is closed behind the joint.
fn wrist() -> Sweep {
    let section = |at, width, thickness| Section { at, width, dorsal: thickness, palmar: thickness };
    Sweep {
        base: WRIST + DVec3::new(-0.0257, -0.0014, -0.0022),
        axis: DVec3::X,
        palmar: DVec3::NEG_Y,
        sections: vec![section(0.0, 0.0310, 0.0165), section(0.0257, 0.0285, 0.0185), section(0.0490, 0.0285, 0.0190)],
        cap: 0.008,
    }
}

fn segment_distance(point: DVec3, from: DVec3, to: DVec3) -> f64 {
    let along = to - from;
    let t = ((point - from).dot(along) / along.length_squared()).clamp(0.0, 1.0);
    (point - from - along * t).length()
}

/// Computes the minimum of two fields, rounded over a width of `k`.
fn smooth_min(a: f64, b: f64, k: f64) -> f64 {
    let overlap = (k - (a - b).abs()).max(0.0) / k;
    a.min(b) - overlap * overlap * k * 0.25
}
