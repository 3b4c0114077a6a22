//! Writers of single files: meshes, numpy arrays, tar archives, MANO files, videos.

use std::fmt::Write as _;
use std::io::{Cursor, Write};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use egotac::hand::{HandModel, Side};
use glam::DVec3;
use image::codecs::jpeg::JpegEncoder;
use image::{ImageFormat, RgbImage};

use super::take::Take;

/// Fingertips of MANO's mesh, thumb to little finger.
const MANO_TIPS: [usize; 5] = [744, 320, 443, 554, 671];

/// Writes a file and the folders above it.
pub fn write(path: &Path, content: impl AsRef<[u8]>) {
    std::fs::create_dir_all(path.parent().unwrap()).unwrap();
    std::fs::write(path, content).unwrap();
}

pub fn png(image: &RgbImage) -> Vec<u8> {
    encoded(image, ImageFormat::Png)
}

pub fn jpeg(image: &RgbImage) -> Vec<u8> {
    encoded(image, ImageFormat::Jpeg)
}

/// Returns a JPEG file of a quality from 1 to 100.
pub fn jpeg_of(image: &RgbImage, quality: u8) -> Vec<u8> {
    let mut bytes = Vec::new();
    JpegEncoder::new_with_quality(&mut bytes, quality).encode_image(image).unwrap();
    bytes
}

fn encoded(image: &RgbImage, format: ImageFormat) -> Vec<u8> {
    let mut bytes = Cursor::new(Vec::new());
    image.write_to(&mut bytes, format).unwrap();
    bytes.into_inner()
}

/// Returns an OBJ file of quads or triangles; `scale` is the number of its units per metre.
pub fn obj((corners, triangles): &(Vec<DVec3>, Vec<[usize; 3]>), scale: f64) -> String {
    let mut text = String::from("# mesh\n");
    corners.iter().for_each(|v| writeln!(text, "v {} {} {}", v.x * scale, v.y * scale, v.z * scale).unwrap());
    triangles.iter().for_each(|[a, b, c]| writeln!(text, "f {} {} {}", a + 1, b + 1, c + 1).unwrap());
    text
}

/// Returns a PLY file, in metres.
pub fn ply((corners, triangles): &(Vec<DVec3>, Vec<[usize; 3]>)) -> String {
    let mut text = format!(
        "ply\nformat ascii 1.0\nelement vertex {}\nproperty float x\nproperty float y\nproperty float z\n\
        element face {}\nproperty list uchar int vertex_indices\nend_header\n",
        corners.len(),
        triangles.len()
    );
    corners.iter().for_each(|v| writeln!(text, "{} {} {}", v.x, v.y, v.z).unwrap());
    triangles.iter().for_each(|[a, b, c]| writeln!(text, "3 {a} {b} {c}").unwrap());
    text
}

/// Returns a GLB file whose vertices are in millimetres below a node that scales to metres.
pub fn glb((corners, triangles): &(Vec<DVec3>, Vec<[usize; 3]>)) -> Vec<u8> {
    let mut binary: Vec<u8> = triangles.iter().flatten().flat_map(|index| (*index as u16).to_le_bytes()).collect();
    let indices = binary.len();
    corners.iter().for_each(|v| (*v * 1000.0).as_vec3().to_array().iter().for_each(|x| binary.extend(x.to_le_bytes())));
    let json = serde_json::json!({
        "asset": { "version": "2.0" }, "scene": 0, "scenes": [{ "nodes": [0] }],
        "nodes": [{ "name": "world", "children": [1] }, { "mesh": 0, "scale": [0.001, 0.001, 0.001] }],
        "meshes": [{ "primitives": [{ "attributes": { "POSITION": 1 }, "indices": 0, "mode": 4 }] }],
        "accessors": [
            { "type": "SCALAR", "componentType": 5123, "count": 3 * triangles.len(), "bufferView": 0, "byteOffset": 0 },
            { "type": "VEC3", "componentType": 5126, "count": corners.len(), "bufferView": 1, "byteOffset": 0 },
        ],
        "bufferViews": [
            { "buffer": 0, "byteOffset": 0, "byteLength": indices },
            { "buffer": 0, "byteOffset": indices, "byteLength": binary.len() - indices },
        ],
        "buffers": [{ "byteLength": binary.len() }],
    });
    let mut text = json.to_string().into_bytes();
    text.resize(text.len().next_multiple_of(4), b' ');
    let mut bytes = b"glTF".to_vec();
    for word in [2, 28 + text.len() + binary.len(), text.len()] {
        bytes.extend((word as u32).to_le_bytes());
    }
    bytes.extend(b"JSON");
    bytes.extend(text);
    bytes.extend((binary.len() as u32).to_le_bytes());
    bytes.extend(b"BIN\0");
    bytes.extend(binary);
    bytes
}

