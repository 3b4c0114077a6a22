//! `egotac verify` on scenes, stores, predictions and recordings.

use std::path::{Path, PathBuf};

use crate::common::egotac;
use candle_core::{Device, Tensor};
use candle_nn::VarMap;
use egotac::dataset::mcap::BagWriter;
use egotac::dataset::tensors;
use egotac::dataset::zarr::{MANO_FORCE, ZarrReader};
use egotac::hand::Topology;
use egotac::message::{Header, Message, TactileFrame, TactileTruth, Time};
use egotac::model::{Checkpoint, Config, EgoTac, Metadata, init};
use egotac::tactile::{N_FIELD, TactileField, TactileSequence, Validity};
use serde_json::Value;
use tempfile::TempDir;

/// Runs `egotac verify`, which must succeed, and returns its JSON.
fn verify(arguments: &[&str]) -> Value {
    let output = egotac(&[&["verify", "--json", "-"], arguments].concat());
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&output.stdout).unwrap()
}

/// Runs `egotac verify`, which must exit with status 1, and returns its error text.
fn refusal(arguments: &[&str]) -> String {
    let output = egotac(&[&["verify"], arguments].concat());
    assert_eq!(output.status.code(), Some(1), "{}", String::from_utf8_lossy(&output.stdout));
    String::from_utf8(output.stderr).unwrap()
}

fn score(report: &Value, candidate: &str, name: &str) -> f64 {
    let candidates = report["candidates"].as_array().unwrap();
    let found = candidates.iter().find(|c| c["name"] == candidate).unwrap_or_else(|| panic!("no {candidate}"));
    found["scores"][name]["value"]
        .as_f64()
        .unwrap_or_else(|| panic!("{candidate}: {name} is {}", found["scores"][name]))
}

struct Folder(TempDir);

impl Folder {
    fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    fn path(&self, name: &str) -> String {
        self.0.path().join(name).to_str().unwrap().to_owned()
    }

    /// Writes a store of one small episode.
    fn store(&self, scene: &str, seed: &str) -> String {
        let path = self.path(&format!("{}.zarr", Path::new(scene).file_stem().unwrap().to_string_lossy()));
        let output = egotac(&["sim", "run", scene, "--seed", seed, "--size", "16", "--out", &path]);
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        path
    }
}

#[test]
fn the_sweep_over_labels_is_deterministic() {
    let folder = Folder::new();
    let (first, out) = (folder.path("a.json"), folder.path("out"));
    let (picture, scenes) = (folder.path("a.png"), ["verify", "pinch_cube", "hover", "--seeds", "2", "--seed", "5"]);
    let output = egotac(&[&scenes[..], &["--json", &first, "--picture", &picture]].concat());
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let table = String::from_utf8(output.stdout).unwrap();
    assert!(table.contains("b_5mm") && table.contains("missed force") && table.contains("4 episodes"), "{table}");
    assert!(egotac(&[&scenes[..], &["--out", &out, "--jobs", "1"]].concat()).status.success());
    let bytes = std::fs::read(&first).unwrap();
    let in_folder = |name: &str| std::fs::read(Path::new(&out).join(name)).unwrap();
    assert!(bytes == in_folder("verify.json"), "not the same bit for bit");
    assert!(
        std::fs::read(&picture).unwrap() == in_folder("verify.png") && image::open(&picture).unwrap().width() > 1000
    );
    let page = String::from_utf8(in_folder("verify.md")).unwrap();
    assert!(
        page.contains(table.trim()) && page.contains("`egotac verify pinch_cube hover --seeds 2 --seed 5"),
        "{page}"
    );

    let report: Value = serde_json::from_slice(&bytes).unwrap();
    assert_eq!((score(&report, "c", "pooled.f1"), score(&report, "c", "missed_force")), (1.0, 0.0));
    let b = ["b_0mm", "b_1mm", "b_2mm", "b_5mm", "b_10mm"];
    for pair in b.windows(2) {
        let of = |name: &str| [0, 1].map(|k| score(&report, pair[k], name));
        let [before, after] = of("pooled.recall");
        assert!(before <= after, "recall of {pair:?}: {before} {after}");
        let [before, after] = of("missed_force");
        assert!(before >= after, "missed force of {pair:?}: {before} {after}");
    }
    assert!(score(&report, "b_10mm", "pooled.recall") > 0.9, "{report:#}");
    // The points lie on the surface, so that label (b) contains label (a).
    for threshold in ["2mm", "5mm", "10mm"] {
        let [a, b] = ["a", "b"].map(|rule| score(&report, &format!("{rule}_{threshold}"), "labelled_ratio"));
        assert!(a <= b, "{threshold}: {a} {b}");
    }
    let interval = &report["candidates"][0]["scores"]["contact_ratio"]["interval"];
    let value = score(&report, "c", "contact_ratio");
    assert!(interval[0].as_f64().unwrap() <= value && value <= interval[1].as_f64().unwrap());
    let sampling = &report["episodes"][0]["samplings"][0];
    assert_eq!((&sampling["name"], &sampling["sides"]["kind"]), (&"cube".into(), &"closed".into()), "{sampling}");
    assert!(sampling["points"].as_u64().unwrap() > 100);
}

