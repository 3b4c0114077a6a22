//! Batches of a training step: frames, windows and labels.

use std::path::Path;

use egotac::dataset::zarr::{Contact, ZarrReader, ZarrWriter};
use egotac::dataset::{Attributes, EpisodeWriter, Frame};
use egotac::hand::Topology;
use egotac::image::{IMAGENET_MEAN, IMAGENET_STD, Preparation, normalise};
use egotac::tactile::{N_FIELD, TactileField, Validity};
use egotac::train::batch::Collate;
use egotac::train::config::AugmentConfig;
use egotac::train::data::Dataset;
use egotac::train::sampler::Clip;
use egotac::train::source::TrainingSource;
use image::{Rgb, RgbImage};

const SIDE: usize = 8;

fn picture(index: usize) -> RgbImage {
    RgbImage::from_fn(SIDE as u32, SIDE as u32, |x, y| Rgb([10 * index as u8, 9 * x as u8, 7 * y as u8]))
}

fn preparation() -> Preparation {
    Preparation {
        side: SIDE,
        resize: Default::default(),
        filter: Default::default(),
        mean: IMAGENET_MEAN,
        std: IMAGENET_STD,
    }
}

/// Writes a store whose frame t has t N on vertex t; frame 7 is refused by a guard, vertex 3 of frame 8 is unknown.
fn write_store(path: &Path) {
    let attributes = Attributes {
        topology: Topology::Mano,
        sigma: 0.0,
        contact_force: 0.05,
        producer: "test".into(),
        version: "1".into(),
        scene: "formula".into(),
        seed: 0,
    };
    let mut writer = ZarrWriter::create(path, attributes, Contact::Truth, Vec::new()).unwrap();
    for t in 0..12 {
        let force = (0..N_FIELD).map(|v| if v == t { t as f32 } else { 0.0 }).collect();
        let mut field = TactileField::from_force(Topology::Mano, force).unwrap();
        if t == 8 {
            field.force[3] = f32::NAN;
        }
        writer
            .push(Frame {
                timestamp: 0.1 * t as f64,
                camera_ego_rgb: picture(t),
                field,
                force_valid: vec![1; N_FIELD],
                contact_valid: (0..N_FIELD).map(|v| u8::from(v != 5)).collect(),
                validity: if t == 7 { Validity::TooDeep } else { Validity::Valid },
                left_hand_pose: None,
                right_hand_pose: None,
            })
            .unwrap();
        if t == 3 || t == 11 {
            writer.end_episode().unwrap();
        }
    }
    writer.finish().unwrap();
}

#[test]
fn batches_contain_each_frame_once_and_the_labels_of_the_newest() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.zarr");
    write_store(&path);
    for in_memory in [true, false] {
        let data = Dataset::new(vec![ZarrReader::open(&path).unwrap()], preparation(), in_memory).unwrap();
        assert_eq!((data.n_frames(), data.topology()), (12, Topology::Mano));
        assert_eq!(data.episodes(), [(0, 0..4), (0, 4..12)]);
        // 1..6 N, 8..11 N are active (frame 7 is refused, and 0 N is no contact): the 99th percentile is the largest.
        assert_eq!(data.statistics().unwrap().force_scale, Some(11.0));

        let collate = Collate {
            horizon: 3,
            predict: 2,
            frame_dt: 0.2,
            force_scale: 2.0,
            augment: AugmentConfig::none(),
            seed: 1,
        };
        let clips = [
            Clip { store: 0, episode: 4..12, newest: vec![7, 9, 11] },
            Clip { store: 0, episode: 0..4, newest: vec![1] },
        ];
        let batch = data.batch(&collate, 0, &clips).unwrap();
        // Windows: 7 <- 5 <- 4 (nearest to 3, before the episode), 9 <- 7 <- 5, 11 <- 9 <- 7; 1 <- 0 <- 0.
        let frames = [4, 5, 7, 9, 11, 0, 1];
        assert_eq!(batch.windows, [0, 1, 2, 1, 2, 3, 2, 3, 4, 5, 5, 6]);
        let pixels = 3 * SIDE * SIDE;
        assert_eq!(batch.frames.len(), frames.len() * pixels);
        for (at, frame) in frames.into_iter().enumerate() {
            let expected = normalise(&picture(frame), IMAGENET_MEAN, IMAGENET_STD);
            let got = &batch.frames[at * pixels..(at + 1) * pixels];
            assert!(got.iter().zip(&expected).all(|(a, b)| (a - b).abs() < 1e-5), "frame {frame}");
        }
        // Targets: each newest frame and the one 0.2 s later, None beyond the episode.
        let targets = [None, Some(9), Some(9), Some(11), Some(11), None, Some(1), Some(3)];
        for (row, target) in targets.into_iter().enumerate() {
            let of = |values: &[f32]| values[row * N_FIELD..(row + 1) * N_FIELD].to_vec();
            let (force, contact) = (of(&batch.force), of(&batch.contact));
            let (mask_force, mask_contact) = (of(&batch.mask_force), of(&batch.mask_contact));
            for v in 0..N_FIELD {
                let pressed = target == Some(v);
                let supervised = f32::from(target.is_some());
                assert_eq!(force[v], if pressed { v as f32 / 2.0 } else { 0.0 }, "row {row}, vertex {v}");
                assert_eq!(mask_force[v], supervised);
                assert_eq!(mask_contact[v], if v == 5 { 0.0 } else { supervised });
                assert_eq!(contact[v], f32::from(pressed && v != 5));
            }
        }
        let labels = data.labels().unwrap();
        assert_eq!(labels.episode_ends, [4, 12]);
        assert!(labels.mask_force[7 * N_FIELD..8 * N_FIELD].iter().all(|mask| *mask == 0), "refused by a guard");
        assert_eq!(labels.mask_force[8 * N_FIELD + 3], 0, "unknown");
        assert_eq!(labels.mask_contact[8 * N_FIELD + 3], 1);
    }
}

#[test]
fn a_mirrored_clip_swaps_the_hands() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.zarr");
    write_store(&path);
    let collate = Collate {
        horizon: 2,
        predict: 1,
        frame_dt: 0.2,
        force_scale: 2.0,
        augment: AugmentConfig { mirror: 1.0, ..AugmentConfig::none() },
        seed: 1,
    };
    let clips = [Clip { store: 0, episode: 4..12, newest: vec![9] }];
    let batch = |mirror: bool| {
        let source = TrainingSource { mirror, ..TrainingSource::path(&path) };
        Dataset::open(&[source], preparation(), true).unwrap().batch(&collate, 0, &clips).unwrap()
    };
    let (plain, mirrored) = (batch(false), batch(true));
    // Each row of the image is reversed.
    for (row, reversed) in plain.frames.chunks_exact(SIDE).zip(mirrored.frames.chunks_exact(SIDE)) {
        assert!(row.iter().eq(reversed.iter().rev()));
    }
    assert_ne!(plain.frames, mirrored.frames);
    // The two hands swap, index by index.
    for (plain, mirrored) in [
        (&plain.force, &mirrored.force),
        (&plain.contact, &mirrored.contact),
        (&plain.mask_force, &mirrored.mask_force),
        (&plain.mask_contact, &mirrored.mask_contact),
    ] {
        let (left, right) = plain.split_at(N_FIELD / 2);
        assert!(mirrored.iter().eq(right.iter().chain(left)));
    }
    assert_eq!((plain.force[9], mirrored.force[9 + N_FIELD / 2]), (4.5, 4.5));
}
