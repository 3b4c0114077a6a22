//! Speed of `egotac data import`: readers of data sets, and contact by distance.

use std::path::{Path, PathBuf};
use std::time::Instant;

use egotac::error::{Error, Result};
use egotac::hand::{HandModel, HandParams, N_VERTICES, Side};
use egotac::import::shapes::{Gaps, MeshFile, Shape};
use egotac::import::{Options, Reader, kind};
use egotac::machine::Machine;
use glam::{DAffine3, DVec3};
use serde::Serialize;

/// Largest allowed time of contact labels for one frame and hand against an object of the largest size, ms.
pub const ALLOWED_MS: f64 = 2.0;
/// Numbers of triangles of the objects.
const TRIANGLES: [usize; 3] = [1_000, 10_000, 100_000];
/// Radius of the objects, m.
const RADIUS: f64 = 0.05;
/// Shortest time of one measurement, s.
const AT_LEAST: f64 = 0.5;
/// Width and height of the images of the data sets that the command writes, pixels.
#[cfg(feature = "sim")]
const IMAGE: (u32, u32) = (640, 480);
/// Repetitions of a measurement; the best counts.
const REPETITIONS: usize = 3;

/// Results.
#[derive(Debug, Clone, Serialize)]
pub struct ImportReport {
    /// The command that measures the same again.
    pub command: String,
    /// Version of the program.
    pub version: &'static str,
    /// The machine that it was measured on.
    pub machine: Machine,
    /// Contact labels by size of the object.
    pub contact: Vec<ContactRow>,
    /// Readers by kind.
    pub readers: Vec<ReaderRow>,
}

/// Time of contact labels for one frame and hand.
#[derive(Debug, Clone, Serialize)]
pub struct ContactRow {
    /// Triangles of the object.
    pub triangles: usize,
    /// Vertices of the hand within 5 cm of the object: those whose distance is computed in full.
    pub near: usize,
    /// Time to read and prepare the mesh, ms.
    pub prepare_ms: f64,
    /// Time for one frame and hand, ms.
    pub label_ms: f64,
}

/// Speed of a reader.
#[derive(Debug, Clone, Serialize)]
pub struct ReaderRow {
    /// Kind of the data set.
    pub kind: &'static str,
    /// Frames of the data set.
    pub frames: usize,
    /// Size of its files without meshes, bytes.
    pub bytes: u64,
    /// Frames per second whose annotations were read and images decoded.
    pub reader_fps: f64,
    /// Frames per second if their files' bytes are read and nothing else.
    pub bytes_fps: f64,
}

/// Measures contact labels against objects in `folder`, and the readers of `sets`, kinds with the folders of data sets; without
/// sets, those of data sets that it writes into `folder`.
///
/// # Errors
/// If a kind is unknown, or a data set can't be read.
pub fn run(sets: &[(String, PathBuf)], folder: &Path, command: String) -> Result<ImportReport> {
    let contact = TRIANGLES.iter().map(|triangles| contact(*triangles, folder)).collect::<Result<_>>()?;
    let written = if sets.is_empty() { written(folder)? } else { Vec::new() };
    let sets =
        sets.iter().map(|(name, path)| (name.as_str(), path)).chain(written.iter().map(|(name, path)| (*name, path)));
    let readers = sets.map(|(name, path)| reader(name, path)).collect::<Result<_>>()?;
    Ok(ImportReport { command, version: egotac::VERSION, machine: Machine::this(), contact, readers })
}

/// Writes a simulated take in the layout of each data set; returns kinds and folders.
#[cfg(feature = "sim")]
fn written(folder: &Path) -> Result<Vec<(&'static str, PathBuf)>> {
    let mut take = crate::writers::take::Take::simulated();
    for (index, frame) in take.frames.iter_mut().enumerate() {
        frame.image = image::RgbImage::from_fn(IMAGE.0, IMAGE.1, |x, y| {
            // Smooth areas with edges, which JPEG and PNG compress about as much as photographs.
            let (u, v) = (x as f32 / 60.0 + index as f32, y as f32 / 45.0);
            let (wave, grain) = (60.0 * (u.sin() * v.cos()), ((x * 7919 + y * 104_729) % 13) as f32);
            let edge = if (x / 80 + y / 60) % 2 == 0 { 40.0 } else { 0.0 };
            [110.0 + wave + edge + grain, 120.0 - wave + grain, 90.0 + edge].map(|value| value as u8).into()
        });
    }
    Ok(crate::writers::write_all(folder, &take))
}

