//! Recordings with their touch for the viewer Rerun: in a file that it opens, or sent to one that runs.

use std::path::Path;
use std::time::Duration;

use glam::Vec3;
use rerun::{
    Clear, Color, EncodedImage, Mesh3D, RecordingStream, RecordingStreamBuilder, Scalars, TriangleIndices,
    ViewCoordinates,
};

use super::clip::Clip;
use super::clock::Clock;
use super::moment::{Moment, known, totals};
use super::place::side_by_side;
use super::publish::publish;
use crate::error::{Error, Result};
use crate::hand::{HandModel, HandParams, Region, Side};
use crate::image::jpeg;
use crate::render::force_colors;
use crate::tactile::TactileField;

/// Name of the application in the viewer.
const APPLICATION: &str = "egotac";
/// JPEG quality of the images, 1 to 100.
const JPEG_QUALITY: u8 = 85;
/// Number of images after which all data are sent, so that little waits in memory.
const FLUSHED_IMAGES: usize = 64;
/// Longest wait for a file or a viewer to take the data.
const PATIENCE: Duration = Duration::from_secs(30);
/// Distance of the true hands below the others, m.
const BELOW: f32 = 0.26;

/// Writes the images of `clip` with their touch as a file for Rerun: images, coloured hands, forces over time, and the truth where
/// there is some. The file appears when it is complete. Calls `progress` after each image. Returns the number of images.
///
/// # Errors
/// If the file can't be written, or the clip can't be read.
pub fn write_rerun(clip: &mut Clip, path: &Path, progress: impl FnMut()) -> Result<usize> {
    publish(path, |folder| {
        let file = folder.join("touch.rrd");
        let stream = recording(clip).save(&file).map_err(|error| Error::file(path, error))?;
        let frames = Rerun::new(clip, stream, &path.display().to_string())?.write(clip, progress)?;
        Ok((file, frames))
    })
}

/// Sends the images of `clip` with their touch, as [`write_rerun`] writes them, to the viewer at `address`, such as
/// `rerun+http://127.0.0.1:9876/proxy`. Calls `progress` after each image. Returns the number of images.
///
/// # Errors
/// If no viewer answers there, or the clip can't be read.
pub fn send_rerun(clip: &mut Clip, address: &str, progress: impl FnMut()) -> Result<usize> {
    let stream = recording(clip).connect_grpc_opts(address).map_err(|error| Error::file(address, error))?;
    Rerun::new(clip, stream, address)?.write(clip, progress)
}

/// Starts the recording of a clip. Equal clips have equal names, so that a viewer shows them once.
fn recording(clip: &Clip) -> RecordingStreamBuilder {
    RecordingStreamBuilder::new(APPLICATION).recording_id(clip.about().name.as_str()).send_properties(false)
}

/// A recording that is being written.
struct Rerun<'a> {
    stream: RecordingStream,
    /// File or address, for errors.
    target: &'a str,
    hands: [HandModel; 2],
    regions: [Vec<Region>; 2],
    /// Force at the dark end of the colours, N.
    scale: f32,
    clock: Clock,
    /// Poses in which the hands were drawn last; None = not drawn yet.
    drawn: [Option<HandParams>; 2],
}

impl<'a> Rerun<'a> {
    /// Starts a recording, and makes sure that it arrives at `target`.
    fn new(clip: &Clip, stream: RecordingStream, target: &'a str) -> Result<Self> {
        // The time of writing says nothing about the recording.
        stream.set_log_time_enabled(false);
        stream.set_log_tick_enabled(false);
        let hands = clip.hands().clone();
        let regions = hands.each_ref().map(HandModel::regions);
        let rerun = Self {
            stream,
            target,
            hands,
            regions,
            scale: clip.about().scale,
            clock: Clock::default(),
            drawn: [None, None],
        };
        let log = |entity: &str, what: &dyn rerun::AsComponents| {
            rerun.stream.log_static(entity, what).map_err(|error| Error::file(target, error))
        };
        log("/", &ViewCoordinates::RDF())?;
        let truths: &[&str] = if clip.about().truth { &["", "truth/"] } else { &[""] };
        for (prefix, model) in truths.iter().flat_map(|prefix| rerun.hands.iter().map(move |model| (prefix, model))) {
            let faces = model.faces.iter().map(|face| TriangleIndices::from(*face));
            log(&format!("{prefix}{}", model.side.name()), &Mesh3D::update_fields().with_triangle_indices(faces))?;
        }
        rerun.flush()?;
        Ok(rerun)
    }

