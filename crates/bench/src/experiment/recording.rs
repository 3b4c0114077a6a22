//! Recordings in the layouts of data sets: rendered episodes are written as others record them, and imported.

use std::path::{Path, PathBuf};
use std::process::Command;

use egotac::dataset::EpisodeReader;
use egotac::dataset::zarr::{
    CAMERA_POSE, LEFT_HAND_POSE, MANO_CONTACT_VALID, MANO_FORCE, MANO_FORCE_VALID, MANO_PROXIMITY, OBJECT_POSE,
    RIGHT_HAND_POSE, TIMESTAMPS, ZarrReader,
};
use egotac::error::{Error, Result};
use egotac::hand::{HandModel, HandParams, Side};
use egotac::sensor::GloveSpec;
use egotac::sim::{Rollout, RolloutOptions, Scene};
use egotac::tactile::{N_FIELD, episode_ranges};
use glam::{DAffine3, DMat3, DQuat, DVec3};
use image::imageops::rotate270;
use serde::Serialize;

use super::recipe::Recipe;
use crate::writers::files::{ManoFiles, angles, glb, jpeg_of, tar, write};
use crate::writers::hot3d::{ClipFrame, members};
use crate::writers::raw_glove::{GloveStream, RawRecording, write_recording};

/// Quality of the JPEG images of clips.
const JPEG_QUALITY: u8 = 95;
/// Time of the first image of a clip, ns since the device's start.
const FIRST_NS: u64 = 54_971_174_871_117;
/// Time of the first image of a raw recording, ms since 1970.
const FIRST_MS: f64 = 1_700_000_000_000.0;
/// Instants per second at which the forces on a glove are simulated.
const GLOVE_RATE: f64 = 100.0;
/// Instants between the samples of the left and the right glove, whose clocks differ from the camera's and from each other.
const GLOVE_STEPS: [usize; 2] = [3, 2];
/// Samples that a glove takes before the first image, while nothing touches it: the import takes them for its rest.
const REST_SAMPLES: usize = 10;
/// Reading of a taxel at rest, N.
const REST: f32 = 0.3;

/// Layout of a data set.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Layout {
    /// HOT3D clips: poses of hands, objects and camera; no force.
    Hot3d,
    /// Raw recordings of EgoTac-SC: taxels of gloves with clocks of their own; no hands and no objects.
    Glove,
}

/// Recordings that are made from rendered stores, and the stores that they become again.
#[derive(Debug, Clone, PartialEq)]
pub struct Recorded {
    /// Layout of the recordings.
    pub layout: Layout,
    /// Folder of the data set.
    pub source: PathBuf,
    /// The imported stores: a folder, or the store of a single recording.
    pub path: PathBuf,
    /// Rendered stores that the recordings are made from.
    pub from: Vec<Recipe>,
    /// MANO-format files of the hands, left first.
    pub mano: [PathBuf; 2],
}

/// Agreement of imported labels with the simulator's.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Agreement {
    /// Kind of the import.
    pub kind: &'static str,
    /// Imported frames.
    pub frames: usize,
    /// Share of the vertices, over all frames, whose contact is known.
    pub known: f64,
    /// F1 of the imported contact against the simulator's, by the 1 cm rule (HOT3D) or by force (glove), where it is known.
    pub contact_f1: f64,
    /// Share of the simulator's force that the imported one sums to; `None` = no force.
    pub force_kept: Option<f64>,
}

/// One episode of a rendered store.
struct Episode<'a> {
    recipe: &'a Recipe,
    store: &'a ZarrReader,
    frames: std::ops::Range<usize>,
    seed: u64,
}

impl Layout {
    /// Name of the kind for `egotac data import`.
    pub fn kind(self) -> &'static str {
        match self {
            Self::Hot3d => "hot3d",
            Self::Glove => "egotac-sc-raw",
        }
    }
}

impl Recorded {
    /// Writes the recordings and imports them, unless that is done. A stopped import resumes.
    ///
    /// # Errors
    /// If a rendered store can't be read, or the import fails.
    pub fn make(&self, mano: &ManoFiles) -> Result<()> {
        if self.is_made() {
            return Ok(());
        }
        if !self.source.exists() {
            let partial = self.source.with_extension("partial");
            if partial.exists() {
                std::fs::remove_dir_all(&partial).map_err(Error::io(&partial))?;
            }
            self.write(&partial, mano)?;
            std::fs::rename(&partial, &self.source).map_err(Error::io(&self.source))?;
        }
        self.import()
    }

