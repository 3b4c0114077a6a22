//! Recordings with their touch as an MCAP file that Foxglove shows with the layout `launch/foxglove.json`.

use std::path::Path;

use super::clip::Clip;
use super::clock::Clock;
use super::markers::surface;
use super::moment::{Moment, known};
use super::picture::Picture;
use super::place::side_by_side;
use super::publish::publish;
use crate::dataset::mcap::BagWriter;
use crate::error::Result;
use crate::hand::{HandModel, HandParams, Region};
use crate::image::jpeg;
use crate::message::{CompressedImage, Header, MarkerArray, Message, TactileFrame, TactileRegions, TactileTruth, Time};
use crate::tactile::{TactileField, Validity};

/// Extension of the file's name.
pub const SCENE_EXTENSION: &str = "mcap";
/// Height of the pictures, pixels.
const HEIGHT: u32 = 480;
/// JPEG quality of the pictures, 1 to 100.
const JPEG_QUALITY: u8 = 85;
/// Frame of the hands, as node `predictor` names it: they are drawn side by side, and not where the camera sees them.
const FRAME: &str = "hand_rest";

/// Topics, as node `predictor` and node `simulator` name them.
const PICTURE: &str = "/predictor/overlay/compressed";
const MARKERS: &str = "/predictor/markers";
const TACTILE: &str = "/predictor/tactile";
const REGIONS: &str = "/predictor/regions";
const TRUTH: &str = "/truth/tactile";

/// Writes the images of `clip` with their touch as an MCAP file: pictures, coloured hands, touch of vertices and regions, and the
/// truth where there is some. The file appears when it is complete. Calls `progress` after each image. Returns the number of
/// images.
///
/// # Errors
/// If the file can't be written, or the clip can't be read.
pub fn write_scene(clip: &mut Clip, path: &Path, mut progress: impl FnMut()) -> Result<usize> {
    publish(path, |folder| {
        let (bag, name) = (folder.join("bag"), "scene.mcap");
        let mut scene = Scene::create(clip, BagWriter::create_named(&bag, name)?)?;
        let frames = clip.each(|moment| {
            scene.write(moment)?;
            progress();
            Ok(())
        })?;
        scene.writer.finish()?;
        Ok((bag.join(name), frames))
    })
}

/// The file during writing.
struct Scene {
    writer: BagWriter,
    hands: [HandModel; 2],
    regions: [Vec<Region>; 2],
    picture: Picture,
    /// Force at the dark end of the colours, N.
    scale: f32,
    /// Origin of the touch.
    touch: String,
    clock: Clock,
}

impl Scene {
    fn create(clip: &Clip, mut writer: BagWriter) -> Result<Self> {
        let mut add = |topic, type_name, schema: String| writer.add_topic(topic, type_name, &schema, false);
        add(PICTURE, CompressedImage::TYPE, CompressedImage::schema())?;
        add(MARKERS, MarkerArray::TYPE, MarkerArray::schema())?;
        add(TACTILE, TactileFrame::TYPE, TactileFrame::schema())?;
        add(REGIONS, TactileRegions::TYPE, TactileRegions::schema())?;
        if clip.about().truth {
            add(TRUTH, TactileTruth::TYPE, TactileTruth::schema())?;
        }
        let (hands, scale, touch) = (clip.hands().clone(), clip.about().scale, clip.about().touch.clone());
        let picture = Picture::new(hands.clone(), scale, HEIGHT);
        let regions = hands.each_ref().map(HandModel::regions);
        Ok(Self { writer, hands, regions, picture, scale, touch, clock: Clock::default() })
    }

    fn write(&mut self, moment: &Moment) -> Result<()> {
        let nanos = self.clock.nanos(moment.stamp_secs);
        let header = Header { stamp: Time::from_nanos(nanos), frame_id: String::new() };
        let format = "jpeg".to_owned();
        let data = jpeg(&self.picture.draw(moment), JPEG_QUALITY)?;
        self.put(PICTURE, &CompressedImage { header: header.clone(), format, data }, nanos)?;
        let at_rest = Header { frame_id: FRAME.into(), ..header.clone() };
        let marker = |(model, params): (&HandModel, &Option<HandParams>)| {
            let vertices = side_by_side(model, params.as_ref().unwrap_or(&HandParams::default()));
            surface(at_rest.clone(), &moment.touch, &vertices, model, self.scale)
        };
        let markers = self.hands.iter().zip(&moment.hands).map(marker).collect();
        self.put(MARKERS, &MarkerArray { markers }, nanos)?;
        let frame = self.frame(header.clone(), &moment.touch, moment.frame)?;
        let mut frame = TactileFrame { warming_up: moment.warming_up, reason: moment.reason.clone(), ..frame };
        frame.familiarity = moment.familiarity.and_then(known).unwrap_or(f32::NAN);
        for (hand, presence) in frame.hands.iter_mut().zip(moment.presence) {
            hand.score = presence.and_then(known).unwrap_or(f32::NAN);
        }
        self.put(REGIONS, &TactileRegions::from_frame(&frame, &self.regions)?, nanos)?;
        self.put(TACTILE, &frame, nanos)?;
        if let Some(truth) = &moment.truth {
            let frame = self.frame(header, truth, moment.frame)?;
            self.put(TRUTH, &TactileTruth::new(frame, Validity::Valid), nanos)?;
        }
        Ok(())
    }

    fn frame(&self, header: Header, field: &TactileField, index: usize) -> Result<TactileFrame> {
        let frame = TactileFrame::from_field(header, field)?;
        Ok(TactileFrame { sequence: index as u64, model_id: self.touch.clone(), ..frame })
    }

    fn put(&mut self, topic: &str, message: &impl Message, nanos: i64) -> Result<()> {
        let nanos = nanos.unsigned_abs();
        self.writer.write(topic, &message.to_cdr(), nanos, nanos)
    }
}