/// Without the simulator there is no take to write.
#[cfg(not(feature = "sim"))]
fn written(_: &Path) -> Result<Vec<(&'static str, PathBuf)>> {
    Ok(Vec::new())
}

/// Measures contact labels of a hand on an uneven ball.
fn contact(triangles: usize, folder: &Path) -> Result<ContactRow> {
    let path = folder.join(format!("ball_{triangles}.obj"));
    std::fs::write(&path, ball(triangles)).map_err(Error::io(&path))?;
    let started = Instant::now();
    let shape = Shape::read(&MeshFile::new(path, 1.0))?;
    let prepare_ms = 1e3 * started.elapsed().as_secs_f64();
    let vertices = HandModel::builtin(Side::Right).forward(&HandParams::default()).vertices;
    let middle = vertices.iter().map(|vertex| vertex.as_dvec3()).sum::<DVec3>() / N_VERTICES as f64;
    // The palm lies on the ball.
    let pose = DAffine3::from_translation(middle - DVec3::new(0.0, RADIUS + 0.01, 0.0));
    let mut gaps = Gaps::new(N_VERTICES);
    let label_ms = 1e3
        * seconds(|| {
            gaps = Gaps::new(N_VERTICES);
            gaps.add(&vertices, &shape, pose);
            Ok(1)
        })?;
    let near = gaps.surface.iter().filter(|distance| distance.is_finite()).count();
    Ok(ContactRow { triangles, near, prepare_ms, label_ms })
}

/// Returns an uneven ball of about so many triangles as an OBJ file.
fn ball(triangles: usize) -> String {
    let rings = ((triangles as f64 / 4.0).sqrt().round() as usize).max(2);
    let around = 2 * rings;
    let mut text = String::new();
    for ring in 0..=rings {
        let polar = std::f64::consts::PI * ring as f64 / rings as f64;
        for step in 0..around {
            let azimuth = std::f64::consts::TAU * step as f64 / around as f64;
            let radius = RADIUS * (1.0 + 0.05 * (7.0 * azimuth).sin() * polar.sin() * (5.0 * polar).cos());
            let (x, y) = (polar.sin() * azimuth.cos(), polar.sin() * azimuth.sin());
            text += &format!("v {} {} {}\n", radius * x, radius * y, radius * polar.cos());
        }
    }
    let at = |ring: usize, step: usize| 1 + ring * around + step % around;
    for ring in 0..rings {
        for step in 0..around {
            let [a, b, c, d] = [at(ring, step), at(ring + 1, step), at(ring + 1, step + 1), at(ring, step + 1)];
            if ring + 1 < rings {
                text += &format!("f {a} {b} {c}\n");
            }
            if ring > 0 {
                text += &format!("f {a} {c} {d}\n");
            }
        }
    }
    text
}

/// Measures the reader of a data set.
fn reader(name: &str, path: &Path) -> Result<ReaderRow> {
    let kind = kind(name)?;
    let found = (kind.find)(path, &Options::default())?;
    if let Some((recording, error)) = found.unreadable.into_iter().next() {
        return Err(Error::file(path, format!("{recording}: {error}")));
    }
    let frames: usize = found.readers.iter().map(|reader| reader.recording().frames).sum();
    if frames == 0 {
        return Err(Error::file(path, format!("expected a data set of kind {name}, got no recording")));
    }
    let mut files = Vec::new();
    for reader in &found.readers {
        files.extend(reader.files()?);
    }
    files.sort();
    files.dedup();
    let bytes = read(&files)?;
    let bytes_secs = seconds(|| read(&files).map(|_| frames))?;
    let reader_secs = seconds(|| found.readers.iter().map(|reader| all_frames(reader.as_ref())).sum())?;
    Ok(ReaderRow { kind: kind.name, frames, bytes, reader_fps: 1.0 / reader_secs, bytes_fps: 1.0 / bytes_secs })
}

