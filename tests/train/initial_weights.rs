//! Initial weights from the data, and the auxiliary keypoint task.

use std::path::Path;

use candle_core::{DType, Device, Tensor, Var};
use candle_nn::VarMap;
use egotac::dataset::zarr::{ArraySpec, CAMERA_POSE, Contact, Dtype, OBJECT_POSE, Values, ZarrReader, ZarrWriter};
use egotac::dataset::{Attributes, EpisodeWriter, Frame};
use egotac::hand::{HandModel, HandParams, N_KEYPOINTS, Side, Topology};
use egotac::image::{IMAGENET_MEAN, IMAGENET_STD, Preparation, Resize};
use egotac::model::{Config, EgoTac, init};
use egotac::tactile::{N_FIELD, TactileField, Validity};
use egotac::train::config::LossWeights;
use egotac::train::data::{Dataset, Statistics};
use egotac::train::initial_weights;
use egotac::train::keypoints::{self, Heads, N_POINTS, Points};
use egotac::train::loss::{SupervisedCounts, Targets, objective};
use glam::Vec3;
use image::RgbImage;
use serde_json::json;

const WIDTH: u32 = 200;
const HEIGHT: u32 = 160;
const FOCAL: f32 = 180.0;

#[test]
fn initial_predictions_are_the_means_of_the_data() {
    let geometry = Config::toy();
    let varmap = VarMap::new();
    let network = EgoTac::new(&geometry, init::var_builder(&varmap, 7, &Device::Cpu)).unwrap();
    let vertex = |f: fn(usize) -> f32| (0..N_FIELD).map(f).collect::<Vec<_>>();
    let statistics = Statistics {
        force_scale: Some(2.0),
        mean_force: vertex(|v| v as f32 * 1e-3),
        contact_rate: vertex(|v| [0.0, 0.02, 0.4, 1.0][v % 4]),
    };
    initial_weights::heads(&varmap, &statistics, 2.0, 3.0).unwrap();
    initial_weights::positions(&varmap, &geometry).unwrap();
    let shape = (2, geometry.horizon, 3, geometry.image, geometry.image);
    let images = Tensor::randn(0f32, 1.0, shape, &Device::Cpu).unwrap();
    let (force, logits) = network.forward(&images).unwrap();
    let force = force.flatten_all().unwrap().to_vec1::<f32>().unwrap();
    for (entry, force) in force.iter().enumerate() {
        assert!((2.0 * force - statistics.mean_force[entry % N_FIELD]).abs() < 1e-5);
    }

    // The logits minimise the expected cross-entropy: its gradient is zero.
    let constant = logits.flatten_all().unwrap().to_vec1::<f32>().unwrap()[..N_FIELD].to_vec();
    let var = Var::from_vec(constant, (1, 1, N_FIELD), &Device::Cpu).unwrap();
    let row = |values: Vec<f32>| Tensor::from_vec(values, (1, 1, N_FIELD), &Device::Cpu).unwrap();
    let [zeros, ones] = [0.0, 1.0].map(|x| row(vec![x; N_FIELD]));
    // A soft target equals the share of frames in contact.
    let truth = Targets {
        force: zeros.clone(),
        contact: row(statistics.contact_rate.clone()),
        mask_force: zeros.clone(),
        mask_contact: ones,
    };
    let loss = LossWeights { contact: N_FIELD as f64, positive_weight: 3.0, ..LossWeights::default() };
    let gradients = objective(&zeros, var.as_tensor(), &truth, 1.0, &loss).unwrap().total.backward().unwrap();
    let slopes = gradients.get(&var).unwrap().flatten_all().unwrap().to_vec1::<f32>().unwrap();
    assert!(slopes.iter().all(|slope| slope.abs() < 1e-3), "{:?}", &slopes[..4]);
}

/// Writes a store whose camera is at the origin and looks along z; the left hand is in front of it, the right is absent.
fn write_store(path: &Path, hand: &HandParams, camera: bool) {
    let attributes = Attributes {
        topology: Topology::EgotacHand1,
        sigma: 0.0,
        contact_force: 0.05,
        producer: "test".into(),
        version: "1".into(),
        scene: "floating".into(),
        seed: 0,
    };
    let extra = match camera {
        true => vec![ArraySpec::new(CAMERA_POSE, [7], Dtype::F32), ArraySpec::new(OBJECT_POSE, [1, 7], Dtype::F32)],
        false => Vec::new(),
    };
    let mut writer = ZarrWriter::create(path, attributes, Contact::Truth, extra).unwrap();
    let intrinsics = json!({ "fx": FOCAL, "fy": FOCAL, "cx": 0.5 * WIDTH as f32, "cy": 0.5 * HEIGHT as f32 });
    writer.set_attribute("episodes", json!([{ "intrinsics": intrinsics }]));
    for t in 0..3 {
        let frame = Frame {
            timestamp: 0.04 * f64::from(t),
            camera_ego_rgb: RgbImage::new(WIDTH, HEIGHT),
            field: TactileField::from_force(Topology::EgotacHand1, vec![0.0; N_FIELD]).unwrap(),
            force_valid: vec![1; N_FIELD],
            contact_valid: vec![1; N_FIELD],
            validity: Validity::Valid,
            left_hand_pose: Some(hand.clone()),
            right_hand_pose: None,
        };
        let extra = match camera {
            true => vec![
                (CAMERA_POSE, Values::F32(vec![0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0])),
                (OBJECT_POSE, Values::F32(vec![0.1, -0.05, 0.5, 1.0, 0.0, 0.0, 0.0])),
            ],
            false => Vec::new(),
        };
        writer.push_with(frame, extra).unwrap();
    }
    writer.end_episode().unwrap();
    writer.finish().unwrap();
}

