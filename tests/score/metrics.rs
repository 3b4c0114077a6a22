//! Metrics: agreement with scikit-learn, scipy and numpy, and undefined scores of degenerate input.

use egotac::hand::{N_VERTICES, Topology};
use egotac::score::metrics::{
    Calibration, ContactScores, EpisodesDefined, EvalOptions, FrameScore, Metrics, Range, calibrate, evaluate,
    evaluate_egophi, intervals, summarize, table, table_with_intervals,
};
use egotac::tactile::{CONTACT_FORCE_N, N_FIELD, TactileSequence};
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
    for (name, target, calibration) in
        [("plain", &target, None), ("masked_episodes", &masked, None), ("calibrated", &target, Some(ranges()))]
    {
        let options = EvalOptions { fps: Some(25.0), calibration };
        let report = serde_json::to_value(evaluate(&pred, target, &options).unwrap()).unwrap();
        assert_agrees(&report, &expected[name], name);
    }
}

/// The calibration of tests/data/metrics/make.py.
fn ranges() -> Calibration {
    let text = r#"{"pred": {"min": 20, "max": 200}, "target": {"min": 10, "max": 150}}"#;
    serde_json::from_str(text).unwrap()
}

/// The fields of tests/data/metrics/make.py with gaps: frames masked whole. The prediction of the third of four episodes does
/// not change, nor does the truth of the fourth.
fn fields_with_gaps() -> (TactileSequence, TactileSequence) {
    let (mut pred, target, mut mask_force, mut mask_contact) = fields();
    let mut force = target.force;
    let rows = |frames: std::ops::Range<usize>| frames.start * N_FIELD..frames.end * N_FIELD;
    mask_force[rows(50..T)].fill(1);
    mask_contact[rows(50..T)].fill(1);
    [0, 5, 6, 12, 22, 23, 31, 40, 41, 55].into_iter().for_each(|t| mask_force[rows(t..t + 1)].fill(0));
    [0, 5, 6, 12, 62].into_iter().for_each(|t| mask_contact[rows(t..t + 1)].fill(0));
    pred.force[rows(50..60)].fill(0.25);
    force[rows(60..T)].fill(0.0);
    let target = TactileSequence::from_force(None, force);
    (pred, TactileSequence { mask_force, mask_contact, episode_ends: vec![23, 50, 60, 64], ..target })
}

#[test]
fn traces_with_gaps_agree_with_scikit_learn_scipy_and_numpy() {
    let (pred, target) = fields_with_gaps();
    let expected: Value = serde_json::from_str(include_str!("../data/metrics/expected.json")).unwrap();
    for (name, calibration) in [("gaps", None), ("gaps_calibrated", Some(ranges()))] {
        let options = EvalOptions { fps: Some(25.0), calibration };
        let report = serde_json::to_value(evaluate(&pred, &target, &options).unwrap()).unwrap();
        assert_agrees(&report, &expected[name], name);
    }
}

#[test]
fn values_in_a_gap_change_no_score() {
    let (pred, target) = fields_with_gaps();
    let options = EvalOptions { fps: Some(25.0), calibration: None };
    let before = evaluate(&pred, &target, &options).unwrap();
    let (mut other, mut truth) = (pred, target);
    for entry in (0..T * N_FIELD).filter(|entry| [5, 6, 12].contains(&(entry / N_FIELD))) {
        (other.force[entry], other.contact[entry]) = (f32::NAN, f32::NAN);
        (truth.force[entry], truth.contact[entry]) = (40.0, 1.0);
    }
    assert_eq!(evaluate(&other, &truth, &options).unwrap(), before);
}

#[test]
fn egophis_protocol_agrees_with_scikit_learn() {
    let (pred, mut target) = fields_with_gaps();
    for (mask, force) in target.mask_force.iter_mut().zip(&target.force) {
        *mask |= u8::from(*force > CONTACT_FORCE_N);
    }
    let scores = evaluate_egophi(&pred, &target, 0).unwrap();
    let expected: Value = serde_json::from_str(include_str!("../data/metrics/expected.json")).unwrap();
    assert_agrees(&serde_json::to_value(&scores).unwrap(), &expected["egophi"], "egophi");
    for (name, [low, high]) in &scores.intervals {
        let value = serde_json::to_value(&scores).unwrap()[name].as_f64().unwrap();
        assert!(low <= &value && &value <= high, "{name}: {value} outside of {low}..{high}");
    }
    let mut unknown = pred;
    unknown.force[N_FIELD + 900] = f32::NAN;
    let scores = evaluate_egophi(&unknown, &target, 0).unwrap();
    assert!(scores.masked_mae.is_none() && scores.volumetric_iou.is_none() && scores.f1.is_some());
}

#[test]
fn a_calibration_split_gives_the_ranges_of_both_sides() {
    let mut force = vec![0.0; 4 * N_FIELD];
    [1.0, 5.0, 100.0, 2.0].into_iter().enumerate().for_each(|(t, f)| force[t * N_FIELD + 3] = f);
    let mut target = TactileSequence::from_force(None, force.clone());
    let pred = TactileSequence::from_force(None, force.iter().map(|f| 2.0 * f).collect());
    target.validity = vec![0, 0, 1, 0];
    let calibration = calibrate(&pred, &target).unwrap();
    let [pred_range, target_range] = [Range { min: 2.0, max: 10.0 }, Range { min: 1.0, max: 5.0 }];
    assert_eq!((calibration.pred(), calibration.target()), (pred_range, target_range));
    // A written calibration reads back equal.
    let text = serde_json::to_string(&calibration).unwrap();
    assert_eq!(serde_json::from_str::<Calibration>(&text).unwrap(), calibration);
    let error = calibrate(&constant(4, 0.1), &target).unwrap_err().to_string();
    assert!(error.contains("predicted total force"), "{error}");
    let unknown = TactileSequence { force: vec![f32::NAN; 4 * N_FIELD], ..pred };
    assert!(calibrate(&unknown, &target).unwrap_err().to_string().contains("an unknown one"));
}

