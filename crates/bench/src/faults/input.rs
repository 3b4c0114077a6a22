//! Small recordings. Each image tells its recording and its number.

use std::fs;
use std::io::Write;
use std::path::Path;
use std::process::{Command, Stdio};

use candle_core::{Device, Tensor};
use candle_nn::VarMap;
use egotac::dataset::mcap::BagWriter;
use egotac::dataset::zarr::{Contact, ZarrWriter};
use egotac::dataset::{Attributes, EpisodeWriter, Frame};
use egotac::error::{Error, Result};
use egotac::hand::Topology;
use egotac::message::{Header, Image, Message, Time};
use egotac::model::{Checkpoint, Config, EgoTac, Metadata, init};
use egotac::tactile::{CONTACT_FORCE_N, N_FIELD, TactileField, Validity};
use image::{Rgb, RgbImage};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use zip::write::SimpleFileOptions;

use super::content::files;

/// Side of the images, pixels.
const SIDE: u32 = 48;
/// Images of each episode: more than a block of the labels' journal holds.
const FRAMES: usize = 80;
/// Time between two images, s.
const STEP_SECS: f64 = 0.04;

/// LeRobot data set of two episodes, as other programs write it.
const LEROBOT: [(&str, &[u8]); 5] = [
    ("meta/info.json", include_bytes!("../../../../tests/data/lerobot/image/meta/info.json")),
    ("meta/stats.json", include_bytes!("../../../../tests/data/lerobot/image/meta/stats.json")),
    ("meta/tasks.parquet", include_bytes!("../../../../tests/data/lerobot/image/meta/tasks.parquet")),
    (
        "meta/episodes/chunk-000/file-000.parquet",
        include_bytes!("../../../../tests/data/lerobot/image/meta/episodes/chunk-000/file-000.parquet"),
    ),
    (
        "data/chunk-000/file-000.parquet",
        include_bytes!("../../../../tests/data/lerobot/image/data/chunk-000/file-000.parquet"),
    ),
];

/// Draws image `index` of recording `recording`: both numbers as 16 bright or dark fields, and seeded noise.
pub fn picture(recording: u16, index: usize) -> RgbImage {
    let code = recording << 10 | index as u16;
    let mut noise = ChaCha8Rng::seed_from_u64(code.into());
    RgbImage::from_fn(SIDE, SIDE, |x, y| {
        let field = 4 * (y / (SIDE / 4)) + x / (SIDE / 4);
        let bright = if code >> field & 1 == 1 { 180 } else { 30 };
        Rgb([bright, noise.random_range(0..60), (4 * x) as u8])
    })
}

/// Writes a checkpoint of the preset `toy` with random weights, whose labels differ from image to image.
///
/// # Errors
/// If it can't be written.
pub fn checkpoint(path: &Path, seed: u64) -> Result<()> {
    checkpoint_of(path, &Config::preset("toy")?, seed)
}

/// As [`checkpoint`], of a network of any size.
///
/// # Errors
/// If it can't be written.
pub fn checkpoint_of(path: &Path, config: &Config, seed: u64) -> Result<()> {
    let vars = VarMap::new();
    EgoTac::new(config, init::var_builder(&vars, seed, &Device::Cpu))?;
    // Initial weights have gates that are zero: such a network does not look at the image.
    let named = vars.data().lock().map_err(|_| Error::file(path, "a thread panicked while it held the weights"))?;
    let mut sorted: Vec<_> = named.iter().collect();
    sorted.sort_by_key(|(name, _)| name.as_str());
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    for (_, var) in sorted {
        let noise: Vec<f32> = (0..var.elem_count()).map(|_| rng.random_range(-0.1..0.1)).collect();
        var.set(&(var.as_tensor() + Tensor::from_vec(noise, var.shape(), &Device::Cpu)?)?)?;
    }
    drop(named);
    Checkpoint::save(path, config, &Metadata::new("faults", 1.0, STEP_SECS), &vars).map(drop)
}

/// Writes a store of two episodes, with a force that follows the image's number.
///
/// # Errors
/// If it can't be written.
pub fn store(path: &Path, recording: u16) -> Result<()> {
    store_of(path, recording, 0..2 * FRAMES)
}

/// As [`store`], with the images of these numbers.
///
/// # Errors
/// If it can't be written.
pub fn store_of(path: &Path, recording: u16, images: impl IntoIterator<Item = usize>) -> Result<()> {
    let attributes = Attributes {
        topology: Topology::default(),
        sigma: 0.0,
        contact_force: f64::from(CONTACT_FORCE_N),
        producer: "egotac bench faults".into(),
        version: egotac::VERSION.into(),
        scene: String::new(),
        seed: recording.into(),
    };
    let mut writer = ZarrWriter::create(path, attributes, Contact::Truth, Vec::new())?;
    for (place, index) in images.into_iter().enumerate() {
        let force = (0..N_FIELD).map(|vertex| if vertex % 7 == index % 7 { 0.4 } else { 0.0 }).collect();
        writer.push(Frame {
            timestamp: STEP_SECS * place as f64,
            camera_ego_rgb: picture(recording, index),
            field: TactileField::from_force(Topology::default(), force)?,
            force_valid: vec![1; N_FIELD],
            contact_valid: vec![1; N_FIELD],
            validity: Validity::Valid,
            left_hand_pose: None,
            right_hand_pose: None,
        })?;
        if place % FRAMES == FRAMES - 1 {
            writer.end_episode()?;
        }
    }
    writer.finish()
}

