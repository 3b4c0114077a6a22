//! Stores whose forces are estimated from noisy poses: what a recording of hands and objects without force teaches.

use std::path::Path;

use egotac::dataset::zarr::{ArraySpec, Contact, Dtype, MANO_FORCE_STD, Values, ZarrReader, ZarrWriter};
use egotac::dataset::{Attributes, EpisodeReader, EpisodeWriter, Frame};
use egotac::error::Result;
use egotac::geometry::{ForceSpreader, SIGMA};
use egotac::hand::{HandModel, Side};
use egotac::label::physics::{BodyOptions, FrameFields, read};
use egotac::physics::{Settings, whole};
use egotac::tactile::{N_FIELD, TactileField, episode_ranges};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use crate::physics::record::add_pose_noise;

/// Standard deviation of the noise of wrists and objects, mm per axis: that of a good marker-less tracker.
pub const MILLIMETRES: f64 = 2.0;
/// The same of rotations, degrees per axis.
pub const DEGREES: f64 = 1.0;

/// Writes the store `from` as the store `out`, with the same pictures and contacts, and with forces from motion in place of
/// true ones: estimated from its poses with noise, each with its standard deviation. The masses of objects are known.
///
/// # Errors
/// If a store can't be read or written, or its objects are not known.
pub fn write(from: &Path, out: &Path) -> Result<()> {
    let store = ZarrReader::open(from)?;
    let models = Side::BOTH.map(HandModel::builtin);
    let spreaders = [ForceSpreader::new(&models[0], SIGMA)?, ForceSpreader::new(&models[1], SIGMA)?];
    let bodies = BodyOptions::default();
    let settings = Settings::default();
    let attributes = Attributes { producer: "egotac experiment".into(), ..store.attributes().clone() };
    let mut rng = ChaCha8Rng::seed_from_u64(attributes.seed);
    let deviations = ArraySpec::new(MANO_FORCE_STD, [N_FIELD], Dtype::F32);
    let mut writer = ZarrWriter::create(out, attributes, Contact::Truth, vec![deviations])?;
    for index in 0..episode_ranges(store.episode_ends()).count() {
        let mut episode = read(&store, index, &models, &bodies)?;
        let take = &mut episode.take;
        add_pose_noise(&mut take.hands, &mut take.poses, MILLIMETRES, DEGREES, &mut rng);
        let estimate = whole(take, &settings);
        for (row, frame) in episode.frames.clone().enumerate() {
            let fields = FrameFields::new(take, row, &estimate.frames[row], &spreaders)?;
            let frame = store.frame(frame)?;
            let frame = Frame {
                force_valid: fields.force.iter().map(|force| u8::from(!force.is_nan())).collect(),
                field: TactileField { force: fields.force, ..frame.field },
                left_hand_pose: None,
                right_hand_pose: None,
                ..frame
            };
            writer.push_with(frame, vec![(MANO_FORCE_STD, Values::F32(fields.sd))])?;
        }
        writer.end_episode()?;
    }
    writer.finish()
}
