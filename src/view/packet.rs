//! Wire form of a moment: what the page gets for one image.
//!
//! Little-endian: the length of a JSON text (u32), the text, padded with spaces to a multiple of four bytes, then the arrays that
//! the text names, f32 each, and the image as JPEG. NaN stays NaN in arrays and is `null` in the text, so that unknown touch never
//! becomes zero.

use glam::Vec3;
use serde::Serialize;

use super::moment::{Moment, known, totals};
use super::place::wrist_frame;
use crate::error::Result;
use crate::hand::{HandModel, Region, Side};
use crate::image::jpeg;
use crate::tactile::TactileField;

/// JPEG quality of images, 1 to 100: blocks are not visible at VGA.
const JPEG_QUALITY: u8 = 85;

/// The text of a packet.
#[derive(Debug, Serialize)]
struct Head<'a> {
    frame: usize,
    /// Number of the moment in a live source, from 1.
    sequence: u64,
    episode: usize,
    stamp: f64,
    /// Width and height of the image, pixels; zeros without an image.
    size: [u32; 2],
    /// Reason why there is no image.
    fault: Option<&'a str>,
    reason: &'a str,
    warming_up: bool,
    familiarity: Option<f32>,
    presence: [Option<f32>; 2],
    total: [Option<f32>; 2],
    truth_total: Option<[Option<f32>; 2]>,
    /// Total force on the 17 regions of each hand, N.
    regions: Vec<Option<f32>>,
    truth_regions: Option<Vec<Option<f32>>>,
    /// Names and lengths of the arrays, in order.
    arrays: Vec<(&'static str, usize)>,
}

/// Encoder of the moments of one source.
#[derive(Debug, Clone)]
pub(super) struct Encoder {
    hands: [HandModel; 2],
    regions: [Vec<Region>; 2],
}

impl Encoder {
    /// Creates the encoder of touch on these hands, left first.
    pub(super) fn new(hands: [HandModel; 2]) -> Self {
        let regions = hands.each_ref().map(HandModel::regions);
        Self { hands, regions }
    }

    /// Encodes a moment; `sequence` is its number in a live source.
    ///
    /// # Errors
    /// If the image can't be encoded.
    pub(super) fn encode(&self, moment: &Moment, sequence: u64) -> Result<Vec<u8>> {
        let mut arrays: Vec<(&'static str, Vec<f32>)> = vec![("force", moment.touch.force.clone())];
        arrays.extend(moment.truth.as_ref().map(|truth| ("truth", truth.force.clone())));
        for ((model, params), names) in self.hands.iter().zip(&moment.hands).zip(NAMES) {
            let Some(params) = params else { continue };
            let posed = model.forward(params);
            arrays.push((names.posed, flat(wrist_frame(model, &posed))));
            if let Some(sight) = &moment.sight {
                arrays.push((names.seen, posed.vertices.iter().flat_map(|vertex| sight.of(*vertex)).collect()));
            }
        }
        let picture = moment.image.as_ref().ok();
        let head = Head {
            frame: moment.frame,
            sequence,
            episode: moment.episode,
            stamp: moment.stamp_secs,
            size: picture.map_or([0, 0], |image| [image.width(), image.height()]),
            fault: moment.image.as_ref().err().map(String::as_str),
            reason: &moment.reason,
            warming_up: moment.warming_up,
            familiarity: moment.familiarity.and_then(known),
            presence: moment.presence.map(|presence| presence.and_then(known)),
            total: totals(&moment.touch),
            truth_total: moment.truth.as_ref().map(totals),
            regions: self.region_forces(&moment.touch),
            truth_regions: moment.truth.as_ref().map(|truth| self.region_forces(truth)),
            arrays: arrays.iter().map(|(name, values)| (*name, values.len())).collect(),
        };
        let mut text = serde_json::to_vec(&head).unwrap_or_default();
        text.resize(text.len().next_multiple_of(4), b' ');
        let mut packet = (text.len() as u32).to_le_bytes().to_vec();
        packet.append(&mut text);
        packet.extend(arrays.iter().flat_map(|(_, values)| values).flat_map(|value| value.to_le_bytes()));
        if let Some(picture) = picture {
            packet.append(&mut jpeg(picture, JPEG_QUALITY)?);
        }
        Ok(packet)
    }

    fn region_forces(&self, field: &TactileField) -> Vec<Option<f32>> {
        field.region_forces(&self.regions).into_iter().map(known).collect()
    }
}

/// Names of the arrays of a hand.
struct Names {
    /// Vertices in the frame of the wrist, m.
    posed: &'static str,
    /// Vertices in the image, as [`super::projection::Sight::of`] gives them.
    seen: &'static str,
}

const NAMES: [Names; 2] =
    [Names { posed: "left_posed", seen: "left_seen" }, Names { posed: "right_posed", seen: "right_seen" }];

fn flat(vertices: impl IntoIterator<Item = Vec3>) -> Vec<f32> {
    vertices.into_iter().flat_map(|vertex| vertex.to_array()).collect()
}

/// Returns the hands for the page: triangles, vertices at rest in the frame of the wrist, and the region of each vertex.
pub(super) fn meshes(hands: &[HandModel; 2]) -> serde_json::Value {
    let mesh = |hand: &HandModel| {
        let rest = hand.forward(&crate::hand::HandParams::default());
        let regions: Vec<usize> = hand.regions().into_iter().map(Region::index).collect();
        let faces: Vec<u32> = hand.faces.iter().flatten().copied().collect();
        serde_json::json!({
            "side": hand.side.name(), "faces": faces, "rest": flat(wrist_frame(hand, &rest)), "regions": regions,
        })
    };
    let names = Region::ALL.map(|region| region.name().replace('_', " "));
    serde_json::json!({ "hands": hands.each_ref().map(mesh), "region_names": names, "sides": Side::BOTH.map(Side::name) })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hand::Topology;

    #[test]
    fn unknown_touch_is_null_and_nan_and_never_zero() {
        let hands = Side::BOTH.map(HandModel::builtin);
        let mut field = TactileField::zeros(Topology::EgotacHand1);
        field.force[Side::Left.range()].fill(f32::NAN);
        let packet = Encoder::new(hands).encode(&Moment::unknown(3, 0, 0.5, field), 0).unwrap();
        let length = u32::from_le_bytes(packet[..4].try_into().unwrap()) as usize;
        let head: serde_json::Value = serde_json::from_slice(&packet[4..4 + length]).unwrap();
        assert_eq!(head["total"], serde_json::json!([null, 0.0]));
        assert!(head["regions"].as_array().unwrap()[..17].iter().all(serde_json::Value::is_null));
        let force: Vec<f32> =
            packet[4 + length..].chunks_exact(4).map(|b| f32::from_le_bytes(b.try_into().unwrap())).collect();
        assert_eq!(force.len(), 1556);
        assert!(force[..778].iter().all(|f| f.is_nan()) && force[778..].iter().all(|f| *f == 0.0));
    }
}
