//! EgoPressure: Parquet files of a head camera, MANO meshes, and the force on a touchpad.

use std::path::{Path, PathBuf};

use glam::{DAffine3, DMat3, DVec3, Vec3};
use serde_json::{Value, json};

use crate::dataset::base_name;
use crate::dataset::source::{EncodedImage, SourceFrame, SourceFrames};
use crate::error::{Error, Result};
use crate::file::{input, limits};
use crate::hand::{N_BETAS, N_VERTICES, Side};
use crate::import::input::folders;
use crate::import::input::json::Json;
use crate::import::input::numbers::{self, vec3};
use crate::import::input::shard::{Shard, ShardRow};
use crate::import::kind::{Found, Kind, Mano, Options};
use crate::import::recording::{
    ManoParams, Moment, PointForce, PoseParams, Reader, RecordedHand, Recording, SensedForce,
};

/// EgoPressure.
pub const KIND: Kind = Kind {
    name: "egopressure",
    gives: "images of the head camera, one hand, its force on a touchpad in newtons, camera pose",
    mano: Mano::Required,
    origin: "EgoPressure: data/*/*/*.parquet and configs",
    licence: "CC BY-NC-SA 4.0; MANO's for the hands",
    find,
};
/// File of the head camera's images.
const IMAGES: &str = "cam-d.color.parquet";
/// Images per second; frames are numbered from 1 on.
const FPS: f64 = 30.0;
/// Rows and columns of the touchpad's cells.
const CELLS: [usize; 2] = [105, 185];
/// Edges of the touchpad along x (columns) and y (rows), m. Its surface is the plane z = 0 about the origin, and z points
/// down into it.
const PAD: [f64; 2] = [0.240, 0.1375];
/// Counts per newton.
const COUNTS: f64 = 1736.0;
/// Height above the touchpad's plane, m, below which a vertex beside the touchpad may touch something that measures nothing.
const BESIDE: f64 = 0.02;
/// Depth below the touchpad's plane, m, below which a vertex may touch the touchpad from beneath; annotations dip a few
/// millimetres into it.
const BENEATH: f64 = 0.01;

fn find(source: &Path, _: &Options) -> Result<Found> {
    let data = source.join("data");
    let root = if data.is_dir() { data } else { source.to_path_buf() };
    let mut found = Found::default();
    let mut folders = vec![root.clone()];
    for _ in 0..3 {
        for folder in folders.iter().filter(|folder| folder.join(IMAGES).is_file()) {
            let name = folder.strip_prefix(&root).unwrap_or(folder).display().to_string();
            let name = if name.is_empty() { base_name(folder) } else { name };
            found.add(name.clone(), Sequence::open(source, name, folder));
        }
        folders = folders.iter().map(|folder| folders::folders(folder)).collect::<Result<Vec<_>>>()?.concat();
    }
    Ok(found)
}

/// One sequence.
struct Sequence {
    recording: Recording,
    frames: Vec<i64>,
    images: PathBuf,
    annotation: Option<Shard>,
    pressure: Option<Shard>,
}

impl Sequence {
    fn open(root: &Path, name: String, path: &Path) -> Result<Self> {
        let images = path.join(IMAGES);
        let frames: Vec<i64> = Shard::open(&images, &["image"])?.frames().collect();
        limits::FRAMES.check(&images, "frames", frames.len() as u64)?;
        if frames.is_empty() {
            return Err(Error::file(&images, "expected at least one frame, got none"));
        }
        let optional = |file: &str, columns: &[&'static str]| {
            let path = path.join(file);
            path.is_file().then(|| Shard::open(&path, columns)).transpose()
        };
        let annotation = ["has_annotation", "hand_side", "vertices", "betas", "full_pose", "transl", "ego_R", "ego_T"];
        let config = root.join("configs").join(format!("{name}.json"));
        let (mut camera, mut about) = (Value::Null, json!({}));
        if config.is_file() {
            let config = Json::parse(&config, &input::read(&config, limits::TEXT)?)?;
            let calibration = config.get("camera_calibrations").get("0");
            let number = |name: &str| calibration.get(name).value().clone();
            camera = json!({
                "fx": number("fx"), "fy": number("fy"), "cx": number("cx"), "cy": number("cy"),
                "width": 1920, "height": 1080, "distortion": [0, 0],
            });
            about = json!({ "participant": config.get("participant").get("id").value() });
        }
        Ok(Self {
            recording: Recording {
                name,
                path: path.to_path_buf(),
                frames: frames.len(),
                measures_force: true,
                camera,
                about,
                ..Recording::default()
            },
            frames,
            annotation: optional("annotation.parquet", &annotation)?,
            pressure: optional("pressure.parquet", &["force"])?,
            images,
        })
    }

