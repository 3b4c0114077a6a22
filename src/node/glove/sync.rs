//! Synchroniser of images and gloves: readings are interpolated to the images' stamps.

use std::collections::VecDeque;

use super::calibration::Taxels;
use crate::hand::Side;
use crate::message::Header;
use crate::sensor::streams::Stream;

/// Largest number of images that wait for readings.
const MAX_WAITING: usize = 500;
/// Time by which a stamp must lie before the newest one to mean that time restarted, s.
const RESTART: f64 = 1.0;

/// Limits of the synchroniser.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Limits {
    /// Longest time between two readings that are interpolated, s.
    pub(crate) max_gap: f64,
    /// Longest time that an image waits for a reading after it, s; a glove that is silent for longer is taken as absent.
    pub(crate) max_wait: f64,
}

/// Images that wait, and the latest readings of both gloves.
#[derive(Debug)]
pub(crate) struct GloveSync {
    limits: Limits,
    gloves: [Glove; 2],
    images: VecDeque<Waiting>,
    /// Images that were dropped because too many waited.
    pub(crate) dropped: u64,
}

/// Readings of one glove.
#[derive(Debug)]
struct Glove {
    stream: Stream<Vec<f32>>,
    /// True if the readings are newtons.
    is_newtons: bool,
    /// Time of the latest arrival, s.
    heard: f64,
}

/// An image that waits for readings.
#[derive(Debug)]
struct Waiting {
    header: Header,
    /// Time of its arrival, s.
    arrived: f64,
}

/// An image and the taxels of both gloves at its stamp, left first; `None` = unknown.
#[derive(Debug, PartialEq)]
pub(crate) struct Paired {
    pub(crate) header: Header,
    pub(crate) taxels: [Option<Taxels>; 2],
}

impl GloveSync {
    /// Creates a synchroniser that has heard nothing.
    pub(crate) fn new(limits: Limits) -> Self {
        let glove = || Glove { stream: Stream::default(), is_newtons: true, heard: f64::NEG_INFINITY };
        Self { limits, gloves: [glove(), glove()], images: VecDeque::new(), dropped: 0 }
    }

    /// Takes the taxels of a glove at a time; `now` is the time of arrival, s. Returns false if they are not newer than the last.
    pub(crate) fn push_reading(&mut self, side: Side, stamp: f64, taxels: Taxels, now: f64) -> bool {
        let glove = &mut self.gloves[side as usize];
        glove.heard = now;
        let (values, is_newtons) = match taxels {
            Taxels::Newtons(values) => (values, true),
            Taxels::Shares(values) => (values, false),
        };
        // Values of another meaning or of a time that restarted can't be interpolated with those before.
        if is_newtons != glove.is_newtons || glove.stream.newest().is_some_and(|newest| newest - stamp > RESTART) {
            glove.stream = Stream::default();
            glove.is_newtons = is_newtons;
        }
        glove.stream.push(stamp, values)
    }

    /// Takes an image; `now` is the time of arrival, s.
    pub(crate) fn push_image(&mut self, header: Header, now: f64) {
        if self.images.back().is_some_and(|last| last.header.stamp.secs() - header.stamp.secs() > RESTART) {
            self.dropped += self.images.len() as u64;
            self.images.clear();
        }
        if self.images.len() == MAX_WAITING {
            self.images.pop_front();
            self.dropped += 1;
        }
        self.images.push_back(Waiting { header, arrived: now });
    }

    /// Returns the next image whose readings are there, or for which none will come, in the order of arrival.
    pub(crate) fn pop(&mut self, now: f64) -> Option<Paired> {
        let Limits { max_gap, max_wait } = self.limits;
        let first = self.images.front()?;
        let stamp = first.header.stamp.secs();
        let is_over = now - first.arrived > max_wait;
        let waits = |glove: &Glove| {
            let is_heard = now - glove.heard <= max_wait || glove.stream.is_empty();
            is_heard && glove.stream.newest().is_none_or(|newest| newest < stamp)
        };
        // A glove that never sent anything is waited for as long as an image waits.
        if !is_over && self.gloves.iter().any(|glove| !glove.stream.is_empty() && waits(glove)) {
            return None;
        }
        if !is_over && self.gloves.iter().all(|glove| glove.stream.is_empty()) {
            return None;
        }
        let Waiting { header, .. } = self.images.pop_front()?;
        let taxels = self.gloves.each_mut().map(|glove| {
            let values = glove.stream.linear(stamp, max_gap)?;
            Some(if glove.is_newtons { Taxels::Newtons(values) } else { Taxels::Shares(values) })
        });
        self.gloves.iter_mut().for_each(|glove| glove.stream.forget(stamp - RESTART));
        Some(Paired { header, taxels })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::message::Time;

    fn image(secs: f64) -> Header {
        Header { stamp: Time::from_nanos((secs * 1e9).round() as i64), frame_id: "camera".into() }
    }

    fn newtons(value: f32) -> Taxels {
        Taxels::Newtons(vec![value])
    }

    fn sync() -> GloveSync {
        GloveSync::new(Limits { max_gap: 0.1, max_wait: 0.5 })
    }

    #[test]
    fn readings_are_interpolated_to_the_stamp_and_an_image_waits_for_the_next_one() {
        let mut sync = sync();
        sync.push_reading(Side::Right, 10.00, newtons(1.0), 10.0);
        sync.push_image(image(10.02), 10.03);
        assert_eq!(sync.pop(10.04), None);
        sync.push_reading(Side::Right, 10.08, newtons(5.0), 10.09);
        let paired = sync.pop(10.09).unwrap();
        assert_eq!((paired.header.stamp, paired.taxels[0].clone()), (image(10.02).stamp, None));
        let Some(Taxels::Newtons(values)) = &paired.taxels[1] else { panic!("{paired:?}") };
        assert!((values[0] - 2.0).abs() < 1e-5, "{values:?}");
        assert_eq!(sync.pop(10.1), None);
    }

    #[test]
    fn an_image_without_readings_around_it_is_unknown_after_the_wait() {
        let mut sync = sync();
        sync.push_image(image(1.0), 1.0);
        assert_eq!(sync.pop(1.4), None);
        assert_eq!(sync.pop(1.6).unwrap().taxels, [None, None]);
        // A gap in the readings, and a glove that fell silent.
        sync.push_reading(Side::Left, 2.0, newtons(1.0), 2.0);
        sync.push_reading(Side::Left, 2.5, newtons(1.0), 2.5);
        sync.push_image(image(2.2), 2.5);
        sync.push_image(image(2.6), 2.6);
        assert_eq!(sync.pop(2.6).unwrap().taxels, [None, None]);
        assert_eq!(sync.pop(2.7), None);
        assert_eq!(sync.pop(3.2).unwrap().taxels, [None, None]);
    }

    #[test]
    fn time_that_restarts_and_another_meaning_forget_what_was_before() {
        let mut sync = sync();
        assert!(sync.push_reading(Side::Left, 100.0, newtons(1.0), 1.0));
        assert!(!sync.push_reading(Side::Left, 99.9, newtons(1.0), 1.0));
        assert!(sync.push_reading(Side::Left, 5.0, newtons(2.0), 1.0));
        assert!(sync.push_reading(Side::Left, 5.01, Taxels::Shares(vec![0.5]), 1.0));
        sync.push_image(image(5.01), 1.0);
        assert_eq!(sync.pop(1.0).unwrap().taxels[0], Some(Taxels::Shares(vec![0.5])));
        sync.push_image(image(90.0), 1.0);
        sync.push_image(image(1.0), 1.0);
        assert_eq!(sync.dropped, 1);
    }
}
