//! Result of all cameras together: for each hand, that of the camera which sees it best.

use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use super::camera::Camera;
use super::views::regions::Regions;
use crate::hand::{HandModel, Side};
use crate::message::{HandTactile, TactileFrame};
use crate::node::lock::lock;
use crate::node::log::Log;
use crate::node::params::{Allowed, Parameter, Parameters};
use crate::node::publisher::Publisher;
use crate::node::qos;
use crate::node::runtime::Runtime;

/// Number of frames in which each camera gave the left and the right hand; clones share it.
pub(super) type Chosen = Arc<Mutex<Vec<[u64; 2]>>>;

/// Publishes the result of all cameras on `~/tactile` and `~/regions`.
pub(super) struct Fusion {
    /// Newest result of each camera with the time when it was computed.
    newest: Vec<Option<(Instant, TactileFrame)>>,
    frames: Publisher<TactileFrame>,
    /// None if the fields have another topology than the hands whose regions are known.
    regions: Option<Regions>,
    chosen: Chosen,
    sequence: u64,
    parameters: Arc<Parameters>,
}

/// A fused frame, and for the left and the right hand the index of the frame that it is from.
struct Fused {
    frame: TactileFrame,
    from: [usize; 2],
}

impl Fusion {
    /// Declares the parameter `fusion_window_ms`.
    pub(super) fn parameter() -> Parameter {
        Parameter::new(
            "fusion_window_ms",
            100.0,
            Allowed::Doubles(0.0, 10_000.0),
            "With cameras: longest time after its computation in which the result of a camera takes part in ~/tactile, \
             milliseconds.",
        )
    }

    /// Creates the publishers for `cameras`, with the regions of `hands`.
    ///
    /// # Errors
    /// If ROS refuses a topic.
    pub(super) fn create(
        runtime: &mut Runtime,
        cameras: &[Camera],
        hands: Option<&[HandModel; 2]>,
    ) -> anyhow::Result<Self> {
        Ok(Self {
            newest: cameras.iter().map(|_| None).collect(),
            frames: runtime.publisher("~/tactile", qos::output())?,
            regions: hands.map(|hands| Regions::create(runtime, "~/regions", hands)).transpose()?,
            chosen: Arc::new(Mutex::new(vec![[0; 2]; cameras.len()])),
            sequence: 0,
            parameters: Arc::clone(runtime.parameters()),
        })
    }

    /// Counts of the frames that each camera gave.
    pub(super) fn chosen(&self) -> &Chosen {
        &self.chosen
    }

    /// Publishes the fusion of new results, by the number of their camera, and of recent ones of the other cameras; nothing if there is no
    /// new one.
    pub(super) fn publish(&mut self, frames: Vec<(usize, TactileFrame)>, log: &Log) {
        if frames.is_empty() {
            return;
        }
        let now = Instant::now();
        for (camera, frame) in frames {
            self.newest[camera] = Some((now, frame));
        }
        let window = Duration::from_secs_f64(1e-3 * self.parameters.get::<f64>("fusion_window_ms"));
        let recent = self.newest.iter().enumerate().filter_map(|(camera, newest)| {
            let (computed, frame) = newest.as_ref()?;
            (now.duration_since(*computed) <= window).then_some((camera, frame))
        });
        let (cameras, frames): (Vec<usize>, Vec<&TactileFrame>) = recent.unzip();
        let Some(Fused { mut frame, from }) = fuse(&frames) else { return };
        frame.sequence = self.sequence;
        self.sequence += 1;
        for (hand, from) in from.into_iter().enumerate() {
            lock(&self.chosen)[cameras[from]][hand] += 1;
        }
        let published = self.frames.publish(&frame);
        let regions = self.regions.as_ref().map_or(Ok(()), |regions| regions.publish(&frame));
        if let Err(error) = published.and(regions) {
            log.warn_throttled("fusion", format!("cannot publish the fused result: {error:#}"));
        }
    }
}

