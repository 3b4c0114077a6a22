//! Taxel maps of gloves: both forms of their weights, conversion of forces, and the refusal to mix kinds of force.

use std::fs;
use std::path::Path;

use crate::common::store::write_bright_store;
use crate::common::{egotac, refused};
use egotac::dataset::tensors;
use egotac::dataset::zarr::{ZarrReader, read_truth};
use egotac::hand::{HandModel, HandParams, N_VERTICES, Side, Topology};
use egotac::sensor::{self, GloveSpec, Layout, SimulatedGlove, TaxelMap};
use egotac::tactile::{ForceKind, N_FIELD, TactileSequence};
use proptest::prelude::*;

const SHIPPED: [(&str, usize); 6] = [
    ("actionsense_32x32", 0),
    ("aether_132", 132),
    ("egotactile_162", 162),
    ("opentouch_169", 169),
    ("tachintech_880", 880),
    ("touchanything_21x21", 0),
];

fn builtin() -> [HandModel; 2] {
    Side::BOTH.map(HandModel::builtin)
}

/// A pad of 4 x 3 taxels on the palm.
const PALM: &str = "name: test\ntitle: test\nplacement: drawn by us\nsource: none\nunit: N\nchannels: 12\npads:\n- name: palm\n  \
    from: wrist\n  to: middle_base\n  corners: [[0.9, 0.3], [0.9, -0.3], [0.4, -0.3], [0.4, 0.3]]\n  grid: [4, 3]\n  first: 0\n  \
    links: [wrist]\n";

fn layout(text: &str) -> egotac::Result<Layout> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("layout.yaml");
    fs::write(&path, text).unwrap();
    Layout::read(&path)
}

#[test]
fn shipped_maps_are_those_of_their_layouts() {
    assert_eq!(sensor::shipped_names(), SHIPPED.map(|(name, _)| name));
    for (name, taxels) in SHIPPED {
        let map = sensor::open(name).unwrap();
        let built = TaxelMap::build(&map.layout, &builtin()).unwrap();
        assert!(map.layout == built.layout && map.topology == Topology::EgotacHand1, "{name}");
        for (own, other) in map.hands.iter().zip(&built.hands) {
            assert!(
                own.reading == other.reading && own.spread == other.spread && own.factors == other.factors,
                "{name}"
            );
        }
        let [left, right] = map.counts();
        assert!(left == right && (taxels == 0 || left == taxels), "{name}: {left} and {right} taxels");
        for hand in &map.hands {
            let one = |sum: f32| (sum - 1.0).abs() < 1e-5;
            let lists = || hand.reading.iter().filter(|list| !list.is_empty());
            assert!(lists().count() > 150, "{name}: {} vertices are covered", lists().count());
            assert!(lists().all(|list| one(list.iter().map(|entry| entry.1).sum())), "{name}: readings");
            let shares = hand.spread.iter().filter(|shares| !shares.is_empty());
            assert!(shares.into_iter().all(|shares| one(shares.iter().map(|entry| entry.1).sum())), "{name}: shares");
        }
    }
}

#[test]
fn both_hands_read_alike_when_the_grids_mirror_each_other() {
    for (name, _) in SHIPPED {
        let map = sensor::open(name).unwrap();
        for pad in &map.layout.pads {
            for (right, left) in pad.taxels(false).unwrap().into_iter().zip(pad.taxels(true).unwrap()) {
                let (Some(right), Some(left)) = (right, left) else {
                    assert_eq!(right, left);
                    continue;
                };
                let (a, b) = (map.hands[1].positions[right], map.hands[0].positions[left]);
                let far = (a - glam::Vec3::new(-b.x, b.y, b.z)).length();
                assert!(far < 1e-5 || (a.is_nan() && b.is_nan()), "{name}, {}: {far} m", pad.name);
            }
        }
    }
    // The palm of the Aether glove lacks the first three cells of its first row on the right hand, the last three on the left.
    let palm = sensor::open("aether_132").unwrap().layout.pads.pop().unwrap();
    assert_eq!(palm.taxels(false).unwrap()[..4], [None, None, None, Some(60)]);
    assert_eq!(palm.taxels(true).unwrap()[..4], [None, None, None, Some(71)]);
}

