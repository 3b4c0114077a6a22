//! Any source as a bag: its images, and touch beside them.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;

use super::bag::{self, tactile_frame};
use super::output::{Journals, Output};
use super::provenance::NAME;
use super::source::{Picture, Shot, Source};
use super::summary::About;
use super::to_store::remove;
use crate::dataset::mcap::BagWriter;
use crate::error::{Error, Result};
use crate::message::{CompressedImage, Header, Image, Message, TactileFrame, Time};

/// Topic of raw images.
const RAW: &str = "/camera/image_raw";
/// Topic of images in PNG or JPEG files.
const COMPRESSED: &str = "/camera/image_raw/compressed";
/// The frame that images and labels are in.
const FRAME: &str = "camera";

/// Writes a bag.
pub struct ToBag {
    /// Where images come from.
    pub source: Arc<dyn Source>,
    /// Topic of the labels.
    pub labels_topic: String,
}

impl Output for ToBag {
    fn assemble(&self, journals: &Journals, about: &mut About, at: &Path, out: &Path) -> Result<()> {
        remove(at)?;
        let name = out.file_name().unwrap_or_default().to_string_lossy();
        let mut bag = BagWriter::create_named(at, &format!("{name}_0.mcap"))?;
        bag.add_topic(&self.labels_topic, TactileFrame::TYPE, &TactileFrame::schema(), false)?;
        let (mut sequence, mut topics) = (0, [false; 2]);
        for unit in 0..self.source.units().len() {
            let mut labels = journals.labels(unit)?;
            for shot in self.source.shots(unit, 0)? {
                let Some(label) = labels.next() else {
                    let name = &self.source.units()[unit].name;
                    return Err(Error::value(name, "the images that were labelled", "more of them"));
                };
                let label = label?;
                let nanos = (label.stamp_secs * 1e9).round();
                let stamp = Time::from_nanos(if nanos.is_finite() { nanos as i64 } else { 0 });
                let header = Header { stamp, frame_id: FRAME.into() };
                let time = stamp.nanos().max(0) as u64;
                write_image(&mut bag, shot, &header, time, &mut topics)?;
                let frame = TactileFrame { sequence, ..tactile_frame(header, &label, about)? };
                bag.write(&self.labels_topic, &frame.to_cdr(), time, time)?;
                sequence += 1;
            }
        }
        let json = serde_json::to_string(about).map_err(|e| Error::value(NAME, "JSON", e))?;
        bag.write_metadata(NAME, BTreeMap::from([("about".to_string(), json)]))?;
        bag.finish()
    }

    fn about(&self, out: &Path) -> Option<About> {
        bag::about(out)
    }
}

/// Writes an image that can be read; `topics` says which of the two are there.
fn write_image(bag: &mut BagWriter, shot: Shot, header: &Header, time: u64, topics: &mut [bool; 2]) -> Result<()> {
    let header = header.clone();
    let mut add = |index: usize, bag: &mut BagWriter| -> Result<&'static str> {
        let topic = [RAW, COMPRESSED][index];
        if !std::mem::replace(&mut topics[index], true) {
            match index {
                0 => bag.add_topic(topic, Image::TYPE, &Image::schema(), false)?,
                _ => bag.add_topic(topic, CompressedImage::TYPE, &CompressedImage::schema(), false)?,
            }
        }
        Ok(topic)
    };
    let (topic, payload) = match shot.picture {
        Err(_) => return Ok(()),
        Ok(Picture::Pixels(image)) => {
            let (width, height) = image.dimensions();
            let (encoding, step, data) = ("rgb8".into(), 3 * width, image.into_raw());
            (add(0, bag)?, Image { header, height, width, encoding, is_bigendian: 0, step, data }.to_cdr())
        }
        Ok(Picture::Raw(image)) => (add(0, bag)?, Image { header, ..image }.to_cdr()),
        Ok(Picture::File(data)) => {
            let format = if data.starts_with(b"\x89PNG") { "png" } else { "jpeg" };
            (add(1, bag)?, CompressedImage { header, format: format.into(), data }.to_cdr())
        }
    };
    bag.write(topic, &payload, time, time)
}
