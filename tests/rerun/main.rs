//! Data for the viewer Rerun, read back by its Python package and sent to one that runs; `make check-rerun` builds and runs these tests.
#![cfg(feature = "rerun")]

#[path = "../common/mod.rs"]
mod common;

use std::collections::BTreeMap;
use std::net::{TcpListener, TcpStream};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use egotac::Side;
use egotac::dataset::Labelled;
use egotac::hand::{HandModel, Region};
use egotac::render::force_color;
use egotac::tactile::TactileField;
use egotac::view::{ClipOptions, open_clips};
use serde_json::Value;

use common::store::write_bright_store;
use common::{egotac, refused};

const FRAMES: usize = 4;
/// Longest wait for a viewer to start or to end.
const PATIENCE: Duration = Duration::from_secs(60);

/// Content of a recording: entity, component, and rows of frame, time and values.
type Content = BTreeMap<String, BTreeMap<String, Vec<(Option<usize>, Option<f64>, Vec<Value>)>>>;

/// Folder of Rerun's Python package, which `make check-rerun` fetches.
fn packages() -> PathBuf {
    Path::new(&std::env::var("EGOTAC_RERUN_PACKAGES").expect("make check-rerun sets EGOTAC_RERUN_PACKAGES"))
        .join("rerun_sdk")
}

fn content(file: &Path) -> Content {
    let path = std::env::join_paths([packages(), packages().join("..")]).unwrap();
    let python = std::env::var("EGOTAC_PYTHON").expect("env.sh sets EGOTAC_PYTHON");
    let mut command = Command::new(python);
    let output = command.arg("tests/rerun/read.py").arg(file).env("PYTHONPATH", path).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let mut content: Content = serde_json::from_slice(&output.stdout).unwrap();
    content.values_mut().flat_map(BTreeMap::values_mut).for_each(|rows| rows.sort_by_key(|row| row.0));
    content
}

/// Labels a store for Rerun, at `target`.
fn label(folder: &Path, target: &str) -> std::process::Output {
    let at = |name: &str| folder.join(name).to_str().unwrap().to_owned();
    if !folder.join("in.zarr").exists() {
        write_bright_store(at("in.zarr").as_ref(), FRAMES);
    }
    egotac(&["label", &at("in.zarr"), "--out", &at("out.zarr"), "--unknown", "guess", "--rerun", target])
}

fn number(row: &(Option<usize>, Option<f64>, Vec<Value>)) -> f64 {
    row.2[0].as_f64().unwrap()
}

/// Checks that a recording holds the forces of `field` under `prefix` in `frame`.
fn check_field(content: &Content, prefix: &str, field: &TactileField, frame: usize, scale: f32) {
    let hands = Side::BOTH.map(HandModel::builtin);
    for side in Side::BOTH {
        let name = side.name();
        let forces = &field.force[side.range()];
        let total = &content[&format!("{prefix}force/{name}")]["Scalars:scalars"][frame];
        let wanted: f32 = forces.iter().sum();
        assert!((number(total) - f64::from(wanted)).abs() < 1e-4 * f64::from(wanted.max(1.0)), "{name} {frame}");
        let regions = hands[side as usize].regions();
        for region in Region::ALL {
            let entity = format!("{prefix}regions/{name}/{}", region.name());
            let own = forces.iter().zip(&regions).filter(|(_, of)| **of == region);
            let wanted: f32 = own.map(|(force, _)| force).sum();
            let got = number(&content[&entity]["Scalars:scalars"][frame]);
            assert!(
                (got - f64::from(wanted)).abs() < 1e-4 * f64::from(wanted.max(1.0)),
                "{entity} {frame}: {got} {wanted}"
            );
        }
        let colors = &content[&format!("{prefix}{name}")]["Mesh3D:vertex_colors"][frame].2;
        assert_eq!(colors.len(), forces.len());
        for (color, force) in colors.iter().zip(forces) {
            let [r, g, b] = force_color(*force, scale).0.map(u64::from);
            assert_eq!(color.as_u64().unwrap(), r << 24 | g << 16 | b << 8 | 0xff, "{force}");
        }
    }
}