/// Returns a `.npy` file of numbers.
pub fn npy(shape: &[usize], descr: &str, data: &[u8]) -> Vec<u8> {
    let lengths: Vec<String> = shape.iter().map(|n| format!("{n},")).collect();
    let mut header = format!("{{'descr': '{descr}', 'fortran_order': False, 'shape': ({}), }}", lengths.join(" "));
    while (10 + header.len() + 1) % 64 != 0 {
        header.push(' ');
    }
    header.push('\n');
    let mut bytes = b"\x93NUMPY\x01\0".to_vec();
    bytes.extend((header.len() as u16).to_le_bytes());
    bytes.extend(header.as_bytes());
    bytes.extend(data);
    bytes
}

pub fn npy_f64(shape: &[usize], values: &[f64]) -> Vec<u8> {
    npy(shape, "<f8", &values.iter().flat_map(|value| value.to_le_bytes()).collect::<Vec<_>>())
}

/// Returns a `.npz` archive of these `.npy` files.
pub fn archive<'a>(arrays: impl IntoIterator<Item = (&'a str, Vec<u8>)>) -> Vec<u8> {
    let mut zip = zip::ZipWriter::new(Cursor::new(Vec::new()));
    let options = zip::write::SimpleFileOptions::default().compression_method(zip::CompressionMethod::Stored);
    for (name, content) in arrays {
        zip.start_file(format!("{name}.npy"), options).unwrap();
        zip.write_all(&content).unwrap();
    }
    zip.finish().unwrap().into_inner()
}

/// Returns a tar archive as Python's `tarfile` writes it.
pub fn tar(members: &[(String, Vec<u8>)]) -> Vec<u8> {
    let mut bytes = Vec::new();
    for (name, content) in members {
        let mut header = [0; 512];
        header[..name.len()].copy_from_slice(name.as_bytes());
        header[100..108].copy_from_slice(b"0000644\0");
        header[124..136].copy_from_slice(format!("{:011o}\0", content.len()).as_bytes());
        header[136..148].copy_from_slice(b"14600000000\0");
        header[156] = b'0';
        header[257..265].copy_from_slice(b"ustar\x0000");
        header[148..156].copy_from_slice(b"        ");
        let sum: u32 = header.iter().map(|byte| u32::from(*byte)).sum();
        header[148..156].copy_from_slice(format!("{sum:06o}\0 ").as_bytes());
        bytes.extend(header);
        bytes.extend(content);
        bytes.resize(bytes.len().next_multiple_of(512), 0);
    }
    bytes.resize(bytes.len() + 1024, 0);
    bytes
}

/// Writes a video without loss, 30 frames per second.
pub fn video(path: &Path, images: &[&RgbImage]) {
    std::fs::create_dir_all(path.parent().unwrap()).unwrap();
    let (width, height) = images[0].dimensions();
    let mut ffmpeg = Command::new("ffmpeg")
        .args([
            "-v",
            "error",
            "-y",
            "-f",
            "rawvideo",
            "-pix_fmt",
            "rgb24",
            "-s",
            &format!("{width}x{height}"),
            "-r",
            "30",
        ])
        .args(["-i", "-", "-c:v", "libx264rgb", "-qp", "0", "-preset", "ultrafast"])
        .arg(path)
        .stdin(Stdio::piped())
        .spawn()
        .unwrap();
    let mut input = ffmpeg.stdin.take().unwrap();
    images.iter().for_each(|image| input.write_all(image.as_raw()).unwrap());
    drop(input);
    assert!(ffmpeg.wait().unwrap().success());
}

