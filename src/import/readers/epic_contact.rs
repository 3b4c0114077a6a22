//! EPIC-Contact: one `.npz` file per clip with MANO meshes of the hands and the object's mesh, all in the camera's frame, beside
//! extracted frames of EPIC-KITCHENS. The members are those that public loaders of the data set read.

use std::path::{Path, PathBuf};

use glam::{DAffine3, DMat3, DVec3, Vec3};
use serde_json::json;

use crate::dataset::base_name;
use crate::dataset::source::SourceFrames;
use crate::error::{Error, Result};
use crate::file::mesh::{self, Mesh};
use crate::file::{input, limits};
use crate::hand::{N_KEYPOINTS, N_VERTICES, Side};
use crate::import::input::csv::Csv;
use crate::import::input::images::Images;
use crate::import::input::lazy::Lazy;
use crate::import::input::numbers::{self, vec3};
use crate::import::input::{arrays, folders};
use crate::import::kind::{Found, Kind, Mano, Options};
use crate::import::recording::{Moment, Reader, RecordedHand, RecordedObject, Recording, View};
use crate::import::shapes::MeshFile;
use crate::numpy::{Array, Npz, first_text};

/// EPIC-Contact.
pub const KIND: Kind = Kind {
    name: "epic-contact",
    gives: "both hands where they are valid, the object, in the head camera's frame; images where frames of EPIC-KITCHENS are extracted",
    mano: Mano::Fitted,
    origin: "EPIC-Contact: CLIP.npz; EPIC-KITCHENS-100: rgb_frames/VIDEO/frame_*.jpg, EPIC_100_video_info.csv",
    licence: "not stated in its files; CC BY-NC 4.0 for EPIC-KITCHENS, MANO's for the hands",
    find,
};
/// Depth of folders with clips below the source, at most.
const MAX_DEPTH: usize = 4;
/// Frames per second of the videos of EPIC-KITCHENS-55, whose names have two digits after the participant, and of its extension.
const FPS: [f64; 2] = [60_000.0 / 1001.0, 50.0];
/// Table of the videos' frame rates.
const VIDEO_INFO: &str = "EPIC_100_video_info.csv";

fn find(source: &Path, _: &Options) -> Result<Found> {
    let root = if source.is_dir() { source } else { source.parent().unwrap_or(source) };
    let mut found = Found::default();
    for path in folders::files_below(source, MAX_DEPTH, |name| name.ends_with(".npz"))? {
        let name = path.strip_prefix(root).unwrap_or(&path).with_extension("").display().to_string();
        found.add(name.clone(), Clip::open(root, &path, name));
    }
    Ok(found)
}

/// One clip.
struct Clip {
    recording: Recording,
    path: PathBuf,
    images: Images,
    /// Stamps of the frames, s.
    stamps: Vec<f64>,
    content: Lazy<Content>,
}

/// Poses of a clip, in the camera's frame.
struct Content {
    /// Vertices and keypoints of both hands in each frame; `None` = not valid.
    hands: [Vec<Option<RecordedHand>>; 2],
    /// `camera_from_object` in each frame; `None` = not valid.
    object: Vec<Option<DAffine3>>,
}

impl Clip {
    fn open(root: &Path, path: &Path, name: String) -> Result<Self> {
        let mut file = File::open(path)?;
        let numbers = file.array("_frame_num", &[0])?.data;
        let frames = numbers.len();
        if frames == 0 || !numbers.is_sorted_by(|before, after| before < after) {
            return Err(file.expected("_frame_num", "numbers of frames that increase, at least one"));
        }
        limits::FRAMES.check(path, "frames", frames as u64)?;
        let video = file.text("video_id")?.unwrap_or_else(|| video_of(&base_name(path)));
        let fps = match frame_rate(root, &video)? {
            Some(fps) => fps,
            None => FPS[usize::from(is_of_extension(&video))],
        };
        let files: Vec<PathBuf> = numbers.iter().map(|number| image(root, &video, *number)).collect();
        let has_images = files.iter().any(|path| path.is_file());
        Ok(Self {
            recording: Recording {
                name,
                path: path.to_path_buf(),
                frames,
                objects: vec![RecordedObject {
                    name: "object".into(),
                    mesh: Some(MeshFile { part: Some(object_mesh), ..MeshFile::new(path.to_path_buf(), 1.0) }),
                }],
                view: if has_images { View::Ego } else { View::None },
                about: json!({
                    "video": video, "first_frame": numbers[0], "frames_per_second": fps,
                    "clip": file.text("_clip")?, "world": "the camera's frame at each instant",
                }),
                ..Recording::default()
            },
            path: path.to_path_buf(),
            images: if has_images { Images::Files(files) } else { Images::Black(frames) },
            stamps: numbers.iter().map(|number| number / fps).collect(),
            content: Lazy::default(),
        })
    }