    /// Compares the imported labels with those of the rendered stores.
    ///
    /// # Errors
    /// If a store can't be read.
    pub fn agreement(&self) -> Result<Agreement> {
        let (mut frames, mut known, mut hits, mut wrong) = (0, 0usize, 0usize, 0usize);
        let (mut force, mut true_force) = (0f64, 0f64);
        let names = self.each(|name, _| Ok(name.to_string()))?;
        let imported = |name: &str| match names.len() {
            1 => self.path.clone(),
            _ => self.path.join(format!("{name}.zarr")),
        };
        self.each(|name, episode| {
            let store = ZarrReader::open(&imported(name))?;
            let (own, there) = (0..store.len(), episode.frames.clone());
            let contact = store.read_contact(own.clone())?;
            let mask = store.read_u8(MANO_CONTACT_VALID, own.clone())?;
            let truth: Vec<bool> = match self.layout {
                Layout::Hot3d => {
                    episode.store.read_u8(MANO_PROXIMITY, there.clone())?.iter().map(|x| *x == 1).collect()
                }
                Layout::Glove => episode.store.read_contact(there.clone())?.iter().map(|x| *x > 0.5).collect(),
            };
            frames += store.len();
            for ((contact, mask), truth) in contact.iter().zip(mask).zip(truth).filter(|((_, mask), _)| *mask == 1) {
                known += usize::from(mask);
                match (*contact > 0.5, truth) {
                    (true, true) => hits += 1,
                    (false, false) => {}
                    _ => wrong += 1,
                }
            }
            if self.layout == Layout::Glove {
                let newtons = store.read_f32(MANO_FORCE, own.clone())?;
                let mask = store.read_u8(MANO_FORCE_VALID, own)?;
                let truth = episode.store.read_f32(MANO_FORCE, there)?;
                force +=
                    newtons.iter().zip(&mask).filter(|(_, mask)| **mask == 1).map(|(x, _)| f64::from(*x)).sum::<f64>();
                // Frames that the gloves say nothing about are left out on both sides.
                let told = mask.chunks_exact(N_FIELD).map(|mask| mask.contains(&1));
                let sums = truth.chunks_exact(N_FIELD).zip(told).filter(|(_, told)| *told);
                true_force += sums.flat_map(|(row, _)| row).map(|x| f64::from(*x)).sum::<f64>();
            }
            Ok(())
        })?;
        Ok(Agreement {
            kind: self.layout.kind(),
            frames,
            known: known as f64 / (frames * N_FIELD).max(1) as f64,
            contact_f1: 2.0 * hits as f64 / (2 * hits + wrong).max(1) as f64,
            force_kept: (self.layout == Layout::Glove).then(|| force / true_force.max(f64::MIN_POSITIVE)),
        })
    }

    /// True if the import is complete: the manifest of several stores is written last.
    fn is_made(&self) -> bool {
        self.path.join("manifest.json").exists() || self.path.join(".zgroup").exists()
    }

    /// Runs `egotac data import`, of this same program.
    fn import(&self) -> Result<()> {
        let program = std::env::current_exe().map_err(Error::io(Path::new("egotac")))?;
        let mut command = Command::new(program);
        command.args(["data", "import", self.layout.kind()]).arg(&self.source).arg("--out").arg(&self.path);
        command.args(["--size", "0", "--force-kind", "spread"]);
        command.arg("--mano-left").arg(&self.mano[0]).arg("--mano-right").arg(&self.mano[1]);
        let output = command.output().map_err(Error::io(&self.source))?;
        match output.status.success() {
            true => Ok(()),
            false => Err(Error::file(&self.source, String::from_utf8_lossy(&output.stderr).trim())),
        }
    }

    /// Calls `visit` with the name of each recording and the rendered episode that it is made from.
    fn each<T>(&self, mut visit: impl FnMut(&str, &Episode) -> Result<T>) -> Result<Vec<T>> {
        let mut results = Vec::new();
        for recipe in &self.from {
            let store = ZarrReader::open(&recipe.path)?;
            let seeds = store.raw_attributes().get("episodes").and_then(|list| list.as_array()).cloned();
            for (index, frames) in episode_ranges(store.episode_ends()).enumerate() {
                let seed = seeds.as_ref().and_then(|list| list.get(index)?["seed"].as_u64());
                let missing = || Error::file(&recipe.path, "expected the seed of each episode, got none");
                let name = match self.layout {
                    Layout::Hot3d => format!("clip-{:06}", results.len()),
                    Layout::Glove => format!("{:04}", results.len()),
                };
                let episode = Episode { recipe, store: &store, frames, seed: seed.ok_or_else(missing)? };
                results.push(visit(&name, &episode)?);
            }
        }
        Ok(results)
    }