/// MANO-format files of the built-in hands. The first components of each basis span the poses of a take.
pub struct ManoFiles {
    pub left: PathBuf,
    pub right: PathBuf,
    pub models: [HandModel; 2],
    mean: [Vec<f64>; 2],
    components: [Vec<Vec<f64>>; 2],
}

impl ManoFiles {
    /// Writes both files into `folder`; with `published_sign`, the left hand's `shapedirs` have the sign of x that the
    /// published file has.
    pub fn write(folder: &Path, take: &Take, published_sign: bool) -> Self {
        let mean = means();
        let components = Side::BOTH.map(|side| basis(take, side, &mean[side as usize]));
        Self::of_basis(folder, Side::BOTH.map(HandModel::builtin), mean, components, published_sign)
    }

    /// Writes both files into `folder`; the first components of each basis are the principal ones of these poses, of 45 angles, rad,
    /// of the left and the right hand. The fingertips have MANO's indices, so that pads of gloves find them.
    pub fn of_poses(folder: &Path, poses: &[Vec<Vec<f64>>; 2]) -> Self {
        let mean = means();
        let components = Side::BOTH.map(|side| principal(&poses[side as usize], &mean[side as usize]));
        Self::of_basis(folder, Side::BOTH.map(with_mano_tips), mean, components, true)
    }

    fn of_basis(
        folder: &Path,
        models: [HandModel; 2],
        mean: [Vec<f64>; 2],
        components: [Vec<Vec<f64>>; 2],
        published_sign: bool,
    ) -> Self {
        let [left, right] = ["MANO_LEFT.npz", "MANO_RIGHT.npz"].map(|name| folder.join(name));
        for (path, side) in [(&left, Side::Left), (&right, Side::Right)] {
            let mut model = models[side as usize].clone();
            if side == Side::Left && published_sign {
                model.fix_left_shapedirs();
            }
            write(path, npz(&model, &mean[side as usize], &components[side as usize].concat()));
        }
        Self { left, right, models, mean, components }
    }

    /// Returns MANO's mean pose of a hand, rad.
    pub fn mean(&self, side: Side) -> &[f64] {
        &self.mean[side as usize]
    }

    /// Returns the coefficients of a pose, of the first 15 components.
    pub fn coefficients(&self, side: Side, pose: &[f64]) -> Vec<f64> {
        let rest: Vec<f64> = pose.iter().zip(self.mean(side)).map(|(angle, mean)| angle - mean).collect();
        self.components[side as usize][..15].iter().map(|component| dot(component, &rest)).collect()
    }
}

/// Returns the 45 angles of a hand's pose, rad.
pub fn angles(pose: &[glam::Vec3; 15]) -> Vec<f64> {
    pose.iter().flat_map(|joint| joint.to_array()).map(f64::from).collect()
}

/// Returns the built-in hand with its fingertips at MANO's indices: each tip changes places with the vertex that is there.
fn with_mano_tips(side: Side) -> HandModel {
    let mut model = HandModel::builtin(side);
    for (place, finger) in MANO_TIPS.into_iter().zip(0..5) {
        let tip = model.tip_vertices[finger] as usize;
        model.v_template.swap(tip, place);
        for (values, width) in [(&mut model.shapedirs, 30), (&mut model.posedirs, 405), (&mut model.lbs_weights, 16)] {
            (0..width).for_each(|k| values.swap(width * tip + k, width * place + k));
        }
        model.j_regressor.chunks_exact_mut(778).for_each(|row| row.swap(tip, place));
        let renamed = |index: u32| match index as usize {
            index if index == tip => place as u32,
            index if index == place => tip as u32,
            _ => index,
        };
        model.faces.iter_mut().for_each(|face| *face = face.map(renamed));
        model.tip_vertices.iter_mut().for_each(|index| *index = renamed(*index));
    }
    model
}