#[test]
fn equal_readings_are_equal_at_every_vertex_and_places_are_interpolated() {
    for name in ["aether_132", "opentouch_169"] {
        let map = sensor::open(name).unwrap();
        for (hand, model) in map.hands.iter().zip(builtin()) {
            let same = hand.reading(&vec![0.7; map.layout.channels]);
            let covered = hand.covered();
            for vertex in 0..N_VERTICES {
                assert!(
                    same[vertex].is_nan() != covered[vertex] && (!covered[vertex] || (same[vertex] - 0.7).abs() < 1e-6)
                );
            }
            // The place between taxels, interpolated as the readings are, is where the vertex lies, up to a cell's curvature
            // and the half cell at the rim.
            let rest = model.forward(&HandParams::default()).vertices;
            let x: Vec<f32> = hand.positions.iter().map(|place| if place.is_nan() { 0.0 } else { place.x }).collect();
            let at = hand.reading(&x);
            let far: Vec<f32> = (0..N_VERTICES).filter(|v| covered[*v]).map(|v| (at[v] - rest[v].x).abs()).collect();
            let mean = far.iter().sum::<f32>() / far.len() as f32;
            assert!(mean < 0.003, "{name}: {mean} m");
        }
    }
}

#[test]
fn readings_and_spread_forces_convert_into_each_other_with_their_sum() {
    let map = sensor::open("aether_132").unwrap();
    // The worst taxel of the palm, whose columns are finer than the mesh, loses or gains a tenth.
    assert!(map.conversion_error() < 0.12, "{}", map.conversion_error());
    let taxels: Vec<f32> = (0..132).map(|k| (k * 7 % 11) as f32 * 0.1).collect();
    let sum = taxels.iter().map(|f| f64::from(*f)).sum::<f64>();
    let reading = map.reading([Some(&taxels), Some(&taxels)]).unwrap();
    let spread = map.spread([Some(&taxels), Some(&taxels)]).unwrap();
    let converted = map.converted(&reading, ForceKind::Spread).unwrap();
    let known = |force: &[f32]| force.iter().filter(|f| !f.is_nan()).map(|f| f64::from(*f)).sum::<f64>();
    assert!((known(&spread) - 2.0 * sum).abs() < 1e-6 * sum && (known(&converted) - 2.0 * sum).abs() < 0.02 * sum);
    // A reading at a vertex is not its share of the force.
    assert!((known(&reading) - 2.0 * sum).abs() > 0.2 * sum);
    let again = map.converted(&converted, ForceKind::Reading).unwrap();
    for (before, after) in reading.iter().zip(&again) {
        assert!(before.is_nan() && after.is_nan() || (before - after).abs() <= 1e-6 * before.max(1e-3));
    }
    assert!(map.reading([Some(&taxels[1..]), None]).unwrap_err().to_string().contains("[132]"));
    assert!(map.reading([None, Some(&taxels)]).unwrap()[..N_VERTICES].iter().all(|force| force.is_nan()));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(32))]

    #[test]
    fn spread_forces_sum_to_the_taxels(taxels in proptest::collection::vec(prop_oneof![2 => Just(0f32), 1 => 0f32..3.0], 880)) {
        thread_local!(static MAP: TaxelMap = sensor::open("tachintech_880").unwrap());
        MAP.with(|map| {
            let force = map.hands[1].spread(&taxels);
            let wanted: f64 = taxels.iter().map(|f| f64::from(*f)).sum();
            let got: f64 = force.iter().filter(|f| !f.is_nan()).map(|f| f64::from(*f)).sum();
            prop_assert!((got - wanted).abs() <= 1e-6 * wanted, "{wanted} N became {got} N");
            Ok(())
        })?;
    }
}

