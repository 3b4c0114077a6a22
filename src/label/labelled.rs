//! Labels read back from any format, with the truth beside them where there is some.

use std::collections::BTreeMap;
use std::path::Path;

use arrow_array::cast::AsArray;
use arrow_array::types::Float32Type;
use arrow_array::{Array, RecordBatch};
use arrow_schema::DataType;

use super::input::Kind;
use super::summary::About;
use crate::dataset::EpisodeReader;
use crate::dataset::lerobot::{LeRobot, numbers, only, reader};
use crate::dataset::mcap::bag_files;
use crate::dataset::mcap::{Pieces, op};
use crate::dataset::zarr::{
    MANO_CONTACT, MANO_CONTACT_SCORE, MANO_CONTACT_VALID, MANO_FORCE, MANO_FORCE_VALID, TIMESTAMPS, ZarrReader,
};
use crate::error::{Error, Result};
use crate::hand::Topology;
use crate::message::{Message, TactileFrame, TactileTruth, Time};
use crate::tactile::{N_FIELD, TactileField, TactileSequence};

/// Labels of a data set, all in memory.
#[derive(Debug, Clone)]
pub struct Labelled {
    /// The labels, with the time stamps and episodes of their frames.
    pub labels: TactileSequence,
    /// Truth for the same frames, if the data set has it beside the labels.
    pub truth: Option<TactileSequence>,
    /// What the data set says about its labels.
    pub about: Option<About>,
}

impl Labelled {
    /// Reads the labels at `path`: a store, a bag or an MCAP file, a LeRobot data set, or a tensor file.
    ///
    /// # Errors
    /// If there are none, or they can't be read.
    pub fn read(path: &Path) -> Result<Self> {
        match Kind::of(path) {
            Some(Kind::Store) => store(path),
            Some(Kind::Bag) => bag(path),
            Some(Kind::LeRobot) => lerobot(path),
            Some(Kind::Tensors) => tensors(path),
            _ => {
                Err(Error::file(path, "holds no labels: expected a store, a bag, a LeRobot data set or a tensor file"))
            }
        }
    }
}

fn store(path: &Path) -> Result<Labelled> {
    let store = ZarrReader::open(path)?;
    let all = 0..store.len();
    let own = |name: &str| name.replacen("data/", &format!("data/{}", super::store::PREDICTED), 1);
    let beside_truth = store.has(&own(MANO_FORCE));
    let numbers = |names: &[String]| -> Result<Vec<f32>> {
        match names.iter().find(|name| store.has(name)) {
            Some(name) => store.read_f32(name, all.clone()),
            None => Ok(vec![f32::NAN; all.len() * N_FIELD]),
        }
    };
    let frames = TactileSequence {
        topology: Some(store.attributes().topology),
        timestamps: store.read(TIMESTAMPS, all.clone())?.into_f64(),
        episode_ends: store.episode_ends().to_vec(),
        ..Default::default()
    };
    let mask = |name: &str| if store.has(name) { store.read_u8(name, all.clone()) } else { Ok(Vec::new()) };
    let (labels, truth) = match beside_truth {
        true => {
            let (force, contact) = (numbers(&[own(MANO_FORCE)])?, numbers(&[own(MANO_CONTACT_SCORE)])?);
            // Labels of an earlier labelling are no truth.
            let truth = match store.has(MANO_CONTACT) {
                true => Some(crate::train::data::read_truth(&store)?),
                false => None,
            };
            (TactileSequence { force, contact, ..frames }, truth)
        }
        false => {
            if ![MANO_FORCE, MANO_CONTACT, MANO_CONTACT_SCORE].iter().any(|name| store.has(name)) {
                return Err(Error::file(path, "holds no labels"));
            }
            let mut force = numbers(&[MANO_FORCE.into()])?;
            let mut contact = numbers(&[MANO_CONTACT.into(), MANO_CONTACT_SCORE.into()])?;
            for (name, values) in [(MANO_FORCE_VALID, &mut force), (MANO_CONTACT_VALID, &mut contact)] {
                for (value, valid) in values.iter_mut().zip(mask(name)?) {
                    if valid == 0 {
                        *value = f32::NAN;
                    }
                }
            }
            (TactileSequence { force, contact, ..frames }, None)
        }
    };
    Ok(Labelled { labels, truth, about: super::store::about(path) })
}

fn tensors(path: &Path) -> Result<Labelled> {
    let mut labels = crate::dataset::tensors::read(path)?;
    if labels.episode_ends.is_empty() {
        labels.episode_ends = vec![labels.n_frames()];
    }
    Ok(Labelled { labels, truth: None, about: super::to_tensors::about(path) })
}