#[test]
fn finer_sampling_increases_the_recall_of_label_a() {
    let recall = |spacing: &str| {
        let report =
            verify(&["pinch_cube", "--seeds", "1", "--seed", "5", "--thresholds", "10mm", "--spacing", spacing]);
        score(&report, "a_10mm", "pooled.recall")
    };
    let (coarse, fine) = (recall("100mm"), recall("3mm"));
    assert!(coarse < 0.5 && fine > 0.9, "{coarse} {fine}");
}

#[test]
fn a_store_and_its_rollout_have_the_same_scores() {
    let folder = Folder::new();
    let store = folder.store("pinch_cube", "5");
    let (stored, run) = (verify(&[&store]), verify(&["pinch_cube", "--seed", "5", "--seeds", "1"]));
    assert_eq!((&stored["force_places"], &run["force_places"]), (&"touched_vertices".into(), &"contacts".into()));
    assert_eq!(stored["counts"]["frames"], run["counts"]["frames"]);
    for candidate in ["c", "a_10mm", "b_1mm", "b_5mm", "b_10mm"] {
        for name in ["pooled.f1", "frame_mean.recall", "missed_force", "labelled_ratio"] {
            let (stored, run) = (score(&stored, candidate, name), score(&run, candidate, name));
            assert!((stored - run).abs() < 0.01, "{candidate}, {name}: {stored} {run}");
        }
    }
}

#[test]
fn a_store_holds_its_custom_scene_and_one_of_an_earlier_version_needs_the_unchanged_file() {
    let folder = Folder::new();
    let text = std::fs::read_to_string(concat!(env!("CARGO_MANIFEST_DIR"), "/sim/scenes/pinch_cube.yaml")).unwrap();
    let scene = folder.path("mine.yaml");
    std::fs::write(&scene, &text).unwrap();
    let store = folder.store(&scene, "5");
    let given = score(&verify(&[&store, "--scene", &scene]), "b_5mm", "pooled.f1");
    let moved_away = folder.path("elsewhere.yaml");
    std::fs::rename(&scene, &moved_away).unwrap();
    let held = score(&verify(&[&store]), "b_5mm", "pooled.f1");
    assert!(held > 0.0 && held == given, "{held} and {given}");
    std::fs::rename(&moved_away, &scene).unwrap();
    // Stores of earlier versions only name their scene.
    let attributes = format!("{store}/.zattrs");
    let mut stored: Value = serde_json::from_str(&std::fs::read_to_string(&attributes).unwrap()).unwrap();
    assert!(stored.as_object_mut().unwrap().remove("scenes").is_some());
    std::fs::write(&attributes, stored.to_string()).unwrap();
    let error = refusal(&[&store]);
    assert!(error.contains("--scene FILE") && error.contains("mine"), "{error}");
    assert_eq!(score(&verify(&[&store, "--scene", &scene]), "b_5mm", "pooled.f1"), given);
    // Another scene of the same name is refused.
    let other = std::fs::read_to_string(concat!(env!("CARGO_MANIFEST_DIR"), "/sim/scenes/hover.yaml")).unwrap();
    let moved = format!("{other}\n");
    std::fs::write(&scene, moved).unwrap();
    let error = refusal(&[&store, "--scene", &scene]);
    assert!(error.contains("that the store was made from"), "{error}");
}

