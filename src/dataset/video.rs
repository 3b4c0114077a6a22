//! Frames of video files, decoded by the program ffmpeg.

mod camera;
mod demuxer;
mod images;

use std::collections::VecDeque;
use std::io::{BufRead, BufReader, ErrorKind, Read};
use std::os::unix::process::ExitStatusExt;
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStderr, ChildStdout, Command, Stdio};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::thread::JoinHandle;

use ::image::RgbImage;
use serde_json::Value;

use crate::error::{Error, Result};
use crate::file::input;
use crate::file::limits;
use crate::image::check_size;

pub use camera::CameraFrames;
pub(crate) use images::VideoFile;

/// Extensions of video files.
pub const EXTENSIONS: [&str; 8] = ["mp4", "mkv", "mov", "avi", "webm", "m4v", "mpg", "mpeg"];
/// Exit status of ffmpeg if it could decode few frames of a damaged file.
const MANY_ERRORS: i32 = 69;
/// Number of ffmpeg's last error messages that are searched for failures of the medium.
const HEARD_ERRORS: usize = 16;
/// Messages of ffmpeg for errors of the operating system. They do not mean that the file is damaged.
const MEDIUM: [&str; 5] = [
    "Input/output error",
    "Cannot allocate memory",
    "Too many open files",
    "Stale file handle",
    "Connection timed out",
];
/// Number of ffprobe's error messages that are reported.
const KEPT_ERRORS: usize = 3;

/// Properties of the first video stream of a file.
#[derive(Debug, Clone, PartialEq)]
pub struct Video {
    /// Width and height before any rotation, pixels.
    pub size: (u32, u32),
    /// Average frame rate, 1/s; None = not stated.
    pub fps: Option<f64>,
    /// Number of frames; None = not stated.
    pub frames: Option<usize>,
    /// Codec, for instance `h264`.
    pub codec: String,
}

/// Damage of a file whose end is missing or unreadable.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Damage {
    /// End of the last complete packet, bytes.
    pub offset: u64,
    /// Messages of the demultiplexer.
    pub reason: String,
}

/// Reads the properties of the file at `path` by ffprobe.
///
/// # Errors
/// If ffprobe is not installed, or finds no video.
pub fn probe(path: &Path) -> Result<Video> {
    let entries = "stream=width,height,codec_name,avg_frame_rate,r_frame_rate,nb_frames";
    let mut text = Vec::new();
    let errors = ffprobe(path, &["-show_entries", entries, "-of", "json"], |words| {
        // An output that breaks off is no JSON.
        let _ = words.take(limits::TEXT.value()).read_to_end(&mut text);
    })?;
    let json: Value = serde_json::from_slice(&text).unwrap_or(Value::Null);
    let stream = &json["streams"][0];
    let side = |name: &str| stream[name].as_u64().and_then(|n| u32::try_from(n).ok()).filter(|n| *n > 0);
    let (Some(width), Some(height)) = (side("width"), side("height")) else {
        let reason = if errors.is_empty() { "ffprobe finds no video in it".into() } else { errors.join("; ") };
        return Err(Error::file(path, reason));
    };
    check_size(width.into(), height.into()).map_err(|error| Error::file(path, error))?;
    let rate = |name: &str| {
        let (over, under) = stream[name].as_str()?.split_once('/')?;
        let fps = over.parse::<f64>().ok()? / under.parse::<f64>().ok()?;
        (fps.is_finite() && fps > 0.0).then_some(fps)
    };
    Ok(Video {
        size: (width, height),
        fps: rate("avg_frame_rate").or_else(|| rate("r_frame_rate")),
        frames: stream["nb_frames"].as_str().and_then(|n| n.parse().ok()),
        codec: stream["codec_name"].as_str().unwrap_or_default().to_string(),
    })
}

