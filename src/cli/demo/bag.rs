//! Reads the demo's own recording back: images, predictions and truth by stamp.

use std::collections::BTreeMap;
use std::path::Path;

use anyhow::{Context, Result, bail};
use image::RgbImage;

use super::topics;
use crate::dataset::mcap::for_each_message;
use crate::message::{Header, Image, Message, TactileFrame, TactileTruth};

/// Everything recorded for one stamp.
#[derive(Debug, Default)]
pub struct Moment {
    /// The camera image, as published.
    pub image: Option<Image>,
    /// The predictor's message.
    pub predicted: Option<TactileFrame>,
    /// The simulator's message.
    pub truth: Option<TactileTruth>,
}

/// A recorded run by stamp, nanoseconds.
pub type Run = BTreeMap<i128, Moment>;

/// Reads the `.mcap` file of a bag.
///
/// # Errors
/// If the file can't be read or a message is not what its topic says.
pub fn read(path: &Path) -> Result<Run> {
    let mut run = Run::new();
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

/// The picture of a published `rgb8` image.
///
/// # Errors
/// If its size and data don't agree or it has another encoding.
pub fn picture(image: &Image) -> Result<RgbImage> {
    anyhow::ensure!(image.encoding == "rgb8", "{}: expected encoding rgb8, got {}", topics::IMAGE, image.encoding);
    RgbImage::from_raw(image.width, image.height, image.data.clone()).with_context(|| {
        format!("{}: {} bytes are not {} x {} pixels", topics::IMAGE, image.data.len(), image.width, image.height)
    })
}