    fn write(&self, root: &Path, mano: &ManoFiles) -> Result<()> {
        let models = models(&self.mano)?;
        let mut meshes = 0;
        self.each(|name, episode| match self.layout {
            Layout::Hot3d => episode.write_clip(root, name, &models, mano, &mut meshes),
            Layout::Glove => episode.write_raw(root, name, &models),
        })?;
        Ok(())
    }
}

impl Episode<'_> {
    /// Writes a clip and the meshes of its objects, which every episode draws anew; `meshes` counts them.
    fn write_clip(
        &self,
        root: &Path,
        name: &str,
        models: &[HandModel; 2],
        mano: &ManoFiles,
        meshes: &mut i64,
    ) -> Result<()> {
        let rollout = Rollout::new(&Scene::load(&self.recipe.scene.display().to_string())?, self.seed, &hands(models))?;
        let mut ids = Vec::new();
        let drawn = rollout.objects().iter().zip(&rollout.episode().objects);
        for (_, draw) in drawn.filter(|(object, _)| object.body().is_some()) {
            let (mut corners, mut triangles) = (Vec::new(), Vec::new());
            for piece in draw.shape.pieces.iter().chain(&draw.shape.base) {
                let (own, faces) = piece.mesh();
                let first = corners.len();
                triangles.extend(faces.iter().map(|face| face.map(|index| first + index as usize)));
                corners.extend(own.iter().map(|vertex| vertex.as_dvec3()));
            }
            write(&root.join(format!("object_models/obj_{meshes:06}.glb")), glb(&(corners, triangles)));
            ids.push(*meshes);
            *meshes += 1;
        }
        let (store, range) = (self.store, self.frames.clone());
        let stamps = store.read(TIMESTAMPS, range.clone())?.into_f64();
        let cameras = poses(store, CAMERA_POSE, range.clone())?;
        let objects = poses(store, OBJECT_POSE, range.clone())?;
        let width = objects.len() / range.len().max(1);
        let hands = [params(store, LEFT_HAND_POSE, range.clone())?, params(store, RIGHT_HAND_POSE, range.clone())?];
        let mut frames = Vec::new();
        for (row, frame) in range.enumerate() {
            frames.push(ClipFrame {
                stamp: FIRST_NS + (stamps[row] * 1e9).round() as u64,
                image: jpeg_of(&rotate270(&store.image(frame)?), JPEG_QUALITY),
                hands: hands.each_ref().map(|hands| hands[row].as_ref()),
                objects: ids.iter().copied().zip(objects[row * width..].iter().copied()).collect(),
                camera: cameras[row] * upright_from_sensor(),
            });
        }
        let betas = [0.0; 10];
        write(&root.join(format!("train_aria/{name}.tar")), tar(&members(&frames, &betas, mano)));
        Ok(())
    }

    fn write_raw(&self, root: &Path, name: &str, models: &[HandModel; 2]) -> Result<()> {
        let stamps = self.store.read(TIMESTAMPS, self.frames.clone())?.into_f64();
        let pictures = self.frames.clone().map(|frame| self.store.image(frame)).collect::<Result<Vec<_>>>()?;
        let images = stamps.iter().map(|stamp| FIRST_MS + (stamp * 1e3).round()).zip(&pictures).collect();
        let (gloves, head) = streams(&self.recipe.scene, self.seed, models)?;
        write_recording(root, name, &RawRecording { images, gloves, head });
        Ok(())
    }
}

/// Times, ms, and poses of the head's tracker.
pub type HeadStream = (Vec<f64>, Vec<DAffine3>);