/// Searches all packets of the file for damage, without decoding them. `decoded` is the number of frames that could be
/// decoded.
///
/// # Errors
/// If ffprobe is not installed.
pub fn damage(path: &Path, decoded: usize) -> Result<Option<Damage>> {
    let promised = probe(path)?.frames.unwrap_or(0);
    let (mut packets, mut offset) = (0, 0);
    // A line for each packet, such as `size=512|pos=48`: those of a long video do not fit into memory together.
    let errors = ffprobe(path, &["-show_entries", "packet=pos,size", "-of", "compact=p=0"], |words| {
        for line in BufReader::new(words).split(b'\n').map_while(std::result::Result::ok) {
            let line = String::from_utf8_lossy(&line);
            let number = |name: &str| line.split('|').find_map(|field| field.strip_prefix(name)?.parse::<u64>().ok());
            packets += usize::from(!line.trim().is_empty());
            offset = offset.max(number("pos=").zip(number("size=")).map_or(0, |(pos, size)| pos.saturating_add(size)));
        }
    })?;
    let expected = promised.max(packets);
    if errors.is_empty() && decoded >= expected {
        return Ok(None);
    }
    let counts = format!("{decoded} of {expected} images could be decoded");
    let reason = [vec![counts], errors].concat().join("; ");
    Ok(Some(Damage { offset, reason }))
}

/// Runs ffprobe on the first video stream; `read` takes its output. Returns its first error messages.
fn ffprobe(path: &Path, arguments: &[&str], read: impl FnOnce(ChildStdout)) -> Result<Vec<String>> {
    drop(input::open(path)?);
    let mut command = Command::new("ffprobe");
    command.args(["-v", "error", "-select_streams", "v:0"]).args(arguments).args(demuxer::arguments(path)?);
    command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
    let mut process = command.spawn().map_err(|error| not_installed("ffprobe", path, &error))?;
    let errors = process.stderr.take().map(|words| {
        std::thread::spawn(move || {
            let lines = BufReader::new(words).split(b'\n').map_while(std::result::Result::ok);
            // Take all lines, so that ffprobe is not held up, and keep the first.
            lines.enumerate().filter(|(index, _)| *index < KEPT_ERRORS).map(|(_, line)| line).collect::<Vec<_>>()
        })
    });
    if let Some(words) = process.stdout.take() {
        read(words);
    }
    process.wait().map_err(Error::io(path))?;
    let errors = errors.and_then(|errors| errors.join().ok()).unwrap_or_default();
    Ok(errors.iter().map(|line| without_tags(&String::from_utf8_lossy(line))).collect())
}

/// Frames of a video in display order, with their times.
#[derive(Debug)]
pub struct VideoFrames {
    path: PathBuf,
    process: Child,
    pixels: BufReader<ChildStdout>,
    stamps: Receiver<f64>,
    /// Reads what ffmpeg says; returns its last error messages.
    listener: Option<JoinHandle<Vec<String>>>,
    frames: usize,
    done: bool,
}

impl VideoFrames {
    /// Decodes the file at `path` from `start` seconds on; None = from the beginning. Earlier frames are left out; times are
    /// those of the file.
    ///
    /// # Errors
    /// If ffmpeg is not installed.
    pub fn open(path: &Path, start: Option<f64>) -> Result<Self> {
        drop(input::open(path)?);
        let mut command = Command::new("ffmpeg");
        command.args(["-nostdin", "-hide_banner", "-nostats", "-loglevel", "level+info"]);
        if let Some(start) = start {
            // ffmpeg seeks to the key frame before `start` and drops the frames in between.
            command.args(["-ss", &format!("{start:.6}")]);
        }
        // One thread: several hide damage in the order in which they come upon it, so that an image would differ between the
        // pass that labels it and the pass that copies it.
        command.args(["-threads", "1"]);
        command.arg("-copyts").args(demuxer::arguments(path)?).args(["-map", "0:v:0", "-vf", "showinfo=checksum=0"]);
        // Passthrough: ffmpeg must neither repeat nor drop frames to reach an even rate.
        command.args([if has_fps_mode() { "-fps_mode" } else { "-vsync" }, "passthrough"]);
        // Of videos with more than 8 bits per channel, PPM files would have 16.
        command.args(["-f", "image2pipe", "-c:v", "ppm", "-pix_fmt", "rgb24", "-"]);
        command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
        let mut process = command.spawn().map_err(|error| not_installed("ffmpeg", path, &error))?;
        let (Some(pixels), Some(words)) = (process.stdout.take(), process.stderr.take()) else {
            return Err(Error::file(path, "ffmpeg's output can't be read"));
        };
        let (to_frames, stamps) = channel();
        let listener = std::thread::spawn(move || listen(words, &to_frames));
        let pixels = BufReader::with_capacity(1 << 20, pixels);
        let path = path.to_path_buf();
        Ok(Self { path, process, pixels, stamps, listener: Some(listener), frames: 0, done: false })
    }

