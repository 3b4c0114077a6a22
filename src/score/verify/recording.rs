//! Scores of predictions against truth in a recording: an MCAP file, or the folder of a bag.

use std::collections::BTreeMap;
use std::path::Path;

use super::candidate::Candidate;
use super::episode::{Episode, EpisodeScorer};
use super::episode_splitter::EpisodeSplitter;
use crate::dataset::LostBytes;
use crate::dataset::mcap::{bag_files, for_each_message, survey};
use crate::error::{Error, Result};
use crate::hand::{HandModel, HandParams, Side, Topology};
use crate::message::{Message, TactileFrame, TactileTruth, Time};
use crate::score::agreement::{TruthFrame, VertexGroups};
use crate::tactile::Validity;

/// Topics to compare; None = the only one of its type.
#[derive(Debug, Clone, Default)]
pub struct Topics {
    /// Topic of predictions, `egotac_msgs/msg/TactileFrame`.
    pub tactile: Option<String>,
    /// Topic of truth, `egotac_msgs/msg/TactileTruth`.
    pub truth: Option<String>,
}

/// Scored episodes of a recording, and numbers of messages without a partner of the same stamp.
#[derive(Debug)]
pub struct Recording {
    /// Episodes, split as [`EpisodeSplitter`] does.
    pub episodes: Vec<Episode>,
    /// Groups of vertices: links if they are known, else hands.
    pub groups: VertexGroups,
    /// Number of predictions without truth.
    pub unmatched_predictions: u64,
    /// Number of truths without prediction.
    pub unmatched_truths: u64,
}

/// Scores the predictions in the recording at `path` by equal stamps.
///
/// Vertices take their positions from the rest pose of `hands`, each hand in its own frame. Without hands of the
/// recording's topology, scores that need positions or links are undefined, except on the built-in hand.
///
/// # Errors
/// If the recording can't be read or is damaged, a topic is missing or ambiguous, a message can't be decoded, or no stamps
/// pair.
pub fn score(path: &Path, topics: &Topics, hands: Option<&[HandModel; 2]>) -> Result<Recording> {
    let (predictions, truths) = read(path, topics)?;
    let unmatched = |own: &mut dyn Iterator<Item = bool>| own.filter(|paired| !paired).count() as u64;
    let unmatched_predictions = unmatched(&mut predictions.keys().map(|stamp| truths.contains_key(stamp)));
    let unmatched_truths = unmatched(&mut truths.keys().map(|stamp| predictions.contains_key(stamp)));
    let first = truths.values().find(|truth| predictions.contains_key(&truth.frame.header.stamp)).ok_or_else(|| {
        let got = format!("{} predictions, {} truths", predictions.len(), truths.len());
        Error::value(format!("{}: pairs of equal stamps", path.display()), "at least one", got)
    })?;
    let hand = RestHands::of(Topology::from_id(&first.frame.topology)?, hands)?;

    let mut splitter = EpisodeSplitter::default();
    let mut episodes = Vec::new();
    let mut open: Option<(u64, String, EpisodeScorer)> = None;
    for (stamp, truth) in &truths {
        let number = splitter.episode_number(truth);
        let Some(prediction) = predictions.get(stamp) else { continue };
        if open.as_ref().is_some_and(|(of, ..)| *of != number) {
            episodes.extend(open.take().map(|(_, name, scorer)| scorer.finish(name, None, Vec::new())));
        }
        let name = || truth.frame.model_id.clone();
        let scorer = || EpisodeScorer::new(&hand.groups, &Candidate::PREDICTIONS);
        let (_, _, scorer) = open.get_or_insert_with(|| (number, name(), scorer()));
        let validity = truth.validity()?;
        if validity != Validity::Valid {
            scorer.refuse(validity);
            continue;
        }
        let (field, target) = (prediction.to_field()?, truth.frame.to_field()?);
        target.topology.must_match(hand.topology)?;
        field.topology.must_match(target.topology)?;
        let frame = TruthFrame::new(stamp.secs(), target.force, field.known_hands(), hand.positions.clone(), None)?;
        scorer.push(&frame, None, Some(&field))?;
    }
    episodes.extend(open.map(|(_, name, scorer)| scorer.finish(name, None, Vec::new())));
    Ok(Recording { episodes, groups: hand.groups, unmatched_predictions, unmatched_truths })
}