#[test]
fn an_unknown_taxel_makes_its_vertices_unknown_alone() {
    let map = sensor::open("aether_132").unwrap();
    let mut taxels = vec![0.5; 132];
    taxels[30] = f32::NAN;
    for field in [map.hands[1].reading(&taxels), map.hands[1].spread(&taxels)] {
        for (vertex, force) in field.iter().enumerate() {
            let list = &map.hands[1].reading[vertex];
            assert_eq!(force.is_nan(), list.is_empty() || list.iter().any(|entry| entry.0 == 30), "vertex {vertex}");
        }
    }
}

#[test]
fn a_layout_that_does_not_fit_is_refused_by_name() {
    layout(PALM).unwrap();
    for (from, to, words) in [
        ("channels: 12", "channels: 11", &["pads[0] (palm).channels", "below 11"][..]),
        ("grid: [4, 3]", "grid: [0, 3]", &["grid", "0 x 3"]),
        ("first: 0", "channels: [0, 1]", &["channels", "[12]"]),
        ("first: 0", "channels: [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 10]", &["channel 10 also in palm"]),
        ("to: middle_base", "to: middle_knuckle", &["middle_knuckle", "middle_base"]),
        ("links: [wrist]", "links: [palm]", &["palm", "wrist"]),
        ("[0.9, -0.3], [0.4, -0.3]", "[0.4, -0.3], [0.9, -0.3]", &["corners", "convex"]),
        ("placement: drawn by us", "placement: guessed", &["placement"]),
        ("grid: [4, 3]", "grids: [4, 3]", &["grids"]),
    ] {
        assert!(PALM.contains(from), "{from}");
        let error = layout(&PALM.replace(from, to)).unwrap_err().to_string();
        assert!(words.iter().all(|word| error.contains(word)) && error.contains("layout.yaml"), "{to}: {error}");
    }
    let point = layout(&PALM.replace("to: middle_base", "to: wrist")).unwrap();
    let error = TaxelMap::build(&point, &builtin()).unwrap_err().to_string();
    assert!(error.contains("pad palm") && error.contains("keypoints that are apart"), "{error}");
}

#[test]
fn maps_are_built_shown_and_read_on_the_command_line() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).display().to_string();
    let (layout, map, picture) = (path("palm.yaml"), path("map.yaml"), path("map.png"));
    fs::write(&layout, PALM).unwrap();
    let ok = |arguments: &[&str]| {
        let output = egotac(arguments);
        assert!(output.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&output.stderr));
        String::from_utf8(output.stdout).unwrap()
    };
    let text = ok(&["sensor", "new", &layout, "--out", &map, "--picture", &picture]);
    assert!(text.contains("12 and 12 taxels") && text.contains("drawn by us"), "{text}");
    let drawn = image::open(&picture).unwrap().to_rgb8();
    assert!(drawn.pixels().filter(|pixel| pixel.0 != [255; 3]).count() > 100_000);
    ok(&["sensor", "show", &map, "--out", &picture]);
    assert!(ok(&["sensor", "list"]).contains("aether_132"));
    assert_eq!(TaxelMap::read(Path::new(&map)).unwrap().counts(), [12, 12]);
    refused(&["sensor", "show", "no_such_glove"], "aether_132");
    // Weights of another map, or damaged ones, are refused.
    let weights = path("map.safetensors");
    let mut bytes = fs::read(&weights).unwrap();
    *bytes.last_mut().unwrap() ^= 1;
    fs::write(&weights, bytes).unwrap();
    refused(&["sensor", "show", &map], "SHA-256");
}