    fn read(&mut self) -> Result<Option<(f64, RgbImage)>> {
        let image = read_ppm(&mut self.pixels);
        if let Err(error) = &image
            && error.kind() == ErrorKind::InvalidData
        {
            // ffmpeg would wait for ever for a reader of its next images. An error means that it has ended.
            let _ = self.process.kill();
            return Err(Error::file(&self.path, error));
        }
        let Ok(Some(image)) = image else {
            // How ffmpeg ended says more than the output that it left.
            self.end()?;
            return image.map(|_| None).map_err(Error::io(&self.path));
        };
        let Ok(stamp) = self.stamps.recv() else {
            self.end()?;
            return Err(Error::file(&self.path, "ffmpeg gave a frame without a time"));
        };
        self.frames += 1;
        Ok(Some((stamp, image)))
    }

    /// Checks that ffmpeg came to the end of the file: that it was not killed, did not fail, and could read the file.
    /// Damaged content is not a failure; [`damage`] reports it.
    fn end(&mut self) -> Result<()> {
        let status = self.process.wait().map_err(Error::io(&self.path))?;
        let errors = self.listener.take().and_then(|listener| listener.join().ok()).unwrap_or_default();
        let last = errors.last().map_or(String::new(), |error| format!(": {error}"));
        let fails =
            |how: String| Err(Error::file(&self.path, format!("ffmpeg {how} after {} images{last}", self.frames)));
        match (status.code(), status.signal()) {
            (_, Some(signal)) => return fails(format!("was ended by signal {signal}")),
            (Some(0 | MANY_ERRORS), _) => {}
            _ => return fails(format!("failed with {status}")),
        }
        // ffmpeg ends well where a file can't be read further.
        if let Some(error) = errors.iter().find(|error| MEDIUM.iter().any(|medium| error.contains(medium))) {
            return Err(Error::file(
                &self.path,
                format!("ffmpeg could not read on after {} images: {error}", self.frames),
            ));
        }
        Ok(())
    }
}

/// Sends the times of the frames in ffmpeg's messages; returns the last error messages.
fn listen(words: ChildStderr, stamps: &Sender<f64>) -> Vec<String> {
    let (mut time_base, mut errors) = (None, VecDeque::new());
    for line in BufReader::new(words).split(b'\n').map_while(std::result::Result::ok) {
        let line = String::from_utf8_lossy(&line);
        if let Some(base) = after(&line, "config in time_base:").and_then(fraction) {
            time_base = Some(base);
        }
        if let Some(stamp) = stamp(&line, time_base)
            && stamps.send(stamp).is_err()
        {
            break;
        }
        if line.contains("[error]") || line.contains("[fatal]") {
            errors.push_back(without_tags(&line));
            if errors.len() > HEARD_ERRORS {
                errors.pop_front();
            }
        }
    }
    errors.into()
}

impl Iterator for VideoFrames {
    type Item = Result<(f64, RgbImage)>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.done {
            return None;
        }
        let frame = self.read().transpose();
        self.done = !matches!(frame, Some(Ok(_)));
        frame
    }
}

impl Drop for VideoFrames {
    fn drop(&mut self) {
        // Errors mean that the process has ended already.
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

/// Returns the time of the frame in a line of the filter `showinfo`, s; NaN if the frame has no time.
fn stamp(line: &str, time_base: Option<(f64, f64)>) -> Option<f64> {
    if !line.contains("showinfo") || after(line, " n:").is_none() {
        return None;
    }
    let pts = after(line, " pts:")?.split_whitespace().next()?;
    // Not `pts_time`: its six digits are too few after an hour.
    match (pts.parse::<i64>(), time_base) {
        // Divide last, so that the result is the f64 nearest to the fraction.
        (Ok(pts), Some((over, under))) => Some(pts as f64 * over / under),
        _ => Some(f64::NAN),
    }
}

fn after<'a>(line: &'a str, mark: &str) -> Option<&'a str> {
    line.find(mark).map(|at| line[at + mark.len()..].trim_start())
}

