//! Recordings made to do harm are refused by name, in little memory and without a hang.

use std::fs::{self, File};
use std::io::{Read, Write};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use crate::common::store::write_plain_store;
use egotac::dataset::zarr::ZarrReader;
use egotac::hand::Topology;
use egotac::image::{Filter, IMAGENET_MEAN, IMAGENET_STD, Preparation, Resize};
use egotac::tactile::{N_FIELD, TactileField};
use egotac::train::data::Dataset;
use flate2::write::{GzEncoder, ZlibEncoder};
use image::{Rgb, RgbImage};
use serde_json::{Value, json};

/// Largest memory of a command, kB: 1 GB beyond what it needs for its work.
const MEMORY_KB: u64 = 1_300_000;
/// Time after which a command counts as hung; no measure of its speed.
const HUNG: Duration = Duration::from_secs(120);

/// Result of a command: status (None = killed by a signal), both outputs, and its largest memory, kB.
struct Ran {
    status: Option<i32>,
    text: String,
    memory_kb: u64,
}

fn run(arguments: &[&str]) -> Ran {
    let folder = tempfile::tempdir().unwrap();
    let to = folder.path().join("text");
    let out = File::create(&to).unwrap();
    let mut command = Command::new(env!("CARGO_BIN_EXE_egotac"));
    command.args(arguments).stdin(Stdio::null()).stdout(out.try_clone().unwrap()).stderr(out);
    let mut child = command.spawn().unwrap();
    let (started, mut memory_kb) = (Instant::now(), 0);
    let status = loop {
        let status = fs::read_to_string(format!("/proc/{}/status", child.id())).unwrap_or_default();
        let peak = status.lines().find_map(|line| line.strip_prefix("VmHWM:"));
        memory_kb = memory_kb.max(peak.map_or(0, |kb| kb.trim().trim_end_matches(" kB").parse().unwrap()));
        if let Some(status) = child.try_wait().unwrap() {
            break status.code();
        }
        if started.elapsed() > HUNG || memory_kb > 4 * MEMORY_KB {
            child.kill().unwrap();
            child.wait().unwrap();
            break None;
        }
        std::thread::sleep(Duration::from_millis(2));
    };
    Ran { status, text: fs::read_to_string(&to).unwrap(), memory_kb }
}

/// Checks that a command fails by itself, names `word` and stays small.
fn refused(arguments: &[&str], word: &str) {
    let Ran { status, text, memory_kb } = run(arguments);
    assert!(matches!(status, Some(1 | 3)), "{arguments:?}: {status:?} {text}");
    assert!(text.contains(word) && !text.contains("panicked"), "{word} is not in: {text}");
    assert!(memory_kb < MEMORY_KB, "{arguments:?}: {memory_kb} kB");
}

/// Writes an intact store of four frames.
fn store(path: &Path) {
    write_plain_store(path, &[4], 0.04, |index| {
        let image = RgbImage::from_fn(60, 40, |x, y| Rgb([10 * index as u8 + x as u8, y as u8, 200 - x as u8]));
        (image, TactileField::zeros(Topology::EgotacHand1))
    });
}

fn edit(store: &Path, array: &str, change: impl FnOnce(&mut Value)) {
    let file = store.join(array).join(".zarray");
    let mut metadata: Value = serde_json::from_slice(&fs::read(&file).unwrap()).unwrap();
    change(&mut metadata);
    fs::write(file, metadata.to_string()).unwrap();
}