    /// Reads the annotated hand; `None` before and after contact.
    fn hand(&self, row: &ShardRow) -> Result<Option<(Side, ManoParams, Vec<Vec3>)>> {
        if row.truth("has_annotation")? != Some(true) {
            return Ok(None);
        }
        let side = match row.text("hand_side")?.as_deref() {
            Some("left") => Side::Left,
            Some("right") => Side::Right,
            _ => return Ok(None),
        };
        let lists = (
            row.list("vertices", 3 * N_VERTICES)?,
            row.list("betas", N_BETAS)?,
            row.list("full_pose", 48)?,
            row.list("transl", 3)?,
        );
        let (Some(vertices), Some(betas), Some(pose), Some(transl)) = lists else { return Ok(None) };
        let params = ManoParams {
            betas: std::array::from_fn(|beta| betas[beta] as f32),
            global_orient: vec3(&pose),
            hand_pose: PoseParams::AxisAngle(std::array::from_fn(|joint| vec3(&pose[3 + 3 * joint..]))),
            transl: vec3(&transl),
        };
        Ok(Some((side, params, vertices.chunks_exact(3).map(vec3).collect())))
    }

    /// Reads the forces on the cells of the touchpad; `None` without a measurement of this frame.
    fn force(&self, frame: i64, vertices: &[Vec3]) -> Result<Option<SensedForce>> {
        let Some(row) = self.pressure.as_ref().map(|shard| shard.row(frame)).transpose()?.flatten() else {
            return Ok(None);
        };
        let [rows, columns] = CELLS;
        let Some(counts) = row.list("force", rows * columns)? else { return Ok(None) };
        let place = |cell: usize, n: usize, edge: f64| ((cell as f64 + 0.5) / n as f64 - 0.5) * edge;
        let points = counts.iter().enumerate().filter(|(_, counts)| **counts > 0.0).map(|(cell, counts)| PointForce {
            position: DVec3::new(place(cell % columns, columns, PAD[0]), place(cell / columns, rows, PAD[1]), 0.0),
            // Out of the touchpad, into the hand.
            normal: DVec3::NEG_Z,
            newtons: counts / COUNTS,
        });
        let unmeasured = |vertex: &Vec3| {
            let [x, y, z] = vertex.as_dvec3().to_array();
            let beside = x.abs() > 0.5 * PAD[0] || y.abs() > 0.5 * PAD[1];
            if beside { z > -BESIDE } else { z > BENEATH }
        };
        Ok(Some(SensedForce { points: points.collect(), unmeasured: vertices.iter().map(unmeasured).collect() }))
    }

    fn stamp(&self, index: usize) -> f64 {
        (self.frames[index] - 1) as f64 / FPS
    }
}

impl Reader for Sequence {
    fn recording(&self) -> &Recording {
        &self.recording
    }

    fn files(&self) -> Result<Vec<PathBuf>> {
        let mut files = Vec::new();
        files.extend([self.images.clone()]);
        files.extend([&self.annotation, &self.pressure].into_iter().flatten().map(|shard| shard.path().to_path_buf()));
        Ok(files)
    }

    fn moment(&self, index: usize) -> Result<Moment> {
        let mut moment = Moment {
            stamp_secs: self.stamp(index),
            world_from_reference: DAffine3::IDENTITY,
            world_from_camera: None,
            hands: [None, None],
            objects: Vec::new(),
            forces: [None, None],
            readings: Vec::new(),
        };
        let frame = self.frames[index];
        let Some(annotation) = &self.annotation else { return Ok(moment) };
        let Some(row) = annotation.row(frame)? else { return Ok(moment) };
        if let (Some(rotation), Some(translation)) = (row.list("ego_R", 9)?, row.list("ego_T", 3)?) {
            let rows: [f64; 9] = std::array::from_fn(|k| rotation[k]);
            let rotation = DMat3::from_cols_array(&rows).transpose();
            let field = format!("frame {frame}: ego_R");
            let pose = numbers::motion(annotation.path(), &field, rotation, DVec3::from_slice(&translation))?;
            moment.world_from_camera = Some(pose.inverse());
        }
        if let Some((side, params, vertices)) = self.hand(&row)? {
            moment.forces[side as usize] = self.force(frame, &vertices)?;
            moment.hands[side as usize] = Some(RecordedHand::Vertices(params, vertices));
        }
        Ok(moment)
    }

    fn images(&self, from: usize) -> Result<SourceFrames<'_>> {
        let shard = Shard::open(&self.images, &["image"])?;
        let frame = move |index: usize| {
            let row = shard.row(self.frames[index]);
            let image = match row.and_then(|row| row.map(|row| row.image("image")).transpose()) {
                Err(error) if error.is_of_medium() => return Err(error),
                Err(error) => Err(error.to_string()),
                Ok(image) => image.map(EncodedImage::File).ok_or_else(|| "its row is missing".to_string()),
            };
            Ok(SourceFrame::new(self.stamp(index), image))
        };
        Ok(Box::new((from..self.frames.len()).map(frame)))
    }
    fn release(&self) {
        [&self.annotation, &self.pressure].into_iter().flatten().for_each(Shard::release);
    }
}