/// Fuses frames of one topology; None without frames. Each hand is taken whole from the frame that knows its touch and has the highest
/// presence of the hand, or familiarity where presence is not estimated; of equal ones, from the newest. Stamp and frame are
/// those of the newest image.
fn fuse(frames: &[&TactileFrame]) -> Option<Fused> {
    let stamp = |index: &usize| frames[*index].header.stamp.nanos();
    let newest = (0..frames.len()).max_by_key(stamp)?;
    let best = |side: Side| {
        let rank = |index: &usize| {
            let frame = frames[*index];
            let hand = frame.hands.get(side as usize)?;
            let weight = if hand.score.is_nan() { frame.familiarity } else { hand.score };
            // NaN, not estimated, comes last.
            Some((is_known(hand), if weight.is_nan() { -1.0 } else { weight }, stamp(index)))
        };
        (0..frames.len()).max_by(|a, b| rank(a).partial_cmp(&rank(b)).unwrap_or(std::cmp::Ordering::Equal))
    };
    let [left, right] = Side::BOTH.map(best);
    let from = [left?, right?];
    let chosen = from.map(|index| frames[index]);
    let hands = chosen.iter().enumerate().filter_map(|(side, frame)| frame.hands.get(side).cloned()).collect();
    let mut reasons: Vec<&str> = Vec::new();
    for (side, frame) in Side::BOTH.into_iter().zip(chosen) {
        let other = format!("{}: ", Side::BOTH[1 - side as usize].name());
        let own = frame.reason.split("; ").filter(|reason| !reason.is_empty() && !reason.starts_with(&other));
        reasons.extend(own.filter(|reason| !reasons.contains(reason)).collect::<Vec<_>>());
    }
    let frame = TactileFrame {
        header: frames[newest].header.clone(),
        hands,
        sequence: 0,
        inference_secs: frames[newest].inference_secs,
        model_id: frames[newest].model_id.clone(),
        topology: frames[newest].topology.clone(),
        warming_up: chosen.iter().any(|frame| frame.warming_up),
        familiarity: chosen[0].familiarity.max(chosen[1].familiarity),
        reason: reasons.join("; "),
    };
    Some(Fused { frame, from })
}

/// True if touch of a hand is known at a vertex.
fn is_known(hand: &HandTactile) -> bool {
    hand.contact.iter().any(|contact| !contact.is_nan())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hand::Topology;
    use crate::message::{Header, Time};
    use crate::tactile::{Certainty, Doubt, TactileField};

    /// Frame of one camera; `presence`: NaN = not estimated. Forces are `newtons` everywhere.
    fn frame(nanosec: u32, newtons: f32, familiarity: f32, presence: [f32; 2]) -> TactileFrame {
        let mut field = TactileField::zeros(Topology::EgotacHand1);
        field.force.fill(newtons);
        field.contact.fill(if newtons.is_nan() { f32::NAN } else { 0.5 });
        let header = Header { stamp: Time { sec: 5, nanosec }, frame_id: format!("camera_{nanosec}") };
        let number = |value: f32| (!value.is_nan()).then_some(value);
        let certainty =
            Certainty { familiarity: number(familiarity), presence: presence.map(number), ..Certainty::default() };
        TactileFrame { model_id: "m".into(), ..TactileFrame::from_field(header, &field).unwrap() }
            .with_certainty(&certainty)
    }

    /// Index of the frames that both hands are from.
    fn from(frames: &[TactileFrame]) -> [usize; 2] {
        fuse(&frames.iter().collect::<Vec<_>>()).unwrap().from
    }

    const NONE: [f32; 2] = [f32::NAN; 2];

    #[test]
    fn each_hand_comes_whole_from_the_camera_with_its_highest_presence() {
        let frames = [frame(1, 1.0, 0.9, [0.9, 0.2]), frame(2, 2.0, 0.1, [0.3, 0.8])];
        let Fused { frame: fused, from } = fuse(&[&frames[0], &frames[1]]).unwrap();
        assert_eq!(from, [0, 1]);
        assert_eq!(fused.hands, [frames[0].hands[0].clone(), frames[1].hands[1].clone()]);
        assert_eq!(fused.header, frames[1].header, "that of the newest image");
    }

    #[test]
    fn without_presence_familiarity_decides_and_without_both_the_newest_stamp() {
        assert_eq!(from(&[frame(1, 1.0, 0.6, NONE), frame(2, 2.0, 0.5, NONE)]), [0, 0]);
        assert_eq!(from(&[frame(3, 1.0, f32::NAN, NONE), frame(2, 2.0, f32::NAN, NONE)]), [0, 0]);
        assert_eq!(from(&[frame(3, 1.0, f32::NAN, NONE), frame(2, 2.0, 0.0, NONE)]), [1, 1]);
        assert!(fuse(&[]).is_none());
    }

    #[test]
    fn known_touch_comes_before_unknown_touch() {
        assert_eq!(from(&[frame(1, 1.0, 0.1, NONE), frame(2, f32::NAN, 0.9, NONE)]), [0, 0]);
    }

    #[test]
    fn the_reason_is_that_of_the_hands_that_were_taken() {
        let absent = |side: usize| {
            let mut doubt = [None; 2];
            doubt[side] = Some(Doubt::Absent);
            Certainty { presence: [Some(0.5); 2], doubt, masked: true, ..Certainty::default() }
        };
        let a = frame(1, 1.0, 0.5, [0.9, 0.1]).with_certainty(&absent(1));
        let b = frame(2, 1.0, 0.5, [0.9, 0.1]).with_certainty(&absent(0));
        let mut seen = [a.clone(), b.clone()];
        // The left hand of the first camera and the right hand of the second are known.
        seen[0].hands[0].score = 0.9;
        seen[1].hands[1].score = 0.9;
        assert_eq!(fuse(&[&seen[0], &seen[1]]).unwrap().frame.reason, "");
        assert_eq!(fuse(&[&a]).unwrap().frame.reason, a.reason);
        assert!(a.reason.starts_with("right: "), "{}", a.reason);
    }
}
