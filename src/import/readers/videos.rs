//! Data sets of videos to be labelled, with the actions that their authors annotated: EPIC-KITCHENS, Ego4D, EgoPAT3D.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use glam::DAffine3;
use serde::Deserialize;
use serde_json::{Value, json};

use crate::dataset::base_name;
use crate::dataset::source::SourceFrames;
use crate::error::{Error, Result};
use crate::file::{input, limits};
use crate::import::input::csv::Csv;
use crate::import::input::images::{self, Images};
use crate::import::input::{folders, numbers};
use crate::import::kind::{Found, Kind, Mano, Options};
use crate::import::recording::{Moment, Reader, Recording};

/// EPIC-KITCHENS.
pub const EPIC: Kind = Kind {
    name: "epic",
    gives: "video of the head camera to be labelled, narrated actions",
    mano: Mano::Optional,
    origin: "EPIC-KITCHENS-100: P*/videos/*.MP4, EPIC_100_{train, validation}.csv",
    licence: "CC BY-NC 4.0",
    find: epic,
};
/// Ego4D.
pub const EGO4D: Kind = Kind {
    name: "ego4d",
    gives: "video of the head camera to be labelled, narrations",
    mano: Mano::Optional,
    origin: "Ego4D: {full_scale, clips, video_540ss}/UID.mp4, annotations/narration.json",
    licence: "Ego4D licence agreement",
    find: ego4d,
};
/// EgoPAT3D.
pub const EGOPAT3D: Kind = Kind {
    name: "egopat3d",
    gives: "video of the head camera to be labelled, ranges of actions",
    mano: Mano::Optional,
    origin: "EgoPAT3D: SCENE/RECORDING/{rgb_video.mp4, hand_frames/clip_ranges.txt}",
    licence: "its authors' terms of use",
    find: egopat3d,
};

/// Depth at which videos lie, at most.
const MAX_DEPTH: usize = 4;
/// Seconds per minute, and minutes per hour.
const SIXTY: f64 = 60.0;

/// An annotated action.
#[derive(Debug, Clone, PartialEq)]
struct Action {
    /// Begin and end, s; equal for a moment.
    secs: [f64; 2],
    /// Words of the annotators.
    text: String,
}

fn epic(source: &Path, _: &Options) -> Result<Found> {
    let mut actions: BTreeMap<String, Vec<Action>> = BTreeMap::new();
    let annotations = ["EPIC_100_train.csv", "EPIC_100_validation.csv"];
    let places = [source.to_path_buf(), source.join("epic-kitchens-100-annotations"), source.join("annotations")];
    for path in places.iter().flat_map(|folder| annotations.map(|name| folder.join(name))).filter(|path| path.is_file())
    {
        let table = Csv::read(&path)?;
        for row in table.rows() {
            let video = row.get("video_id")?.to_string();
            let secs = [seconds(row.get("start_timestamp")?), seconds(row.get("stop_timestamp")?)];
            let [Some(start), Some(stop)] = secs else {
                return Err(row.expected("start_timestamp", "hours:minutes:seconds"));
            };
            let action = Action { secs: [start, stop], text: row.get("narration")?.to_string() };
            actions.entry(video).or_default().push(action);
        }
    }
    let videos = folders::files_below(source, MAX_DEPTH, |name| name.to_ascii_lowercase().ends_with(".mp4"))?;
    let named = videos.into_iter().map(|path| {
        let name = base_name(&path).rsplit_once('.').map_or_else(String::new, |(stem, _)| stem.to_string());
        let actions = actions.get(&name).cloned().unwrap_or_default();
        (name.clone(), path, Ok(json!({ "video": name, "actions": described(&actions) })))
    });
    Ok(found(named))
}

fn ego4d(source: &Path, _: &Options) -> Result<Found> {
    let path = source.join("annotations/narration.json");
    let narrations = match path.is_file() {
        true => narrations(&path)?,
        false => BTreeMap::new(),
    };
    let videos = folders::files_below(source, MAX_DEPTH, |name| name.ends_with(".mp4"))?;
    let named = videos.into_iter().map(|path| {
        let name = path.strip_prefix(source).unwrap_or(&path).with_extension("").display().to_string();
        let uid = base_name(&path).trim_end_matches(".mp4").to_string();
        let actions = narrations.get(&uid).map(|video| described(&video.actions())).unwrap_or_default();
        (name, path, Ok(json!({ "video": uid, "actions": actions })))
    });
    Ok(found(named))
}

fn egopat3d(source: &Path, _: &Options) -> Result<Found> {
    let videos = folders::files_below(source, MAX_DEPTH, |name| name == "rgb_video.mp4")?;
    let named = videos.into_iter().map(|path| {
        let folder = path.parent().unwrap_or(source).to_path_buf();
        let name = folder.strip_prefix(source).unwrap_or(&folder).display().to_string();
        let name = if name.is_empty() { base_name(&folder) } else { name };
        let ranges = folder.join("hand_frames/clip_ranges.txt");
        let about = match ranges.is_file() {
            true => clips(&ranges).map(|clips| json!({ "clips_frames": clips })),
            false => Ok(json!({})),
        };
        (name, path, about)
    });
    Ok(found(named))
}

