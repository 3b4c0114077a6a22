//! Labels and truth read from the messages of a bag.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use super::labels::read_info;
use super::messages::for_each_message;
use crate::dataset::{DoubtRule, Labelled};
use crate::error::{Error, Result};
use crate::hand::Topology;
use crate::message::{HandTactile, Message, TactileFrame, TactileTruth};
use crate::tactile::{N_FIELD, TactileField, TactileSequence};

/// Reads the labels of the first topic that has some. Each file with labels is one episode; truth pairs by equal stamps.
///
/// # Errors
/// If there are no labels, or a file or message can't be read.
pub(crate) fn read_labelled(path: &Path) -> Result<Labelled> {
    let (mut frames, mut truths) = (Vec::<TactileFrame>::new(), BTreeMap::new());
    let (mut episode_ends, mut topic) = (Vec::new(), None::<String>);
    let mut last_file = PathBuf::new();
    for_each_message(path, |file, message| {
        if message.type_name == TactileFrame::TYPE
            && *topic.get_or_insert_with(|| message.topic.to_string()) == message.topic
        {
            if file != last_file && !frames.is_empty() {
                episode_ends.push(frames.len());
            }
            last_file = file.to_path_buf();
            frames.push(TactileFrame::from_cdr(message.payload)?);
        } else if message.type_name == TactileTruth::TYPE {
            let truth = TactileTruth::from_cdr(message.payload)?;
            truths.insert(truth.frame.header.stamp, truth);
        }
        Ok(())
    })?;
    let Some(first) = frames.first() else {
        return Err(Error::file(path, format!("has no message of {}", TactileFrame::TYPE)));
    };
    episode_ends.push(frames.len());
    let topology = Topology::from_id(&first.topology)?;
    let info = read_info(path);
    let rule: Option<DoubtRule> = info.as_ref().and_then(|info| info.provenance.doubt);
    let unknown = || TactileField { topology, force: vec![f32::NAN; N_FIELD], contact: vec![f32::NAN; N_FIELD] };
    let empty = || TactileSequence { topology: Some(topology), ..Default::default() };
    let (mut labels, mut truth) = (empty(), empty());
    for frame in &frames {
        let stamp = &frame.header.stamp;
        labels.timestamps.push(stamp.secs());
        labels.familiarity.push(frame.familiarity);
        let score = |side: u8| frame.hands.iter().find(|hand| hand.side == side).map_or(f32::NAN, |hand| hand.score);
        let presence = [HandTactile::LEFT, HandTactile::RIGHT].map(score);
        labels.presence.extend(presence);
        // A message without hands means that this image has no result.
        let mut field = if frame.hands.is_empty() { unknown() } else { frame.to_field()? };
        if let Some(rule) = &rule {
            rule.hide(&mut field, frame.familiarity, presence);
        }
        labels.push(&field)?;
        truth.push(&match truths.get(stamp).filter(|truth| truth.validity == 0) {
            Some(truth) => truth.frame.to_field()?,
            None => unknown(),
        })?;
    }
    // Messages of before these estimates, or of a network without them.
    for estimates in [&mut labels.familiarity, &mut labels.presence] {
        if estimates.iter().all(|estimate| estimate.is_nan()) {
            estimates.clear();
        }
    }
    labels.episode_ends = episode_ends;
    truth.timestamps.clone_from(&labels.timestamps);
    truth.episode_ends.clone_from(&labels.episode_ends);
    Ok(Labelled { labels, truth: (!truths.is_empty()).then_some(truth), info })
}