#[test]
fn shapes_without_chunks_behind_them_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.zarr");
    let name = path.to_str().unwrap();
    let fresh = || {
        let _ = fs::remove_dir_all(&path);
        store(&path);
    };
    for power in [28, 34, 40, 62] {
        for chunk in [1u64 << power, 1] {
            fresh();
            fs::remove_file(path.join("meta/episode_ends/0")).unwrap();
            edit(&path, "meta/episode_ends", |array| {
                (array["shape"], array["chunks"]) = (json!([1u64 << power]), json!([chunk]))
            });
            refused(&["data", "info", name], "meta/episode_ends");
        }
    }
    for side in [1u64 << 15, 1 << 20, 1 << 31, 1 << 62] {
        fresh();
        let _ = fs::remove_file(path.join("data/camera_ego_rgb/0.0.0.0"));
        edit(&path, "data/camera_ego_rgb", |array| {
            (array["shape"], array["chunks"]) = (json!([4, side, side, 3]), json!([4, side, side, 3]));
        });
        refused(&["data", "info", name], "image size");
    }
    // All arrays agree on a number of frames, of which no image exists.
    fresh();
    let frames = 1u64 << 23;
    for entry in fs::read_dir(path.join("data")).unwrap() {
        let entry = entry.unwrap();
        if !entry.path().is_dir() {
            continue;
        }
        let array = format!("data/{}", entry.file_name().to_str().unwrap());
        edit(&path, &array, |array| array["shape"][0] = json!(frames));
    }
    fs::write(path.join("meta/episode_ends/0"), frames.to_le_bytes()).unwrap();
    refused(&["data", "info", name], "camera_ego_rgb: expected 8388608 images");
}

#[test]
fn chunks_that_decompress_to_more_than_their_shape_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.zarr");
    store(&path);
    let chunk = path.join("data/timestamps/0");
    let zeros = |to: &mut dyn Write| std::io::copy(&mut std::io::repeat(0).take(1 << 30), to).unwrap();
    let mut blosc = vec![2, 1, 0x33, 8];
    [1u32 << 30, 1 << 18, 1 << 10].iter().for_each(|size| blosc.extend_from_slice(&size.to_le_bytes()));
    blosc.resize(1 << 10, 0);
    for id in ["gzip", "zlib", "zstd", "blosc"] {
        let bytes = match id {
            "gzip" => {
                let mut encoder = GzEncoder::new(Vec::new(), flate2::Compression::fast());
                zeros(&mut encoder);
                encoder.finish().unwrap()
            }
            "zlib" => {
                let mut encoder = ZlibEncoder::new(Vec::new(), flate2::Compression::fast());
                zeros(&mut encoder);
                encoder.finish().unwrap()
            }
            "zstd" => {
                let mut encoder = zstd::Encoder::new(Vec::new(), 1).unwrap();
                zeros(&mut encoder);
                encoder.finish().unwrap()
            }
            _ => blosc.clone(),
        };
        fs::write(&chunk, bytes).unwrap();
        let compressor = match id {
            "blosc" => json!({ "id": id, "cname": "lz4", "clevel": 1, "shuffle": 0, "blocksize": 0 }),
            _ => json!({ "id": id, "level": 1 }),
        };
        edit(&path, "data/timestamps", |array| array["compressor"] = compressor);
        refused(&["data", "info", path.to_str().unwrap()], "data/timestamps");
    }
}

#[test]
fn training_reads_planar_images_as_every_other_command_does() {
    let folder = tempfile::tempdir().unwrap();
    let [rows, planes] = ["rows.zarr", "planes.zarr"].map(|name| folder.path().join(name));
    store(&rows);
    store(&planes);
    // The images as (T, 3, H, W).
    let chunk = planes.join("data/camera_ego_rgb/0.0.0.0");
    let pixels = fs::read(&chunk).unwrap();
    let size = 60 * 40;
    let frames = pixels.chunks_exact(3 * size);
    let planar = frames.flat_map(|frame| (0..3).flat_map(move |c| (0..size).map(move |i| frame[3 * i + c])));
    fs::write(&chunk, planar.collect::<Vec<u8>>()).unwrap();
    edit(&planes, "data/camera_ego_rgb", |array| {
        (array["shape"], array["chunks"]) = (json!([4, 3, 40, 60]), json!([4, 3, 40, 60]));
    });
    let preparation = Preparation {
        side: 32,
        resize: Resize::Crop,
        filter: Filter::Triangle,
        mean: IMAGENET_MEAN,
        std: IMAGENET_STD,
    };
    let [a, b] = [&rows, &planes].map(|path| {
        let reader = ZarrReader::open(path).unwrap();
        let images: Vec<RgbImage> = (0..4).map(|frame| reader.image(frame).unwrap()).collect();
        assert_eq!(reader.images(1..3).unwrap(), images[1..3]);
        let seen = |in_memory| {
            let reader = ZarrReader::open(path).unwrap();
            let data = Dataset::new(vec![reader], preparation.clone(), in_memory).unwrap();
            data.read(0, 0..4, false).unwrap().images
        };
        assert_eq!(seen(false), seen(true));
        (images, seen(false))
    });
    assert_eq!(a, b);
    assert_eq!(a.0[2].get_pixel(5, 7), &Rgb([25, 7, 195]));
    // `predict` (and `eval --checkpoint`, which calls it).
    let fields = [&rows, &planes].map(|path| {
        let out = path.with_extension("safetensors");
        let done = run(&["predict", "--data", path.to_str().unwrap(), "--out", out.to_str().unwrap()]);
        assert_eq!(done.status, Some(0), "{}", done.text);
        fs::read(out).unwrap()
    });
    assert_eq!(fields[0], fields[1]);
}