    fn content(&self) -> Result<Content> {
        let (mut file, frames) = (File::open(&self.path)?, self.recording.frames);
        let mut hands = [vec![None; frames], vec![None; frames]];
        for (side, [letter, word]) in [(Side::Left, ["l", "left"]), (Side::Right, ["r", "right"])] {
            let valid = file.array(&format!("{word}_valid"), &[frames])?.data;
            let vertices = file.array_with_gaps(&format!("mano.v3d.cam.{letter}"), &[frames, N_VERTICES, 3])?;
            let joints = file.array_with_gaps(&format!("mano.j3d.cam.{letter}"), &[frames, N_KEYPOINTS, 3])?;
            let rows = vertices.data.chunks_exact(3 * N_VERTICES).zip(joints.data.chunks_exact(3 * N_KEYPOINTS));
            for ((hand, (vertices, joints)), valid) in hands[side as usize].iter_mut().zip(rows).zip(valid) {
                let vertices: Vec<Vec3> = vertices.chunks_exact(3).map(vec3).collect();
                let keypoints = numbers::keypoints(joints).filter(|_| vertices.iter().all(|vertex| vertex.is_finite()));
                *hand = keypoints.filter(|_| valid > 0.5).map(|keypoints| RecordedHand::Mesh(vertices, keypoints));
            }
        }
        let object = file.object_poses()?;
        match object.len() == frames {
            true => Ok(Content { hands, object }),
            false => Err(file.expected("object.rot", &format!("{frames} rotations, as many as frames"))),
        }
    }
}

/// Reads the mesh of a clip's object in its own frame, from the first frame whose pose is valid.
fn object_mesh(path: &Path) -> Result<Mesh> {
    let mut file = File::open(path)?;
    let poses = file.object_poses()?;
    let Some((frame, pose)) = poses.iter().enumerate().find_map(|(frame, pose)| Some((frame, (*pose)?))) else {
        return Err(file.expected("object.rot", "at least one rotation"));
    };
    let placed = file.array_with_gaps("object.v.cam", &[poses.len(), 0, 3])?;
    let most = placed.shape[1];
    // Objects of a batch are padded to the largest.
    let count =
        |array: Option<Array>| array.and_then(|array| array.data.get(frame).copied()).map(|count| count as usize);
    let vertices = count(file.optional("object.v_len")?).unwrap_or(most).min(most);
    let object_from_camera = pose.inverse();
    let row = &placed.data[3 * most * frame..][..3 * vertices];
    let vertices = row.chunks_exact(3).map(|v| object_from_camera.transform_point3(DVec3::from_slice(v)).as_vec3());
    let faces = file.optional("object.f")?.ok_or_else(|| file.expected("object.f", "this member"))?;
    // (F, 3), or the same in each frame.
    let each = match faces.shape.as_slice() {
        [count, 3] | [_, count, 3] => *count,
        shape => return Err(file.expected("object.f", &format!("shape [any, 3] or [any, any, 3], not {shape:?}"))),
    };
    let each = count(file.optional("object.f_len")?).unwrap_or(each).min(each);
    let index = |value: &f64| if *value >= 0.0 && value.fract() == 0.0 { *value as u32 } else { u32::MAX };
    let triangles = faces.data.chunks_exact(3).take(each).map(|f| [index(&f[0]), index(&f[1]), index(&f[2])]);
    mesh::checked(path, (vertices.collect(), triangles.collect()))
}

/// A clip's archive.
struct File<'a> {
    path: &'a Path,
    archive: Npz<std::io::BufReader<std::fs::File>>,
}

impl<'a> File<'a> {
    fn open(path: &'a Path) -> Result<Self> {
        let archive = Npz::new(std::io::BufReader::new(input::open(path)?));
        Ok(Self { path, archive: archive.map_err(|error| Error::library(path, error))? })
    }

    fn expected(&self, member: &str, what: &str) -> Error {
        Error::file(self.path, format!("{member}: expected {what}"))
    }

