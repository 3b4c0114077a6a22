//! LeRobot data sets as image sources, one unit per episode.

use std::path::Path;

use serde_json::Value;

use super::policy_input::{ColumnRole, KNOWN, LabelColumn};
use super::prefix::prefix;
use super::{Camera, Episode, LeRobot, Row};
use crate::dataset::identity::InputFiles;
use crate::dataset::source::{EncodedImage, ImageSource, SourceFrame, SourceFrames, Unit};
use crate::dataset::video::VideoFrames;
use crate::error::{Error, Result};
use crate::hand::Region;

/// Default prefix of the new columns. Policies ignore names that begin neither with `observation` nor with `action`.
pub const PREFIX: &str = "tactile";

/// Input of policies that labels become.
#[derive(Debug)]
pub(super) struct PolicyInput {
    /// Feature.
    pub name: &'static str,
    /// Number of elements that the data set has in it.
    pub base: usize,
    /// Names of these elements.
    pub names: Vec<String>,
}

/// A data set whose images are labelled.
#[derive(Debug)]
pub struct LeRobotDataset {
    pub(super) dataset: LeRobot,
    camera: String,
    kind: Camera,
    pub(super) prefix: String,
    /// Columns of labels that are written, or that make up the input of policies.
    pub(super) chosen: Vec<LabelColumn>,
    /// Input of policies that the labels become; None = they are columns that policies ignore.
    pub(super) input: Option<PolicyInput>,
    /// Regions of MANO's vertices, left hand first; None = unknown.
    pub(super) mano_regions: Option<[Vec<Region>; 2]>,
    /// True if the data set has the columns already, and they are replaced.
    pub(super) replaces: bool,
    units: Vec<Unit>,
}

impl LeRobotDataset {
    /// Opens the data set at `root`. Images come from `camera`, by default the only one; the new columns are named
    /// `prefix.force` and so on.
    ///
    /// # Errors
    /// If it can't be read, `camera` does not exist or is ambiguous, or columns with this prefix exist already.
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
        Ok(Self {
            camera: camera.clone(),
            kind: *kind,
            prefix: prefix.to_string(),
            chosen: LabelColumn::DEFAULT.to_vec(),
            input: None,
            mano_regions: None,
            replaces: false,
            units,
            dataset,
        })
    }

    /// Opens a labelled data set whose columns of labels are to be replaced.
    ///
    /// # Errors
    /// If it can't be read, or has no labels.
    pub fn labelled(root: &Path) -> Result<Self> {
        let dataset = LeRobot::open(root)?;
        let prefix = prefix(&dataset)?.to_string();
        if let Some(name) = input_with_labels(&dataset) {
            let problem = format!("labels are a part of {name}, which can't be carried over");
            return Err(Error::file(
                root,
                format!("{problem}: label the recording anew with --mano-left and --mano-right"),
            ));
        }
        let (camera, units, chosen) = (String::new(), Vec::new(), LabelColumn::DEFAULT.to_vec());
        let (kind, input, mano_regions) = (Camera::Rows, None, None);
        Ok(Self { camera, kind, prefix, chosen, input, mano_regions, replaces: true, units, dataset })
    }

    /// True for a column, or a statistic of one, that is replaced.
    pub(super) fn is_replaced(&self, name: &str) -> bool {
        let name = name.strip_prefix("stats/").unwrap_or(name);
        let name = name.split_once('/').map_or(name, |(column, _)| column);
        if self.is_extended(name) {
            return true;
        }
        let own = ["force", "contact", "region_force", "total", "certainty"];
        let rest = name.strip_prefix(&self.prefix).and_then(|rest| rest.strip_prefix('.'));
        self.replaces && rest.is_some_and(|column| own.contains(&column))
    }

    /// True for a column to whose values labels are appended.
    pub(super) fn is_extended(&self, name: &str) -> bool {
        self.input.as_ref().is_some_and(|input| input.base > 0 && input.name == name)
    }

    /// Returns the data set with a choice of columns, and their role for policies.
    ///
    /// # Errors
    /// If the data set has no state that they could be appended to, has an environment state already, or is labelled.
    pub fn with_columns(mut self, columns: &[LabelColumn], role: ColumnRole) -> Result<Self> {
        let root = &self.dataset.root;
        if !columns.is_empty() {
            self.chosen = columns.to_vec();
        }
        if let Some(twice) = (1..self.chosen.len()).find(|at| self.chosen[..*at].contains(&self.chosen[*at])) {
            return Err(Error::value("columns", "each column once", format!("{} twice", self.chosen[twice].name())));
        }
        let Some(name) = role.feature() else { return Ok(self) };
        if columns.is_empty() {
            self.chosen = vec![LabelColumn::RegionForce];
        }
        if let Some(taken) = input_with_labels(&self.dataset) {
            return Err(Error::file(
                root,
                format!("feature {taken} holds labels already; label the original data set"),
            ));
        }
        let feature = self.dataset.info["features"].get(name);
        self.input = Some(match (role, feature) {
            (ColumnRole::EnvironmentState, None) => PolicyInput { name, base: 0, names: Vec::new() },
            (ColumnRole::EnvironmentState, Some(_)) => {
                return Err(Error::file(root, format!("has a feature {name} already; take --as state")));
            }
            (_, Some(feature)) => {
                let numbers = ["float32", "float64"].iter().any(|dtype| feature["dtype"] == *dtype);
                let shape = feature["shape"].as_array().filter(|shape| numbers && shape.len() == 1);
                let base = shape.and_then(|shape| shape[0].as_u64()).filter(|base| (1..1 << 16).contains(base));
                let Some(base) = base.map(|base| base as usize) else {
                    let expected = "expected floats of shape [N], to append labels to";
                    return Err(Error::file(root, format!("feature {name}: {expected}, got {feature}")));
                };
                PolicyInput { name, base, names: names_of(feature, name, base) }
            }
            (_, None) => {
                return Err(Error::file(
                    root,
                    format!("has no feature {name} to append labels to; take --as environment_state"),
                ));
            }
        });
        Ok(self)
    }

    /// Returns the data set with the regions of MANO's vertices, for the forces of regions on that topology.
    #[must_use]
    pub fn with_mano_regions(self, mano_regions: Option<[Vec<Region>; 2]>) -> Self {
        Self { mano_regions, ..self }
    }

    /// Returns the camera's key.
    pub fn camera(&self) -> &str {
        &self.camera
    }

    /// Describes the new columns: their prefix, and what differs from the usual ones.
    pub fn columns_text(&self) -> String {
        let chosen: Vec<&str> = self.chosen.iter().map(|column| column.name()).collect();
        match &self.input {
            Some(input) => format!("{}; {} in {}", self.prefix, chosen.join(", "), input.name),
            None if self.chosen == LabelColumn::DEFAULT => self.prefix.clone(),
            None => format!("{}: {}", self.prefix, chosen.join(", ")),
        }
    }

    /// Returns the prefix of the new columns.
    pub fn prefix(&self) -> &str {
        &self.prefix
    }

    /// Returns the rows of an episode with the video frames nearest to their times.
    fn video_frames(&self, episode: &Episode, from: usize) -> Result<SourceFrames<'_>> {
        let Some((path, start)) = self.dataset.video_file(&self.camera, episode)? else {
            return Err(Error::file(&self.dataset.root, format!("episode {} has no video", episode.index)));
        };
        // A video frame belongs to a row if their times differ by at most half a frame.
        let half = 0.5 / self.dataset.fps;
        let mut rows = self.dataset.rows(episode, None, from)?.peekable();
        let first = rows.peek().and_then(|row| row.as_ref().ok()).map_or(0.0, |row| row.timestamp);
        // A missing video is damage: the rows get no label.
        let mut frames = match path.exists() {
            true => Some(VideoFrames::open(&path, Some((start + first - half).max(0.0)))?.peekable()),
            false => None,
        };
        let frame = move |row: Result<Row>| {
            let row = match row {
                Ok(row) => row,
                Err(error) => return unreadable(error),
            };
            let wanted = start + row.timestamp;
            let mut image = Err(format!("{}: no frame at {wanted:.3} s", path.display()));
            while let Some(frame) = frames.as_mut().and_then(|frames| {
                frames.next_if(|frame| frame.as_ref().map_or(true, |(stamp, _)| *stamp <= wanted + half))
            }) {
                let (stamp, pixels) = frame?;
                if (stamp - wanted).abs() <= half {
                    image = Ok(EncodedImage::Pixels(pixels));
                    break;
                }
            }
            Ok(SourceFrame::new(row.timestamp, image))
        };
        Ok(Box::new(rows.map(frame)))
    }
}