#[test]
fn with_a_calibration_the_gain_of_a_sensor_changes_no_temporal_score() {
    let (pred, target, ..) = fields();
    let louder = TactileSequence { force: pred.force.iter().map(|f| 4.0 * f).collect(), ..pred.clone() };
    let scores = |pred: &TactileSequence, calibration: Option<Calibration>| {
        let report = evaluate(pred, &target, &EvalOptions { fps: Some(25.0), calibration }).unwrap();
        let names = ["temporal_pearson", "force_cosine", "rise_f1", "fall_f1", "dft_pearson", "spectral_convergence"];
        names.map(|name| report.score(name).unwrap())
    };
    let each = [&pred, &louder].map(|pred| scores(pred, Some(calibrate(pred, &target).unwrap())));
    assert!(each[0].iter().zip(each[1]).all(|(a, b)| (a - b).abs() < 1e-6), "{each:?}");
    let [a, b] = [&pred, &louder].map(|pred| scores(pred, None)[5]);
    assert!(b > a + 0.5, "in newtons the spectra differ: {a} {b}");
}

#[test]
fn the_table_shows_intervals_and_the_episodes_of_each_temporal_score() {
    let (pred, target) = fields_with_gaps();
    let options = EvalOptions { fps: Some(25.0), calibration: None };
    let report = evaluate(&pred, &target, &options).unwrap();
    let text = table_with_intervals(&[("x", &report)], &intervals(&pred, &target, &options, 0).unwrap());
    let row = |name: &str| text.lines().find(|line| line.starts_with(name)).unwrap_or_else(|| panic!("{name}: {text}"));
    assert!(row("fall F1").contains("on 2 of 4 episodes") && row("DFT Pearson").contains("on 3 of 4 episodes"));
    assert!(row("F1, frame mean").contains("0.45122") && row("F1, frame mean").contains(" .. "), "{text}");
    assert!(text.find("F1, frame mean") < text.find("F1, pooled"), "{text}");
    assert!(
        text.contains("11 of them without contact, 18.6 %") && text.contains("10 masked frames are gaps"),
        "{text}"
    );
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
    assert_eq!((sum.mae, sum.active_mae), (whole.mae, whole.active_mae));
    assert!((sum.temporal_pearson.unwrap() - whole.temporal_pearson.unwrap()).abs() < 1e-12);
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
    assert_eq!((report.share_without_positives, report.false_positive_rate), (Some(1.0), Some(0.0)));
    assert_eq!((report.frame_mean, report.pooled), (ContactScores::default(), ContactScores::default()));
    assert_eq!(report.counts.frames_without_positives, 4);
    assert_eq!((report.force_cosine, report.rise_f1, report.dft_pearson), (None, None, None));
}

#[test]
fn a_constant_prediction_of_changing_truth_has_correlations_of_zero() {
    let (truth, ..) = fields();
    let scores = report(&constant(T, 0.1), &truth);
    assert_eq!((scores.temporal_pearson, scores.dft_pearson, scores.rise_f1), (Some(0.0), Some(0.0), Some(0.0)));
    assert_eq!(scores.spectral_convergence, Some(1.0), "a constant has no spectrum, so all of the target's is missed");
    let varied = report(&truth, &truth);
    assert!(varied.temporal_pearson.unwrap() > 1.0 - 1e-12 && varied.dominant_frequency_error_hz == Some(0.0));
    assert!(scores.dominant_frequency_error_hz.unwrap() > 0.0, "its strongest frequency is 0");
    // The cosine of any positive constant is the same; that of no force at all is 0.
    let [weak, strong, none] = [0.1, 0.7, 0.0].map(|f| report(&constant(T, f), &truth).force_cosine.unwrap());
    assert!((weak - strong).abs() < 1e-12 && weak > 0.1 && none == 0.0, "{weak} {strong} {none}");
}

#[test]
fn truth_that_does_not_change_leaves_temporal_scores_undefined() {
    let (pred, ..) = fields();
    let scores = report(&pred, &constant(T, 0.1));
    assert_eq!(scores.episodes_defined, EpisodesDefined::default());
    for name in ["temporal_pearson", "force_cosine", "rise_f1", "fall_f1", "dft_pearson", "spectral_convergence"] {
        assert_eq!(scores.score(name), None, "{name}");
    }
    // Such episodes take no part in the means.
    let mut truth = fields().1;
    truth.force[32 * N_FIELD..].fill(0.3);
    truth.episode_ends = vec![32, 64];
    let (whole, half) = (report(&pred, &truth), pred.select(0..32));
    assert_eq!(whole.temporal_pearson, report(&half, &truth.select(0..32)).temporal_pearson);
    assert_eq!((whole.episodes_defined.temporal_pearson, whole.counts.episodes), (1, 2));
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