/// Reads the first and the last frame of each clip.
fn clips(path: &Path) -> Result<Vec<[f64; 2]>> {
    let values = numbers::read(path)?;
    let (pairs, rest) = values.as_chunks::<2>();
    match rest.is_empty() {
        true => Ok(pairs.to_vec()),
        false => Err(Error::file(path, format!("expected pairs of frame numbers, got {} numbers", values.len()))),
    }
}

fn found(videos: impl Iterator<Item = (String, PathBuf, Result<Value>)>) -> Found {
    let mut found = Found::default();
    for (name, path, about) in videos {
        found.add(name.clone(), about.and_then(|about| Video::open(name, path, about)));
    }
    found
}

fn described(actions: &[Action]) -> Vec<Value> {
    let described = |action: &Action| json!({ "secs": action.secs, "text": action.text });
    actions.iter().map(described).collect()
}

/// Reads a time of the form hours:minutes:seconds, s.
fn seconds(text: &str) -> Option<f64> {
    let parts: Option<Vec<f64>> = text
        .split(':')
        .map(|part| part.parse().ok().filter(|value: &f64| value.is_finite() && *value >= 0.0))
        .collect();
    match parts?.as_slice() {
        [hours, minutes, seconds] => Some((hours * SIXTY + minutes) * SIXTY + seconds),
        _ => None,
    }
}

/// Narrations of one video.
#[derive(Debug, Default, Deserialize)]
struct Narrated {
    narration_pass_1: Option<Pass>,
    narration_pass_2: Option<Pass>,
}

#[derive(Debug, Deserialize)]
struct Pass {
    #[serde(default)]
    narrations: Vec<Narration>,
}

#[derive(Debug, Deserialize)]
struct Narration {
    timestamp_sec: f64,
    narration_text: String,
}

impl Narrated {
    /// Returns the narrations of the first of two annotators who has some.
    fn actions(&self) -> Vec<Action> {
        let passes = [&self.narration_pass_1, &self.narration_pass_2].into_iter().flatten();
        let pass = passes.map(|pass| &pass.narrations).find(|narrations| !narrations.is_empty());
        let action = |narration: &Narration| Action {
            secs: [narration.timestamp_sec; 2],
            text: narration.narration_text.clone(),
        };
        pass.into_iter().flatten().map(action).collect()
    }
}

/// Reads narrations by video: directly, or below the key `videos`, as the second version of the data set has them.
fn narrations(path: &Path) -> Result<BTreeMap<String, Narrated>> {
    #[derive(Deserialize)]
    struct Versioned {
        videos: BTreeMap<String, Narrated>,
    }
    let content = input::read(path, limits::FILE)?;
    match serde_json::from_slice::<Versioned>(&content) {
        Ok(Versioned { videos }) => Ok(videos),
        Err(error) => serde_json::from_slice(&content).map_err(|_| Error::file(path, error)),
    }
}

/// A video without annotations of hands.
struct Video {
    recording: Recording,
    images: Images,
    fps: f64,
}

impl Video {
    fn open(name: String, path: PathBuf, about: Value) -> Result<Self> {
        let facts = images::video_alone(&path)?;
        let frames = facts.frames.filter(|frames| *frames > 0);
        let frames =
            frames.ok_or_else(|| Error::file(&path, "expected a video that states its number of frames, got none"))?;
        limits::FRAMES.check(&path, "frames", frames as u64)?;
        Ok(Self {
            recording: Recording { name, path: path.clone(), frames, about, ..Recording::default() },
            images: Images::Video(path),
            fps: facts.fps,
        })
    }
}

impl Reader for Video {
    fn recording(&self) -> &Recording {
        &self.recording
    }

    fn files(&self) -> Result<Vec<PathBuf>> {
        Ok(self.images.paths())
    }

    fn moment(&self, index: usize) -> Result<Moment> {
        Ok(Moment {
            stamp_secs: index as f64 / self.fps,
            world_from_reference: DAffine3::IDENTITY,
            world_from_camera: None,
            hands: [None, None],
            objects: Vec::new(),
            forces: [None, None],
            readings: Vec::new(),
        })
    }

    fn images(&self, from: usize) -> Result<SourceFrames<'_>> {
        self.images.frames(from, |index| index as f64 / self.fps)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_are_hours_minutes_and_seconds() {
        assert_eq!(seconds("01:02:03.25"), Some(3723.25));
        assert!(["1:2", "a:b:c", "00:00:-1", "00:00:nan", ""].iter().all(|text| seconds(text).is_none()));
    }

    #[test]
    fn narrations_of_both_versions_read_and_the_first_annotator_who_has_some_counts() {
        let video = r#"{"a": {"narration_pass_1": {"narrations": []}, "status": "complete", "narration_pass_2": {"narrations":
            [{"timestamp_sec": 1.5, "narration_text": "C takes a cup"}]}}}"#;
        let file = tempfile::NamedTempFile::new().unwrap();
        for text in [video.to_string(), format!("{{\"version\": \"2.0\", \"videos\": {video}}}")] {
            std::fs::write(file.path(), text).unwrap();
            let actions = narrations(file.path()).unwrap()["a"].actions();
            assert_eq!(actions, [Action { secs: [1.5, 1.5], text: "C takes a cup".into() }]);
        }
    }
}
