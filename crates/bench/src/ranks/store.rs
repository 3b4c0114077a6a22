//! The store that the runs train on.

use std::path::Path;

use egotac::dataset::zarr::{Contact, ZarrWriter};
use egotac::dataset::{Attributes, EpisodeWriter, Frame};
use egotac::error::Result;
use egotac::hand::Topology;
use egotac::tactile::{CONTACT_FORCE_N, N_FIELD, TactileField, Validity};
use image::{Rgb, RgbImage};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Time between two frames, s.
pub const FRAME_SECS: f64 = 0.04;
/// Frames of the one episode: enough that few clips are cut short.
const FRAMES: usize = 200;
/// Share of contacts among the labels.
const ACTIVE: f64 = 0.1;

/// Writes a store of random pictures with `side` x `side` pixels, and random forces.
///
/// # Errors
/// If it can't be written.
pub fn write(path: &Path, side: u32) -> Result<()> {
    let attributes = Attributes {
        topology: Topology::default(),
        sigma: 0.0,
        contact_force: f64::from(CONTACT_FORCE_N),
        producer: "egotac bench ranks".into(),
        version: egotac::VERSION.into(),
        scene: String::new(),
        seed: 0,
    };
    let mut rng = ChaCha8Rng::seed_from_u64(0);
    let mut writer = ZarrWriter::create(path, attributes, Contact::Truth, Vec::new())?;
    for index in 0..FRAMES {
        let color: [u8; 3] = rng.random();
        let force = (0..N_FIELD).map(|_| if rng.random_bool(ACTIVE) { rng.random_range(0.1..1.0) } else { 0.0 });
        writer.push(Frame {
            timestamp: FRAME_SECS * index as f64,
            camera_ego_rgb: RgbImage::from_fn(side, side, |x, y| Rgb([color[0], (x % 256) as u8, (y % 256) as u8])),
            field: TactileField::from_force(Topology::default(), force.collect())?,
            force_valid: vec![1; N_FIELD],
            contact_valid: vec![1; N_FIELD],
            validity: Validity::Valid,
            left_hand_pose: None,
            right_hand_pose: None,
        })?;
    }
    writer.end_episode()?;
    writer.finish()
}