fn preparation() -> Preparation {
    Preparation { side: 56, resize: Resize::Crop, filter: Default::default(), mean: IMAGENET_MEAN, std: IMAGENET_STD }
}

#[test]
fn keypoints_agree_with_a_pinhole_projection() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.zarr");
    let hand = HandParams { transl: Vec3::new(0.02, -0.01, 0.45), ..HandParams::default() };
    write_store(&path, &hand, true);
    let points = keypoints::read(&ZarrReader::open(&path).unwrap(), 1..3, &preparation()).unwrap();
    assert_eq!(points.len(), 2);
    let model = HandModel::builtin(Side::Left);
    let places = model.keypoints(&model.forward(&hand));
    // The crop keeps the central 160 columns.
    let expected = |p: Vec3| [(80.0 + FOCAL * p.x / p.z) / 160.0, (80.0 + FOCAL * p.y / p.z) / 160.0];
    let near = |a: [f32; 2], b: [f32; 2]| (a[0] - b[0]).abs() < 1e-5 && (a[1] - b[1]).abs() < 1e-5;
    for (k, place) in places.into_iter().enumerate() {
        assert!(near(points[1][k], expected(place)), "{k}: {:?} {:?}", points[1][k], expected(place));
    }
    let absent = &points[1][N_KEYPOINTS..2 * N_KEYPOINTS];
    assert!(absent.iter().all(|place| place[0] == f32::INFINITY), "the absent hand is known not to be in the image");
    assert!(near(points[1][2 * N_KEYPOINTS], expected(Vec3::new(0.1, -0.05, 0.5))));
}

#[test]
fn keypoints_of_a_store_without_camera_poses_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.zarr");
    write_store(&path, &HandParams::default(), false);
    let mut data = Dataset::new(vec![ZarrReader::open(&path).unwrap()], preparation(), false).unwrap();
    let error = data.find_keypoints().unwrap_err().to_string();
    assert!(error.contains("loss.keypoints") && error.contains("camera"), "{error}");
}

#[test]
fn patches_are_numbered_row_by_row_within_the_image() {
    let cases = [([0.0, 0.0], 0), ([0.26, 0.0], 1), ([0.99, 0.51], 11), ([0.1, 0.999], 12)];
    for (place, patch) in cases {
        assert_eq!(keypoints::patch(place, 4), Some(patch), "{place:?}");
    }
    for place in [[1.0, 0.5], [0.5, -0.01], [f32::NAN, 0.5]] {
        assert_eq!(keypoints::patch(place, 4), None, "{place:?}");
    }
}

#[test]
fn untrained_keypoint_heads_have_the_loss_of_guessing() {
    // Tokens of zeros give equal probabilities for all patches, and the centre of the image for all coordinates.
    let geometry = Config::toy();
    let heads = Heads::new(&geometry, init::var_builder(&VarMap::new(), 1, &Device::Cpu)).unwrap();
    let zeros = |shape: &[usize]| Tensor::zeros(shape, DType::F32, &Device::Cpu).unwrap();
    let (tokens, z) = (zeros(&[2, geometry.tokens(), geometry.vision_width]), zeros(&[1, geometry.width]));
    let unknown = [[f32::NAN; 2]; N_POINTS];
    let counts = |points: &[Points], newest: &[Points]| {
        let [points, newest_points] = [points, newest].map(|points| keypoints::in_image(points) as f64);
        SupervisedCounts { points, newest_points, ..SupervisedCounts::default() }
    };
    let costs = |points: &[Points; 2]| {
        let loss = heads.loss(&tokens, points, &z, &points[1..], &counts(points, &points[1..])).unwrap();
        [loss.patch, loss.cls, loss.scene].map(|tensor| tensor.to_scalar::<f32>().unwrap())
    };
    assert_eq!(costs(&[unknown; 2]), [0.0; 3]);
    let mut points = [unknown; 2];
    points[0][3] = [0.1, 0.7]; // 0.4 and 0.2 from the middle
    points[1][5] = [0.5, 0.9]; // 0 and 0.4
    points[1][6] = [1.2, 0.5]; // outside
    let n_patches = (geometry.tokens() - 1) as f32;
    for (cost, expected) in costs(&points).into_iter().zip([n_patches.ln(), 0.25, 0.2]) {
        assert!((cost - expected).abs() < 1e-5, "{cost} instead of {expected}");
    }
    assert!(heads.loss(&tokens, &points[1..], &z, &points[1..], &SupervisedCounts::default()).is_err());
}
