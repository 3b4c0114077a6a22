//! Fields on the vertices of MANO files: stores, data sets, predictions, scores and training.
//!
//! The MANO files are the synthetic ones of tests/data/hand/make_golden.py.

use std::fs;
use std::path::{Path, PathBuf};

use crate::common::store::{write_bright_store, write_store};
use crate::common::{egotac, hand_data};
use egotac::dataset::EpisodeReader;
use egotac::dataset::Labelled;
use egotac::dataset::tensors;
use egotac::dataset::zarr::{ZarrReader, read_truth};
use egotac::hand::{FieldMap, HandModel, HandParams, Region, Side, Topology};
use egotac::tactile::{N_FIELD, TactileField, TactileSequence};
use egotac::train::{Config, Control, Event, train};
use glam::Vec3;
use image::RgbImage;
use proptest::prelude::*;

/// MANO files of both hands in a folder.
struct Files {
    folder: tempfile::TempDir,
    left: PathBuf,
    right: PathBuf,
}

impl Files {
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let left = folder.path().join("left.pkl");
        let packed = fs::read(hand_data("left_plain.pkl.gz")).unwrap();
        let mut plain = Vec::new();
        std::io::Read::read_to_end(&mut flate2::read::GzDecoder::new(&packed[..]), &mut plain).unwrap();
        fs::write(&left, plain).unwrap();
        Self { folder, left, right: hand_data("right.npz") }
    }

    fn map(&self) -> FieldMap {
        FieldMap::load(&self.left, &self.right).unwrap()
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// Runs `egotac` with the MANO files; must succeed.
    fn run(&self, arguments: &[&Path]) -> String {
        let arguments: Vec<&str> = arguments.iter().map(|path| path.to_str().unwrap()).collect();
        let files = ["--mano-left", self.left.to_str().unwrap(), "--mano-right", self.right.to_str().unwrap()];
        let output = egotac(&[&arguments[..], &files].concat());
        assert!(output.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&output.stderr));
        String::from_utf8(output.stdout).unwrap()
    }
}

fn p(text: &str) -> &Path {
    Path::new(text)
}

fn totals(force: &[f32]) -> Vec<f64> {
    force.chunks(778).map(|hand| hand.iter().map(|f| f64::from(*f)).sum()).collect()
}

fn assert_totals_kept(before: &[f32], after: &[f32]) {
    for (before, after) in totals(before).into_iter().zip(totals(after)) {
        assert!((before - after).abs() <= 1e-6 * before, "{before} N became {after} N");
    }
}

/// Writes a store with touch at every fingertip in turn, of both hands.
fn touching_store(path: &Path) {
    let hand = HandModel::builtin(Side::Right);
    write_store(path, &[6, 4], 0.04, |index| {
        let tip = hand.v_template[hand.tip_vertices[index % 5] as usize];
        let bump = |v: &Vec3| (-v.distance_squared(tip) / (2.0 * 0.005f32.powi(2))).exp();
        let one: Vec<f32> = hand.v_template.iter().map(bump).collect();
        let force = [0.2, 0.5].iter().flat_map(|n| one.iter().map(move |b| n * b)).collect();
        let image = RgbImage::from_pixel(40, 40, [20 * index as u8, 90, 90].into());
        (image, TactileField::from_force(Topology::EgotacHand1, force).unwrap())
    });
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    #[test]
    fn each_hand_keeps_its_force_to_a_millionth(
        force in proptest::collection::vec(prop_oneof![3 => Just(0f32), 1 => 0f32..5.0], 2 * N_FIELD),
    ) {
        thread_local!(static MAP: FieldMap = Files::new().map());
        MAP.with(|map| {
            for to in [Topology::Mano, Topology::EgotacHand1] {
                assert_totals_kept(&force, &map.force(to, &force).unwrap());
            }
        });
    }
}

#[test]
fn contact_is_that_of_a_near_vertex_of_the_same_hand_and_unknown_force_makes_no_known_one() {
    let map = Files::new().map();
    let names: Vec<f32> = (0..N_FIELD).map(|vertex| vertex as f32).collect();
    let nearest = map.nearest(Topology::Mano, &names).unwrap();
    for side in Side::BOTH {
        let (from, to) = (map.regions(Topology::EgotacHand1), map.regions(Topology::Mano));
        let same = nearest[side.range()].iter().enumerate().filter(|(vertex, near)| {
            assert!(side.range().contains(&(**near as usize)), "{near} is a vertex of the other hand");
            from[side as usize][**near as usize % 778] == to[side as usize][*vertex]
        });
        assert!(same.count() > 650, "most vertices stay in their region");
    }
    let (force, mut mask) = (vec![0.1f32; N_FIELD], vec![1u8; N_FIELD]);
    let mut unknown = force.clone();
    for vertex in [20, 300, 900] {
        unknown[vertex] = f32::NAN;
        mask[vertex] = 0;
    }
    let carried = map.force(Topology::Mano, &unknown).unwrap();
    let mask = map.force_mask(Topology::Mano, &mask).unwrap();
    assert!(carried.iter().zip(&mask).all(|(force, mask)| force.is_nan() == (*mask == 0)));
    assert!((3..60).contains(&mask.iter().filter(|mask| **mask == 0).count()));
    assert!(map.force(Topology::Mano, &[0.0; 778]).unwrap_err().to_string().contains("1556"));
}

