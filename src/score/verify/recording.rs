//! Scores of a recording of predictions and truth: an MCAP file, or the folder of a bag.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use super::candidate::Candidate;
use super::episode::{Episode, EpisodeScorer};
use super::episode_splitter::EpisodeSplitter;
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
    /// Groups of vertices, links where these are known.
    pub groups: VertexGroups,
    /// Predictions without truth.
    pub unmatched_predictions: u64,
    /// Truths without prediction.
    pub unmatched_truths: u64,
}

/// Scores the predictions in the recording at `path` by equal stamps.
///
/// Vertex positions are those of the rest pose of `hands`, each hand in its own frame. Without hands, scores that need
/// positions or links are undefined, except on the built-in hand.
///
/// # Errors
/// If the recording can't be read, a topic is missing or not the only one of its type, a message does not fit its topic's
/// type, or no stamps are equal.
pub fn score(path: &Path, topics: &Topics, hands: Option<&[HandModel; 2]>) -> Result<Recording> {
    let file = file_of(path)?;
    let bytes = std::fs::read(&file).map_err(Error::io(&file))?;
    let channels = channels(&bytes, &file)?;
    let tactile = topic(&channels, &file, TactileFrame::TYPE, topics.tactile.as_deref())?;
    let truth = topic(&channels, &file, TactileTruth::TYPE, topics.truth.as_deref())?;
    let mut predictions: BTreeMap<Time, TactileFrame> = BTreeMap::new();
    let mut truths: BTreeMap<Time, TactileTruth> = BTreeMap::new();
    for message in mcap::MessageStream::new(&bytes).map_err(|error| Error::file(&file, error))? {
        let message = message.map_err(|error| Error::file(&file, error))?;
        let named = |error: Error| Error::file(&file, format!("{}: {error}", message.channel.topic));
        if message.channel.topic == tactile {
            let frame = TactileFrame::from_cdr(&message.data).map_err(named)?;
            predictions.insert(frame.header.stamp, frame);
        } else if message.channel.topic == truth {
            let truth = TactileTruth::from_cdr(&message.data).map_err(named)?;
            truths.insert(truth.frame.header.stamp, truth);
        }
    }
    let unmatched = |own: &mut dyn Iterator<Item = bool>| own.filter(|paired| !paired).count() as u64;
    let unmatched_predictions = unmatched(&mut predictions.keys().map(|stamp| truths.contains_key(stamp)));
    let unmatched_truths = unmatched(&mut truths.keys().map(|stamp| predictions.contains_key(stamp)));
    let first = truths.values().find(|truth| predictions.contains_key(&truth.frame.header.stamp)).ok_or_else(|| {
        let got = format!("{} predictions, {} truths", predictions.len(), truths.len());
        Error::value(format!("{}: pairs of equal stamps", file.display()), "at least one", got)
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
        let scorer = || EpisodeScorer::new(&hand.groups, &[Candidate::Prediction]);
        let (_, _, scorer) = open.get_or_insert_with(|| (number, name(), scorer()));
        let validity = truth.validity()?;
        if validity != Validity::Valid {
            scorer.refuse(validity);
            continue;
        }
        let (field, target) = (prediction.to_field()?, truth.frame.to_field()?);
        target.topology.must_match(hand.topology)?;
        field.topology.must_match(target.topology)?;
        let frame = TruthFrame::new(stamp.secs(), target.force, Vec::new(), hand.positions.clone(), None)?;
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

/// The one MCAP file of a bag's folder, or the file itself.
fn file_of(path: &Path) -> Result<PathBuf> {
    if !path.is_dir() {
        return Ok(path.to_path_buf());
    }
    let entries = std::fs::read_dir(path).map_err(Error::io(path))?;
    let mut files: Vec<PathBuf> = entries.flatten().map(|entry| entry.path()).collect();
    files.retain(|file| file.extension().is_some_and(|extension| extension == "mcap"));
    match files.as_slice() {
        [file] => Ok(file.clone()),
        _ => Err(Error::file(path, format!("expected a folder with one .mcap file, got {}", files.len()))),
    }
}

/// Topic and type of each channel that has a message.
fn channels(bytes: &[u8], file: &Path) -> Result<BTreeMap<String, String>> {
    let mut channels = BTreeMap::new();
    // Not from the summary: a recording that was cut off has none.
    for message in mcap::MessageStream::new(bytes).map_err(|error| Error::file(file, error))? {
        let channel = message.map_err(|error| Error::file(file, error))?.channel;
        if !channels.contains_key(&channel.topic) {
            let type_name = channel.schema.as_ref().map(|schema| schema.name.clone()).unwrap_or_default();
            channels.insert(channel.topic.clone(), type_name);
        }
    }
    Ok(channels)
}

/// The topic of messages of `type_name`: the wanted one, or the only one.
fn topic(channels: &BTreeMap<String, String>, file: &Path, type_name: &str, wanted: Option<&str>) -> Result<String> {
    let topics: Vec<&str> = channels.iter().filter(|(_, t)| *t == type_name).map(|(topic, _)| topic.as_str()).collect();
    match (wanted, topics.as_slice()) {
        (Some(wanted), topics) if topics.contains(&wanted) => Ok(wanted.to_owned()),
        (Some(wanted), _) => Err(Error::unknown("topic", wanted, topics)),
        (None, [only]) => Ok((*only).to_owned()),
        (None, []) => Err(Error::file(file, format!("has no topic of {type_name}"))),
        (None, several) => {
            let got = several.join(", ");
            Err(Error::value(format!("{}: topics of {type_name}", file.display()), "one, or one named", got))
        }
    }
}