fn fraction(text: &str) -> Option<(f64, f64)> {
    let (over, rest) = text.split_once('/')?;
    let under: String = rest.chars().take_while(char::is_ascii_digit).collect();
    Some((over.parse().ok()?, under.parse().ok()?))
}

/// Reads the next image of a stream of binary PPM files; None at the end.
fn read_ppm(reader: &mut impl BufRead) -> std::io::Result<Option<RgbImage>> {
    let invalid = |what: &str| std::io::Error::new(ErrorKind::InvalidData, format!("ffmpeg's output: {what}"));
    let mut head = Vec::new();
    // Three lines: format, width and height, largest value.
    for _ in 0..3 {
        if reader.by_ref().take(64).read_until(b'\n', &mut head)? == 0 {
            return if head.is_empty() { Ok(None) } else { Err(invalid("an image that is cut off")) };
        }
    }
    let head = String::from_utf8_lossy(&head);
    let words: Vec<&str> = head.split_whitespace().collect();
    let ["P6", width, height, "255"] = words[..] else { return Err(invalid("no image")) };
    let (Ok(width), Ok(height)) = (width.parse::<u32>(), height.parse::<u32>()) else {
        return Err(invalid("an image's size"));
    };
    check_size(width.into(), height.into()).map_err(|error| invalid(&error.to_string()))?;
    let mut pixels = vec![0; width as usize * height as usize * 3];
    reader.read_exact(&mut pixels)?;
    Ok(RgbImage::from_raw(width, height, pixels))
}

fn without_tags(line: &str) -> String {
    // `[mov,mp4 @ 0x55d0] moov atom not found`: strip the address, which varies per run.
    line.split_once("] ").map_or(line, |(_, rest)| rest).to_string()
}

fn not_installed(program: &str, path: &Path, error: &std::io::Error) -> Error {
    Error::file(path, format!("{program}, which reads videos, can't be run ({error}); install the package ffmpeg"))
}

/// True if ffmpeg has the option `-fps_mode`, which replaced `-vsync` in version 5.1.
fn has_fps_mode() -> bool {
    let Ok(output) = Command::new("ffmpeg").arg("-version").stdin(Stdio::null()).output() else { return true };
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    let version = text.split_whitespace().nth(2).unwrap_or_default();
    let mut numbers = version.split(|c: char| !c.is_ascii_digit()).map(str::parse::<u32>);
    // A version without a number is a recent build from source.
    !matches!((numbers.next(), numbers.next()), (Some(Ok(major)), Some(Ok(minor))) if (major, minor) < (5, 1))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_of_showinfo_give_exact_times() {
        let line = "[Parsed_showinfo_0 @ 0x5581] [info] n:   7 pts: 123456 pts_time:1.37173 pos:   4000 fmt:yuv420p";
        assert_eq!(stamp(line, Some((1.0, 90_000.0))), Some(123_456.0 / 90_000.0));
        assert!(
            stamp("[Parsed_showinfo_0 @ 0x5581] [info] n:   7 pts: NOPTS pts_time:NOPTS", Some((1.0, 2.0)))
                .unwrap()
                .is_nan()
        );
        assert_eq!(stamp("[info] Stream #0:0: Video: h264, 25 fps", Some((1.0, 2.0))), None);
        let config = "[Parsed_showinfo_0 @ 0x55] [info] config in time_base: 1/12800, frame_rate: 25/1";
        assert_eq!(after(config, "config in time_base:").and_then(fraction), Some((1.0, 12_800.0)));
    }

    #[test]
    fn images_come_one_after_the_other_and_a_cut_one_is_an_error() {
        let bytes = b"P6\n2 1\n255\nabcdefP6\n1 1\n255\nghiP6\n1 ";
        let mut reader = &bytes[..];
        assert_eq!(read_ppm(&mut reader).unwrap().unwrap().into_raw(), b"abcdef");
        assert_eq!(read_ppm(&mut reader).unwrap().unwrap().into_raw(), b"ghi");
        assert!(read_ppm(&mut reader).is_err());
    }
}