fn lerobot(path: &Path) -> Result<Labelled> {
    let dataset = LeRobot::open(path)?;
    let about = super::lerobot::about(path);
    let features = dataset.info["features"].as_object();
    let is_force = |(name, feature): &(&String, &serde_json::Value)| {
        name.ends_with(".force") && feature["shape"][0].as_u64() == Some(N_FIELD as u64)
    };
    let Some((force, _)) = features.into_iter().flatten().find(is_force) else {
        return Err(Error::file(path, "holds no labels: no feature PREFIX.force of 1556 numbers"));
    };
    let contact = format!("{}contact", force.trim_end_matches("force"));
    let mut labels = TactileSequence::default();
    for file in dataset.data_files()? {
        let builder = reader(&file)?;
        let mask = only(&builder, |name| ["timestamp", force, &contact].contains(&name));
        for batch in builder.with_projection(mask).build().map_err(|e| Error::file(&file, e))? {
            let batch = batch.map_err(|e| Error::file(&file, e))?;
            labels.timestamps.extend(numbers(&batch, "timestamp", &file)?);
            labels.force.extend(lists(&batch, force, &file)?);
            labels.contact.extend(lists(&batch, &contact, &file)?);
        }
    }
    for episode in &dataset.episodes {
        let before = labels.episode_ends.last().copied().unwrap_or(0);
        labels.episode_ends.push(before + episode.length);
    }
    labels.topology = about.as_ref().map(|about| about.provenance.topology);
    Ok(Labelled { labels, truth: None, about })
}

/// The numbers of a column of lists.
fn lists(batch: &RecordBatch, name: &str, path: &Path) -> Result<Vec<f32>> {
    let column = batch.column_by_name(name);
    let values = column.and_then(|column| match column.data_type() {
        DataType::FixedSizeList(..) => column.as_fixed_size_list_opt().map(|list| list.values().clone()),
        DataType::List(_) => column.as_list_opt::<i32>().map(|list| list.values().clone()),
        _ => None,
    });
    let values = values.as_ref().and_then(|values| values.as_primitive_opt::<Float32Type>());
    match values {
        Some(values) if values.len() == batch.num_rows() * N_FIELD => Ok(values.values().to_vec()),
        _ => Err(Error::file(path, format!("{name}: expected lists of {N_FIELD} float32"))),
    }
}

/// Frames of the first topic of labels by name, one episode per file that has some; truth pairs by equal stamps.
fn bag(path: &Path) -> Result<Labelled> {
    let (mut frames, mut truths): (Vec<(Time, TactileFrame)>, _) = (Vec::new(), BTreeMap::new());
    let (mut episode_ends, mut topic) = (Vec::new(), None);
    for file in bag_files(path)? {
        for_each_message(&file, |channel, type_name, payload| {
            let named = |error: Error| Error::file(&file, format!("{channel}: {error}"));
            if type_name == TactileFrame::TYPE && *topic.get_or_insert_with(|| channel.to_string()) == channel {
                let frame = TactileFrame::from_cdr(payload).map_err(named)?;
                frames.push((frame.header.stamp, frame));
            } else if type_name == TactileTruth::TYPE {
                let truth = TactileTruth::from_cdr(payload).map_err(named)?;
                truths.insert(truth.frame.header.stamp, truth);
            }
            Ok(())
        })?;
        if episode_ends.last().copied().unwrap_or(0) < frames.len() {
            episode_ends.push(frames.len());
        }
    }
    let Some((_, first)) = frames.first() else {
        return Err(Error::file(path, format!("has no message of {}", TactileFrame::TYPE)));
    };
    let topology = Topology::from_id(&first.topology)?;
    let unknown = || TactileField { topology, force: vec![f32::NAN; N_FIELD], contact: vec![f32::NAN; N_FIELD] };
    let (mut labels, mut truth) = (TactileSequence::default(), TactileSequence::default());
    for (stamp, frame) in &frames {
        labels.timestamps.push(stamp.secs());
        // A message without hands holds no result for its image.
        labels.push(&if frame.hands.is_empty() { unknown() } else { frame.to_field()? })?;
        let known = truths.get(stamp).filter(|truth| truth.validity == 0);
        truth.push(&match known {
            Some(truth) => truth.frame.to_field()?,
            None => unknown(),
        })?;
    }
    labels.episode_ends = episode_ends;
    truth.timestamps.clone_from(&labels.timestamps);
    truth.episode_ends.clone_from(&labels.episode_ends);
    Ok(Labelled { labels, truth: (!truths.is_empty()).then_some(truth), about: super::bag::about(path) })
}

/// Calls `take` with topic, type and payload of each message that can be read, in the file's order.
fn for_each_message(path: &Path, mut take: impl FnMut(&str, &str, &[u8]) -> Result<()>) -> Result<()> {
    let mut schemas: BTreeMap<u16, String> = BTreeMap::new();
    let mut channels: BTreeMap<u16, (String, String)> = BTreeMap::new();
    let mut note = |opcode: u8, body: &[u8]| -> Result<()> {
        use mcap::records::Record as Parsed;
        if !matches!(opcode, op::SCHEMA | op::CHANNEL | op::MESSAGE) {
            return Ok(());
        }
        match mcap::parse_record(opcode, body) {
            Ok(Parsed::Schema { header, .. }) => drop(schemas.insert(header.id, header.name)),
            Ok(Parsed::Channel(channel)) => {
                let type_name = schemas.get(&channel.schema_id).cloned().unwrap_or_default();
                channels.insert(channel.id, (channel.topic, type_name));
            }
            Ok(Parsed::Message { header, data }) => {
                if let Some((topic, type_name)) = channels.get(&header.channel_id) {
                    return take(topic, type_name, &data);
                }
            }
            _ => {}
        }
        Ok(())
    };
    for piece in Pieces::open(path)? {
        piece?.records().try_for_each(|(opcode, body)| note(opcode, body))?;
    }
    Ok(())
}
