//! Episodes of a store as takes.

use std::ops::Range;

use super::bodies::{BodyOptions, Surroundings};
use crate::dataset::EpisodeReader;
use crate::dataset::zarr::{LEFT_HAND_POSE, OBJECT_POSE, RIGHT_HAND_POSE, TIMESTAMPS, ZarrReader};
use crate::error::{Error, Result};
use crate::hand::{HandModel, HandParams, Side};
use crate::physics::gravity::{FREE_FALL, Support};
use crate::physics::{Pose, Take, Tracked};
use crate::tactile::episode_ranges;

/// One episode.
#[derive(Debug)]
pub struct EpisodeTake<'a> {
    /// Frames of the store.
    pub frames: Range<usize>,
    /// Hands, bodies and surroundings.
    pub take: Take<'a>,
    /// Source of the direction of gravity, in words.
    pub gravity: &'static str,
}

/// Reads episode `index` of a store; `models`: left and right hand on the store's topology.
///
/// # Errors
/// If an array is missing or damaged, or the bodies are not known.
pub fn read<'a>(
    store: &ZarrReader,
    index: usize,
    models: &'a [HandModel; 2],
    options: &BodyOptions,
) -> Result<EpisodeTake<'a>> {
    let topology = store.attributes().topology;
    models.iter().try_for_each(|model| topology.must_match(model.topology))?;
    let Some(frames) = episode_ranges(store.episode_ends()).nth(index) else {
        return Err(Error::value("episode", format!("below {}", store.episode_ends().len()), index));
    };
    for name in [OBJECT_POSE, LEFT_HAND_POSE, RIGHT_HAND_POSE] {
        if !store.has(name) {
            let expected = format!("expected an array {name}, which forces from motion need; got none");
            return Err(Error::file(store.path(), expected));
        }
    }
    let n = frames.len();
    let times = store.read(TIMESTAMPS, frames.clone())?.into_f64();
    if let Some(at) = times.windows(2).position(|pair| pair[1] <= pair[0] || !pair[1].is_finite()) {
        let (before, after) = (times[at], times[at + 1]);
        let expected = format!("{TIMESTAMPS}: expected ascending seconds, got {after} after {before}");
        return Err(Error::file(store.path(), expected));
    }
    let rows = store.read_f32(OBJECT_POSE, frames.clone())?;
    let objects = rows.len() / (7 * n.max(1));
    let pose = |frame: usize, object: usize| {
        let start = 7 * (frame * objects + object);
        rows.get(start..start + 7).and_then(|row| row.try_into().ok()).and_then(Pose::from_row)
    };
    let first: Vec<Option<Pose>> = (0..objects).map(|object| pose(0, object)).collect();
    let Surroundings { bodies, fixed, gravity, zeros_are_absent } = options.surroundings(store, index, &first)?;
    // A store of several scenes has as many poses as its richest scene; one scene's bodies come first.
    let poses = (0..bodies.len()).map(|object| (0..n).map(|frame| pose(frame, object)).collect()).collect();
    let hand = |name: &str| -> Result<Vec<Tracked>> {
        let rows = store.read_f32(name, frames.clone())?;
        Ok(rows.as_chunks::<61>().0.iter().map(|row| tracked(row, zeros_are_absent)).collect())
    };
    let hands = [hand(LEFT_HAND_POSE)?, hand(RIGHT_HAND_POSE)?];
    let mut take =
        Take { times, models: Side::BOTH.map(|side| &models[side as usize]), hands, bodies, poses, fixed, gravity };
    let source = match (options.gravity, take.gravity) {
        (Some(down), _) => {
            let down = down.normalize();
            take.gravity = Some(down * FREE_FALL);
            if take.fixed.is_empty()
                && let Some(support) = Support::below(&take, -down)
            {
                take.fixed.push(support.slab()?);
            }
            "given"
        }
        (None, Some(_)) => "the simulator's",
        (None, None) => match Support::find(&take) {
            Some(support) => {
                take.gravity = Some(support.gravity());
                take.fixed.push(support.slab()?);
                "found from resting objects"
            }
            None => "unknown",
        },
    };
    Ok(EpisodeTake { frames, take, gravity: source })
}

fn tracked(row: &[f32; 61], zeros_are_absent: bool) -> Tracked {
    if row.iter().any(|x| !x.is_finite()) {
        return Tracked::Unknown;
    }
    match row.iter().all(|x| *x == 0.0) {
        true if zeros_are_absent => Tracked::Absent,
        true => Tracked::Unknown,
        false => Tracked::Present(Box::new(HandParams::from_array(row))),
    }
}
