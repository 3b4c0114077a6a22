//! New bags from the images and labels of any source.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;

use super::BagWriter;
use super::labels::{read_info, tactile_frame};
use crate::dataset::base_name;
use crate::dataset::copy::remove;
use crate::dataset::label_info::LabelInfo;
use crate::dataset::labels::{LabelOutput, SourceLabels, next_label};
use crate::dataset::provenance::PROVENANCE_KEY;
use crate::dataset::source::{EncodedImage, ImageSource};
use crate::error::{Error, Result};
use crate::message::{CompressedImage, Header, Image, Message, TactileFrame, Time};

/// Topic of raw images.
const RAW: &str = "/camera/image_raw";
/// Topic of images in PNG or JPEG files.
const COMPRESSED: &str = "/camera/image_raw/compressed";
/// Frame id of images and labels.
const FRAME: &str = "camera";

/// Writes images and labels into a new bag.
pub struct BagOutput {
    /// Source of the images.
    pub source: Arc<dyn ImageSource>,
    /// Topic of the labels.
    pub labels_topic: String,
}

impl LabelOutput for BagOutput {
    fn assemble(&self, labels: &dyn SourceLabels, info: &mut LabelInfo, at: &Path, out: &Path) -> Result<()> {
        remove(at)?;
        let mut bag = BagWriter::create_named(at, &format!("{}_0.mcap", base_name(out)))?;
        bag.add_topic(&self.labels_topic, TactileFrame::TYPE, &TactileFrame::schema(), false)?;
        let mut images = ImageTopics::default();
        let mut sequence = 0;
        for (index, unit) in self.source.units().iter().enumerate() {
            let mut labels = labels.labels(index)?;
            for frame in self.source.frames(index, 0)? {
                let frame = frame?;
                let label = next_label(&mut labels, &unit.name)?;
                let nanos = (label.stamp_secs * 1e9).round();
                let stamp = Time::from_nanos(if nanos.is_finite() { nanos as i64 } else { 0 });
                let header = Header { stamp, frame_id: FRAME.into() };
                let time = stamp.nanos().max(0) as u64;
                if let Ok(image) = frame.image {
                    images.write(&mut bag, image, header.clone(), time)?;
                }
                let frame = TactileFrame { sequence, ..tactile_frame(header, &label, info)? };
                bag.write(&self.labels_topic, &frame.to_cdr(), time, time)?;
                sequence += 1;
            }
        }
        let json = serde_json::to_string(info).map_err(|e| Error::value(PROVENANCE_KEY, "JSON", e))?;
        bag.write_metadata(PROVENANCE_KEY, BTreeMap::from([("about".to_string(), json)]))?;
        bag.finish()
    }

    fn holds_keypoints(&self) -> bool {
        false
    }

    fn info(&self, out: &Path) -> Option<LabelInfo> {
        read_info(out)
    }
}

/// Image topics that the bag has so far; each is added with its first message.
#[derive(Default)]
struct ImageTopics {
    raw: bool,
    compressed: bool,
}

impl ImageTopics {
    fn write(&mut self, bag: &mut BagWriter, image: EncodedImage, header: Header, time: u64) -> Result<()> {
        let raw = match image {
            EncodedImage::File(data) => {
                if !std::mem::replace(&mut self.compressed, true) {
                    bag.add_topic(COMPRESSED, CompressedImage::TYPE, &CompressedImage::schema(), false)?;
                }
                let format = if data.starts_with(b"\x89PNG") { "png" } else { "jpeg" }.into();
                return bag.write(COMPRESSED, &CompressedImage { header, format, data }.to_cdr(), time, time);
            }
            EncodedImage::Pixels(image) => Image::from_rgb(header, &image),
            EncodedImage::Raw(image) => Image { header, ..image },
        };
        if !std::mem::replace(&mut self.raw, true) {
            bag.add_topic(RAW, Image::TYPE, &Image::schema(), false)?;
        }
        bag.write(RAW, &raw.to_cdr(), time, time)
    }
}