/// Writes a store into a zip file, stored without compression.
///
/// # Errors
/// If it can't be written.
pub fn zipped(path: &Path, recording: u16) -> Result<()> {
    let folder = tempfile::tempdir().map_err(Error::io(path))?;
    let inner = folder.path().join("table.zarr");
    store(&inner, recording)?;
    let fail = |error: zip::result::ZipError| Error::file(path, error);
    let mut archive = zip::ZipWriter::new(fs::File::create(path).map_err(Error::io(path))?);
    let options = SimpleFileOptions::default().compression_method(zip::CompressionMethod::Stored);
    for (name, bytes) in files(&inner)? {
        archive.start_file(format!("table.zarr/{}", name.display()), options).map_err(fail)?;
        archive.write_all(&bytes).map_err(Error::io(path))?;
    }
    archive.finish().map_err(fail).map(drop)
}

/// Writes a bag of raw images.
///
/// # Errors
/// If it can't be written.
pub fn bag(path: &Path, recording: u16) -> Result<()> {
    let mut bag = BagWriter::create(path)?;
    let topic = "/camera/image_raw";
    bag.add_topic(topic, Image::TYPE, &Image::schema(), false)?;
    for index in 0..2 * FRAMES {
        let stamp = Time::from_nanos(1_000_000_000 + (index as f64 * STEP_SECS * 1e9) as i64);
        let header = Header { stamp, frame_id: "camera".into() };
        let (encoding, step, data) = ("rgb8".into(), 3 * SIDE, picture(recording, index).into_raw());
        let image = Image { header, height: SIDE, width: SIDE, encoding, is_bigendian: 0, step, data };
        let time = stamp.nanos() as u64;
        bag.write(topic, &image.to_cdr(), time, time)?;
    }
    bag.finish()
}

/// Writes a folder of PNG files.
///
/// # Errors
/// If one can't be written.
pub fn images(path: &Path, recording: u16) -> Result<()> {
    (0..FRAMES).try_for_each(|index| {
        egotac::file::write_png(&path.join(format!("frame_{index:03}.png")), &picture(recording, index))
    })
}

/// Writes a lossless video by ffmpeg.
///
/// # Errors
/// If ffmpeg is missing or fails.
pub fn video(path: &Path, recording: u16) -> Result<()> {
    let mut command = Command::new("ffmpeg");
    let size = format!("{SIDE}x{SIDE}");
    command.args(["-v", "error", "-f", "rawvideo", "-pix_fmt", "rgb24", "-s", &size, "-framerate", "25", "-i", "-"]);
    command.args(["-c:v", "ffv1", "-pix_fmt", "bgr0"]).arg(path).stdin(Stdio::piped());
    let mut child = command.spawn().map_err(Error::io("ffmpeg"))?;
    if let Some(mut pixels) = child.stdin.take() {
        for index in 0..FRAMES {
            pixels.write_all(picture(recording, index).as_raw()).map_err(Error::io("ffmpeg"))?;
        }
    }
    match child.wait().map_err(Error::io("ffmpeg"))?.success() {
        true => Ok(()),
        false => Err(Error::file(path, "ffmpeg could not write it")),
    }
}

/// True if ffmpeg is there.
pub fn has_ffmpeg() -> bool {
    Command::new("ffmpeg").arg("-version").stdout(Stdio::null()).status().is_ok_and(|status| status.success())
}

/// Writes a LeRobot data set with images in its rows.
///
/// # Errors
/// If it can't be written.
pub fn lerobot(path: &Path) -> Result<()> {
    LEROBOT.iter().try_for_each(|(name, bytes)| egotac::file::write(&path.join(name), bytes))
}

/// Writes a recording as H2O distributes it: both hands move over a box, in the frame of the camera.
///
/// # Errors
/// If a file can't be written.
pub fn h2o(path: &Path, recording: u16) -> Result<()> {
    let camera = path.join("cam4");
    images(&camera.join("rgb"), recording)?;
    let corners = (0..8).map(|corner| {
        let at = |axis: i32| if corner >> axis & 1 == 1 { 0.04 } else { -0.04 };
        format!("v {} {} {}\n", at(0), at(1), at(2))
    });
    let faces =
        "f 1 3 2\nf 2 3 4\nf 5 6 7\nf 6 8 7\nf 1 2 5\nf 2 6 5\nf 3 7 4\nf 4 7 8\nf 1 5 3\nf 3 5 7\nf 2 4 6\nf 4 8 6\n";
    let mesh = corners.chain([faces.into()]).collect::<String>();
    egotac::file::write(&path.join("object/spray/lotion_spray.obj"), mesh.as_bytes())?;
    for index in 0..FRAMES {
        let along = 0.002 * index as f64 - 0.08 + 0.001 * f64::from(recording);
        let hand = |x: f64| format!("1 {x} 0 0.4 0 0 {}{}", 0.01 * index as f64, " 0".repeat(55));
        let files = [
            ("hand_pose_mano", format!("{} {}", hand(along), hand(along + 0.05))),
            ("obj_pose_rt", "4 1 0 0 0 0 1 0 0 0 0 1 0.4 0 0 0 1".into()), // class 4 is the spray
        ];
        for (folder, text) in files {
            egotac::file::write(&camera.join(folder).join(format!("{index:06}.txt")), text.as_bytes())?;
        }
    }
    Ok(())
}

/// Writes a folder of recordings: two folders of images and a store.
///
/// # Errors
/// If one can't be written.
pub fn several(path: &Path, recording: u16) -> Result<()> {
    images(&path.join("left"), recording)?;
    images(&path.join("right"), recording + 1)?;
    store(&path.join("table.zarr"), recording + 2)
}