/// Simulates an episode once more, with gloves and without pictures; returns the samples of both gloves and of the head's tracker,
/// with their times.
///
/// # Errors
/// If the scene can't be read or simulated.
pub fn streams(scene: &Path, seed: u64, models: &[HandModel; 2]) -> Result<([GloveStream; 2], HeadStream)> {
    let mut scene = Scene::load(&scene.display().to_string())?;
    scene.spec.rate = GLOVE_RATE;
    scene.spec.glove = Some(GloveSpec { gain: 0.1, noise: 0.02, ..GloveSpec::ideal("aether_132") });
    let mut rollout = Rollout::new(&scene, seed, &hands(models))?;
    let mut gloves = GLOVE_STEPS.map(|steps| {
        let before = (1..=REST_SAMPLES).rev().map(|k| FIRST_MS - 1e3 / GLOVE_RATE * (steps * k) as f64);
        GloveStream { stamps: before.collect(), taxels: vec![vec![REST; 132]; REST_SAMPLES] }
    });
    let (mut stamps, mut poses) = (Vec::new(), Vec::new());
    let mut instant = 0;
    while let Some(frame) = rollout.next_frame()? {
        let time = FIRST_MS + 1e3 * frame.frame.timestamp;
        for ((glove, steps), taxels) in gloves.iter_mut().zip(GLOVE_STEPS).zip(frame.taxels.into_iter().flatten()) {
            if instant % steps == 1 {
                glove.stamps.push(time);
                glove.taxels.push(taxels.into_iter().map(|newtons| newtons + REST).collect());
            }
        }
        stamps.push(time);
        let camera = DAffine3::from_rotation_translation(frame.camera.orientation, frame.camera.position);
        poses.push(camera * DAffine3::from_mat3(DMat3::from_diagonal(DVec3::new(-1.0, -1.0, 1.0))));
        instant += 1;
    }
    Ok((gloves, (stamps, poses)))
}

/// Writes MANO-format files of the built-in hands into `folder`, whose basis explains the poses of all episodes of the
/// recipes: they stand in for MANO's licensed files.
///
/// # Errors
/// If a scene can't be read or simulated.
pub fn mano_files(folder: &Path, recipes: &[&Recipe]) -> Result<ManoFiles> {
    let mut found = [Vec::new(), Vec::new()];
    for recipe in recipes {
        let options = RolloutOptions { picture: None, ..RolloutOptions::default() };
        let scene = Scene::load(&recipe.scene.display().to_string())?;
        for episode in 0..recipe.episodes as u64 {
            let mut rollout = Rollout::new(&scene, recipe.seed + episode, &options)?;
            while let Some(frame) = rollout.next_frame()? {
                let hands = [frame.frame.left_hand_pose, frame.frame.right_hand_pose];
                let poses = hands.map(|hand| hand.map(|hand| angles(&hand.hand_pose)));
                found.iter_mut().zip(poses).for_each(|(found, pose)| found.extend(pose));
            }
        }
    }
    Ok(ManoFiles::of_poses(folder, &found))
}

/// Reads the hands of MANO-format files, left first.
///
/// # Errors
/// If a file can't be read.
pub fn models([left, right]: &[PathBuf; 2]) -> Result<[HandModel; 2]> {
    Ok([HandModel::load(left, Side::Left)?, HandModel::load(right, Side::Right)?])
}

fn hands(models: &[HandModel; 2]) -> RolloutOptions {
    RolloutOptions { hands: models.clone(), picture: None, ..RolloutOptions::default() }
}

/// Axes of the sensor of a HOT3D camera, in the frame of the upright image: the sensor is mounted on its side.
fn upright_from_sensor() -> DAffine3 {
    DAffine3::from_mat3(DMat3::from_cols(DVec3::NEG_Y, DVec3::X, DVec3::Z)).inverse()
}

/// Reads poses in a row: position, m, and quaternion w, x, y, z.
fn poses(store: &ZarrReader, name: &str, range: std::ops::Range<usize>) -> Result<Vec<DAffine3>> {
    let values: Vec<f64> = store.read_f32(name, range)?.into_iter().map(f64::from).collect();
    let pose = |row: &[f64; 7]| {
        let [x, y, z, w, qx, qy, qz] = *row;
        let turn = DQuat::from_xyzw(qx, qy, qz, w).normalize();
        DAffine3::from_rotation_translation(turn, DVec3::new(x, y, z))
    };
    Ok(values.as_chunks::<7>().0.iter().map(pose).collect())
}

/// Reads the parameters of a hand; `None` where it is absent.
fn params(store: &ZarrReader, name: &str, range: std::ops::Range<usize>) -> Result<Vec<Option<HandParams>>> {
    let values = store.read_f32(name, range)?;
    let present = |row: &[f32; 61]| row.iter().any(|value| *value != 0.0).then(|| HandParams::from_array(row));
    Ok(values.as_chunks::<61>().0.iter().map(present).collect())
}
