//! `egotac experiment recordings`: what is recorded in the layouts of data sets comes back from the import.
#![cfg(feature = "sim")]

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use egotac::dataset::zarr::{MANO_CONTACT_VALID, MANO_FORCE, MANO_FORCE_VALID, MANO_PROXIMITY, TIMESTAMPS, ZarrReader};
use egotac::hand::{N_FIELD, Side};
use egotac::sensor::{self, TaxelMap};
use egotac_bench::experiment::recording::{models, streams};
use serde_json::Value;

/// First seed of the training episodes.
const SEED: u64 = 70_000;

/// Returns the only entry of a folder whose name begins so.
fn only(folder: &Path, begin: &str) -> PathBuf {
    let all = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    let mut found = all.filter(|path| path.file_name().unwrap().to_string_lossy().starts_with(begin));
    let first = found.next().unwrap_or_else(|| panic!("nothing in {} begins with {begin}", folder.display()));
    assert!(found.next().is_none(), "{begin}");
    first
}

#[test]
fn recordings_of_poses_and_of_gloves_are_imported_with_their_labels_and_trained_on() {
    let folder = tempfile::tempdir().unwrap();
    let (work, out) = (folder.path().join("work"), folder.path().join("out"));
    let output = Command::new(env!("CARGO_BIN_EXE_egotac-bench"))
        .args(["experiment", "recordings", "--quick", "--work"])
        .arg(&work)
        .arg("--out")
        .arg(&out)
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let data = work.join("data");
    check_contact(&data);
    check_force(&data);
    check_report(&out);
}

/// Checks that the contact of the imported clip is the 1 cm rule on the simulator's own surfaces.
fn check_contact(data: &Path) {
    let store = ZarrReader::open(&only(&data.join("imported"), "hot3d_")).unwrap();
    let rendered = ZarrReader::open(&only(data, "recorded_hot3d_lift_mug_train")).unwrap();
    assert_eq!(store.len(), rendered.len());
    let got = store.read_contact(0..store.len()).unwrap();
    let known = store.read_u8(MANO_CONTACT_VALID, 0..store.len()).unwrap();
    let want = rendered.read_u8(MANO_PROXIMITY, 0..store.len()).unwrap();
    let (mut hits, mut wrong) = (0, 0);
    for ((got, want), _) in got.iter().zip(&want).zip(&known).filter(|(_, known)| **known == 1) {
        match (*got == 1.0, *want == 1) {
            (true, true) => hits += 1,
            (false, false) => {}
            _ => wrong += 1,
        }
    }
    let f1 = 2.0 * f64::from(hits) / f64::from(2 * hits + wrong);
    assert!(hits > 1000 && f1 > 0.99, "{hits} vertices in contact, F1 {f1}");
    // The clip has no force.
    assert!(!store.read_u8(MANO_FORCE_VALID, 0..store.len()).unwrap().contains(&1));
}

/// Checks that the forces of the imported recording are the taxel map of what the simulated taxels read: rest subtracted, light
/// readings cut off, the mean of three samples, linear between the samples around an image.
fn check_force(data: &Path) {
    let models = models(&["MANO_LEFT.npz", "MANO_RIGHT.npz"].map(|name| data.join("mano").join(name))).unwrap();
    let scene = only(&data.join("scenes"), "recorded_glove_");
    let (gloves, _) = streams(&scene, SEED, &models).unwrap();
    let map = TaxelMap::build(&sensor::open("aether_132").unwrap().layout, &models).unwrap();
    let store = ZarrReader::open(&only(&data.join("imported"), "egotac-sc-raw_")).unwrap();
    let stamps = store.read(TIMESTAMPS, 0..store.len()).unwrap().into_f64();
    let force = store.read_f32(MANO_FORCE, 0..store.len()).unwrap();
    let known = store.read_u8(MANO_FORCE_VALID, 0..store.len()).unwrap();
    let (mut compared, mut newtons) = (0, 0.0);
    for (side, glove) in Side::BOTH.into_iter().zip(&gloves) {
        let n = glove.stamps.len();
        let rest = |taxel: usize| glove.taxels[..10].iter().map(|sample| sample[taxel]).sum::<f32>() / 10.0;
        let cut = |sample: usize, taxel: usize| Some(glove.taxels[sample][taxel] - rest(taxel)).filter(|x| *x >= 0.2);
        let mean = |sample: usize, taxel: usize| {
            let around = sample.saturating_sub(1)..(sample + 2).min(n);
            let count = around.len() as f32;
            around.map(|sample| cut(sample, taxel).unwrap_or(0.0)).sum::<f32>() / count
        };
        for (row, stamp) in stamps.iter().enumerate() {
            let after = glove.stamps.iter().position(|sample| *sample >= stamp * 1e3 - 1e-6);
            let at = N_FIELD * row + side.range().start;
            let (got, known) = (&force[at..at + 778], &known[at..at + 778]);
            let Some(after) = after.filter(|after| *after > 0) else {
                assert!(!known.contains(&1), "image {row}: no sample follows it");
                continue;
            };
            let span = glove.stamps[after] - glove.stamps[after - 1];
            let share = ((stamp * 1e3 - glove.stamps[after - 1]) / span) as f32;
            let taxels: Vec<f32> =
                (0..132).map(|taxel| (1.0 - share) * mean(after - 1, taxel) + share * mean(after, taxel)).collect();
            let want = map.hands[side as usize].spread(&taxels);
            for ((got, want), known) in got.iter().zip(&want).zip(known) {
                assert_eq!(*known == 1, want.is_finite());
                if want.is_finite() {
                    assert!((got - want).abs() < 1e-3 * (1.0 + want), "image {row}: {got} N for {want} N");
                    compared += 1;
                    newtons += got;
                }
            }
        }
    }
    assert!(compared > 10_000 && newtons > 1.0, "{compared} vertices, {newtons} N");
}

/// Checks that all arms are scored, and that clips without force give no network of force.
fn check_report(out: &Path) {
    let report: Value = serde_json::from_slice(&fs::read(out.join("recordings.json")).unwrap()).unwrap();
    let arms = report["arms"].as_array().unwrap();
    let arm = |name: &str| arms.iter().find(|arm| arm["name"] == name).unwrap();
    let frames = |name: &str| arm(name)["training_frames"].as_u64().unwrap();
    assert_eq!(frames("mixed"), frames("glove") + frames("hot3d"));
    let seed = |name: &str| &arm(name)["tests"]["ood_force"]["seeds"][0];
    assert!(seed("hot3d")["active_mae"].is_null() && seed("zero")["active_mae"].is_number());
    assert!(["mixed", "glove", "hot3d"].iter().all(|name| seed(name)["pooled"]["auroc"].is_number()));
    let imported = &report["imported"];
    assert!(imported[0]["contact_f1"].as_f64().unwrap() > 0.99, "{imported}");
    let kept = imported[1]["force_kept"].as_f64().unwrap();
    assert!((0.02..1.0).contains(&kept), "{imported}");
}