#[test]
fn a_file_holds_images_hands_and_forces_of_labels_and_truth() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("made/touch.rrd");
    let output = label(folder.path(), file.to_str().unwrap());
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let content = content(&file);
    let out = folder.path().join("out.zarr");
    let Labelled { labels, truth, .. } = Labelled::read(&out).unwrap();
    let scale = open_clips(&out, &ClipOptions::default()).unwrap()[0].about().scale;
    for frame in 0..FRAMES {
        check_field(&content, "/", &labels.field(frame).unwrap(), frame, scale);
        check_field(&content, "/truth/", &truth.as_ref().unwrap().field(frame).unwrap(), frame, scale);
        let (image, media) =
            (&content["/image"]["EncodedImage:blob"][frame], &content["/image"]["EncodedImage:media_type"]);
        assert_eq!((image.0, image.1), (Some(frame), Some(0.04 * frame as f64)));
        assert_eq!(media[frame].2, ["image/jpeg"]);
        let familiarity = &content["/familiarity"]["Scalars:scalars"][frame];
        assert!((number(familiarity) - f64::from(labels.familiarity[frame])).abs() < 1e-6);
        let presence = &content["/presence/right"]["Scalars:scalars"][frame];
        assert!((number(presence) - f64::from(labels.presence[2 * frame + 1])).abs() < 1e-6);
    }
    for entity in ["/left", "/right", "/truth/left", "/truth/right"] {
        let mesh = &content[entity];
        // Hands at rest are written once.
        assert_eq!(mesh["Mesh3D:vertex_positions"].len(), 1);
        assert_eq!(mesh["Mesh3D:vertex_positions"][0].2.len(), 778);
        let faces = HandModel::builtin(Side::Left).faces.len();
        assert_eq!((mesh["Mesh3D:triangle_indices"][0].0, mesh["Mesh3D:triangle_indices"][0].2.len()), (None, faces));
    }
    let x = |entity: &str| content[entity]["Mesh3D:vertex_positions"][0].2[0][0].as_f64().unwrap();
    assert!(x("/left") < 0.0 && x("/right") > 0.0, "the right hand is on the right");
    // A finished file leaves nothing else beside it.
    assert_eq!(std::fs::read_dir(folder.path().join("made")).unwrap().count(), 1);
}

#[test]
fn a_hand_whose_touch_is_unknown_has_gaps_and_no_zeros() {
    let folder = tempfile::tempdir().unwrap();
    write_bright_store(&folder.path().join("in.zarr"), FRAMES);
    let at = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    // No image is so familiar, and no hand so sure.
    let doubt = ["--familiarity-threshold", "1", "--presence-threshold", "1"];
    let arguments = ["label", &at("in.zarr"), "--out", &at("out.zarr"), "--rerun", &at("touch.rrd")];
    let output = egotac(&[&arguments[..], &doubt].concat());
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let content = content(&folder.path().join("touch.rrd"));
    for entity in ["/force/left", "/regions/right/index_tip"] {
        assert!(!content[entity].contains_key("Scalars:scalars"), "{:?}", content[entity]);
        assert_eq!(content[entity]["Clear:is_recursive"].len(), FRAMES);
    }
}

/// A viewer that runs without a window and writes what it is sent.
struct Viewer(Child);

impl Viewer {
    fn start(port: u16, file: &Path) -> Self {
        let mut command = Command::new(packages().join("rerun_cli/rerun"));
        command.args(["--bind", "127.0.0.1", "--port", &port.to_string(), "--save"]).arg(file);
        let child = command.stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
        let start = Instant::now();
        while TcpStream::connect(("127.0.0.1", port)).is_err() {
            assert!(start.elapsed() < PATIENCE, "the viewer does not start");
            std::thread::sleep(Duration::from_millis(50));
        }
        Self(child)
    }
}

impl Drop for Viewer {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

#[test]
fn a_viewer_that_runs_gets_what_a_file_holds() {
    let folder = tempfile::tempdir().unwrap();
    let port = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
    let (sent, file) = (folder.path().join("sent.rrd"), folder.path().join("touch.rrd"));
    assert!(label(folder.path(), file.to_str().unwrap()).status.success());
    let wanted = content(&file);
    let viewer = Viewer::start(port, &sent);
    let output = label(folder.path(), &format!("rerun+http://127.0.0.1:{port}/proxy"));
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let start = Instant::now();
    // The viewer writes what it got on its own time.
    while std::fs::metadata(&sent).map_or(0, |file| file.len()) < std::fs::metadata(&file).unwrap().len() / 2 {
        assert!(start.elapsed() < PATIENCE, "the viewer got too little");
        std::thread::sleep(Duration::from_millis(50));
    }
    std::thread::sleep(Duration::from_secs(1));
    drop(viewer);
    assert_eq!(content(&sent), wanted);
}

#[test]
fn names_and_addresses_that_lead_nowhere_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    write_bright_store(&folder.path().join("in.zarr"), FRAMES);
    let at = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let (input, out) = (at("in.zarr"), at("out.zarr"));
    let with = |target: &str, expected: &str| {
        refused(&["label", &input, "--out", &out, "--unknown", "guess", "--rerun", target], expected);
    };
    with(&at("touch.mcap"), "expected a name that ends in .rrd, or the address of a viewer");
    assert!(!Path::new(&out).exists(), "refused before labelling");
    let port = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
    with(&format!("rerun+http://127.0.0.1:{port}/proxy"), &format!("127.0.0.1:{port}"));
    with("rerun+http://nowhere", "nowhere");
}