/// Writes an MCAP file of one chunk that states `wanted` bytes.
fn chunk_file(path: &Path, compression: &str, wanted: u64, data: &[u8]) {
    let mut file = mcap::MAGIC.to_vec();
    let mut record = |opcode: u8, body: &[u8]| {
        file.push(opcode);
        file.extend_from_slice(&(body.len() as u64).to_le_bytes());
        file.extend_from_slice(body);
    };
    record(1, &[0; 8]);
    let mut body = [0u64, 0, wanted].map(u64::to_le_bytes).concat();
    body.extend_from_slice(&[0; 4]);
    body.extend_from_slice(&(compression.len() as u32).to_le_bytes());
    body.extend_from_slice(compression.as_bytes());
    body.extend_from_slice(&(data.len() as u64).to_le_bytes());
    body.extend_from_slice(data);
    record(6, &body);
    record(15, &[0; 4]);
    fs::write(path, file).unwrap();
}

#[test]
fn bags_whose_chunks_or_records_are_bombs_take_little_memory() {
    const GIB: u64 = 1 << 30;
    let folder = tempfile::tempdir().unwrap();
    let zeros = |to: &mut dyn Write| std::io::copy(&mut std::io::repeat(0).take(2 * GIB), to).unwrap();
    let mut encoder = zstd::Encoder::new(Vec::new(), 1).unwrap();
    zeros(&mut encoder);
    let zstd = encoder.finish().unwrap();
    let mut encoder = lz4::EncoderBuilder::new().build(Vec::new()).unwrap();
    zeros(&mut encoder);
    let lz4 = encoder.finish().0;
    for (compression, data) in [("zstd", &zstd), ("lz4", &lz4)] {
        for wanted in [2 * GIB, 100, u64::MAX] {
            let path = folder.path().join("a.mcap");
            chunk_file(&path, compression, wanted, data);
            let out = folder.path().join("out");
            refused(&["label", path.to_str().unwrap(), "--out", out.to_str().unwrap()], "sensor_msgs/msg/Image");
        }
    }
    // One record of 3 GB, nearly all of it a hole.
    let path = folder.path().join("sparse.mcap");
    let mut file = File::create(&path).unwrap();
    file.write_all(mcap::MAGIC).unwrap();
    file.write_all(&[12]).unwrap();
    file.write_all(&(3 * GIB).to_le_bytes()).unwrap();
    file.set_len(8 + 9 + 3 * GIB).unwrap();
    let done = run(&["data", "info", path.to_str().unwrap()]);
    assert!(done.status.is_some() && done.memory_kb < MEMORY_KB, "{} {} kB", done.text, done.memory_kb);
}