/// Positions and groups of the vertices of hands whose pose is not known.
#[derive(Debug, Clone)]
pub struct RestHands {
    /// Meaning of the vertex indices.
    pub topology: Topology,
    /// (1556) m, each hand in its own frame; empty = not known.
    pub positions: Vec<glam::Vec3>,
    /// Links where they are known, else hands.
    pub groups: VertexGroups,
}

impl RestHands {
    /// Returns the rest pose of `hands`, or that of the built-in hand for its topology.
    ///
    /// # Errors
    /// If `hands` are of another topology.
    pub fn of(topology: Topology, hands: Option<&[HandModel; 2]>) -> Result<Self> {
        let own = Side::BOTH.map(HandModel::builtin);
        let hands = match (hands, topology) {
            (Some(hands), _) => {
                hands.iter().try_for_each(|hand| topology.must_match(hand.topology))?;
                Some(hands)
            }
            (None, Topology::EgotacHand1) => Some(&own),
            (None, Topology::Mano) => None,
        };
        let Some(hands) = hands else {
            return Ok(Self { topology, positions: Vec::new(), groups: VertexGroups::hands() });
        };
        let positions = hands.iter().flat_map(|hand| hand.forward(&HandParams::default()).vertices).collect();
        Ok(Self { topology, positions, groups: VertexGroups::links(hands) })
    }
}

/// Predictions and truths by stamp.
type Messages = (BTreeMap<Time, TactileFrame>, BTreeMap<Time, TactileTruth>);

/// Reads predictions and truths from all files of the recording.
fn read(path: &Path, topics: &Topics) -> Result<Messages> {
    let present = topics_of(path)?;
    let tactile = topic(&present, path, TactileFrame::TYPE, topics.tactile.as_deref())?;
    let truth = topic(&present, path, TactileTruth::TYPE, topics.truth.as_deref())?;
    let (mut predictions, mut truths) = (BTreeMap::new(), BTreeMap::new());
    let lost = for_each_message(path, |_, message| {
        if message.topic == tactile {
            let frame = TactileFrame::from_cdr(message.payload)?;
            predictions.insert(frame.header.stamp, frame);
        } else if message.topic == truth {
            let truth = TactileTruth::from_cdr(message.payload)?;
            truths.insert(truth.frame.header.stamp, truth);
        }
        Ok(())
    })?;
    match lost.first() {
        // A score of the readable part would look like one of the whole.
        Some(LostBytes { file, offset, bytes, reason }) => {
            Err(Error::file(path, format!("{file} is damaged, {bytes} bytes from byte {offset}: {reason}")))
        }
        None => Ok((predictions, truths)),
    }
}

/// Returns the message type of each topic with messages.
fn topics_of(path: &Path) -> Result<BTreeMap<String, String>> {
    let mut topics = BTreeMap::new();
    for file in bag_files(path)? {
        for topic in survey(&file)?.topics.into_values().filter(|topic| topic.messages > 0) {
            topics.entry(topic.name).or_insert(topic.type_name);
        }
    }
    Ok(topics)
}

/// Returns the topic called `wanted`, or the only topic of messages of `type_name`.
fn topic(present: &BTreeMap<String, String>, path: &Path, type_name: &str, wanted: Option<&str>) -> Result<String> {
    let topics: Vec<&str> = present.iter().filter(|(_, t)| *t == type_name).map(|(topic, _)| topic.as_str()).collect();
    match (wanted, topics.as_slice()) {
        (Some(wanted), topics) if topics.contains(&wanted) => Ok(wanted.to_owned()),
        (Some(wanted), _) => Err(Error::unknown("topic", wanted, topics)),
        (None, [only]) => Ok((*only).to_owned()),
        (None, []) => Err(Error::file(path, format!("has no topic of {type_name}"))),
        (None, several) => {
            let got = several.join(", ");
            Err(Error::value(format!("{}: topics of {type_name}", path.display()), "one, or one named", got))
        }
    }
}
