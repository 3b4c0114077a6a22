//! Regions of a hand: three phalanges per finger, palm, dorsal.

use glam::Vec3;

use super::{HandModel, N_JOINTS, Side, mesh};
use crate::error::{Error, Result};

/// A named region of a hand's surface.
///
/// The three regions of a finger go all around it: `proximal` moves with its first joint, `middle` with the second,
/// `tip` with the third (of the thumb: metacarpal, proximal and distal phalanx). Skin that moves with the wrist is
/// `palm` or `dorsal`, by the direction it faces at rest.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
#[allow(missing_docs, reason = "the names are their own description")]
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

impl Region {
    /// All regions, thumb to little finger from tip to base, then palm and dorsal.
    pub const ALL: [Region; 17] = [
        Self::ThumbTip,
        Self::ThumbMiddle,
        Self::ThumbProximal,
        Self::IndexTip,
        Self::IndexMiddle,
        Self::IndexProximal,
        Self::MiddleTip,
        Self::MiddleMiddle,
        Self::MiddleProximal,
        Self::RingTip,
        Self::RingMiddle,
        Self::RingProximal,
        Self::LittleTip,
        Self::LittleMiddle,
        Self::LittleProximal,
        Self::Palm,
        Self::Dorsal,
    ];

    /// Returns the name used in files, messages and tables, e.g. `thumb_tip`.
    pub fn name(self) -> &'static str {
        match self {
            Self::ThumbTip => "thumb_tip",
            Self::ThumbMiddle => "thumb_middle",
            Self::ThumbProximal => "thumb_proximal",
            Self::IndexTip => "index_tip",
            Self::IndexMiddle => "index_middle",
            Self::IndexProximal => "index_proximal",
            Self::MiddleTip => "middle_tip",
            Self::MiddleMiddle => "middle_middle",
            Self::MiddleProximal => "middle_proximal",
            Self::RingTip => "ring_tip",
            Self::RingMiddle => "ring_middle",
            Self::RingProximal => "ring_proximal",
            Self::LittleTip => "little_tip",
            Self::LittleMiddle => "little_middle",
            Self::LittleProximal => "little_proximal",
            Self::Palm => "palm",
            Self::Dorsal => "dorsal",
        }
    }

    /// Returns the names of the regions of both hands, `<side>_<region>`, left hand first; the order of all vectors over regions.
    pub fn names_of_both_hands() -> Vec<String> {
        let of_side = |side: Side| Self::ALL.iter().map(move |region| format!("{}_{}", side.name(), region.name()));
        Side::BOTH.into_iter().flat_map(of_side).collect()
    }

    /// Parses a name.
    ///
    /// # Errors
    /// If the name is unknown; the error lists the valid ones.
    pub fn from_name(name: &str) -> Result<Self> {
        let found = Self::ALL.into_iter().find(|region| region.name() == name);
        found.ok_or_else(|| Error::unknown("region", name, Self::ALL.map(Self::name)))
    }

    /// Returns the index in [`Self::ALL`], 0 to 16.
    pub fn index(self) -> usize {
        self as usize
    }
}

/// Region that moves with each joint, in MANO's joint order; the normal separates palm and dorsal at the wrist.
const JOINT_REGION: [Region; N_JOINTS] = [
    Region::Palm,
    Region::IndexProximal,
    Region::IndexMiddle,
    Region::IndexTip,
    Region::MiddleProximal,
    Region::MiddleMiddle,
    Region::MiddleTip,
    Region::LittleProximal,
    Region::LittleMiddle,
    Region::LittleTip,
    Region::RingProximal,
    Region::RingMiddle,
    Region::RingTip,
    Region::ThumbProximal,
    Region::ThumbMiddle,
    Region::ThumbTip,
];

/// Computes the region of each vertex from its strongest joint and, at the wrist, from its rest normal.
pub(super) fn of_vertices(model: &HandModel) -> Vec<Region> {
    let normals = mesh::vertex_normals(&model.v_template, &model.faces);
    let region = |(joint, normal): (usize, &Vec3)| match joint {
        // The palms of both hands face -y at rest.
        0 if normal.y > 0.0 => Region::Dorsal,
        _ => JOINT_REGION[joint],
    };
    model.strongest_joints().into_iter().zip(&normals).map(region).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn region_names_are_unique_and_read_back() {
        for (index, region) in Region::ALL.into_iter().enumerate() {
            assert_eq!(Region::from_name(region.name()).unwrap(), region);
            assert_eq!(region.index(), index);
        }
        assert!(Region::from_name("nail").unwrap_err().to_string().contains("thumb_tip"));
    }
}