#[test]
fn a_cell_that_decompresses_to_much_more_is_refused() {
    use arrow_array::{ArrayRef, BinaryArray, Float64Array, RecordBatch, StructArray};
    use parquet::arrow::ArrowWriter;
    use parquet::basic::Compression;
    use parquet::file::properties::WriterProperties;
    use std::sync::Arc;

    let folder = tempfile::tempdir().unwrap();
    let data = copied("image", folder.path());
    let rows = data.join("data/chunk-000/file-000.parquet");
    let cell = vec![0u8; 300 << 20];
    let bytes: ArrayRef = Arc::new(BinaryArray::from(vec![&cell[..], b"x"]));
    let field = Arc::new(arrow_schema::Field::new("bytes", bytes.data_type().clone(), true));
    let times: ArrayRef = Arc::new(Float64Array::from(vec![0.0, 0.1]));
    let image: ArrayRef = Arc::new(StructArray::from(vec![(field, bytes)]));
    let camera =
        info(&data)["features"].as_object().unwrap().iter().find(|(_, f)| f["dtype"] == "image").unwrap().0.clone();
    let batch = RecordBatch::try_from_iter([("timestamp", times), (camera.as_str(), image)]).unwrap();
    let properties =
        WriterProperties::builder().set_compression(Compression::SNAPPY).set_dictionary_enabled(false).build();
    let mut writer = ArrowWriter::try_new(File::create(&rows).unwrap(), batch.schema(), Some(properties)).unwrap();
    writer.write(&batch).unwrap();
    writer.close().unwrap();
    let out = folder.path().join("out");
    let [input, out] = [&data, &out].map(|path| path.to_str().unwrap());
    refused(&["label", input, "--camera", &camera, "--out", out], "EGOTAC_LIMIT_CHUNK_BYTES");
}

/// Copies a LeRobot data set of the tests.
fn copied(name: &str, folder: &Path) -> PathBuf {
    let to = folder.join(name);
    egotac::dataset::copy_folder(&Path::new("tests/data/lerobot").join(name), &to, false).unwrap();
    to
}

fn info(data: &Path) -> Value {
    serde_json::from_slice(&fs::read(data.join("meta/info.json")).unwrap()).unwrap()
}

#[test]
fn names_in_a_data_set_lead_to_no_other_file() {
    let folder = tempfile::tempdir().unwrap();
    let video =
        fs::canonicalize("tests/data/lerobot/video/videos/observation.images.head/chunk-000/file-000.mp4").unwrap();
    fs::copy(&video, folder.path().join("secret.mp4")).unwrap();
    let data = copied("video", folder.path());
    // An output of its own for each: labels of a data set before it changed would be refused for that.
    let mut outs = (0..).map(|index| folder.path().join(format!("out{index}")).to_str().unwrap().to_owned());
    let mut label_refused = |input: &Path, word: &str| {
        refused(&["label", input.to_str().unwrap(), "--out", &outs.next().unwrap()], word);
    };
    for (key, name) in [
        ("video_path", "../secret.mp4"),
        ("video_path", video.to_str().unwrap()),
        ("data_path", "/etc/passwd"),
        ("data_path", "data/../../other.parquet"),
    ] {
        let mut changed = info(&data);
        changed[key] = name.into();
        fs::write(data.join("meta/info.json"), changed.to_string()).unwrap();
        label_refused(&data, "expected names of files inside this folder");
        let _ = fs::remove_dir_all(&data);
        copied("video", folder.path());
    }
    // A link out of the data set, in place of a video.
    let inside = data.join("videos/observation.images.head/chunk-000/file-000.mp4");
    fs::remove_file(&inside).unwrap();
    std::os::unix::fs::symlink(&video, &inside).unwrap();
    label_refused(&data, "--follow-links");
    // Playlists called videos.
    let list = folder.path().join("list.mp4");
    for text in [
        format!("#EXTM3U\n#EXT-X-TARGETDURATION:9\n#EXTINF:9,\n{}\n#EXT-X-ENDLIST\n", video.display()),
        format!("ffconcat version 1.0\nfile {}\n", video.display()),
    ] {
        fs::write(&list, text).unwrap();
        label_refused(&list, "expected a video");
    }
}

