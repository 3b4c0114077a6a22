//! Anatomy of the built-in right hand: positions of its bones and thickness around them.
//!
//! Units are metres, in the rest frame of the hand module: fingers along -x, palm facing -y, thumb towards +z. The
//! sizes are those of a medium adult hand (length 0.19 m from wrist to middle fingertip, breadth 0.085 m), tuned
//! manually.

use glam::DVec3;

use crate::hand::N_JOINTS;

/// Position of the wrist joint, m.
pub const WRIST: DVec3 = DVec3::new(0.0957, 0.0064, 0.0062);

/// A finger: a straight chain of phalanges with elliptic cross-sections.
#[derive(Debug, Clone)]
pub struct Finger {
    /// Joint index of its first joint in MANO order.
    pub first_joint: usize,
    /// Positions of the joints from base to end, then of the skin's tip, m.
    pub joints: [DVec3; 4],
    /// Unit direction from base to tip of the swept part.
    pub axis: DVec3,
    /// Unit direction that its pad faces.
    pub palmar: DVec3,
    /// Unit direction across the finger, `axis x palmar`.
    pub across: DVec3,
    /// Start of the swept part, m.
    pub base: DVec3,
    /// Distances from `base` to each joint of the swept part and to the tip, m.
    pub marks: Vec<f64>,
    /// Cross-sections along the axis, ascending.
    pub sections: Vec<Section>,
    /// Length of the rounded end, m.
    pub cap: f64,
}

/// An elliptic cross-section whose palmar and dorsal halves differ.
#[derive(Debug, Clone, Copy)]
pub struct Section {
    /// Distance from the base along the axis, m.
    pub at: f64,
    /// Half width, m.
    pub width: f64,
    /// Thickness on the dorsal side of the axis, m.
    pub dorsal: f64,
    /// Thickness on the palmar side of the axis, m.
    pub palmar: f64,
}

/// Position and size of one finger: base joint, yaw towards +z, degrees, lengths of its phalanges, m, and radius at its
/// middle joint, m.
struct Placement {
    first_joint: usize,
    base: DVec3,
    yaw_deg: f64,
    lengths: [f64; 3],
    radius: f64,
}

/// Returns index, middle, little, ring (MANO order) and thumb.
pub fn fingers() -> [Finger; 5] {
    let place = |first_joint, base: [f64; 3], yaw_deg, lengths, radius| {
        finger(&Placement { first_joint, base: DVec3::from_array(base), yaw_deg, lengths, radius })
    };
    [
        place(1, [0.0075, 0.0040, 0.0270], 5.0, [0.0365, 0.0235, 0.0245], 0.0091),
        place(4, [0.0020, 0.0060, 0.0050], 0.0, [0.0405, 0.0265, 0.0260], 0.0093),
        place(7, [0.0190, 0.0010, -0.0350], -15.0, [0.0290, 0.0190, 0.0220], 0.0078),
        place(10, [0.0085, 0.0045, -0.0160], -6.0, [0.0370, 0.0250, 0.0250], 0.0088),
        thumb(),
    ]
}

/// Returns the 16 joints in MANO order, m.
pub fn joints() -> [DVec3; N_JOINTS] {
    let mut joints = [WRIST; N_JOINTS];
    for finger in fingers() {
        joints[finger.first_joint..finger.first_joint + 3].copy_from_slice(&finger.joints[..3]);
    }
    joints
}

/// Creates a finger that starts at its knuckle, with the pad facing -y.
fn finger(placement: &Placement) -> Finger {
    let yaw = placement.yaw_deg.to_radians();
    let axis = DVec3::new(-yaw.cos(), 0.0, yaw.sin());
    let palmar = DVec3::NEG_Y;
    let [proximal, middle, distal] = placement.lengths;
    let marks = vec![0.0, proximal, proximal + middle, proximal + middle + distal];
    // Factors of the radius: narrower between the joints, thicker on the pads, flat at the nail.
    let section = |at, width, dorsal, palmar| (at, [width, dorsal, palmar]);
    let sections = [
        section(0.0, 1.04, 1.14, 1.24),
        section(0.5 * proximal, 1.01, 0.98, 1.14),
        section(proximal, 1.05, 0.98, 0.95),
        section(proximal + 0.5 * middle, 0.96, 0.85, 1.00),
        section(proximal + middle, 0.94, 0.79, 0.84),
        section(proximal + middle + 0.42 * distal, 0.90, 0.66, 0.90),
        section(proximal + middle + 0.68 * distal, 0.82, 0.56, 0.80),
    ];
    Finger {
        first_joint: placement.first_joint,
        joints: std::array::from_fn(|i| placement.base + axis * marks[i]),
        axis,
        palmar,
        across: axis.cross(palmar),
        base: placement.base,
        sections: scaled(&sections, placement.radius),
        cap: 0.32 * distal,
        marks,
    }
}

/// Creates the thumb. Its metacarpal lies in the ball of the thumb, the other two phalanges are swept, and the pad
/// faces the index finger.
fn thumb() -> Finger {
    const RADIUS: f64 = 0.0105;
    let carpal = DVec3::new(0.0735, -0.0060, 0.0290);
    let base = DVec3::new(0.0475, -0.0125, 0.0565);
    let axis = DVec3::new(-0.70, -0.08, 0.71).normalize();
    let (proximal, distal) = (0.0300, 0.0270);
    let across_the_palm = DVec3::new(-0.71, 0.0, -0.70);
    let palmar = (DVec3::NEG_Y * 0.62 + across_the_palm * 0.78).reject_from(axis).normalize();
    let section = |at, width, dorsal, palmar| (at, [width, dorsal, palmar]);
    let sections = [
        section(0.0, 1.12, 1.08, 1.20),
        section(0.5 * proximal, 1.00, 0.92, 1.06),
        section(proximal, 1.05, 0.94, 0.94),
        section(proximal + 0.42 * distal, 1.04, 0.74, 1.00),
        section(proximal + 0.66 * distal, 0.95, 0.62, 0.88),
    ];
    Finger {
        first_joint: 13,
        joints: [carpal, base, base + axis * proximal, base + axis * (proximal + distal)],
        axis,
        palmar,
        across: axis.cross(palmar),
        base,
        sections: scaled(&sections, RADIUS),
        cap: 0.34 * distal,
        marks: vec![0.0, proximal, proximal + distal],
    }
}

/// Scales sections, given as factors, by a radius.
fn scaled(sections: &[(f64, [f64; 3])], radius: f64) -> Vec<Section> {
    let scale = |&(at, [width, dorsal, palmar]): &(f64, [f64; 3])| Section {
        at,
        width: width * radius,
        dorsal: dorsal * radius,
        palmar: palmar * radius,
    };
    sections.iter().map(scale).collect()
}
