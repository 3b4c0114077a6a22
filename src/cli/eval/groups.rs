//! Groups of `egotac eval --by`: episodes of a scene or a store, vertices of a hand or a region.

use std::collections::BTreeMap;

use anyhow::{bail, ensure};

use super::{Args, Case};
use crate::dataset::EpisodeReader;
use crate::dataset::zarr::ZarrReader;
use crate::hand::{HandModel, Side, Topology};
use crate::score::metrics::{self, EvalOptions, Intervals, Metrics, VertexGroup};
use crate::tactile::TactileSequence;

/// A way to group what is scored.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum Grouping {
    /// Episodes of the same scene.
    Scene,
    /// Episodes of the same store.
    Source,
    /// Vertices of the left and of the right hand.
    Side,
    /// Vertices of each region, of both hands.
    Region,
}

impl Grouping {
    /// Returns the name on the command line and in JSON.
    pub fn name(self) -> &'static str {
        match self {
            Self::Scene => "scene",
            Self::Source => "source",
            Self::Side => "side",
            Self::Region => "region",
        }
    }
}

/// Origin of an episode.
#[derive(Debug, Clone)]
pub struct Origin {
    /// Name of the store.
    source: String,
    /// Scene that was simulated, if the store says so.
    scene: Option<String>,
}

impl Origin {
    /// Returns the origin of an episode of a store.
    pub fn of(store: &ZarrReader, episode: usize) -> Self {
        let entry = store.raw_attributes().get("episodes").and_then(|episodes| episodes.get(episode));
        let scene = entry.and_then(|entry| entry.get("scene")).and_then(|scene| scene.as_str());
        let source = store.path().file_name().unwrap_or(store.path().as_os_str());
        let of_store = Some(&store.attributes().scene).filter(|scene| !scene.is_empty());
        Self {
            source: source.to_string_lossy().into_owned(),
            scene: scene.map(str::to_owned).or_else(|| of_store.cloned()),
        }
    }
}

/// Scores of the groups of one grouping.
pub struct Scored {
    /// The grouping.
    pub by: Grouping,
    /// Name, scores and intervals of each group.
    pub groups: Vec<(String, Metrics, Intervals)>,
}

/// Scores each group. Without a calibration, the ranges of a group are its own.
pub fn score(by: Grouping, args: &Args, case: &mut Case) -> anyhow::Result<Scored> {
    let options = EvalOptions { fps: case.options.fps.or_else(|| case.target.fps()), ..case.options.clone() };
    let scored = |name: String, pred: &TactileSequence, target: &TactileSequence| {
        let intervals = metrics::intervals(pred, target, &options, args.seed)?;
        anyhow::Ok((name, metrics::evaluate(pred, target, &options)?, intervals))
    };
    let mut groups = Vec::new();
    match by {
        Grouping::Scene | Grouping::Source => {
            for (name, frames) in frames_by_name(by, case)? {
                groups.push(scored(name, &case.pred.select(frames.clone()), &case.target.select(frames))?);
            }
        }
        Grouping::Side | Grouping::Region => {
            for group in vertex_groups(by, args, case)? {
                let target = &mut case.target;
                let masks = [target.mask_force.clone(), target.mask_contact.clone()];
                group.restrict(target);
                groups.push(scored(group.name, &case.pred, target)?);
                [target.mask_force, target.mask_contact] = masks;
            }
        }
    }
    Ok(Scored { by, groups })
}

/// Returns the frames of each scene or store.
fn frames_by_name(by: Grouping, case: &Case) -> anyhow::Result<BTreeMap<String, Vec<usize>>> {
    let option = by.name();
    let episodes = case.target.episodes();
    ensure!(
        case.origins.len() == episodes.len(),
        "--by {option}: expected truth from stores (--data, or a store as --target), got a tensor file, which names no {option}"
    );
    let mut frames: BTreeMap<String, Vec<usize>> = BTreeMap::new();
    for (index, (origin, episode)) in case.origins.iter().zip(episodes).enumerate() {
        let name = match by {
            Grouping::Scene => origin.scene.clone(),
            _ => Some(origin.source.clone()),
        };
        let Some(name) = name else {
            bail!("--by scene: {}, episode {index} names no scene, as stores of `egotac sim` do", origin.source);
        };
        frames.entry(name).or_default().extend(episode);
    }
    Ok(frames)
}

/// Returns both hands, or every region.
fn vertex_groups(by: Grouping, args: &Args, case: &Case) -> anyhow::Result<Vec<VertexGroup>> {
    if by == Grouping::Side {
        return Ok(Side::BOTH.into_iter().map(VertexGroup::hand).collect());
    }
    let topology = case.target.topology.or(case.pred.topology).unwrap_or_default();
    let models = match (args.hands.files()?, topology) {
        (Some(models), _) => models,
        (None, Topology::EgotacHand1) => Side::BOTH.map(HandModel::builtin),
        (None, Topology::Mano) => {
            bail!("--by region: the fields are on MANO's vertices; give --mano-left and --mano-right")
        }
    };
    models.iter().try_for_each(|model| topology.must_match(model.topology))?;
    Ok(VertexGroup::regions(&models))
}