#[test]
fn forces_of_two_kinds_are_never_scored_or_trained_on_together() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let text = |name: &str| path(name).display().to_string();
    write_bright_store(&path("spread.zarr"), 6);
    let convert = |field: &str, to: &str, out: &str| {
        let output =
            egotac(&["sensor", "convert", "aether_132", "--field", &text(field), "--to", to, "--out", &text(out)]);
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    };
    convert("spread.zarr", "reading", "reading.zarr");
    convert("reading.zarr", "spread", "again.zarr");
    let [spread, reading, again] =
        ["spread.zarr", "reading.zarr", "again.zarr"].map(|name| ZarrReader::open(&path(name)).unwrap());
    assert_eq!(spread.force_kind().unwrap(), Some(ForceKind::Spread));
    assert_eq!(reading.force_kind().unwrap(), Some(ForceKind::Reading));
    let [before, there, back] = [&spread, &reading, &again].map(|store| read_truth(store).unwrap());
    let covered: Vec<bool> = sensor::open("aether_132").unwrap().hands.iter().flat_map(|hand| hand.covered()).collect();
    for entry in 0..before.force.len() {
        let known = covered[entry % N_FIELD];
        assert_eq!((there.mask_force[entry] == 1, back.mask_force[entry] == 1), (known, known));
        assert!(!known || (before.force[entry] - back.force[entry]).abs() < 1e-6 * before.force[entry].max(1.0));
    }
    assert!(reading.image(3).unwrap() == spread.image(3).unwrap());
    // Scores.
    let guess = TactileSequence { force_kind: Some(ForceKind::Spread), ..before.clone() };
    tensors::write(&path("guess.safetensors"), &guess, Default::default()).unwrap();
    refused(&["eval", "--pred", &text("guess.safetensors"), "--target", &text("reading.zarr")], "force_kind");
    convert("guess.safetensors", "reading", "guessed.safetensors");
    assert!(
        egotac(&["eval", "--pred", &text("guessed.safetensors"), "--target", &text("reading.zarr")]).status.success()
    );
    refused(
        &["sensor", "convert", "aether_132", "--field", &text("spread.zarr"), "--to", "spread", "--out", &text("x")],
        "force_kind",
    );
    // Training, and the checkpoint that it gives.
    let config = |stores: &str, name: &str| {
        let config = format!(
            "name: t\ndata: [{stores}]\nout: {}\nmodel: toy\nseed: 5\nsteps: 1\nbatch: {{clips: 1, windows: 2}}\n",
            text(name)
        );
        fs::write(path("run.yaml"), config).unwrap();
        text("run.yaml")
    };
    let both = format!("{}, {}", text("spread.zarr"), text("reading.zarr"));
    refused(&["train", "--config", &config(&both, "mixed")], "force_kind");
    let run = config(&text("reading.zarr"), "run");
    assert!(egotac(&["train", "--config", &run]).status.success());
    let checkpoint = text("run/checkpoint.safetensors");
    refused(&["eval", "--checkpoint", &checkpoint, "--data", &text("spread.zarr")], "force_kind");
    assert!(egotac(&["eval", "--checkpoint", &checkpoint, "--data", &text("reading.zarr")]).status.success());
}

/// Returns gloves, and forces on the vertices that their taxels feel.
fn gloves(spec: GloveSpec) -> (SimulatedGlove, Vec<f32>) {
    let map = sensor::open("aether_132").unwrap();
    let force = map.hands.iter().flat_map(|hand| hand.covered()).enumerate();
    let force =
        force.map(|(vertex, covered)| if covered && vertex % 3 == 0 { 0.01 * (vertex % 17) as f32 } else { 0.0 });
    let force = force.collect();
    (SimulatedGlove::new(map.into(), spec, 4).unwrap(), force)
}

fn sum(values: &[f32]) -> f64 {
    values.iter().map(|value| f64::from(*value)).sum()
}