    fn write(mut self, clip: &mut Clip, mut progress: impl FnMut()) -> Result<usize> {
        let frames = clip.each(|moment| {
            self.moment(moment)?;
            if moment.frame % FLUSHED_IMAGES == FLUSHED_IMAGES - 1 {
                self.flush()?;
            }
            progress();
            Ok(())
        })?;
        self.flush()?;
        Ok(frames)
    }

    fn moment(&mut self, moment: &Moment) -> Result<()> {
        self.stream.set_time_sequence("frame", moment.frame as i64);
        self.stream.set_duration_secs("time", self.clock.nanos(moment.stamp_secs) as f64 / 1e9);
        match &moment.image {
            Ok(image) => {
                let image = EncodedImage::new(jpeg(image, JPEG_QUALITY)?).with_media_type(rerun::MediaType::JPEG);
                self.log("image", &image)?;
            }
            Err(_) => self.log("image", &Clear::flat())?,
        }
        for side in Side::BOTH {
            self.hand(moment, side)?;
            self.log_known(&format!("presence/{}", side.name()), moment.presence[side as usize].and_then(known))?;
        }
        self.log_known("familiarity", moment.familiarity.and_then(known))?;
        for (prefix, field) in [("", Some(&moment.touch)), ("truth/", moment.truth.as_ref())] {
            if let Some(field) = field {
                self.forces(prefix, field)?;
            }
        }
        Ok(())
    }

    /// Writes the places of a hand's vertices if they differ from the last ones, and those of the truth.
    fn hand(&mut self, moment: &Moment, side: Side) -> Result<()> {
        let params = moment.hands[side as usize].clone().unwrap_or_default();
        if self.drawn[side as usize].as_ref() == Some(&params) {
            return Ok(());
        }
        let vertices: Vec<[f32; 3]> = side_by_side(&self.hands[side as usize], &params)
            .into_iter()
            .map(|vertex: Vec3| vertex.to_array())
            .collect();
        self.log(side.name(), &Mesh3D::update_fields().with_vertex_positions(vertices.iter().copied()))?;
        if moment.truth.is_some() {
            // Below the other one: y points down.
            let below = vertices.into_iter().map(|[x, y, z]| [x, y + BELOW, z]);
            self.log(&format!("truth/{}", side.name()), &Mesh3D::update_fields().with_vertex_positions(below))?;
        }
        self.drawn[side as usize] = Some(params);
        Ok(())
    }

    /// Writes the colours of both hands and their forces, in total and by region.
    fn forces(&self, prefix: &str, field: &TactileField) -> Result<()> {
        let regions = field.region_forces(&self.regions);
        for (side, total) in Side::BOTH.into_iter().zip(totals(field)) {
            let name = side.name();
            let colors = force_colors(&field.force[side.range()], self.scale);
            let colors = colors.into_iter().map(|color| Color::from_rgb(color[0], color[1], color[2]));
            self.log(&format!("{prefix}{name}"), &Mesh3D::update_fields().with_vertex_colors(colors))?;
            self.log_known(&format!("{prefix}force/{name}"), total)?;
            for (region, force) in Region::ALL.iter().zip(&regions[side as usize * Region::ALL.len()..]) {
                self.log_known(&format!("{prefix}regions/{name}/{}", region.name()), known(*force))?;
            }
        }
        Ok(())
    }

    /// Writes a value over time; an unknown one ends the curve until the next known one.
    fn log_known(&self, entity: &str, value: Option<f32>) -> Result<()> {
        match value {
            Some(value) => self.log(entity, &Scalars::single(f64::from(value))),
            None => self.log(entity, &Clear::flat()),
        }
    }

    fn log(&self, entity: &str, what: &dyn rerun::AsComponents) -> Result<()> {
        self.stream.log(entity, what).map_err(|error| Error::file(self.target, error))
    }

    /// Waits until all data are written.
    fn flush(&self) -> Result<()> {
        self.stream.flush_with_timeout(PATIENCE).map_err(|error| Error::file(self.target, error))
    }
}
