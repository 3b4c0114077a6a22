//! Recordings with their touch as an MCAP file that Foxglove shows with the layout `launch/foxglove.json`.

use std::path::Path;

use glam::Vec3;

use super::clip::Clip;
use super::markers::surface;
use super::moment::{Moment, known};
use super::picture::Picture;
use super::place::wrist_frame;
use crate::dataset::mcap::BagWriter;
use crate::error::{Error, Result};
use crate::hand::{HandModel, HandParams, Region, Side};
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
/// Distance of a wrist from the middle between both hands, m.
const APART: f32 = 0.12;
/// Distance of the wrists below the middle of the hands, m.
const BELOW: f32 = 0.09;
/// Time from the last image of an episode to the first one of the next, s, where stamps begin anew.
const PAUSE_SECS: f64 = 1.0;

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
    let folder = path.parent().filter(|parent| !parent.as_os_str().is_empty()).unwrap_or(Path::new("."));
    std::fs::create_dir_all(folder).map_err(Error::io(folder))?;
    let unfinished = tempfile::Builder::new().prefix(".foxglove-").tempdir_in(folder).map_err(Error::io(folder))?;
    let (bag, name) = (unfinished.path().join("bag"), "scene.mcap");
    let mut scene = Scene::create(clip, BagWriter::create_named(&bag, name)?)?;
    let mut player = clip.player();
    let mut frames = 0;
    while let Some(moment) = player.moment(frames)? {
        scene.write(&moment)?;
        frames += 1;
        progress();
    }
    if frames == 0 {
        return Err(Error::file(path, "would be empty: the recording has no image"));
    }
    scene.writer.finish()?;
    std::fs::rename(bag.join(name), path).map_err(Error::io(path))?;
    Ok(frames)
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
            let vertices = placed(model, params.as_ref().unwrap_or(&HandParams::default()));
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

/// Returns the vertices of a hand beside the other one, m, with the axes of a camera (x right, y down, z to the front): palms to
/// the viewer, fingers up, the right hand on the right.
fn placed(model: &HandModel, params: &HandParams) -> Vec<Vec3> {
    let x = if model.side == Side::Right { APART } else { -APART };
    let place = |vertex: Vec3| Vec3::new(vertex.x + x, BELOW - vertex.y, -vertex.z);
    wrist_frame(model, &model.forward(params)).into_iter().map(place).collect()
}

/// A time that never goes back: stamps of a recording may begin anew in each episode.
#[derive(Debug, Default)]
struct Clock {
    /// Time that is added to stamps, s.
    shift: f64,
    /// Time of the last image, s.
    last: Option<f64>,
}

impl Clock {
    /// Returns the time of an image with this stamp, ns.
    fn nanos(&mut self, stamp_secs: f64) -> i64 {
        let stamp = if stamp_secs.is_finite() { stamp_secs } else { 0.0 };
        match self.last {
            None => self.shift = (-stamp).max(0.0),
            Some(last) if stamp + self.shift <= last => self.shift = last + PAUSE_SECS - stamp,
            Some(_) => {}
        }
        self.last = Some(stamp + self.shift);
        ((stamp + self.shift) * 1e9).round() as i64
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn time_goes_on_where_stamps_begin_anew() {
        let mut clock = Clock::default();
        let stamps = [0.0, 0.5, 0.0, 0.5, 7.0, 1.0].map(|stamp| clock.nanos(stamp));
        assert_eq!(stamps.map(|nanos| nanos / 100_000_000), [0, 5, 15, 20, 85, 95]);
        let mut clock = Clock::default();
        assert_eq!([-3.0, -2.5].map(|stamp| clock.nanos(stamp)), [0, 500_000_000]);
    }

    #[cfg(feature = "ros")]
    #[test]
    fn hands_at_rest_lie_where_the_node_draws_them() {
        let models = Side::BOTH.map(HandModel::builtin);
        for (model, node) in models.iter().zip(crate::node::placed_hand::rest_hands(&models)) {
            let ours = placed(model, &HandParams::default());
            assert!(ours.iter().zip(&node.posed.vertices).all(|(a, b)| a.distance(*b) < 1e-6));
        }
    }
}
