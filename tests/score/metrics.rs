//! Metrics: agreement with scikit-learn, scipy and numpy, and undefined scores of degenerate input.

use egotac::hand::{N_VERTICES, Topology};
use egotac::score::metrics::{
    Calibration, ContactScores, EvalOptions, FrameScore, Metrics, evaluate, summarize, table,
};
use egotac::tactile::{N_FIELD, TactileSequence};
use serde_json::Value;

const T: usize = 64;

fn mix(x: u64) -> u64 {
    let x = x.wrapping_add(0x9E37_79B9_7F4A_7C15);
    let x = (x ^ (x >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    let x = (x ^ (x >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    x ^ (x >> 31)
}

/// The fields of tests/data/metrics/make.py: prediction, truth, the two masks.
fn fields() -> (TactileSequence, TactileSequence, Vec<u8>, Vec<u8>) {
    let (mut pred, mut target) = (TactileSequence::default(), TactileSequence::default());
    let (mut mask_force, mut mask_contact) = (Vec::new(), Vec::new());
    for index in 0..T * N_FIELD {
        let t = index / N_FIELD;
        let a = mix(index as u64);
        let b = mix(a);
        let bits = |x: u64, shift: u32, modulus: u64| ((x >> shift) % modulus) as f32;
        let factor = (2.0 + bits(mix(1000 + t as u64), 3, 16)) / 16.0;
        let touched = bits(a, 8, 20) < (1 + t % 5) as f32 && !t.is_multiple_of(7);
        let force = if touched { bits(a, 20, 512) / 256.0 } else { 0.0 };
        let contact = force > 0.05;
        target.force.push(force);
        target.contact.push(f32::from(contact));
        pred.force.push(if bits(b, 3, 8) < 6.0 { force * factor } else { bits(b, 20, 64) / 256.0 });
        pred.contact.push((bits(b, 30, 64) + 32.0 * f32::from(contact)) / 96.0);
        mask_force.push(u8::from(bits(a, 45, 13) != 0.0));
        mask_contact.push(u8::from(bits(b, 45, 11) != 0.0));
    }
    (pred, target, mask_force, mask_contact)
}

fn assert_agrees(ours: &Value, expected: &Value, at: &str) {
    match expected {
        Value::Object(map) => {
            map.iter().for_each(|(key, value)| assert_agrees(&ours[key], value, &format!("{at}.{key}")))
        }
        _ => {
            let (ours, expected) = (ours.as_f64().unwrap_or(f64::NAN), expected.as_f64().unwrap());
            assert!((ours - expected).abs() <= 1e-6 * expected.abs().max(1.0), "{at}: {ours} instead of {expected}");
        }
    }
}

#[test]
fn scores_agree_with_scikit_learn_scipy_and_numpy() {
    let (pred, target, mask_force, mask_contact) = fields();
    let expected: Value = serde_json::from_str(include_str!("../data/metrics/expected.json")).unwrap();
    let masked = TactileSequence { mask_force, mask_contact, episode_ends: vec![23, 50, 64], ..target.clone() };
    let calibration = r#"{"pred": {"min": 20, "max": 200}, "target": {"min": 10, "max": 150}}"#;
    let calibration = Some(serde_json::from_str::<Calibration>(calibration).unwrap());
    for (name, target, calibration) in
        [("plain", &target, None), ("masked_episodes", &masked, None), ("calibrated", &target, calibration)]
    {
        let options = EvalOptions { fps: Some(25.0), calibration };
        let report = serde_json::to_value(evaluate(&pred, target, &options).unwrap()).unwrap();
        assert_agrees(&report, &expected[name], name);
    }
}

#[test]
fn frame_scores_sum_up_to_the_whole() {
    let (pred, target, ..) = fields();
    let whole = evaluate(&pred, &target, &EvalOptions::default()).unwrap();
    let frames: Vec<FrameScore> = (0..T)
        .map(|t| {
            let rows = t * N_FIELD..(t + 1) * N_FIELD;
            let of = |values: &[f32]| values[rows.clone()].to_vec();
            FrameScore::new(&of(&pred.force), &of(&pred.contact), &of(&target.force), &of(&target.contact), &[], &[])
        })
        .collect();
    let sum = summarize(&frames);
    assert_eq!((sum.mae, sum.active_mae, sum.temporal_pearson), (whole.mae, whole.active_mae, whole.temporal_pearson));
    assert_eq!(sum.frame_mean, whole.frame_mean);
    assert_eq!(sum.pooled, ContactScores { auroc: None, ..whole.pooled });
    assert_eq!(sum.counts, whole.counts);
}

fn constant(n_frames: usize, force: f32) -> TactileSequence {
    TactileSequence::from_force(None, vec![force; n_frames * N_FIELD])
}

fn report(pred: &TactileSequence, target: &TactileSequence) -> Metrics {
    evaluate(pred, target, &EvalOptions { fps: Some(25.0), calibration: None }).unwrap()
}

#[test]
fn truth_without_contact_leaves_contact_scores_undefined() {
    let report = report(&constant(4, 0.0), &constant(4, 0.0));
    assert_eq!((report.mae, report.active_mae), (Some(0.0), None));
    assert_eq!((report.frame_mean, report.pooled), (ContactScores::default(), ContactScores::default()));
    assert_eq!(report.counts.frames_without_positives, 4);
    assert_eq!((report.force_cosine, report.rise_f1, report.dft_pearson), (None, None, None));
}

#[test]
fn constant_traces_have_no_spectrum_and_no_correlation() {
    let (pred, ..) = fields();
    let report = report(&constant(T, 0.1), &pred);
    assert_eq!((report.temporal_pearson, report.dft_pearson), (None, None));
    assert_eq!(report.dominant_frequency_error_hz, None);
    assert_eq!(report.spectral_convergence, Some(1.0), "a constant has no spectrum, so all of the target's is missed");
    assert_eq!(report.rise_f1, Some(0.0));
}

#[test]
fn one_frame_and_none_are_scored_without_nan() {
    let one = report(&constant(1, 0.2), &constant(1, 0.1));
    assert!((one.mae.unwrap() - 0.1).abs() < 1e-6);
    assert_eq!(one.pooled.auroc, None, "no negatives");
    assert_eq!((one.pooled.f1, one.temporal_pearson), (Some(1.0), None));
    let none = report(&TactileSequence::default(), &TactileSequence::default());
    assert_eq!((none.mae, none.counts.frames), (None, 0));
    for report in [&one, &none] {
        let json = serde_json::to_string(report).unwrap();
        assert!(!json.contains("NaN") && !table(&[("x", report)]).contains("NaN"));
    }
}

#[test]
fn masked_and_unknown_truth_does_not_count() {
    let (pred, target, ..) = fields();
    let none = vec![0; T * N_FIELD];
    let masked = TactileSequence { mask_force: none.clone(), mask_contact: none, ..target.clone() };
    let options = EvalOptions::default();
    let nothing = evaluate(&pred, &masked, &options).unwrap();
    assert_eq!((nothing.mae, nothing.pooled, nothing.counts.force_entries), (None, ContactScores::default(), 0));
    // The left hand unknown in truth scores as if it were masked out.
    let left = |index: usize| index % N_FIELD < N_VERTICES;
    let mask: Vec<u8> = (0..T * N_FIELD).map(|index| u8::from(!left(index))).collect();
    let mut unknown = target.clone();
    for index in (0..T * N_FIELD).filter(|index| left(*index)) {
        unknown.force[index] = f32::NAN;
        unknown.contact[index] = f32::NAN;
    }
    let masked = TactileSequence { mask_force: mask.clone(), mask_contact: mask, ..target.clone() };
    assert_eq!(evaluate(&pred, &unknown, &options).unwrap(), evaluate(&pred, &masked, &options).unwrap());
    // So does a frame that a guard refused.
    let refused = TactileSequence { validity: (0..T).map(|t| u8::from(t % 3 == 0)).collect(), ..target.clone() };
    let mask: Vec<u8> = (0..T * N_FIELD).map(|index| u8::from(!(index / N_FIELD).is_multiple_of(3))).collect();
    let masked = TactileSequence { mask_force: mask.clone(), mask_contact: mask, ..target };
    assert_eq!(evaluate(&pred, &refused, &options).unwrap(), evaluate(&pred, &masked, &options).unwrap());
}

#[test]
fn an_unknown_prediction_makes_its_scores_undefined() {
    let (mut pred, target, ..) = fields();
    pred.force[5] = f32::NAN;
    let report = report(&pred, &target);
    assert_eq!((report.mae, report.active_mae, report.temporal_pearson), (None, None, None));
    assert!(report.pooled.f1.is_some());
    assert_eq!(report.counts.unknown_predictions, 1);
}

#[test]
fn mismatched_lengths_episodes_and_topologies_are_refused() {
    let (pred, target, ..) = fields();
    let refused = |pred: &TactileSequence, target: &TactileSequence, word: &str| {
        let error = evaluate(pred, target, &EvalOptions::default()).unwrap_err().to_string();
        assert!(error.contains(word), "{word} is not in: {error}");
    };
    refused(&constant(3, 0.0), &target, "pred force");
    refused(&pred, &TactileSequence { mask_force: vec![1; 5], ..target.clone() }, "mask_force");
    for episode_ends in [vec![10, 63], vec![0, 64], vec![40, 30, 64]] {
        refused(&pred, &TactileSequence { episode_ends, ..target.clone() }, "episode_ends");
    }
    let on = |topology, sequence: &TactileSequence| TactileSequence { topology: Some(topology), ..sequence.clone() };
    refused(&on(Topology::Mano, &pred), &on(Topology::EgotacHand1, &target), "mano");
}
