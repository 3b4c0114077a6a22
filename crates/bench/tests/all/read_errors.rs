//! A read error of the medium (EIO) stops `egotac label` with the file's name; the same command goes on there later.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use egotac::dataset::mcap::BagWriter;
use egotac::dataset::zarr::{Contact, ZarrWriter};
use egotac::dataset::{Attributes, EpisodeWriter, Frame};
use egotac::hand::Topology;
use egotac::message::{Header, Image, Message, Time};
use egotac::tactile::{N_FIELD, TactileField, Validity};
use egotac_bench::faults::content::{self, files};
use egotac_bench::faults::inject::{CallCounts, Injection, Library};
use egotac_bench::faults::input;
use image::{RgbImage, imageops};

/// Images of a recording: several blocks of the journal, and several chunks of the file.
const FRAMES: usize = 160;
/// Side of the images, pixels.
const SIDE: u32 = 160;
/// Runs with an error, each at another read of the input.
const RUNS: u32 = 6;
/// Further runs at most, until one stops behind the first label.
const MORE_RUNS: u32 = 24;
/// Number of the error.
const EIO: &str = "5";

/// An image that differs from all others.
fn picture(index: usize) -> RgbImage {
    imageops::resize(&input::picture(1, index), SIDE, SIDE, imageops::FilterType::Nearest)
}

fn store(path: &Path) {
    let attributes: Attributes = serde_json::from_value(serde_json::json!({ "topology": "egotac-hand-1" })).unwrap();
    let mut writer = ZarrWriter::create(path, attributes, Contact::Truth, Vec::new()).unwrap();
    for index in 0..FRAMES {
        let frame = Frame {
            timestamp: 0.04 * index as f64,
            camera_ego_rgb: picture(index),
            field: TactileField::zeros(Topology::EgotacHand1),
            force_valid: vec![1; N_FIELD],
            contact_valid: vec![1; N_FIELD],
            validity: Validity::Valid,
            left_hand_pose: None,
            right_hand_pose: None,
        };
        writer.push(frame).unwrap();
    }
    writer.end_episode().unwrap();
    writer.finish().unwrap();
}

fn bag(path: &Path) {
    let mut bag = BagWriter::create(path).unwrap();
    bag.add_topic("/camera", Image::TYPE, &Image::schema(), false).unwrap();
    for index in 0..FRAMES {
        let stamp = Time::from_nanos(1_000_000_000 + 40_000_000 * index as i64);
        let header = Header { stamp, frame_id: "camera".into() };
        let (encoding, step, data) = ("rgb8".into(), 3 * SIDE, picture(index).into_raw());
        let image = Image { header, height: SIDE, width: SIDE, encoding, is_bigendian: 0, step, data };
        let time = stamp.nanos() as u64;
        bag.write("/camera", &image.to_cdr(), time, time).unwrap();
    }
    bag.finish().unwrap();
}

struct Bench {
    folder: PathBuf,
    library: Library,
    input: PathBuf,
    more: &'static [&'static str],
}

/// End of a run: status, standard output, standard error.
type Ended = (Option<i32>, serde_json::Value, String);

impl Bench {
    /// Labels the input into `out`, with an error at reads of files below `below`.
    fn label(&self, out: &Path, fault: Option<(&Injection, &Path)>) -> (Ended, CallCounts) {
        let mut command = Command::new(env!("CARGO_BIN_EXE_egotac-bench"));
        command.args(["label", "--json", "-", "--checkpoint"]).arg(self.folder.join("model.safetensors"));
        command.arg("--out").arg(out).arg(&self.input).args(self.more);
        let counts = self.folder.join("counts");
        if let Some((injection, below)) = fault {
            self.library.load(&mut command, injection, below, &counts).unwrap();
        }
        let output = command.output().unwrap();
        let told = serde_json::from_slice(&output.stdout).unwrap_or_default();
        let ended = (output.status.code(), told, String::from_utf8_lossy(&output.stderr).into_owned());
        (ended, if fault.is_some() { CallCounts::read(&counts).unwrap() } else { CallCounts::default() })
    }
}

/// Checks runs with errors at reads of the files below `part` of the input, evenly spread over all these reads.
fn read_errors_lose_nothing(name: &str, write: fn(&Path), part: &str, more: &'static [&'static str]) {
    let temp = tempfile::tempdir().unwrap();
    let folder = temp.path().canonicalize().unwrap();
    let input = folder.join("in").join(name);
    fs::create_dir(folder.join("in")).unwrap();
    write(&input);
    input::checkpoint(&folder.join("model.safetensors"), 1).unwrap();
    let below = if part.is_empty() { input.clone() } else { input.join(part) };
    let bench = Bench { library: Library::compile(&folder).unwrap(), folder: folder.clone(), input, more };
    let (whole, out) = (folder.join("whole").join(name), folder.join("out").join(name));
    let at_read = |number| Injection { calls: "read", number, action: EIO.into(), goes_on: false };
    let ((status, told, errors), counts) = bench.label(&whole, Some((&at_read(0), &below)));
    assert_eq!(status, Some(0), "{errors}");
    let frames = told["summary"]["frames"].as_u64().unwrap();
    let (expected, reads) = (files(&whole).unwrap(), counts.of("read"));
    assert!(reads >= RUNS, "{reads} reads");
    let spread = (0..RUNS).map(|run| 1 + reads * (2 * run + 1) / (2 * RUNS));
    // The input is read for its identity, for its images, for its identity again and for the copy: images in the middle.
    let around = (0..MORE_RUNS)
        .map(|run| (reads / 2 + 2).saturating_add_signed(run.div_ceil(2) as i32 * [1, -1][run as usize % 2]));
    let mut is_resumed = false;
    for (run, number) in spread.chain(around).enumerate() {
        if run >= RUNS as usize && is_resumed {
            break;
        }
        let ((status, _, errors), counts) = bench.label(&out, Some((&at_read(number), &below)));
        assert_eq!((counts.hits, status), (1, Some(1)), "read {number} of {reads}: {errors}");
        assert!(errors.contains(below.to_str().unwrap()), "read {number} of {reads}: {errors}");
        assert_eq!(errors.matches("Input/output error").count(), 1, "{errors}");
        assert!(!out.exists(), "read {number} of {reads}");
        let labelled = errors.split_once(" images of ").map_or(0, |(before, _)| {
            before.rsplit(' ').next().and_then(|count| count.parse::<u64>().ok()).unwrap_or(0)
        });
        let ((status, told, errors), _) = bench.label(&out, None);
        assert_eq!(status, Some(0), "after read {number} of {reads}: {errors}");
        assert!(files(&out).unwrap() == expected, "after read {number} of {reads}: another output");
        // The next run goes on behind the journal.
        let now = told["images_labelled_now"].as_u64().unwrap();
        assert!(now + labelled <= frames, "{labelled} of {frames} images were labelled, and then {now}");
        is_resumed |= 0 < now && now < frames;
        fs::remove_dir_all(folder.join("out")).unwrap();
    }
    assert!(is_resumed, "no run stopped within the images");
}

#[test]
fn of_a_store() {
    read_errors_lose_nothing("table.zarr", store, "data/camera_ego_rgb/3.0.0.0", &[]);
}

#[test]
fn of_a_bag() {
    read_errors_lose_nothing("table", bag, "", &[]);
}

#[test]
fn of_a_lerobot_data_set() {
    let write = |path: &Path| input::lerobot(path).unwrap();
    read_errors_lose_nothing("table", write, "data", &["--camera", content::CAMERA]);
}
