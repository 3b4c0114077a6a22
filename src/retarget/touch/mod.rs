//! Transfer of touch from the skin of a human hand to the links of a robot hand.

pub mod balance;
mod expected;
mod human;
mod links;
mod pinch_point;
mod pooling;
mod torque_limits;
mod transfer;

pub use self::expected::{ExpectedLinkTouch, ExpectedTouch};
pub use self::human::{DORSAL, N_SEGMENTS, PALM, SegmentTouch, Touch};
pub(super) use self::pinch_point::PinchPoint;
pub use self::pooling::TouchPooling;
pub(super) use self::transfer::{TouchTransfer, TransferInput};