/// Checks properties that hold for any hand and object: forces act only where the surfaces are near.
fn is_sound(report: &Value) {
    assert_eq!(score(report, "c", "pooled.f1"), 1.0);
    assert!(score(report, "b_10mm", "pooled.recall") > 0.9 && score(report, "b_10mm", "missed_force") < 0.1);
    assert!(score(report, "b_2mm", "pooled.precision") > 0.3, "{}", score(report, "b_2mm", "pooled.precision"));
    let ratios = ["c", "b_10mm"].map(|candidate| score(report, candidate, "labelled_ratio"));
    assert!(ratios[0] > 0.002 && ratios[1] < 0.2, "{ratios:?}");
}

#[test]
fn mano_hands_score_like_built_in_hands() {
    let folder = Folder::new();
    let data = |name: &str| format!("{}/tests/data/hand/{name}", env!("CARGO_MANIFEST_DIR"));
    let left = folder.path("left.pkl");
    let mut plain = Vec::new();
    let zipped = std::fs::read(data("left_plain.pkl.gz")).unwrap();
    std::io::Read::read_to_end(&mut flate2::read::GzDecoder::new(&zipped[..]), &mut plain).unwrap();
    std::fs::write(&left, plain).unwrap();
    let hands = ["--mano-left", &left, "--mano-right", &data("right.npz")];
    let report = verify(&[&["pinch_cube", "press_button", "--seeds", "2", "--seed", "5"], &hands[..]].concat());
    is_sound(&report);
    // A store of MANO hands records its topology and is scored only with MANO hands.
    let store = folder.path("mano.zarr");
    let run = ["sim", "run", "pinch_cube", "--seed", "5", "--size", "16", "--out", &store];
    assert!(egotac(&[&run[..], &hands].concat()).status.success());
    assert_eq!(ZarrReader::open(Path::new(&store)).unwrap().raw_attributes()["topology"], "mano");
    is_sound(&verify(&[&[&store[..]], &hands[..]].concat()));
    let error = refusal(&[&store]);
    assert!(error.contains("mano") && error.contains("egotac-hand-1"), "{error}");
}

#[test]
fn a_cube_from_a_mesh_file_scores_like_the_primitive() {
    let folder = Folder::new();
    let corners: String = (0..8).map(|i| format!("v {} {} {}\n", i & 1, (i >> 1) & 1, i >> 2)).collect();
    let faces = ["1 3 4 2", "5 6 8 7", "1 2 6 5", "3 7 8 4", "1 5 7 3", "2 4 8 6"].map(|face| format!("f {face}\n"));
    std::fs::write(folder.path("unit.obj"), corners + &faces.concat()).unwrap();
    let text = std::fs::read_to_string(concat!(env!("CARGO_MANIFEST_DIR"), "/sim/scenes/pinch_cube.yaml")).unwrap();
    let shape = "{ cube: { size: [0.03, 0.048] } }";
    assert!(text.contains(shape));
    let report = |name: &str, instead: &str| {
        let scene = folder.path(name);
        std::fs::write(&scene, text.replace(shape, instead)).unwrap();
        verify(&[&scene, "--seeds", "3", "--seed", "5"])
    };
    let cube = report("cube.yaml", "{ cube: { size: 0.04 } }");
    let mesh = report("mesh.yaml", "{ mesh: { file: unit.obj, scale: 0.04 } }");
    for (candidate, name) in [("b_2mm", "pooled.f1"), ("b_5mm", "pooled.f1"), ("b_5mm", "missed_force")] {
        let [a, b] = [&cube, &mesh].map(|report| score(report, candidate, name));
        assert!((a - b).abs() < 0.15, "{candidate}, {name}: {a} as a cube, {b} as a mesh");
    }
    is_sound(&cube);
    is_sound(&mesh);
}

fn write(path: &str, sequence: &TactileSequence) {
    tensors::write(Path::new(path), sequence, Default::default()).unwrap();
}