/// Names of the elements of a feature, also where a data set nests them in a map of one list, or has none.
fn names_of(feature: &Value, name: &str, width: usize) -> Vec<String> {
    let names = &feature["names"];
    let nested = names.as_object().and_then(|map| map.values().next()).unwrap_or(names);
    let listed: Option<Vec<String>> =
        nested.as_array().and_then(|list| list.iter().map(|name| name.as_str().map(str::to_string)).collect());
    listed
        .filter(|list| list.len() == width)
        .unwrap_or_else(|| (0..width).map(|index| format!("{name}.{index}")).collect())
}

/// Returns the input of policies that labels are a part of; None if there is none.
fn input_with_labels(dataset: &LeRobot) -> Option<&'static str> {
    let names = [ColumnRole::State, ColumnRole::EnvironmentState].into_iter().filter_map(ColumnRole::feature);
    names.into_iter().find(|name| {
        let names = dataset.info["features"][name]["names"].as_array();
        names.is_some_and(|names| names.ends_with(&KNOWN.map(Value::from)))
    })
}

impl ImageSource for LeRobotDataset {
    fn units(&self) -> &[Unit] {
        &self.units
    }

    fn files(&self) -> Result<InputFiles> {
        let mut files = InputFiles::new(&self.dataset.root);
        files.add_folder("meta")?;
        files.add_folder("data")?;
        for episode in self.dataset.episodes.iter().filter(|_| self.kind == Camera::Video) {
            files.add(self.dataset.video_file(&self.camera, episode)?.map(|(file, _)| file));
        }
        Ok(files)
    }

    fn frames(&self, unit: usize, from: usize) -> Result<SourceFrames<'_>> {
        let episode = &self.dataset.episodes[unit];
        if self.kind == Camera::Video {
            return self.video_frames(episode, from);
        }
        let rows = self.dataset.rows(episode, Some(&self.camera), from)?;
        Ok(Box::new(rows.map(|row| match row {
            Ok(row) => {
                let image = row.image.map(EncodedImage::File).ok_or_else(|| "the row has no image".to_string());
                Ok(SourceFrame::new(row.timestamp, image))
            }
            Err(error) => unreadable(error),
        })))
    }
}

/// Returns the frame of a damaged row.
///
/// # Errors
/// If the row is not damaged, but its file can't be read.
fn unreadable(error: Error) -> Result<SourceFrame> {
    match error.is_of_medium() {
        true => Err(error),
        false => Ok(SourceFrame::new(f64::NAN, Err(error.to_string()))),
    }
}
