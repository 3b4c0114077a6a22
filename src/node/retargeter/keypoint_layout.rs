//! Order of the positions that hand trackers give.

use glam::DVec3;

use crate::error::{Error, Result};
use crate::hand::N_KEYPOINTS;
use crate::node::params::{Allowed, Parameter, Parameters};

/// Values of the parameter: `auto`, then the names of [`KeypointLayout::KNOWN`].
const NAMES: [&str; 4] = ["auto", "keypoints21", "webxr25", "openxr26"];

/// Declares the parameter `keypoint_layout`.
pub(super) fn parameter() -> Parameter {
    Parameter::fixed(
        "keypoint_layout",
        "auto",
        Allowed::OneOf(&NAMES),
        "Order of the positions on keypoints. keypoints21: wrist, then each finger from base to tip; webxr25: wrist, four of the \
         thumb, five of each finger from the metacarpal to the tip; openxr26: the palm, then as webxr25; auto: by their number.",
    )
}

/// Order of the positions of a hand.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum KeypointLayout {
    /// By the number of positions.
    Auto,
    /// Wrist, then thumb, index, middle, ring and little finger, four each from base to tip.
    Keypoints21,
    /// Joints of WebXR: as [`Self::Keypoints21`], with the metacarpal before the four of each finger but the thumb.
    WebXr25,
    /// Joints of OpenXR (`XR_EXT_hand_tracking`): the palm, then those of WebXR.
    OpenXr26,
}

impl KeypointLayout {
    const KNOWN: [Self; 3] = [Self::Keypoints21, Self::WebXr25, Self::OpenXr26];

    /// Reads the parameter.
    pub(super) fn of(parameters: &Parameters) -> Self {
        match parameters.get::<String>("keypoint_layout").as_str() {
            "keypoints21" => Self::Keypoints21,
            "webxr25" => Self::WebXr25,
            "openxr26" => Self::OpenXr26,
            _ => Self::Auto,
        }
    }

    fn count(self) -> usize {
        match self {
            Self::Auto => 0,
            Self::Keypoints21 => N_KEYPOINTS,
            Self::WebXr25 => 25,
            Self::OpenXr26 => 26,
        }
    }

    /// Returns the 21 keypoints.
    ///
    /// # Errors
    /// If the number of positions is another one.
    pub(super) fn keypoints(self, positions: &[DVec3]) -> Result<[DVec3; N_KEYPOINTS]> {
        let layout = match self {
            Self::Auto => Self::KNOWN.into_iter().find(|known| known.count() == positions.len()),
            given => Some(given).filter(|given| given.count() == positions.len()),
        };
        let Some(layout) = layout else {
            let counts = match self {
                Self::Auto => "21, 25 or 26".to_owned(),
                given => given.count().to_string(),
            };
            return Err(Error::shape("poses", counts, [positions.len()]));
        };
        Ok(std::array::from_fn(|keypoint| positions[layout.index_of(keypoint)]))
    }

    /// Returns the index of a keypoint among the positions.
    fn index_of(self, keypoint: usize) -> usize {
        // The metacarpals before this keypoint: one for each finger from the index finger (keypoints 5 to 8) on.
        let metacarpals = keypoint.div_ceil(4) - usize::from(keypoint > 0);
        match self {
            Self::Auto | Self::Keypoints21 => keypoint,
            Self::WebXr25 => keypoint + metacarpals,
            Self::OpenXr26 => keypoint + metacarpals + 1,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Joints of OpenXR in the order of `XrHandJointEXT`.
    const OPENXR: [&str; 26] = [
        "palm",
        "wrist",
        "thumb_metacarpal",
        "thumb_proximal",
        "thumb_distal",
        "thumb_tip",
        "index_metacarpal",
        "index_proximal",
        "index_intermediate",
        "index_distal",
        "index_tip",
        "middle_metacarpal",
        "middle_proximal",
        "middle_intermediate",
        "middle_distal",
        "middle_tip",
        "ring_metacarpal",
        "ring_proximal",
        "ring_intermediate",
        "ring_distal",
        "ring_tip",
        "little_metacarpal",
        "little_proximal",
        "little_intermediate",
        "little_distal",
        "little_tip",
    ];

    #[test]
    fn each_layout_gives_the_same_21_keypoints() {
        let position = |joint: usize| DVec3::new(joint as f64, 0.0, 0.0);
        let all: Vec<DVec3> = (0..26).map(position).collect();
        let names = |points: [DVec3; 21]| points.map(|point| OPENXR[point.x as usize]);
        let expected: Vec<&str> = OPENXR
            .into_iter()
            .filter(|name| *name == "thumb_metacarpal" || *name != "palm" && !name.ends_with("_metacarpal"))
            .collect();
        for layout in [KeypointLayout::Auto, KeypointLayout::OpenXr26] {
            assert_eq!(names(layout.keypoints(&all).unwrap()).to_vec(), expected);
        }
        for layout in [KeypointLayout::Auto, KeypointLayout::WebXr25] {
            assert_eq!(names(layout.keypoints(&all[1..]).unwrap()).to_vec(), expected);
        }
        let plain: Vec<DVec3> = (0..21).map(position).collect();
        for layout in [KeypointLayout::Auto, KeypointLayout::Keypoints21] {
            assert_eq!(layout.keypoints(&plain).unwrap().to_vec(), plain);
        }
    }

    #[test]
    fn another_number_of_positions_is_refused() {
        let twenty = vec![DVec3::ZERO; 20];
        let error = KeypointLayout::Auto.keypoints(&twenty).unwrap_err().to_string();
        assert!(error.contains("21, 25 or 26") && error.contains("20"), "{error}");
        assert!(KeypointLayout::OpenXr26.keypoints(&vec![DVec3::ZERO; 25]).is_err());
    }
}