#[test]
fn predictions_are_scored_and_the_gate_sets_the_exit_status() {
    let folder = Folder::new();
    let store = folder.store("pinch_cube", "5");
    let reader = ZarrReader::open(Path::new(&store)).unwrap();
    let force = reader.read_f32(MANO_FORCE, 0..reader.len()).unwrap();
    let [right, half, none] = ["right", "half", "none"].map(|name| folder.path(&format!("{name}.safetensors")));
    let from_force = |force| TactileSequence::from_force(Some(Topology::EgotacHand1), force);
    let mut sequence = from_force(force);
    write(&right, &sequence);
    sequence.force.iter_mut().for_each(|f| *f /= 2.0);
    write(&half, &sequence);
    write(&none, &from_force(vec![0.0; sequence.force.len()]));

    // A store is accepted as predictions, too.
    for predictions in [&right, &store] {
        let report =
            verify(&[&store, "--predictions", predictions, "--require", "f1=1,missed_force=0,onset_error_secs=0"]);
        assert_eq!(score(&report, "prediction", "link_force_error"), 0.0);
        assert_eq!(score(&report, "prediction", "cop_distance_mm"), 0.0);
    }
    let report = verify(&[&store, "--predictions", &half]);
    // Two predictions that see no image stand beside it: no touch at all, and the truth of the frame before.
    assert_eq!((score(&report, "zero", "frame_mean.f1"), score(&report, "zero", "missed_force")), (0.0, 1.0));
    let held = ["frame_mean.f1", "mae"].map(|name| score(&report, "persistence", name));
    assert!(held[0] > 0.5 && held[0] < 1.0 && held[1] > 0.0, "{held:?}");
    assert!((score(&report, "prediction", "link_force_error") - 0.5).abs() < 1e-6);
    let links = report["candidates"][0]["links"].as_object().unwrap();
    assert!(!links.is_empty() && links.values().all(|link| (link["error"].as_f64().unwrap() - 0.5).abs() < 1e-6));

    let missed = refusal(&[&store, "--predictions", &none, "--require", "f1=0.7,missed_force=0.2,labelled=0"]);
    assert!(
        missed.contains("labelled") && missed.contains("missed_force"),
        "an unknown name lists the known: {missed}"
    );
    let missed = refusal(&[&store, "--predictions", &none, "--require", "f1=0.7,missed_force=0.2,mae=1"]);
    assert!(missed.contains("frame_mean.f1: at least 0.7 is required, got 0.0000, which misses by 0.7000"), "{missed}");
    assert!(
        missed.contains("missed_force: at most 0.2 is required, got 1.0000") && !missed.contains("mae"),
        "{missed}"
    );

    write(&none, &from_force(vec![0.0; N_FIELD]));
    assert!(refusal(&[&store, "--predictions", &none]).contains("frames, as the episodes have"));
    assert!(refusal(&["pinch_cube", "--predictions", &right]).contains("expected the stores"));
    assert!(refusal(&["pinch_cube", "--require", "f1=0.7"]).contains("of which label?"));
    assert!(refusal(&["pinch_cube", "--require", "b_7mm:f1=0.7"]).contains("b_5mm"));
    assert!(refusal(&["pinch_cube", "--thresholds", "5mm,1mm"]).contains("growing"));
}

#[test]
fn a_network_is_scored_on_rendered_images() {
    let folder = Folder::new();
    let path = PathBuf::from(folder.path("model.safetensors"));
    let (vars, config) = (VarMap::new(), Config::toy());
    EgoTac::new(&config, init::var_builder(&vars, 1, &Device::Cpu)).unwrap();
    for var in vars.all_vars() {
        var.set(&Tensor::randn(0f32, 0.2, var.shape(), &Device::Cpu).unwrap()).unwrap();
    }
    Checkpoint::save(&path, &config, &Metadata::new("random", 2.0, 0.04), &vars).unwrap();
    let model = path.to_str().unwrap();
    let arguments = ["pinch_cube", "--seeds", "1", "--seed", "5", "--size", "16", "--checkpoint", model];
    let report = verify(&arguments);
    let rate = score(&report, "prediction", "labelled_ratio");
    assert!(rate > 0.0 && rate < 1.0, "{rate}");
    let missed = refusal(&[&arguments[..], &["--require", "f1=0.99"]].concat());
    assert!(missed.contains("prediction: frame_mean.f1: at least 0.99 is required"), "{missed}");
    // The images of a store give the same scores.
    let stored = verify(&[&folder.store("pinch_cube", "5"), "--checkpoint", model]);
    for name in ["pooled.f1", "mae", "missed_force"] {
        assert!((score(&stored, "prediction", name) - score(&report, "prediction", name)).abs() < 1e-9, "{name}");
    }
}

