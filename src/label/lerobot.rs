//! LeRobot data sets: touch as further columns, with their statistics.

mod columns;
mod output;

use std::path::Path;

use super::source::{Picture, Shot, Shots, Source, Unit};
use crate::dataset::lerobot::{Camera, Episode, LeRobot, Row};
use crate::dataset::video::Frames;
use crate::error::{Error, Result};

pub use output::about;

/// Prefix of the columns. Policies ignore what begins neither with `observation` nor with `action`.
pub const PREFIX: &str = "tactile";

/// A data set whose images are labelled: one unit per episode.
#[derive(Debug)]
pub struct LeRobotDataset {
    dataset: LeRobot,
    camera: String,
    kind: Camera,
    prefix: String,
    units: Vec<Unit>,
}

impl LeRobotDataset {
    /// Opens the data set at `root`. Images come from `camera`, or from the only one; columns are called `prefix.force` and
    /// so on.
    ///
    /// # Errors
    /// If it can't be read, there is no such camera or no single one, or there are such columns already.
    pub fn open(root: &Path, camera: Option<&str>, prefix: &str) -> Result<Self> {
        let dataset = LeRobot::open(root)?;
        let cameras = dataset.cameras();
        let names = || cameras.keys().map(String::as_str);
        let found = match (camera, cameras.len()) {
            (Some(camera), _) => cameras.iter().find(|(name, _)| *name == camera),
            (None, 1) => cameras.iter().next(),
            (None, 0) => return Err(Error::file(root, "has no camera: no feature of dtype video or image")),
            (None, _) => {
                let expected = "one camera, or one named by --camera";
                return Err(Error::value(root.display(), expected, names().collect::<Vec<_>>().join(", ")));
            }
        };
        let Some((camera, kind)) = found else {
            return Err(Error::unknown("camera", camera.unwrap_or_default(), names()));
        };
        if prefix.is_empty() || prefix.contains('/') {
            return Err(Error::value("prefix", "a name without slashes, which LeRobot refuses", prefix));
        }
        let dotted = format!("{prefix}.");
        let features = dataset.info["features"].as_object();
        if let Some(taken) = features.into_iter().flatten().map(|(name, _)| name).find(|name| name.starts_with(&dotted))
        {
            return Err(Error::file(root, format!("has a feature {taken} already; choose another --prefix")));
        }
        let unit =
            |episode: &Episode| Unit { name: format!("episode {}", episode.index), frames: Some(episode.length) };
        let units = dataset.episodes.iter().map(unit).collect();
        Ok(Self { camera: camera.clone(), kind: *kind, prefix: prefix.to_string(), units, dataset })
    }

    /// The camera's key.
    pub fn camera(&self) -> &str {
        &self.camera
    }

    /// The columns' prefix.
    pub fn prefix(&self) -> &str {
        &self.prefix
    }

    fn video_shots(&self, episode: &Episode, from: usize) -> Result<Shots<'_>> {
        let Some((path, start)) = self.dataset.video_file(&self.camera, episode) else {
            return Err(Error::file(&self.dataset.root, format!("episode {} has no video", episode.index)));
        };
        let half = 0.5 / self.dataset.fps;
        let mut rows = self.dataset.rows(episode, None, from)?.peekable();
        let first = rows.peek().and_then(|row| row.as_ref().ok()).map_or(0.0, |row| row.timestamp);
        // A video that lacks is damage: its frames get no label.
        let mut frames = match path.exists() {
            true => Some(Frames::open(&path, Some((start + first - half).max(0.0)))?.peekable()),
            false => None,
        };
        let shot = move |row: Result<Row>| {
            let row = match row {
                Ok(row) => row,
                Err(error) => {
                    return Shot { stamp_secs: f64::NAN, offset: None, picture: Err(error.to_string()), note: None };
                }
            };
            let wanted = start + row.timestamp;
            let mut picture = Err(format!("{}: no frame at {wanted:.3} s", path.display()));
            while let Some(frame) = frames.as_mut().and_then(|frames| {
                frames.next_if(|frame| frame.as_ref().map_or(true, |(stamp, _)| *stamp <= wanted + half))
            }) {
                match frame {
                    Ok((stamp, image)) if (stamp - wanted).abs() <= half => picture = Ok(Picture::Pixels(image)),
                    Ok(_) => continue,
                    Err(error) => picture = Err(error.to_string()),
                }
                break;
            }
            Shot { stamp_secs: row.timestamp, offset: None, picture, note: None }
        };
        Ok(Box::new(rows.map(shot)))
    }
}

impl Source for LeRobotDataset {
    fn units(&self) -> &[Unit] {
        &self.units
    }

    fn shots(&self, unit: usize, from: usize) -> Result<Shots<'_>> {
        let episode = &self.dataset.episodes[unit];
        if self.kind == Camera::Video {
            return self.video_shots(episode, from);
        }
        let rows = self.dataset.rows(episode, Some(&self.camera), from)?;
        Ok(Box::new(rows.map(|row| match row {
            Ok(row) => {
                let picture = row.image.map(Picture::File).ok_or_else(|| "the row has no image".to_string());
                Shot { stamp_secs: row.timestamp, offset: None, picture, note: None }
            }
            Err(error) => Shot { stamp_secs: f64::NAN, offset: None, picture: Err(error.to_string()), note: None },
        })))
    }
}
