//! Contact point of a robot fingertip.

use glam::DVec3;

/// Point at which a robot fingertip touches another fingertip or the held object.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PinchPoint {
    /// Position in the world, m.
    pub position: DVec3,
    /// Unit normal out of the fingertip, in the world.
    pub normal: DVec3,
}