/// Writes a bag of 20 frames at 25 Hz with touch from frame 6 on. The prediction of frame 9 is missing, the truth of frame
/// 12 is invalid.
fn bag(folder: &Path, other: bool) {
    bag_of(folder, 0..20, other);
}

/// Writes a bag with the given frames of that bag.
fn bag_of(folder: &Path, frames: std::ops::Range<i64>, other: bool) {
    let mut bag = BagWriter::create(folder).unwrap();
    bag.add_topic("/predictor/tactile", TactileFrame::TYPE, &TactileFrame::schema(), false).unwrap();
    bag.add_topic("/truth/tactile", TactileTruth::TYPE, &TactileTruth::schema(), false).unwrap();
    if other {
        bag.add_topic("/other/tactile", TactileFrame::TYPE, &TactileFrame::schema(), false).unwrap();
    }
    for index in frames {
        let stamp = Time::from_nanos(1_700_000_000_000_000_000 + index * 40_000_000);
        let header = Header { stamp, frame_id: "camera".into() };
        let mut force = vec![0.0; N_FIELD];
        if index >= 6 {
            force[100..110].fill(0.5);
        }
        let field = TactileField::from_force(Topology::EgotacHand1, force).unwrap();
        let mut frame = TactileFrame::from_field(header, &field).unwrap();
        frame.model_id = "simulator/pinch_cube".into();
        let validity = if index == 12 { Validity::TooFast } else { Validity::Valid };
        let time = stamp.nanos() as u64;
        bag.write("/truth/tactile", &TactileTruth::new(frame.clone(), validity).to_cdr(), time, time).unwrap();
        if index != 9 {
            bag.write("/predictor/tactile", &frame.to_cdr(), time, time).unwrap();
        }
        if other {
            bag.write("/other/tactile", &frame.to_cdr(), time, time).unwrap();
        }
    }
    bag.finish().unwrap();
}

#[test]
fn a_bag_of_two_files_scores_as_the_same_bag_of_one_file() {
    let folder = Folder::new();
    let [whole, first, second, split] = ["whole", "first", "second", "split"].map(|name| folder.path(name));
    bag(Path::new(&whole), false);
    bag_of(Path::new(&first), 0..9, false);
    bag_of(Path::new(&second), 9..20, false);
    std::fs::create_dir(&split).unwrap();
    // The names are in the opposite order: the order of `metadata.yaml` counts.
    std::fs::copy(format!("{first}/first_0.mcap"), format!("{split}/z.mcap")).unwrap();
    std::fs::copy(format!("{second}/second_0.mcap"), format!("{split}/a.mcap")).unwrap();
    let metadata =
        "rosbag2_bagfile_information:\n  storage_identifier: mcap\n  relative_file_paths: [z.mcap, a.mcap]\n";
    std::fs::write(format!("{split}/metadata.yaml"), metadata).unwrap();
    let [whole, split] = [whole, split].map(|bag| verify(&["--recording", &bag]));
    for part in ["counts", "unmatched", "candidates", "episodes"] {
        assert_eq!(split[part], whole[part], "{part}");
    }
    assert_eq!(split["counts"]["frames"], 18);
}

#[test]
fn a_recording_is_scored_by_equal_stamps() {
    let folder = Folder::new();
    let [plain, ambiguous] = ["plain", "ambiguous"].map(|name| folder.path(name));
    bag(Path::new(&plain), false);
    bag(Path::new(&ambiguous), true);
    let report = verify(&["--recording", &plain, "--require", "f1=1,missed_force=0"]);
    assert_eq!(report["counts"]["frames"], 18);
    assert_eq!(report["unmatched"]["truths"], 1);
    assert_eq!(report["counts"]["refused"][Validity::TooFast.reason()], 1);
    assert_eq!(score(&report, "prediction", "onset_error_secs"), 0.0);
    assert_eq!(score(&report, "prediction", "link_force_error"), 0.0);
    // The bag's file alone gives the same scores.
    let file = format!("{plain}/plain_0.mcap");
    assert_eq!(verify(&["--recording", &file])["counts"], report["counts"]);
    let error = refusal(&["--recording", &ambiguous]);
    assert!(error.contains("/other/tactile, /predictor/tactile"), "{error}");
    verify(&["--recording", &ambiguous, "--tactile-topic", "/predictor/tactile"]);
    assert!(refusal(&["--recording", &ambiguous, "--tactile-topic", "/hand"]).contains("/other/tactile"));
}
