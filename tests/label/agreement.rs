//! Agreement of labels with forces, against numbers computed by hand and by scikit-learn.

use std::collections::BTreeMap;

use egotac::geometry::force::link_vertices;
use egotac::hand::{HandModel, HandParams, N_VERTICES, Side};
use egotac::score::agreement::scores::{SCORES, find};
use egotac::score::agreement::{Scorer, Sums, TruthFrame, VertexGroups};
use egotac::tactile::N_FIELD;
use glam::{DVec3, Vec3};

/// Splitmix64 as in tests/data/label/make.py.
fn mix(x: u64) -> u64 {
    let x = x.wrapping_add(0x9E37_79B9_7F4A_7C15);
    let x = (x ^ (x >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    let x = (x ^ (x >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    x ^ (x >> 31)
}

fn noise(stream: u64, index: usize) -> f64 {
    (mix(index as u64 + stream * 1_000_000) >> 40) as f64 / f64::from(1 << 24)
}

fn value(sums: &Sums, name: &str) -> Option<f64> {
    (find(name).unwrap().value)(sums)
}

fn parts() -> VertexGroups {
    VertexGroups::links(&Side::BOTH.map(HandModel::builtin))
}

fn positions() -> Vec<Vec3> {
    Side::BOTH.iter().flat_map(|side| HandModel::builtin(*side).forward(&HandParams::default()).vertices).collect()
}

/// Returns the truth of a frame with the given forces at the given vertices.
fn truth(time: f64, forces: &[(usize, f32)]) -> TruthFrame {
    TruthFrame::new(time, field(forces), Vec::new(), positions(), None).unwrap()
}

fn field(values: &[(usize, f32)]) -> Vec<f32> {
    let mut field = vec![0.0; N_FIELD];
    values.iter().for_each(|(vertex, value)| field[*vertex] = *value);
    field
}

#[test]
fn scores_are_those_of_scikit_learn_and_scipy() {
    let (t, v) = (16, N_FIELD);
    let positions: Vec<Vec3> =
        (0..v).map(|i| Vec3::from_array([0, 1, 2].map(|k| (noise(5, 3 * i + k) * 0.03) as f32))).collect();
    let contacts: [Vec<DVec3>; 2] = [0, 1].map(|side| {
        (0..40).map(|i| DVec3::from_array([0, 1, 2].map(|k| noise(6, (side * 40 + i) * 3 + k))) * 0.03).collect()
    });
    let mut scorer = Scorer::new(VertexGroups::hands());
    for frame in 0..t {
        let at = |i: usize| frame * v + i;
        let force: Vec<f32> = (0..v)
            .map(|i| if noise(1, at(i)) > 0.9 && frame % 5 != 0 { noise(2, at(i)) as f32 } else { 0.0 })
            .collect();
        let label: Vec<f32> =
            (0..v).map(|i| f32::from(noise(3, at(i)) + 0.5 * f64::from(u8::from(force[i] > 0.05)) > 0.75)).collect();
        let guess: Vec<f32> = (0..v).map(|i| (f64::from(force[i]) * (0.5 + noise(4, at(i)))) as f32).collect();
        let truth = TruthFrame::new(0.04 * frame as f64, force, vec![1; v], positions.clone(), Some(&contacts));
        scorer.push(&truth.unwrap(), &label, &guess).unwrap();
    }
    let sums = scorer.finish();
    let expected: BTreeMap<String, f64> =
        serde_json::from_str(include_str!("../data/label/expected.json")).expect("expected.json");
    assert_eq!(expected.len(), 16);
    for (name, expected) in expected {
        let got = value(&sums, &name).unwrap();
        assert!((got - expected).abs() < 1e-9, "{name}: {got} instead of {expected}");
    }
    // The groups are hands, not links.
    assert_eq!(value(&sums, "link_force_error"), None);
}

#[test]
fn a_perfect_label_scores_one_and_an_empty_label_zero() {
    let (mut perfect, mut empty) = (Scorer::new(parts()), Scorer::new(parts()));
    for frame in 0..20 {
        let touching = (5..15).contains(&frame);
        let forces: &[(usize, f32)] = if touching { &[(100, 0.4), (900, 1.5), (901, 0.02)] } else { &[] };
        let truth = truth(0.04 * f64::from(frame), forces);
        perfect.push(&truth, truth.touched(), truth.force()).unwrap();
        empty.push(&truth, &field(&[]), &field(&[])).unwrap();
    }
    let (perfect, empty) = (perfect.finish(), empty.finish());
    for name in ["precision", "recall", "f1", "iou", "frame_mean.precision", "frame_mean.recall", "frame_mean.f1"] {
        assert_eq!((value(&perfect, name), value(&empty, name)), (Some(1.0), Some(0.0)), "{name}");
    }
    for name in ["missed_force", "missed_touches", "link_force_error"] {
        assert_eq!((value(&perfect, name), value(&empty, name)), (Some(0.0), Some(1.0)), "{name}");
    }
    for name in ["onset_error_secs", "offset_error_secs", "cop_distance_mm", "mae", "false_contact_mass"] {
        assert_eq!(value(&perfect, name), Some(0.0), "{name}");
    }
    // Without labelled vertices, shares of labelled vertices and onset errors are undefined.
    for name in ["false_contact_mass", "onset_error_secs", "false_touches", "cop_distance_mm"] {
        assert_eq!(value(&empty, name), None, "{name}");
    }
    assert_eq!(value(&perfect, "contact_ratio"), Some(10.0 * 2.0 / (20.0 * 1556.0)));
    assert_eq!(perfect.timing.touches, 2, "one link of each hand");
}

#[test]
fn missed_force_and_false_mass_are_shares_of_force_and_of_vertices() {
    // Two touched vertices, 3 N and 1 N; the label finds the weaker one, and one on the other hand.
    let truth = truth(0.0, &[(100, 3.0), (400, 1.0)]);
    let sums =
        Sums::of_frame(&parts(), &truth, &field(&[(400, 0.9), (N_VERTICES + 400, 0.6), (200, 0.5)]), &[]).unwrap();
    assert_eq!(value(&sums, "missed_force"), Some(0.75));
    assert_eq!(value(&sums, "false_contact_mass"), Some(0.5));
    assert_eq!((value(&sums, "precision"), value(&sums, "recall")), (Some(0.5), Some(0.5)));
    assert_eq!((value(&sums, "mae"), value(&sums, "link_force_error")), (None, None), "no forces were given");
}

#[test]
fn a_labelled_vertex_is_false_beyond_three_millimetres_of_a_contact_of_its_hand() {
    let places = positions();
    let at = places[100].as_dvec3();
    for (off, expected) in [(0.0029, Some(0.0)), (0.0031, Some(1.0))] {
        let contacts = [vec![at + DVec3::Y * off], Vec::new()];
        let truth = TruthFrame::new(0.0, field(&[(100, 1.0)]), Vec::new(), places.clone(), Some(&contacts)).unwrap();
        let sums = Sums::of_frame(&parts(), &truth, &field(&[(100, 1.0)]), &[]).unwrap();
        assert_eq!(value(&sums, "false_contact_mass"), expected, "{off}");
        // A contact of the other hand does not count.
        let contacts = [Vec::new(), vec![at]];
        let truth = TruthFrame::new(0.0, field(&[(100, 1.0)]), Vec::new(), places.clone(), Some(&contacts)).unwrap();
        let sums = Sums::of_frame(&parts(), &truth, &field(&[(100, 1.0)]), &[]).unwrap();
        assert_eq!(value(&sums, "false_contact_mass"), Some(1.0));
    }
}

#[test]
fn link_errors_add_up_and_centres_of_pressure_are_weighted_by_force() {
    let model = HandModel::builtin(Side::Left);
    let links = link_vertices(&model);
    let (tip, thumb) = (&links[3], &links[15]);
    let [a, b] = [tip[0], tip[1]].map(|v| v as usize);
    let truth_forces = [(a, 2.0), (thumb[0] as usize, 2.0)];
    // The labelled index force is a quarter too large, on two vertices; the thumb has no labelled force.
    let guess = field(&[(a, 1.25), (b, 1.25)]);
    let sums = Sums::of_frame(&parts(), &truth(0.0, &truth_forces), &guess, &guess).unwrap();
    assert!((value(&sums, "link_force_error").unwrap() - (0.5 + 2.0) / 4.0).abs() < 1e-6);
    let middle = (positions()[a].as_dvec3() + positions()[b].as_dvec3()) / 2.0;
    let expected = 1e3 * middle.distance(positions()[a].as_dvec3());
    assert!((value(&sums, "cop_distance_mm").unwrap() - expected).abs() < 1e-6, "of the one pressed link");
    let index = parts().names().iter().position(|name| name == "left/index3").unwrap();
    assert_eq!(sums.group_force[index], [0.5, 2.0]);
}

#[test]
fn touches_are_not_followed_across_a_refused_frame() {
    let run = |refused: Option<i32>| {
        let mut scorer = Scorer::new(parts());
        for frame in 0..20 {
            let time = 0.04 * f64::from(frame);
            let forces: &[(usize, f32)] = if (5..15).contains(&frame) { &[(100, 1.0)] } else { &[] };
            let label: &[(usize, f32)] = if (7..15).contains(&frame) { &[(100, 1.0)] } else { &[] };
            match refused == Some(frame) {
                true => scorer.refuse(),
                false => drop(scorer.push(&truth(time, forces), &field(label), &[]).unwrap()),
            }
        }
        let sums = scorer.finish();
        (sums.timing.onset.count, value(&sums, "onset_error_secs"), sums.frames)
    };
    let (count, error, frames) = run(None);
    assert_eq!((count, frames), (1, 20));
    assert!((error.unwrap() - 0.08).abs() < 1e-9);
    // The refused frame lies just before the first touched one, so that the onset is unknown.
    assert_eq!(run(Some(4)), (0, None, 19));
}

#[test]
fn unknown_labels_make_scores_undefined_and_masked_vertices_do_not_count() {
    let mut label = field(&[(100, 1.0)]);
    label[7] = f32::NAN;
    let sums = Sums::of_frame(&parts(), &truth(0.0, &[(100, 1.0)]), &label, &[]).unwrap();
    for name in ["f1", "frame_mean.f1", "missed_force", "false_contact_mass"] {
        assert_eq!(value(&sums, name), None, "{name}");
    }
    let mut mask = vec![1; N_FIELD];
    mask[7] = 0;
    let truth = TruthFrame::new(0.0, field(&[(100, 1.0)]), mask, positions(), None).unwrap();
    let sums = Sums::of_frame(&parts(), &truth, &label, &[]).unwrap();
    assert_eq!(value(&sums, "f1"), Some(1.0));
    // Unknown truth does not count either.
    let mut force = field(&[(100, 1.0)]);
    force[7] = f32::NAN;
    let truth = TruthFrame::new(0.0, force, Vec::new(), positions(), None).unwrap();
    assert_eq!(value(&Sums::of_frame(&parts(), &truth, &label, &[]).unwrap(), "f1"), Some(1.0));
}

#[test]
fn sums_of_episodes_add_up_to_those_of_all_frames() {
    let frames: Vec<(TruthFrame, Vec<f32>)> = (0..6)
        .map(|i| {
            // Nothing is touched in the second frame.
            let force = if i == 1 { 0.0 } else { 0.5 + i as f32 };
            (truth(0.04 * f64::from(i), &[(100 + i as usize, force)]), field(&[(102, 1.0), (104, 1.0)]))
        })
        .collect();
    let score = |frames: &[(TruthFrame, Vec<f32>)]| {
        let mut scorer = Scorer::new(parts());
        frames.iter().for_each(|(truth, label)| drop(scorer.push(truth, label, label).unwrap()));
        scorer.finish()
    };
    let mut parted = score(&frames[..2]);
    parted += &score(&frames[2..]);
    let whole = score(&frames);
    for score in &SCORES {
        if !score.name.contains("_secs") && !score.name.contains("touches") {
            let (a, b) = ((score.value)(&whole), (score.value)(&parted));
            assert!(a.is_some() && (a.unwrap() - b.unwrap()).abs() < 1e-12, "{}: {a:?} {b:?}", score.name);
        }
    }
}

#[test]
fn errors_name_the_array_of_wrong_length() {
    let error = |force: Vec<f32>, mask: Vec<u8>, places: Vec<Vec3>, time: f64| {
        TruthFrame::new(time, force, mask, places, None).unwrap_err().to_string()
    };
    assert!(error(vec![0.0; 778], vec![], vec![], 0.0).contains("force"));
    assert!(error(field(&[]), vec![1], vec![], 0.0).contains("mask"));
    assert!(error(field(&[]), vec![], vec![Vec3::NAN; N_FIELD], 0.0).contains("positions[0]"));
    assert!(error(field(&[(3, -1.0)]), vec![], vec![], 0.0).contains("force[3]"));
    assert!(error(field(&[(3, f32::INFINITY)]), vec![], vec![], 0.0).contains("force[3]"));
    assert!(error(field(&[]), vec![], vec![], f64::NAN).contains("time"));
    let mut scorer = Scorer::new(parts());
    assert!(scorer.push(&truth(1.0, &[]), &[0.0; 3], &[]).unwrap_err().to_string().contains("label"));
    scorer.push(&truth(1.0, &[]), &field(&[]), &[]).unwrap();
    assert!(scorer.push(&truth(1.0, &[]), &field(&[]), &[]).unwrap_err().to_string().contains("time"));
    assert!(find("f3").unwrap_err().to_string().contains("missed_force"));
}
