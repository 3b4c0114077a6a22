//! Regions of a hand: three phalanges per finger, palm, dorsal.

use super::HandModel;

/// A named part of a hand's surface.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
#[allow(missing_docs)]
pub enum Region {
    ThumbTip,
    ThumbMiddle,
    ThumbProximal,
    IndexTip,
    IndexMiddle,
    IndexProximal,
    MiddleTip,
    MiddleMiddle,
    MiddleProximal,
    RingTip,
    RingMiddle,
    RingProximal,
    LittleTip,
    LittleMiddle,
    LittleProximal,
    Palm,
    Dorsal,
}

pub(super) fn of_vertices(_model: &HandModel) -> Vec<Region> {
    unimplemented!()
}
