//! The tactile field: force and contact per vertex of both hands, one of the two types that cross the middle.

use crate::error::{Error, Result};
use crate::hand::{N_FIELD, Region, Side, Topology};

/// Force above which a vertex is in contact in truth, N (paper: CONTACT = F > 0.05 N).
pub const CONTACT_FORCE_N: f32 = 0.05;

/// Validity of a frame's truth: valid, or the guard that refused it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
#[repr(u8)]
pub enum Validity {
    /// No guard refused the frame.
    #[default]
    Valid = 0,
    /// The engine raised a warning counter (bad state, full arena).
    EngineWarning = 1,
    /// A state is not finite, or time did not advance by the timestep.
    NotFinite = 2,
    /// A velocity is beyond that of any hand.
    TooFast = 3,
    /// A penetration depth is beyond the limit of the touching bodies.
    TooDeep = 4,
    /// Contact forces don't balance weight and acceleration.
    Unbalanced = 5,
    /// The solver hit its iteration cap.
    NotConverged = 6,
    /// Kinetic energy changed without work.
    EnergyError = 7,
    /// The engine's memory for contacts is nearly full.
    MemoryFull = 8,
    /// A held object slips slowly although friction should hold it.
    Creeping = 9,
    /// A friction force is outside of its cone.
    OutsideCone = 10,
    /// A force on a link is beyond that of a human hand.
    TooStrong = 11,
}

impl Validity {
    /// All kinds, in the order of their codes.
    pub const ALL: [Validity; 12] = [
        Self::Valid,
        Self::EngineWarning,
        Self::NotFinite,
        Self::TooFast,
        Self::TooDeep,
        Self::Unbalanced,
        Self::NotConverged,
        Self::EnergyError,
        Self::MemoryFull,
        Self::Creeping,
        Self::OutsideCone,
        Self::TooStrong,
    ];

    /// Returns the code of stores and messages; 0 is valid.
    pub fn code(self) -> u8 {
        self as u8
    }

    /// Returns the kind of a code of the array or field `name`.
    ///
    /// # Errors
    /// If the code is unknown.
    pub fn from_code(name: impl ToString, code: u8) -> Result<Self> {
        let known = Self::ALL.get(usize::from(code)).copied();
        known.ok_or_else(|| Error::value(name, format!("0 to {}", Self::ALL.len() - 1), code))
    }

    /// Describes the guard's finding; empty for a valid frame.
    pub fn reason(self) -> &'static str {
        match self {
            Self::Valid => "",
            Self::EngineWarning => "the engine raised a warning",
            Self::NotFinite => "the state is not finite or time did not advance",
            Self::TooFast => "a velocity is beyond its bound",
            Self::TooDeep => "a contact is deeper than the bodies allow",
            Self::Unbalanced => "contact forces do not balance weight and acceleration",
            Self::NotConverged => "the solver hit its iteration cap",
            Self::EnergyError => "kinetic energy came or went without work",
            Self::MemoryFull => "the engine's memory for contacts is nearly full",
            Self::Creeping => "a held object slips slowly",
            Self::OutsideCone => "friction is beyond its cone",
            Self::TooStrong => "a force is beyond that of a human hand",
        }
    }
}

/// Force and contact on the vertices of both hands at one instant.
///
/// ```
/// use egotac::{Side, TactileField, Topology};
///
/// let mut force = vec![0.0; 1556]; // N; left hand 0..778, right hand 778..1556
/// force[778 + 320] = 0.4; // tip of the right index finger
/// let field = TactileField::from_force(Topology::EgotacHand1, force)?;
/// assert_eq!(field.total_force(Side::Right), 0.4);
/// assert_eq!(field.contact[778 + 320], 1.0); // above 0.05 N
/// # Ok::<(), egotac::Error>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct TactileField {
    /// Meaning of the vertex indices.
    pub topology: Topology,
    /// (1556) normal force, N, never negative; NaN = unknown.
    pub force: Vec<f32>,
    /// (1556) contact probability; truth is 0 or 1; NaN = unknown.
    pub contact: Vec<f32>,
}

