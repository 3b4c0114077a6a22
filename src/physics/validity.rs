//! Reasons why forces of a hand are unknown at a frame.

/// Validity of the forces on one hand at one frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[repr(u8)]
pub enum ForceValidity {
    /// The forces are estimated.
    Valid = 0,
    /// The hand's pose is unknown.
    HandUnknown = 1,
    /// The pose of a body that the hand touches is unknown.
    PoseGap = 2,
    /// The tracking of a body that the hand touches jumps.
    PoseJump = 3,
    /// A body moves in a way that no contact explains.
    Unexplained = 4,
    /// The hand is deeper in a body than noise explains.
    Deep = 5,
    /// The mass of a body that the hand touches is unknown.
    MassUnknown = 6,
    /// The direction of gravity is unknown.
    GravityUnknown = 7,
    /// The hand touches something whose forces the motion does not tell: a fixed or held thing, or the other hand.
    NotFree = 8,
}

impl ForceValidity {
    /// All values, by code.
    pub const ALL: [Self; 9] = [
        Self::Valid,
        Self::HandUnknown,
        Self::PoseGap,
        Self::PoseJump,
        Self::Unexplained,
        Self::Deep,
        Self::MassUnknown,
        Self::GravityUnknown,
        Self::NotFree,
    ];

    /// Returns the code in stores.
    pub fn code(self) -> u8 {
        self as u8
    }

    /// Returns the reason in words.
    pub fn reason(self) -> &'static str {
        match self {
            Self::Valid => "valid",
            Self::HandUnknown => "the pose of the hand is unknown",
            Self::PoseGap => "the pose of a touched body is unknown",
            Self::PoseJump => "the tracking of a touched body jumps",
            Self::Unexplained => "a body moves in a way that no contact explains",
            Self::Deep => "the hand is deeper in a body than noise explains",
            Self::MassUnknown => "the mass of a touched body is unknown",
            Self::GravityUnknown => "the direction of gravity is unknown",
            Self::NotFree => "the hand touches something that does not move freely",
        }
    }
}