#[test]
fn an_ideal_glove_reads_the_force_on_its_taxels() {
    let (mut glove, force) = gloves(GloveSpec::ideal("aether_132"));
    let read = glove.read(0.0, &force).unwrap();
    for (side, taxels) in Side::BOTH.into_iter().zip(&read) {
        let wanted = sum(&force[side.range()]);
        assert!((sum(taxels) - wanted).abs() < 1e-5 * wanted);
        // A single loaded vertex loads the taxels around it, in the ratio of its weights.
        let mut one = vec![0.0; N_FIELD];
        let hand = &glove.map().hands[side as usize];
        let vertex = (0..N_VERTICES).find(|vertex| hand.reading[*vertex].len() == 4).unwrap();
        one[side.range().start + vertex] = 2.0;
        let loads = sensor::simulated::loads(hand, &one[side.range()]);
        assert!(
            hand.reading[vertex].iter().all(|&(taxel, weight)| (loads[taxel as usize] - 2.0 * weight).abs() < 1e-6)
        );
    }
    assert!(glove.read(0.1, &force[1..]).is_err());
}

#[test]
fn each_imperfection_of_a_glove_does_what_it_says() {
    let with = |change: &dyn Fn(&mut GloveSpec)| {
        let mut spec = GloveSpec::ideal("aether_132");
        change(&mut spec);
        gloves(spec)
    };
    let (mut ideal, force) = with(&|_| ());
    let plain = ideal.read(0.0, &force).unwrap()[1].clone();
    // A floor cuts off what is below it and leaves the rest.
    let (mut glove, _) = with(&|spec| spec.floor = 0.1);
    let read = glove.read(0.0, &force).unwrap()[1].clone();
    assert!(plain.iter().zip(&read).all(|(plain, read)| *read == if *plain < 0.1 { 0.0 } else { *plain }));
    assert!(read.iter().any(|newtons| *newtons > 0.0) && plain.iter().any(|newtons| (0.001..0.1).contains(newtons)));
    // Crosstalk moves force between taxels and keeps its sum.
    let (mut glove, _) = with(&|spec| spec.crosstalk = 0.2);
    let read = glove.read(0.0, &force).unwrap()[1].clone();
    assert!(read != plain && (sum(&read) - sum(&plain)).abs() < 1e-4 * sum(&plain));
    // Gains differ from taxel to taxel and stay the same over time.
    let (mut glove, _) = with(&|spec| spec.gain = 0.1);
    let (first, later) = (glove.read(0.0, &force).unwrap(), glove.read(1.0, &force).unwrap());
    let ratios: Vec<f32> =
        first[1].iter().zip(&plain).filter(|(_, plain)| **plain > 0.01).map(|(a, b)| a / b).collect();
    let mean = sum(&ratios) / ratios.len() as f64;
    let spread = (ratios.iter().map(|r| (f64::from(*r) - mean).powi(2)).sum::<f64>() / ratios.len() as f64).sqrt();
    assert!(first == later && (mean - 1.0).abs() < 0.05 && (0.06..0.14).contains(&spread), "{mean} {spread}");
    // Noise has its standard deviation, and drift grows with the square root of time.
    let steady = vec![5.0; N_FIELD];
    let deviation = |values: &[f32], from: &[f32]| {
        let square = values.iter().zip(from).map(|(a, b)| f64::from(a - b).powi(2)).sum::<f64>();
        (square / values.len() as f64).sqrt()
    };
    let still = ideal.read(1.0, &steady).unwrap()[1].clone();
    let (mut glove, _) = with(&|spec| spec.noise = 0.05);
    let noise = deviation(&glove.read(0.0, &steady).unwrap()[1], &still);
    assert!((0.04..0.06).contains(&noise), "{noise}");
    let (mut glove, _) = with(&|spec| spec.drift = 0.1);
    let zero = deviation(&glove.read(0.0, &steady).unwrap()[1], &still);
    let one = deviation(&glove.read(1.0, &steady).unwrap()[1], &still);
    let nine = deviation(&glove.read(9.0, &steady).unwrap()[1], &still);
    assert!(zero == 0.0 && (0.08..0.12).contains(&one) && (2.0..4.0).contains(&(nine / one)), "{zero} {one} {nine}");
}

