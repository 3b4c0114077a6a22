//! Stores made to do harm are refused by name, in little memory, and damage is named.

use std::fs::{self, File};
use std::io::{Read, Write};
use std::path::Path;

use crate::common::{Ran, measured, refused_small, small_store};
use egotac::dataset::zarr::ZarrReader;
use egotac::image::{Filter, IMAGENET_MEAN, IMAGENET_STD, Preparation, Resize};
use egotac::train::data::Dataset;
use flate2::write::{GzEncoder, ZlibEncoder};
use image::{Rgb, RgbImage};
use serde_json::{Value, json};

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
        small_store(&path);
    };
    for power in [28, 34, 40, 62] {
        for chunk in [1u64 << power, 1] {
            fresh();
            fs::remove_file(path.join("meta/episode_ends/0")).unwrap();
            edit(&path, "meta/episode_ends", |array| {
                (array["shape"], array["chunks"]) = (json!([1u64 << power]), json!([chunk]))
            });
            refused_small(&["data", "info", name], "meta/episode_ends");
        }
    }
    for side in [1u64 << 15, 1 << 20, 1 << 31, 1 << 62] {
        fresh();
        let _ = fs::remove_file(path.join("data/camera_ego_rgb/0.0.0.0"));
        edit(&path, "data/camera_ego_rgb", |array| {
            (array["shape"], array["chunks"]) = (json!([4, side, side, 3]), json!([4, side, side, 3]));
        });
        refused_small(&["data", "info", name], "image size");
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
    refused_small(&["data", "info", name], "camera_ego_rgb: expected 8388608 images");
}

#[test]
fn a_frame_in_very_many_chunks_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.zarr");
    small_store(&path);
    // Chunks of one number, all of them absent: millions of looks into the file system.
    for entry in fs::read_dir(path.join("data")).unwrap().map(|entry| entry.unwrap()).filter(|e| e.path().is_dir()) {
        let name = entry.file_name().into_string().unwrap();
        edit(&path, &format!("data/{name}"), |array| {
            array["shape"][0] = json!(4096);
            if name == "mano_force" {
                array["chunks"] = json!([1, 1]);
            }
        });
    }
    fs::write(path.join("meta/episode_ends/0"), 4096u64.to_le_bytes()).unwrap();
    let out = folder.path().join("a.html");
    refused_small(&["report", path.to_str().unwrap(), "--out", out.to_str().unwrap()], "EGOTAC_LIMIT_PART_CHUNKS");
}

/// Packs a store into a zip file, and flips a bit of the content of one of its files.
fn zip_with_a_flipped_bit(store: &Path, file: &str, to: &Path) {
    let mut zip = zip::ZipWriter::new(File::create(to).unwrap());
    let options = zip::write::SimpleFileOptions::default().compression_method(zip::CompressionMethod::Stored);
    let mut folders = vec![store.to_path_buf()];
    while let Some(folder) = folders.pop() {
        for path in fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()) {
            if path.is_dir() {
                folders.push(path);
                continue;
            }
            zip.start_file(path.strip_prefix(store).unwrap().to_str().unwrap(), options).unwrap();
            zip.write_all(&fs::read(path).unwrap()).unwrap();
        }
    }
    zip.finish().unwrap();
    let mut archive = zip::ZipArchive::new(File::open(to).unwrap()).unwrap();
    let place = archive.by_name(file).unwrap().data_start().unwrap() as usize;
    let mut bytes = fs::read(to).unwrap();
    bytes[place + 9] ^= 4;
    fs::write(to, bytes).unwrap();
}

#[test]
fn damaged_truth_is_named_and_never_read_as_zeros() {
    let folder = tempfile::tempdir().unwrap();
    let [path, zip] = ["a.zarr", "b.zarr.zip"].map(|name| folder.path().join(name));
    small_store(&path);
    // Read as zeros, this chunk would say that no force is known.
    let chunk = "data/mano_force_valid/0.0";
    zip_with_a_flipped_bit(&path, chunk, &zip);
    let bytes = fs::read(path.join(chunk)).unwrap();
    fs::write(path.join(chunk), &bytes[..bytes.len() / 2]).unwrap();
    let folder_as_chunk = folder.path().join("c.zarr");
    small_store(&folder_as_chunk);
    fs::remove_file(folder_as_chunk.join(chunk)).unwrap();
    fs::create_dir(folder_as_chunk.join(chunk)).unwrap();
    for input in [&path, &zip, &folder_as_chunk] {
        let out = folder.path().join("out.zarr");
        let Ran { status, text, .. } =
            measured(&["label", input.to_str().unwrap(), "--unknown", "guess", "--out", out.to_str().unwrap()]);
        assert_eq!(status, Some(3), "{text}");
        let lost: Vec<&str> = text.lines().filter(|line| line.starts_with("lost: ")).collect();
        assert!(lost.len() == 1 && lost[0].contains(chunk), "{text}");
        let labelled = ZarrReader::open(&out).unwrap();
        assert!(labelled.read_f32("data/predicted_mano_force", 0..4).unwrap().iter().all(|force| force.is_finite()));
        assert!(labelled.read_u8("data/mano_force_valid", 0..4).is_err());
        assert!(labelled.read_u8("data/mano_contact_valid", 0..4).is_ok());
        fs::remove_dir_all(&out).unwrap();
    }
}

#[test]
fn chunks_that_decompress_to_more_than_their_shape_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.zarr");
    small_store(&path);
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
        refused_small(&["data", "info", path.to_str().unwrap()], "data/timestamps");
    }
}

#[test]
fn training_reads_planar_images_as_every_other_command_does() {
    let folder = tempfile::tempdir().unwrap();
    let [rows, planes] = ["rows.zarr", "planes.zarr"].map(|name| folder.path().join(name));
    small_store(&rows);
    small_store(&planes);
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
        let done = measured(&["predict", "--data", path.to_str().unwrap(), "--out", out.to_str().unwrap()]);
        assert_eq!(done.status, Some(0), "{}", done.text);
        fs::read(out).unwrap()
    });
    assert_eq!(fields[0], fields[1]);
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