#[test]
fn a_carried_pose_keeps_its_wrist() {
    let map = Files::new().map();
    for side in Side::BOTH {
        let (builtin, mano) = (HandModel::builtin(side), &map.mano()[side as usize]);
        let params = HandParams {
            betas: std::array::from_fn(|i| 0.1 * i as f32),
            global_orient: Vec3::new(0.3, -0.8, 1.1),
            transl: Vec3::new(0.1, 0.2, 0.3),
            ..HandParams::default()
        };
        let carried = map.params(side, Topology::Mano, &params);
        let moved = builtin.joints(&params)[0].distance(mano.joints(&carried)[0]);
        assert!(moved < 1e-6, "{side:?}: the wrist moved by {moved} m");
        assert_eq!(carried.global_orient, params.global_orient);
    }
}

#[test]
fn a_whole_store_is_carried_over_and_back() {
    let files = Files::new();
    let [store, there, back] = ["a.zarr", "mano.zarr", "back.zarr"].map(|name| files.path(name));
    touching_store(&store);
    let map = |from: &Path, to: &str, out: &Path| {
        files.run(&[p("hand"), p("map"), p("--field"), from, p("--to"), p(to), p("--out"), out])
    };
    map(&store, "mano", &there);
    map(&there, "builtin", &back);
    let readers = [&store, &there, &back].map(|path| ZarrReader::open(path).unwrap());
    let truths = readers.each_ref().map(|reader| read_truth(reader).unwrap());
    for (reader, topology) in readers.iter().zip([Topology::EgotacHand1, Topology::Mano, Topology::EgotacHand1]) {
        assert_eq!(reader.attributes().topology, topology);
        assert_eq!(reader.episode_ends(), [6, 10]);
        assert!(reader.image(7).unwrap() == readers[0].image(7).unwrap());
    }
    for truth in &truths[1..] {
        assert_totals_kept(&truths[0].force, &truth.force);
        assert_eq!(truth.timestamps, truths[0].timestamps);
        assert!(truth.contact.iter().all(|contact| [0.0, 1.0].contains(contact)));
        let touched = |truth: &TactileSequence| truth.contact.iter().filter(|c| **c == 1.0).count();
        let (before, after) = (touched(&truths[0]), touched(truth));
        assert!(before > 50 && 2 * after > before && after < 2 * before, "{before} touched vertices became {after}");
    }
    // Touch is on the same fingertip as before.
    let regions = files.map().regions(Topology::Mano);
    for (frame, tip) in [Region::ThumbTip, Region::IndexTip, Region::MiddleTip].into_iter().enumerate() {
        let of = truths[1].field(frame).unwrap().region_forces(&regions);
        assert!(of[17 + tip.index()] > 0.8 * of[17..].iter().sum::<f32>(), "frame {frame}: {of:?}");
    }
    let again = egotac(&[
        "hand",
        "map",
        "--mano",
        files.right.to_str().unwrap(),
        "--field",
        there.to_str().unwrap(),
        "--to",
        "mano",
        "--out",
        "x",
    ]);
    let error = String::from_utf8_lossy(&again.stderr).into_owned();
    assert!(!again.status.success() && error.contains("mano.zarr") && error.contains("egotac-hand-1"), "{error}");
}

#[test]
fn a_labelled_lerobot_data_set_is_carried_over_with_its_regions() {
    let files = Files::new();
    let [labelled, there, direct] = ["labelled", "there", "direct"].map(|name| files.path(name));
    let input = "tests/data/lerobot/video";
    let output = egotac(&["label", input, "--unknown", "guess", "--out", labelled.to_str().unwrap()]);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    files.run(&[p("hand"), p("map"), p("--field"), &labelled, p("--to"), p("mano"), p("--out"), &there]);
    files.run(&[p("label"), p(input), p("--unknown"), p("guess"), p("--out"), &direct]);
    let [before, after, direct_labels] = [&labelled, &there, &direct].map(|path| Labelled::read(path).unwrap());
    assert_totals_kept(&before.labels.force, &after.labels.force);
    assert_eq!(after.labels.topology, Some(Topology::Mano));
    // Labelled on MANO's vertices at once or carried over afterwards: the same columns and statistics.
    // The network tells no presence; NaN differs from itself.
    let known = |labels: &TactileSequence| TactileSequence { presence: Vec::new(), ..labels.clone() };
    assert_eq!(known(&after.labels), known(&direct_labels.labels));
    for file in ["meta/info.json", "meta/stats.json"] {
        let [there, direct] = [&there, &direct].map(|root| fs::read_to_string(root.join(file)).unwrap());
        assert!(there == direct && there.contains("tactile.region_force"), "{file}");
    }
    for file in ["data/chunk-000/file-000.parquet", "meta/episodes/chunk-000/file-000.parquet"] {
        let rows = |root: &Path| {
            let reader = egotac::dataset::lerobot::reader(&root.join(file)).unwrap().build().unwrap();
            reader.map(Result::unwrap).collect::<Vec<_>>()
        };
        assert!(rows(&there) == rows(&direct), "{file}");
    }
    assert_eq!(after.info.unwrap().provenance.mano_sha256.len(), 2);
}