#[test]
fn samples_come_at_their_rate_and_after_their_delay() {
    let spec = GloveSpec { rate: 10.0, delay: 0.25, ..GloveSpec::ideal("aether_132") };
    let (mut glove, force) = gloves(spec);
    let mut seen = Vec::new();
    for frame in 0..50 {
        let scale = frame as f32;
        let force: Vec<f32> = force.iter().map(|newtons| newtons * scale).collect();
        seen.push(sum(&glove.read(0.02 * f64::from(frame), &force).unwrap()[1]));
    }
    let (mut ideal, force) = gloves(GloveSpec::ideal("aether_132"));
    let unit = sum(&ideal.read(0.0, &force).unwrap()[1]);
    // At 0.02 s per frame, samples are those of frames 0, 5, 10, ... and come out 12.5 frames later.
    for (frame, got) in seen.iter().enumerate() {
        let sample = if frame < 13 { 0 } else { (2 * frame - 25) / 10 * 5 };
        assert!((got - unit * sample as f64).abs() < 1e-3 * unit.max(*got), "frame {frame}: {}", got / unit);
    }
    let wrong = GloveSpec { crosstalk: 1.5, ..GloveSpec::ideal("aether_132") };
    assert!(wrong.check().unwrap_err().to_string().contains("glove.crosstalk"));
}

/// Returns the outlines of the Aether glove with these grids on fingers and palm.
fn with_grids(finger: [usize; 2], palm: [usize; 2]) -> TaxelMap {
    let mut layout = sensor::open("aether_132").unwrap().layout;
    let mut first = 0;
    for pad in &mut layout.pads {
        pad.grid = if pad.name == "palm" { palm } else { finger };
        (pad.first, pad.channels, pad.left_channels) = (Some(first), None, None);
        first += pad.grid[0] * pad.grid[1];
    }
    layout.channels = first;
    TaxelMap::build(&layout, &builtin()).unwrap()
}

#[test]
fn finer_taxels_bring_a_force_nearer_to_where_it_acts_also_beyond_the_mesh() {
    let hand = &builtin()[1];
    let (vertices, links) = (&hand.v_template, hand.strongest_joints());
    let normals = egotac::hand::vertex_normals(vertices, &hand.faces);
    // From 216 taxels on, many have no vertex of their own.
    let grids = [([4, 3], [5, 9]), ([6, 4], [8, 12]), ([8, 6], [12, 16]), ([12, 8], [20, 20])];
    let errors = grids.map(|(finger, palm)| {
        let map = with_grids(finger, palm);
        let taxels = &map.hands[1];
        let covered = taxels.covered();
        let (mut error, mut total) = (0.0, 0.0);
        for at in (0..778).filter(|vertex| covered[*vertex]).step_by(3) {
            // A contact as the simulator spreads it.
            let beside = |v: usize| links[v] == links[at] && normals[v].dot(normals[at]) > 0.0;
            let weight = |v: usize| (-vertices[v].distance_squared(vertices[at]) / (2.0 * 0.004f32.powi(2))).exp();
            let truth: Vec<f32> = (0..778).map(|v| if beside(v) { weight(v) } else { 0.0 }).collect();
            let felt = taxels.spread(&egotac::sensor::simulated::loads(taxels, &truth));
            for vertex in (0..778).filter(|vertex| covered[*vertex]) {
                error += f64::from((felt[vertex] - truth[vertex]).abs());
                total += f64::from(truth[vertex]);
            }
        }
        error / total
    });
    assert!(errors.windows(2).all(|pair| pair[1] < 0.85 * pair[0]) && errors[3] < 0.3, "{errors:?}");
}