#[test]
fn pipes_and_devices_are_refused_at_once() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.zarr");
    let [out, labelled] = ["fields.safetensors", "labelled"].map(|name| folder.path().join(name));
    let pipe = |at: &Path| {
        let _ = fs::remove_file(at);
        assert!(Command::new("mkfifo").arg(at).status().unwrap().success());
    };
    let zero = |at: &Path| {
        let _ = fs::remove_file(at);
        std::os::unix::fs::symlink("/dev/zero", at).unwrap();
    };
    for special in [&pipe as &dyn Fn(&Path), &zero] {
        let _ = fs::remove_dir_all(&path);
        store(&path);
        special(&path.join("data/camera_ego_rgb/0.0.0.0"));
        refused(&["predict", "--data", path.to_str().unwrap(), "--out", out.to_str().unwrap()], "0.0.0.0");
        let data = copied("image", folder.path());
        special(&data.join("data/chunk-000/file-000.parquet"));
        refused(
            &[
                "label",
                data.to_str().unwrap(),
                "--camera",
                "observation.images.head",
                "--out",
                labelled.to_str().unwrap(),
            ],
            "file-000.parquet",
        );
        fs::remove_dir_all(&data).unwrap();
        for name in ["a.mp4", "a.mcap", "a.safetensors"] {
            let file = folder.path().join(name);
            special(&file);
            refused(&["report", file.to_str().unwrap(), "--out", out.to_str().unwrap()], name);
            refused(&["data", "info", file.to_str().unwrap()], name);
            fs::remove_file(&file).unwrap();
        }
    }
}

#[test]
fn a_report_on_more_frames_than_there_are_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.safetensors");
    let field = vec![0; 3 * N_FIELD * 4];
    let ends = 100i64.to_le_bytes();
    let tensor =
        |dtype, shape: &[usize], data| safetensors::tensor::TensorView::new(dtype, shape.to_vec(), data).unwrap();
    let [force, ends] =
        [tensor(safetensors::Dtype::F32, &[3, N_FIELD], &field[..]), tensor(safetensors::Dtype::I64, &[1], &ends)];
    fs::write(&path, safetensors::serialize([("force", force), ("episode_ends", ends)], None).unwrap()).unwrap();
    refused(
        &["report", path.to_str().unwrap(), "--out", folder.path().join("a.html").to_str().unwrap()],
        "episode_ends",
    );
}

#[test]
fn output_to_a_full_disk_is_an_error() {
    let full = File::options().write(true).open("/dev/full").unwrap();
    let mut command = Command::new(env!("CARGO_BIN_EXE_egotac"));
    command.args(["data", "info", "tests/data/oxt/task.zarr.zip"]).stdout(full).stderr(Stdio::piped());
    let done = command.output().unwrap();
    let text = String::from_utf8(done.stderr).unwrap();
    assert_eq!(done.status.code(), Some(1), "{text}");
    assert!(text.starts_with("egotac: standard output: No space left on device"), "{text}");
}

#[test]
fn a_deflated_zip_store_reads_as_a_stored_one() {
    let folder = tempfile::tempdir().unwrap();
    let deflated = folder.path().join("task.zarr.zip");
    let stored = Path::new("tests/data/oxt/task.zarr.zip");
    let mut from = zip::ZipArchive::new(File::open(stored).unwrap()).unwrap();
    let mut to = zip::ZipWriter::new(File::create(&deflated).unwrap());
    for index in 0..from.len() {
        let mut entry = from.by_index(index).unwrap();
        if entry.is_dir() {
            continue;
        }
        let options = zip::write::SimpleFileOptions::default().compression_method(zip::CompressionMethod::Deflated);
        to.start_file(entry.name().unwrap().to_string(), options).unwrap();
        std::io::copy(&mut entry, &mut to).unwrap();
    }
    to.finish().unwrap();
    let [a, b] = [stored, &deflated].map(|path| ZarrReader::open(path).unwrap());
    assert_eq!(a.arrays(), b.arrays());
    assert_eq!(a.images(0..a.len()).unwrap(), b.images(0..b.len()).unwrap());
}