/// Reads all moments of a recording and decodes its images; returns their number. An image that the recording lacks does not count.
fn all_frames(reader: &dyn Reader) -> Result<usize> {
    for index in 0..reader.recording().frames {
        reader.moment(index)?;
    }
    let mut frames = 0;
    for image in reader.images(0)? {
        if let Ok(image) = image?.image {
            image.decode()?;
            frames += 1;
        }
    }
    reader.release();
    Ok(frames)
}

/// Reads files whole; returns the number of bytes.
fn read(files: &[PathBuf]) -> Result<u64> {
    let there = files.iter().filter(|path| path.is_file());
    there.map(|path| std::fs::read(path).map(|content| content.len() as u64).map_err(Error::io(path))).sum()
}

/// Returns the least time of one of the units that `work` does, s; `work` returns their number.
fn seconds(mut work: impl FnMut() -> Result<usize>) -> Result<f64> {
    let mut best = f64::INFINITY;
    for _ in 0..REPETITIONS {
        let (started, mut units) = (Instant::now(), 0);
        while started.elapsed().as_secs_f64() < AT_LEAST {
            units += work()?;
        }
        best = best.min(started.elapsed().as_secs_f64() / units.max(1) as f64);
    }
    Ok(best)
}

/// Returns the report as Markdown.
pub fn markdown(report: &ImportReport) -> String {
    let ImportReport { command, version, machine, contact, readers } = report;
    let mut text = format!(
        "# Speed of imports\n\nWritten by `{command}`: egotac {version},\n{machine}. Numbers: `import.json`.\n\n\
         ## Contact labels\n\nOne hand on an uneven ball: signed distance and 1 cm rule of 778 vertices. At most {ALLOWED_MS} ms are allowed \
         at {} triangles.\n\n\
         | triangles | vertices within 5 cm | preparing the mesh, ms | label of a frame and hand, ms |\n|---|---|---|---|\n",
        TRIANGLES[TRIANGLES.len() - 1]
    );
    for ContactRow { triangles, near, prepare_ms, label_ms } in contact {
        text += &format!("| {triangles} | {near} | {prepare_ms:.1} | {label_ms:.3} |\n");
    }
    if readers.is_empty() {
        return text;
    }
    text += "\n## Readers\n\nFrames per second of one thread: annotations read and images decoded, beside reading the bytes of the same files \
             and nothing else.\nThe files are in memory. Short recordings: of a video, most of the time is the start of ffmpeg.\n\n\
             | kind | frames | kB per frame | reader, 1/s | bytes alone, 1/s |\n|---|---|---|---|---|\n";
    for ReaderRow { kind, frames, bytes, reader_fps, bytes_fps } in readers {
        let size = *bytes as f64 / 1e3 / *frames as f64;
        text += &format!("| {kind} | {frames} | {size:.0} | {reader_fps:.0} | {bytes_fps:.0} |\n");
    }
    text
}

#[cfg(all(test, feature = "sim"))]
mod tests {
    use super::*;

    #[test]
    fn the_data_sets_that_it_writes_are_read_to_their_end() {
        let folder = tempfile::tempdir().unwrap();
        let sets = written(folder.path()).unwrap();
        assert!(sets.len() > 10);
        for (name, path) in sets {
            let found = (kind(name).unwrap().find)(&path, &Options::default()).unwrap();
            assert!(found.unreadable.is_empty(), "{name}: {:?}", found.unreadable);
            let frames: usize = found.readers.iter().map(|reader| all_frames(reader.as_ref()).unwrap()).sum();
            assert!(frames > 0, "{name}");
        }
    }
}