/// Returns mean poses of both hands, rad; any will do.
fn means() -> [Vec<f64>; 2] {
    [1.0, -1.0].map(|sign| (0..45).map(|k| sign * 0.1 * (k as f64 * 0.7).sin()).collect())
}

/// Returns 45 orthonormal vectors, those that explain most of the poses' differences from the mean first.
fn principal(poses: &[Vec<f64>], mean: &[f64]) -> Vec<Vec<f64>> {
    let mut moments = nalgebra::DMatrix::<f64>::zeros(45, 45);
    for pose in poses {
        let rest = nalgebra::DVector::from_iterator(45, pose.iter().zip(mean).map(|(angle, mean)| angle - mean));
        moments += &rest * rest.transpose();
    }
    let found = moments.symmetric_eigen();
    let mut order: Vec<usize> = (0..45).collect();
    order.sort_by(|a, b| found.eigenvalues[*b].total_cmp(&found.eigenvalues[*a]));
    order.into_iter().map(|column| found.eigenvectors.column(column).iter().copied().collect()).collect()
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// Returns 45 orthonormal vectors, the first of which span the poses of a take about the mean.
fn basis(take: &Take, side: Side, mean: &[f64]) -> Vec<Vec<f64>> {
    let poses = take.frames.iter().map(|frame| angles(&frame.hand(side).params.hand_pose));
    let poses = poses.map(|pose| pose.iter().zip(mean).map(|(angle, mean)| angle - mean).collect::<Vec<f64>>());
    let axes = (0..45).map(|k| (0..45).map(|j| f64::from(u8::from(j == k))).collect());
    let mut found: Vec<Vec<f64>> = Vec::new();
    for mut vector in poses.chain(axes) {
        for _ in 0..2 {
            for earlier in &found {
                let along = dot(earlier, &vector);
                vector.iter_mut().zip(earlier).for_each(|(x, e)| *x -= along * e);
            }
        }
        let length = dot(&vector, &vector).sqrt();
        if length > 1e-6 && found.len() < 45 {
            found.push(vector.iter().map(|x| x / length).collect());
        }
    }
    found
}

fn npz(model: &HandModel, mean: &[f64], components: &[f64]) -> Vec<u8> {
    let f32s = |values: &[f32]| values.iter().flat_map(|value| value.to_le_bytes()).collect::<Vec<u8>>();
    let template: Vec<f32> = model.v_template.iter().flat_map(|v| v.to_array()).collect();
    let faces: Vec<u8> = model.faces.concat().iter().flat_map(|index| index.to_le_bytes()).collect();
    let parents = model.parents.iter().enumerate().map(|(joint, parent)| if joint == 0 { -1 } else { *parent as i64 });
    let tree: Vec<u8> = parents.chain(0..16).flat_map(i64::to_le_bytes).collect();
    let arrays = [
        ("v_template", npy(&[778, 3], "<f4", &f32s(&template))),
        ("f", npy(&[model.faces.len(), 3], "<u4", &faces)),
        ("shapedirs", npy(&[778, 3, 10], "<f4", &f32s(&model.shapedirs))),
        ("posedirs", npy(&[778, 3, 135], "<f4", &f32s(&model.posedirs))),
        ("J_regressor", npy(&[16, 778], "<f4", &f32s(&model.j_regressor))),
        ("weights", npy(&[778, 16], "<f4", &f32s(&model.lbs_weights))),
        ("kintree_table", npy(&[2, 16], "<i8", &tree)),
        ("hands_mean", npy_f64(&[45], mean)),
        ("hands_components", npy_f64(&[45, 45], components)),
    ];
    archive(arrays)
}
