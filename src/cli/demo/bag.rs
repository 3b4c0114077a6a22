//! Reads the demo's recording: images, predictions and truth by stamp.

use std::collections::BTreeMap;
use std::path::Path;

use anyhow::{Context, Result, bail};
use image::RgbImage;

use super::topics;
use crate::dataset::mcap::for_each_message;
use crate::message::{Header, Image, Message, TactileFrame, TactileTruth};

/// Messages of one stamp.
#[derive(Debug, Default)]
pub struct StampMessages {
    /// Camera image.
    pub image: Option<Image>,
    /// Message of the predictor.
    pub predicted: Option<TactileFrame>,
    /// Message of the simulator.
    pub truth: Option<TactileTruth>,
}

/// Recorded messages by stamp, nanoseconds.
pub type MessagesByStamp = BTreeMap<i128, StampMessages>;

/// Reads the `.mcap` file of a bag.
///
/// # Errors
/// If the file can't be read, or a message can't be decoded.
pub fn read(path: &Path) -> Result<MessagesByStamp> {
    let mut run = MessagesByStamp::new();
    let lost = for_each_message(path, |_, message| {
        match message.topic {
            topics::IMAGE => {
                let image = Image::from_cdr(message.payload)?;
                let stamp = stamp(&image.header);
                run.entry(stamp).or_default().image = Some(image);
            }
            topics::TACTILE => {
                let frame = TactileFrame::from_cdr(message.payload)?;
                let stamp = stamp(&frame.header);
                run.entry(stamp).or_default().predicted = Some(frame);
            }
            topics::TRUTH => {
                let truth = TactileTruth::from_cdr(message.payload)?;
                let stamp = stamp(&truth.frame.header);
                run.entry(stamp).or_default().truth = Some(truth);
            }
            _ => {}
        }
        Ok(())
    })?;
    if let Some(lost) = lost.first() {
        bail!("{}: damaged at byte {}: {}", path.display(), lost.offset, lost.reason);
    }
    Ok(run)
}

fn stamp(header: &Header) -> i128 {
    i128::from(header.stamp.sec) * 1_000_000_000 + i128::from(header.stamp.nanosec)
}

/// Converts an `rgb8` image message to a picture.
///
/// # Errors
/// If the encoding differs, or the data does not match the size.
pub fn picture(image: &Image) -> Result<RgbImage> {
    anyhow::ensure!(image.encoding == "rgb8", "{}: expected encoding rgb8, got {}", topics::IMAGE, image.encoding);
    RgbImage::from_raw(image.width, image.height, image.data.clone()).with_context(|| {
        let (got, width, height) = (image.data.len(), image.width, image.height);
        format!("{}: expected data of {width} x {height} pixels, got {got} bytes", topics::IMAGE)
    })
}
