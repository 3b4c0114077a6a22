//! Stores of moving discs, and runs on them for tests of several ranks, with unknown vertices and frames.

use std::path::Path;

use egotac::dataset::zarr::{Contact, ZarrWriter};
use egotac::dataset::{Attributes, EpisodeWriter, Frame};
use egotac::hand::Topology;
use egotac::tactile::{N_FIELD, TactileField, Validity};
use image::{Rgb, RgbImage};

/// Writes `a.zarr` and `b.zarr` into a folder: of each, other vertices are unknown in other frames, and a guard refuses some frames.
pub fn write(folder: &Path) {
    // Shares of known vertices from none to all, so that the ranks' counts differ much.
    let known =
        |t: usize, offset: usize| (0..N_FIELD).map(|v| u8::from((v + offset) % 7 < (3 * t + offset) % 8)).collect();
    let partly = |episode: usize, t: usize, frame: &mut Frame| {
        (frame.force_valid, frame.contact_valid) = (known(t, episode), known(t, episode + 3));
        frame.validity = if t % 9 == 4 { Validity::TooDeep } else { Validity::Valid };
    };
    write_discs(&folder.join("a.zarr"), 1, [3, 23], partly);
    write_discs(&folder.join("b.zarr"), 2, [2, 17], partly);
}

/// Returns the configuration of a run on both stores: force and contact of the first, contact alone of the second, which is also
/// mirrored. An epoch has 38 windows in clips of at most 5, so that its last batch is small.
pub fn config(folder: &Path, out: &str, clips: usize, steps: usize) -> String {
    let folder = folder.display();
    format!(
        "name: test\ndata:\n- {folder}/a.zarr\n- {{stores: [{folder}/b.zarr], labels: contact, mirror: true}}\n\
         out: {folder}/{out}\nmodel: toy\nseed: 5\nsteps: {steps}\nsave_every: 3\nthreads: 1\n\
         sampling: {{epoch: 38}}\nbatch: {{clips: {clips}, windows: 5}}\nema: 0.9\nloss: {{active: 1}}\n"
    )
}

/// Writes a store with a disc on grey: its quadrant selects the touched vertices, its brightness the force. `change` may change each
/// frame, whose labels are all known, by its episode and its place in it.
pub fn write_discs(path: &Path, seed: u64, [episodes, frames]: [usize; 2], change: impl Fn(usize, usize, &mut Frame)) {
    let attributes = Attributes {
        topology: Topology::EgotacHand1,
        sigma: 0.0,
        contact_force: 0.05,
        producer: "test".into(),
        version: "1".into(),
        scene: "disc".into(),
        seed,
    };
    let mut writer = ZarrWriter::create(path, attributes, Contact::Truth, Vec::new()).unwrap();
    for episode in 0..episodes {
        for t in 0..frames {
            let phase = 0.23 * t as f64 + 1.7 * (seed as f64 + 10.0 * episode as f64);
            let (x, y) = (32.0 + 18.0 * phase.cos(), 32.0 + 18.0 * (1.3 * phase).sin());
            let press = (0.5 - 0.9 * (0.7 * phase).cos()).clamp(0.0, 1.0);
            let image = RgbImage::from_fn(64, 64, |px, py| {
                let inside = (f64::from(px) - x).powi(2) + (f64::from(py) - y).powi(2) < 81.0;
                if inside { Rgb([(60.0 + 195.0 * press) as u8, 40, 200]) } else { Rgb([110, 110, 110]) }
            });
            let start = 200 * (usize::from(x > 32.0) + 2 * usize::from(y > 32.0));
            let force = (0..N_FIELD).map(|v| if (start..start + 60).contains(&v) { 0.8 * press as f32 } else { 0.0 });
            let mut frame = Frame {
                timestamp: 0.04 * t as f64,
                camera_ego_rgb: image,
                field: TactileField::from_force(Topology::EgotacHand1, force.collect()).unwrap(),
                force_valid: vec![1; N_FIELD],
                contact_valid: vec![1; N_FIELD],
                validity: Validity::Valid,
                left_hand_pose: None,
                right_hand_pose: None,
            };
            change(episode, t, &mut frame);
            writer.push(frame).unwrap();
        }
        writer.end_episode().unwrap();
    }
    writer.finish().unwrap();
}

/// Returns the largest relative difference (L2) of a tensor, and its name, between two checkpoints.
///
/// The keys' biases are left out: the softmax of the attention does not depend on them, so that their gradient is rounding alone, which
/// Adam turns into whole steps. They change no output.
pub fn difference(a: &Path, b: &Path) -> (f64, String) {
    let [a, b] = [a, b].map(|path| std::fs::read(path).unwrap());
    let [a, b] = [&a, &b].map(|bytes| safetensors::SafeTensors::deserialize(bytes).unwrap());
    let values = |file: &safetensors::SafeTensors, name: &str| -> Vec<f64> {
        let bytes = file.tensor(name).unwrap().data().to_vec();
        bytes.as_chunks::<4>().0.iter().map(|bytes| f64::from(f32::from_le_bytes(*bytes))).collect()
    };
    let norm = |values: &mut dyn Iterator<Item = f64>| values.map(|x| x * x).sum::<f64>().sqrt();
    let mut worst = (0.0, String::new());
    for name in a.names().into_iter().filter(|name| !name.ends_with("attention.key.bias")) {
        let (a, b) = (values(&a, name), values(&b, name));
        let apart = norm(&mut a.iter().zip(&b).map(|(a, b)| a - b));
        let relative = apart / norm(&mut b.iter().copied()).max(1e-30);
        if apart > 0.0 && relative > worst.0 {
            worst = (relative, name.to_owned());
        }
    }
    worst
}