    /// Reads an array that may be missing, of any shape.
    fn optional(&mut self, name: &str) -> Result<Option<Array>> {
        let named = |message: String| Error::file(self.path, format!("{name}: {message}"));
        self.archive.array(name).map_err(named)
    }

    /// Reads an array of a shape; 0 stands for lengths that may be any. Its numbers may be NaN.
    fn array_with_gaps(&mut self, name: &str, shape: &[usize]) -> Result<Array> {
        let array = self.optional(name)?.ok_or_else(|| self.expected(name, "this member, got none"))?;
        arrays::check_shape(self.path, name, array, shape)
    }

    /// Reads an array of finite numbers.
    fn array(&mut self, name: &str, shape: &[usize]) -> Result<Array> {
        let array = self.optional(name)?.ok_or_else(|| self.expected(name, "this member, got none"))?;
        arrays::check(self.path, name, array, shape)
    }

    /// Reads the first text of an array of texts; `None` without the member, or if it is of another kind.
    fn text(&mut self, name: &str) -> Result<Option<String>> {
        let content =
            self.archive.member(name).map_err(|message| Error::file(self.path, format!("{name}: {message}")))?;
        Ok(content.and_then(|content| first_text(&content)))
    }

    /// Reads `camera_from_object` of each frame; `None` where it is not a rigid motion.
    fn object_poses(&mut self) -> Result<Vec<Option<DAffine3>>> {
        let rotations = self.array_with_gaps("object.rot", &[0, 3, 3])?;
        let places = self.array_with_gaps("object.cam_t", &[rotations.shape[0], 3])?;
        let poses = rotations.data.as_chunks::<9>().0.iter().zip(places.data.as_chunks::<3>().0);
        let pose = |(rows, place): (&[f64; 9], &[f64; 3])| {
            let rotation = DMat3::from_cols_array(rows).transpose();
            numbers::motion(self.path, "object.rot", rotation, DVec3::from_array(*place)).ok()
        };
        Ok(poses.map(pose).collect())
    }
}

/// Returns the path of an extracted frame of a video: that of the participant's folder if it exists.
fn image(root: &Path, video: &str, number: f64) -> PathBuf {
    let file = format!("rgb_frames/{video}/frame_{:010}.jpg", number as u64);
    let participant = video.split('_').next().unwrap_or_default();
    let own = root.join(participant).join(&file);
    if own.is_file() { own } else { root.join(file) }
}

/// Returns the video of a clip's name, which begins with participant and number.
fn video_of(name: &str) -> String {
    name.split('_').take(2).collect::<Vec<_>>().join("_")
}

/// Returns true if the video's number has three digits.
fn is_of_extension(video: &str) -> bool {
    video.rsplit('_').next().is_some_and(|number| number.len() >= 3)
}

/// Returns the frame rate of a video in the table of videos; `None` without the table or the video.
fn frame_rate(root: &Path, video: &str) -> Result<Option<f64>> {
    let path = root.join(VIDEO_INFO);
    if !path.is_file() {
        return Ok(None);
    }
    for row in Csv::read(&path)?.rows() {
        if row.get("video_id")? == video {
            let rate = row.get("fps")?.parse().ok().filter(|rate: &f64| rate.is_finite() && *rate > 0.0);
            return rate.map(Some).ok_or_else(|| row.expected("fps", "a positive number"));
        }
    }
    Ok(None)
}

impl Reader for Clip {
    fn recording(&self) -> &Recording {
        &self.recording
    }

    fn files(&self) -> Result<Vec<PathBuf>> {
        Ok([vec![self.path.clone()], self.images.paths()].concat())
    }

    fn moment(&self, index: usize) -> Result<Moment> {
        let content = self.content.get(&self.path, || self.content())?;
        Ok(Moment {
            stamp_secs: self.stamps[index],
            world_from_reference: DAffine3::IDENTITY,
            world_from_camera: Some(DAffine3::IDENTITY),
            hands: Side::BOTH.map(|side| content.hands[side as usize][index].clone()),
            objects: vec![content.object[index]],
            forces: [None, None],
            readings: Vec::new(),
        })
    }

    fn images(&self, from: usize) -> Result<SourceFrames<'_>> {
        self.images.frames(from, |index| self.stamps[index])
    }

    fn release(&self) {
        self.content.release();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_clips_tell_the_video_and_its_rate() {
        assert_eq!(video_of("P01_103_12_bottle.npz"), "P01_103");
        assert!(is_of_extension("P01_103") && !is_of_extension("P01_03"));
    }
}
