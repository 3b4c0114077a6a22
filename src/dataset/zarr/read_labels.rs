//! Labels of a store, read as truth or as predictions.

use std::ops::Range;
use std::path::Path;

use super::labels::{predicted, read_info};
use super::{
    FAMILIARITY, FRAME_VALIDITY, MANO_CONTACT, MANO_CONTACT_SCORE, MANO_CONTACT_VALID, MANO_FORCE, MANO_FORCE_VALID,
    MANO_PROXIMITY, PRESENCE, TIMESTAMPS, ZarrReader,
};
use crate::dataset::{EpisodeReader, Labelled};
use crate::error::{Error, Result};
use crate::tactile::{N_FIELD, TactileSequence};

/// Reads the labels of a store: predictions beside truth, or the store's own force and contact.
///
/// # Errors
/// If there are none, or they can't be read.
pub(crate) fn read_labelled(path: &Path) -> Result<Labelled> {
    let store = ZarrReader::open(path)?;
    let frames = 0..store.len();
    let info = read_info(path);
    if store.has(&predicted(MANO_FORCE)) {
        let force = read_or_unknown(&store, &predicted(MANO_FORCE), frames.clone())?;
        let contact = read_or_unknown(&store, &predicted(MANO_CONTACT_SCORE), frames.clone())?;
        let force_kind = info.as_ref().map(|info: &crate::dataset::LabelInfo| info.provenance.force_kind);
        let mut labels = with_time(TactileSequence { force_kind, force, contact, ..Default::default() }, &store)?;
        hide_invalid(&store, predicted, &mut labels)?;
        read_estimates(&store, predicted, &mut labels)?;
        // Without `mano_contact` the other arrays are labels of an earlier run, not truth.
        let truth = store.has(MANO_CONTACT).then(|| read_truth(&store)).transpose()?;
        return Ok(Labelled { labels, truth, info });
    }
    if ![MANO_FORCE, MANO_CONTACT, MANO_CONTACT_SCORE].iter().any(|name| store.has(name)) {
        return Err(Error::file(path, "holds no labels"));
    }
    let mut labels = with_time(read_fields(&store, frames.clone())?, &store)?;
    hide_invalid(&store, str::to_string, &mut labels)?;
    read_estimates(&store, str::to_string, &mut labels)?;
    Ok(Labelled { labels, truth: None, info })
}

/// Makes force and contact unknown where their arrays of validity, under names of the given form, say so.
fn hide_invalid(store: &ZarrReader, named: impl Fn(&str) -> String, labels: &mut TactileSequence) -> Result<()> {
    for (name, values) in [(MANO_FORCE_VALID, &mut labels.force), (MANO_CONTACT_VALID, &mut labels.contact)] {
        let name = named(name);
        if !store.has(&name) {
            continue;
        }
        for (value, valid) in values.iter_mut().zip(store.read_u8(&name, 0..store.len())?) {
            if valid == 0 {
                *value = f32::NAN;
            }
        }
    }
    Ok(())
}

/// Reads familiarity and presence, under names of the given form, where the store has them.
fn read_estimates(store: &ZarrReader, named: impl Fn(&str) -> String, labels: &mut TactileSequence) -> Result<()> {
    for (name, values) in [(FAMILIARITY, &mut labels.familiarity), (PRESENCE, &mut labels.presence)] {
        let name = named(name);
        if store.has(&name) {
            *values = store.read_f32(&name, 0..store.len())?;
        }
    }
    Ok(())
}

/// Reads the labels of a whole store, with timestamps and episodes, masked as [`read_labels`] does.
///
/// # Errors
/// If an array can't be read.
pub fn read_truth(store: &ZarrReader) -> Result<TactileSequence> {
    with_time(read_labels(store, 0..store.len())?, store)
}

/// Reads the labels of a range of frames, without timestamps and episodes. The masks are 0 where a label is unknown or a
/// guard refused the frame.
///
/// # Errors
/// If an array can't be read.
pub fn read_labels(store: &ZarrReader, frames: Range<usize>) -> Result<TactileSequence> {
    let fields = read_fields(store, frames.clone())?;
    let n = frames.len();
    let validity = match store.has(FRAME_VALIDITY) {
        true => store.read_u8(FRAME_VALIDITY, frames.clone())?,
        false => vec![0; n],
    };
    let mask = |name: &str, label: &[f32]| -> Result<Vec<u8>> {
        let mut mask = match store.has(name) {
            true => store.read_u8(name, frames.clone())?,
            false => vec![1; n * N_FIELD],
        };
        for (entry, (mask, label)) in mask.iter_mut().zip(label).enumerate() {
            // Values that are not finite or negative are unknown too: one of them would make every loss NaN.
            let known = label.is_finite() && *label >= 0.0;
            *mask = u8::from(*mask != 0 && known && validity[entry / N_FIELD] == 0);
        }
        Ok(mask)
    };
    let mask_force = mask(MANO_FORCE_VALID, &fields.force)?;
    let mask_contact = mask(MANO_CONTACT_VALID, &fields.contact)?;
    Ok(TactileSequence { mask_force, mask_contact, validity, ..fields })
}

/// Reads contact by distance of a range of frames, `data/mano_proximity`, without timestamps and episodes. Force is
/// unknown; the contact's mask is 0 where the store's own contact is not supervised or a guard refused the frame.
///
/// # Errors
/// If the store lacks the array, or one can't be read.
pub fn read_proximity(store: &ZarrReader, frames: Range<usize>) -> Result<TactileSequence> {
    if !store.has(MANO_PROXIMITY) {
        let missing = "holds no data/mano_proximity, which `labels: proximity` needs; stores of `egotac sim` hold it";
        return Err(Error::file(store.path(), missing));
    }
    let contact = store.read_u8(MANO_PROXIMITY, frames.clone())?.into_iter().map(f32::from).collect();
    let mut labels = read_labels(store, frames)?;
    labels.contact = contact;
    labels.force.fill(f32::NAN);
    labels.mask_force.fill(0);
    Ok(labels)
}

/// Reads force and contact of a range of frames, without masks; NaN = unknown.
///
/// # Errors
/// If an array can't be read.
pub fn read_fields(store: &ZarrReader, frames: Range<usize>) -> Result<TactileSequence> {
    let force = read_or_unknown(store, MANO_FORCE, frames.clone())?;
    let contact = store.read_contact(frames)?;
    let (topology, force_kind) = (Some(store.attributes().topology), store.force_kind()?);
    Ok(TactileSequence { topology, force_kind, force, contact, ..Default::default() })
}

fn read_or_unknown(store: &ZarrReader, name: &str, frames: Range<usize>) -> Result<Vec<f32>> {
    match store.has(name) {
        true => store.read_f32(name, frames),
        false => Ok(vec![f32::NAN; frames.len() * N_FIELD]),
    }
}

/// Adds topology, timestamps and episodes of a whole store to its labels.
fn with_time(labels: TactileSequence, store: &ZarrReader) -> Result<TactileSequence> {
    Ok(TactileSequence {
        topology: Some(store.attributes().topology),
        timestamps: store.read(TIMESTAMPS, 0..store.len())?.into_f64(),
        episode_ends: store.episode_ends().to_vec(),
        ..labels
    })
}