#[test]
fn predictions_and_scores_are_on_mano_whatever_the_checkpoint() {
    let files = Files::new();
    let [store, plain, mano] = ["a.zarr", "plain.safetensors", "mano.safetensors"].map(|name| files.path(name));
    touching_store(&store);
    let output =
        egotac(&["predict", "--unknown", "guess", "--data", store.to_str().unwrap(), "--out", plain.to_str().unwrap()]);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    files.run(&[p("predict"), p("--unknown"), p("guess"), p("--data"), &store, p("--out"), &mano]);
    let [before, after] = [&plain, &mano].map(|path| tensors::read(path).unwrap());
    assert_eq!(after.topology, Some(Topology::Mano));
    assert_eq!(before.clone().carried(&files.map(), Topology::Mano).unwrap(), after);
    // Fields of either topology beside a store of the built-in hand.
    let score = |pred: &Path| -> serde_json::Value {
        let text =
            files.run(&[p("eval"), p("--pred"), pred, p("--target"), &store, p("--by"), p("region"), p("--json")]);
        serde_json::from_str(&text).unwrap()
    };
    let (of_plain, of_mano) = (score(&plain), score(&mano));
    assert!(of_plain["mae"].is_f64() && of_plain == of_mano);
    let unmapped = egotac(&["eval", "--pred", mano.to_str().unwrap(), "--target", store.to_str().unwrap()]);
    assert!(String::from_utf8_lossy(&unmapped.stderr).contains("topology mismatch"));
}

#[test]
fn training_on_stores_of_either_topology_gives_a_checkpoint_of_mano() {
    let files = Files::new();
    let (builtin, mano) = (files.path("a.zarr"), files.path("b.zarr"));
    write_bright_store(&builtin, 12);
    files.run(&[p("hand"), p("map"), p("--field"), &builtin, p("--to"), p("mano"), p("--out"), &mano]);
    let config = |stores: &[&Path], out: &str, more: &str| -> Config {
        let list: Vec<_> = stores.iter().map(|store| store.display().to_string()).collect();
        let (stores, out) = (list.join(", "), files.path(out).display().to_string());
        let text = format!(
            "name: t\ndata: [{stores}]\nout: {out}\nmodel: toy\nseed: 5\nsteps: 2\nbatch: {{clips: 1, windows: 2}}\n{more}"
        );
        serde_yaml::from_str(&text).unwrap()
    };
    let run = |config: &Config| train(config, false, &candle_core::Device::Cpu, &mut |_: Event| Control::Continue);
    let hands = format!("mano_left: {}\nmano_right: {}\n", files.left.display(), files.right.display());
    assert!(run(&config(&[&builtin, &mano], "mixed", "")).unwrap_err().to_string().contains("topology mismatch"));
    let checkpoint = run(&config(&[&builtin, &mano], "both", &hands)).unwrap().checkpoint;
    let (_, metadata, _) = egotac::model::checkpoint::load_tensors(&checkpoint).unwrap();
    assert_eq!(metadata.topology, Topology::Mano);
    // A checkpoint of the built-in hand starts a training on MANO's vertices: its heads move with the vertices.
    let before = run(&config(&[&builtin], "plain", "")).unwrap().checkpoint;
    let start = format!("{hands}init: {}\n", before.display());
    assert!(run(&config(&[&builtin], "refused", &format!("init: {}\n", checkpoint.display()))).is_err());
    let after = run(&config(&[&builtin], "moved", &start)).unwrap().checkpoint;
    let bias = |path: &Path, name: &str| -> Vec<f32> {
        let all = candle_core::safetensors::load(path, &candle_core::Device::Cpu).unwrap();
        all[name].to_vec1().unwrap()
    };
    let moved = files.map().force(Topology::Mano, &bias(&before, "force_head.bias")).unwrap();
    // The force of other vertices has another scale: newtons are kept.
    let [from, to] = [&before, &after].map(|path| egotac::model::checkpoint::load_tensors(path).unwrap().1.force_scale);
    let distance = |(a, b): (&f32, f32)| (a * from / to - b).abs();
    let far = moved.iter().zip(bias(&after, "force_head.bias")).map(distance).fold(0.0, f32::max);
    assert!(far < 5e-3, "two steps moved a bias by {far}");
}
