//! Recordings made to do harm are refused by name, in little memory and without a hang.

use std::fs::{self, File};
use std::io::{Read, Write};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use crate::common::{MEMORY_KB, Ran, measured, refused_small, small_store};
use egotac::message::{self, Message};
use egotac::tactile::N_FIELD;
use image::RgbImage;
use serde_json::Value;

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
            refused_small(&["label", path.to_str().unwrap(), "--out", out.to_str().unwrap()], "sensor_msgs/msg/Image");
        }
    }
    // One record of 3 GB, nearly all of it a hole.
    let path = folder.path().join("sparse.mcap");
    let mut file = File::create(&path).unwrap();
    file.write_all(mcap::MAGIC).unwrap();
    file.write_all(&[12]).unwrap();
    file.write_all(&(3 * GIB).to_le_bytes()).unwrap();
    file.set_len(8 + 9 + 3 * GIB).unwrap();
    let done = measured(&["data", "info", path.to_str().unwrap()]);
    assert!(done.status.is_some() && done.memory_kb < MEMORY_KB, "{} {} kB", done.text, done.memory_kb);
}

#[test]
fn images_of_a_chunk_are_decoded_one_by_one() {
    const IMAGES: u32 = 76;
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    let options = mcap::WriteOptions::new().profile("ros2").chunk_size(Some(1 << 30));
    let mut writer = options.create(File::create(&path).unwrap()).unwrap();
    let schema = writer.add_schema(message::Image::TYPE, "ros2msg", message::Image::schema().as_bytes()).unwrap();
    let channel_id = writer.add_channel(schema, "/image", "cdr", &Default::default()).unwrap();
    for sequence in 0..IMAGES {
        let stamp = message::Time { sec: 1, nanosec: 1000 * sequence };
        let header = message::Header { stamp, frame_id: String::new() };
        let payload = message::Image::from_rgb(header, &RgbImage::new(1024, 1024)).to_cdr();
        let time = u64::from(sequence);
        let header = mcap::records::MessageHeader { channel_id, sequence, log_time: time, publish_time: time };
        writer.write_to_known_channel(&header, &payload).unwrap();
    }
    writer.finish().unwrap();
    let out = folder.path().join("out");
    let Ran { status, text, memory_kb } = measured(&["label", path.to_str().unwrap(), "--out", out.to_str().unwrap()]);
    assert!(status == Some(0) && text.contains("76 of 76 images labelled"), "{text}");
    // The chunk has 239 MB, and so would all its images together.
    assert!(memory_kb < 420_000, "{memory_kb} kB");
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
    let cell = vec![0u8; 150 << 20];
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
    refused_small(&["label", input, "--camera", &camera, "--out", out], "EGOTAC_LIMIT_PAGE_BYTES");
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
        refused_small(&["label", input.to_str().unwrap(), "--out", &outs.next().unwrap()], word);
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
        small_store(&path);
        special(&path.join("data/camera_ego_rgb/0.0.0.0"));
        refused_small(&["predict", "--data", path.to_str().unwrap(), "--out", out.to_str().unwrap()], "0.0.0.0");
        let data = copied("image", folder.path());
        special(&data.join("data/chunk-000/file-000.parquet"));
        refused_small(
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
            refused_small(&["report", file.to_str().unwrap(), "--out", out.to_str().unwrap()], name);
            refused_small(&["data", "info", file.to_str().unwrap()], name);
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
    refused_small(
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
fn the_exit_status_tells_the_result_also_where_nothing_can_be_printed() {
    let folder = tempfile::tempdir().unwrap();
    small_store(&folder.path().join("in/a.zarr"));
    fs::write(folder.path().join("in/b.mcap"), b"no bag").unwrap();
    let run = |words: &[&str], input: &str| {
        let full = || File::options().write(true).open("/dev/full").unwrap();
        let mut command = Command::new(env!("CARGO_BIN_EXE_egotac"));
        command.args(words).arg(folder.path().join(input)).stdout(Stdio::null()).stderr(full());
        command.status().unwrap().code()
    };
    let out = folder.path().join("out");
    // A recording that can't be read is listed on standard error; the other one is labelled.
    assert_eq!(run(&["label", "--out", out.to_str().unwrap()], "in"), Some(3));
    assert!(out.join("a.zarr").is_dir());
    assert_eq!(run(&["data", "info"], "none"), Some(1));
    assert_eq!(run(&["data", "no-such-command"], "none"), Some(2));
}

#[test]
fn an_output_that_was_moved_away_is_no_success() {
    let folder = tempfile::tempdir().unwrap();
    let [input, out] = ["in", "out"].map(|name| folder.path().join(name));
    small_store(&input.join("a.zarr"));
    fs::create_dir(input.join("b")).unwrap();
    for index in 0..200 {
        RgbImage::new(64, 64).save(input.join(format!("b/{index}.png"))).unwrap();
    }
    let mut command = Command::new(env!("CARGO_BIN_EXE_egotac"));
    command.arg("label").arg(&input).arg("--out").arg(&out).stdout(Stdio::null()).stderr(Stdio::piped());
    let child = command.spawn().unwrap();
    while !out.join("a.zarr").exists() {
        std::thread::sleep(std::time::Duration::from_millis(1));
    }
    fs::rename(out.join("a.zarr"), folder.path().join("moved.zarr")).unwrap();
    let done = child.wait_with_output().unwrap();
    let text = String::from_utf8(done.stderr).unwrap();
    assert_eq!(done.status.code(), Some(3), "{text}");
    assert!(text.contains("a.zarr: was moved or removed after it was written"), "{text}");
    // The same command labels it again.
    let done = measured(&["label", input.to_str().unwrap(), "--out", out.to_str().unwrap()]);
    assert!(done.status == Some(0) && out.join("a.zarr").is_dir(), "{}", done.text);
}

#[test]
fn labels_of_a_bag_with_evil_metadata_are_a_bag_that_reads_back() {
    let folder = tempfile::tempdir().unwrap();
    let (path, out) = (folder.path().join("a.mcap"), folder.path().join("out"));
    let options = mcap::WriteOptions::new().profile("ros2");
    let mut writer = options.create(File::create(&path).unwrap()).unwrap();
    let schema = writer.add_schema(message::Image::TYPE, "ros2msg", message::Image::schema().as_bytes()).unwrap();
    let topic = format!("/{}", "camera".repeat(100_000));
    // As YAML, more nested lists than any reader takes; as a list of profiles, none.
    let qos = format!("- history: {}", "[".repeat(5000));
    let metadata = std::collections::BTreeMap::from([("offered_qos_profiles".to_string(), qos)]);
    let channel_id = writer.add_channel(schema, &topic, "cdr", &metadata).unwrap();
    for sequence in 0..4 {
        let stamp = message::Time { sec: 1, nanosec: 40_000_000 * sequence };
        let header = message::Header { stamp, frame_id: String::new() };
        let payload = message::Image::from_rgb(header, &RgbImage::new(64, 64)).to_cdr();
        let time = stamp.nanos() as u64;
        let header = mcap::records::MessageHeader { channel_id, sequence, log_time: time, publish_time: time };
        writer.write_to_known_channel(&header, &payload).unwrap();
    }
    writer.finish().unwrap();
    let [input, out] = [&path, &out].map(|path| path.to_str().unwrap());
    let done = measured(&["label", input, "--out", out]);
    assert_eq!(done.status, Some(0), "{}", done.text);
    for bag in [input, out] {
        let done = measured(&["data", "info", bag]);
        assert_eq!(done.status, Some(0), "{}", done.text);
        assert!(done.text.contains("... (600001 bytes)") && done.text.len() < 4000, "{} bytes", done.text.len());
    }
}