impl TactileField {
    /// Creates a field without touch.
    pub fn zeros(topology: Topology) -> Self {
        Self { topology, force: vec![0.0; N_FIELD], contact: vec![0.0; N_FIELD] }
    }

    /// Creates a field of which nothing is known.
    pub fn unknown(topology: Topology) -> Self {
        Self { topology, force: vec![f32::NAN; N_FIELD], contact: vec![f32::NAN; N_FIELD] }
    }

    /// Creates a field from forces; contact is force > 0.05 N.
    ///
    /// # Errors
    /// If `force` does not have 1556 entries, or one is negative or not finite.
    pub fn from_force(topology: Topology, force: Vec<f32>) -> Result<Self> {
        if force.len() != N_FIELD {
            return Err(Error::shape("force", format!("[{N_FIELD}]"), [force.len()]));
        }
        if let Some(bad) = force.iter().position(|f| !f.is_finite() || *f < 0.0) {
            return Err(Error::value(format!("force[{bad}]"), "a finite number >= 0", force[bad]));
        }
        let contact = force.iter().map(|f| f32::from(*f > CONTACT_FORCE_N)).collect();
        Ok(Self { topology, force, contact })
    }

    /// Returns the total force on each region, N: the 17 of the left hand in the order of [`Region::ALL`], then those of the
    /// right hand; NaN if a force in the region is unknown.
    ///
    /// `regions`: region of each vertex of the left and the right hand, (778) each, as `HandModel::regions` returns them.
    pub fn region_forces(&self, regions: &[Vec<Region>; 2]) -> Vec<f32> {
        let mut sums = vec![0.0f64; 2 * Region::ALL.len()];
        for side in Side::BOTH {
            let start = side as usize * Region::ALL.len();
            for (force, region) in self.force[side.range()].iter().zip(&regions[side as usize]) {
                sums[start + region.index()] += f64::from(*force);
            }
        }
        sums.into_iter().map(|sum| sum as f32).collect()
    }

    /// Returns the highest contact probability in each region, in the order of [`Self::region_forces`]; NaN if one in the region is
    /// unknown.
    ///
    /// `regions`: as for [`Self::region_forces`].
    pub fn region_contacts(&self, regions: &[Vec<Region>; 2]) -> Vec<f32> {
        let mut highest = vec![0.0f32; 2 * Region::ALL.len()];
        for side in Side::BOTH {
            let start = side as usize * Region::ALL.len();
            for (contact, region) in self.contact[side.range()].iter().zip(&regions[side as usize]) {
                let highest = &mut highest[start + region.index()];
                // `max` would ignore NaN.
                *highest = if contact.is_nan() || highest.is_nan() { f32::NAN } else { highest.max(*contact) };
            }
        }
        highest
    }

    /// True if neither force nor contact of any vertex of a hand is known.
    pub fn is_unknown(&self, side: Side) -> bool {
        let [force, contact] = [&self.force, &self.contact].map(|values| &values[side.range()]);
        force.iter().chain(contact).all(|value| value.is_nan())
    }

    /// Returns the mask of the hands of which anything is known, (1556): 0 on a hand that is unknown; empty if none is.
    pub fn known_hands(&self) -> Vec<u8> {
        let unknown = Side::BOTH.map(|side| self.is_unknown(side));
        match unknown.contains(&true) {
            true => {
                let mask = |side: &Side| vec![u8::from(!unknown[*side as usize]); side.range().len()];
                Side::BOTH.iter().flat_map(mask).collect()
            }
            false => Vec::new(),
        }
    }

    /// Returns the total normal force on one hand, N; NaN if any force is unknown.
    pub fn total_force(&self, side: Side) -> f32 {
        self.force[side.range()].iter().map(|f| f64::from(*f)).sum::<f64>() as f32
    }
}
