//! Agreement of replayed forces with recorded and with estimated ones.

use std::path::Path;

use serde::Serialize;

use super::{ReplayFrame, Replayed, recorded, replay};
use crate::dataset::zarr::{FRAME_VALIDITY, MANO_FORCE, ZarrReader};
use crate::error::Result;
use crate::hand::{HandModel, N_JOINTS};
use crate::label::physics::{BodyOptions, ESTIMATED};
use crate::sim::rig::site_of;
use crate::tactile::N_FIELD;

/// Force below which neither side counts as touching, N.
const TOUCHING: f64 = 0.05;
/// Number of frames at either end of an episode that do not count: splines have samples on one side only there.
const EDGE: usize = 3;
/// Sites of a hand: five fingers and the palm.
const SITES: usize = 6;
/// Arrays of `egotac label --physics`.
const LINK_FORCE: &str = "data/link_force";
const OBJECT_WRENCH: &str = "data/object_wrench";

/// Agreement of one quantity, over the entries in which either side is above 0.05 N.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Agreement {
    /// Quantity, and what the replay is compared with.
    pub quantity: String,
    /// Entries.
    pub entries: usize,
    /// Pearson correlation; NaN if one side is constant.
    pub correlation: f64,
    /// Sum of absolute differences over the sum of the other side.
    pub relative_error: f64,
    /// Mean of the replay, N.
    pub replay: f64,
    /// Mean of the other side, N.
    pub other: f64,
}

/// Result of a replay.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ReplayReport {
    /// Frames of the store.
    pub frames: usize,
    /// Replayed frames, without those at the edges of episodes and gaps, which do not count.
    pub replayed: usize,
    /// Mean rotation that the hinges of the replayed hand miss of a recorded joint, degrees.
    pub missed_rotation_degrees: f64,
    /// Agreements; those with forces from motion only where the store has them.
    pub agreements: Vec<Agreement>,
}

impl ReplayReport {
    /// Replays a store, and compares with the forces that it holds. `models` and `bodies` as for [`replay`].
    ///
    /// # Errors
    /// As [`replay`].
    pub fn of(path: &Path, models: &[HandModel; 2], bodies: &BodyOptions) -> Result<Self> {
        let Replayed { frames, missed_rotation } = replay(path, models, bodies)?;
        let store = ZarrReader::open(path)?;
        let n = store.len();
        let valid = match store.has(FRAME_VALIDITY) {
            true => store.read_u8(FRAME_VALIDITY, 0..n)?.into_iter().map(|code| code == 0).collect(),
            false => vec![true; n],
        };
        let used: Vec<&ReplayFrame> =
            frames.iter().filter(|frame| frame.to_edge >= EDGE && valid[frame.frame]).collect();
        let mut agreements = Vec::new();
        // Forces from motion stand in this array if nothing else was known.
        let estimated = store.raw_attributes().get("force_origin").is_some_and(|origin| origin == ESTIMATED);
        if store.has(MANO_FORCE) && store.force_kind()?.is_some() && !estimated {
            let force = store.read_f32(MANO_FORCE, 0..n)?;
            let joints = models.each_ref().map(HandModel::strongest_joints);
            let links = |frame: usize| -> Vec<f64> {
                let mut links = vec![0.0; 2 * N_JOINTS];
                for (vertex, force) in force[frame * N_FIELD..(frame + 1) * N_FIELD].iter().enumerate() {
                    let (side, own) = (vertex / (N_FIELD / 2), vertex % (N_FIELD / 2));
                    links[side * N_JOINTS + joints[side][own]] += f64::from(*force);
                }
                links
            };
            let name = if recorded::is_import(&store) { "recorded forces" } else { "truth" };
            agreements.extend(of_links(name, &used, &links));
        }
        if store.has(LINK_FORCE) {
            let stored = store.read_f32(LINK_FORCE, 0..n)?;
            let row = 2 * N_JOINTS;
            let links = |frame: usize| stored[frame * row..(frame + 1) * row].iter().map(|f| f64::from(*f)).collect();
            agreements.extend(of_links("forces from motion", &used, &links));
        }
        if store.has(OBJECT_WRENCH) {
            let stored = store.read_f32(OBJECT_WRENCH, 0..n)?;
            let objects = stored.len() / (6 * n.max(1));
            let pairs = used.iter().flat_map(|frame| {
                frame.net.iter().enumerate().filter(|(object, _)| *object < objects).map(|(object, net)| {
                    let row = &stored[6 * (frame.frame * objects + object)..][..3];
                    let other = glam::Vec3::from_slice(row).as_dvec3();
                    (net.length(), other.length(), net.distance(other))
                })
            });
            agreements.push(Agreement::of("net force on objects, against forces from motion", pairs.collect()));
        }
        let missed_rotation_degrees = missed_rotation.to_degrees();
        Ok(Self { frames: n, replayed: used.len(), missed_rotation_degrees, agreements })
    }
}

/// Compares the sums over each hand, and the forces of each finger and palm.
fn of_links(other: &str, frames: &[&ReplayFrame], links: &dyn Fn(usize) -> Vec<f64>) -> [Agreement; 2] {
    let (mut totals, mut fingers) = (Vec::new(), Vec::new());
    for frame in frames {
        let stored = links(frame.frame);
        let own: Vec<f64> = frame.links.iter().flatten().copied().collect();
        let pair = |a: f64, b: f64| (a, b, (a - b).abs());
        // An unknown hand leaves the sum of the other one known.
        totals.extend(
            own.chunks(N_JOINTS).zip(stored.chunks(N_JOINTS)).map(|(a, b)| pair(a.iter().sum(), b.iter().sum())),
        );
        let mut sites = [(0.0, 0.0); 2 * SITES];
        for (index, (own, stored)) in own.iter().zip(&stored).enumerate() {
            let site = &mut sites[index / N_JOINTS * SITES + site_of(index % N_JOINTS) as usize];
            *site = (site.0 + own, site.1 + stored);
        }
        fingers.extend(sites.into_iter().map(|(a, b)| pair(a, b)));
    }
    [
        Agreement::of(&format!("sum of normal forces on a hand, against {other}"), totals),
        Agreement::of(&format!("normal force per finger and palm, against {other}"), fingers),
    ]
}

impl Agreement {
    /// Compares triples of both sides and their difference, N; unknown ones (NaN) do not count.
    fn of(quantity: &str, triples: Vec<(f64, f64, f64)>) -> Self {
        let known = triples.into_iter().filter(|(a, b, off)| off.is_finite() && (*a > TOUCHING || *b > TOUCHING));
        let known: Vec<(f64, f64, f64)> = known.collect();
        let n = known.len() as f64;
        let mean = |of: &dyn Fn(&(f64, f64, f64)) -> f64| known.iter().map(of).sum::<f64>() / n;
        let (replay, other) = (mean(&|t| t.0), mean(&|t| t.1));
        let covariance = mean(&|t| (t.0 - replay) * (t.1 - other));
        let spread = (mean(&|t| (t.0 - replay).powi(2)) * mean(&|t| (t.1 - other).powi(2))).sqrt();
        let correlation = if spread > 0.0 { covariance / spread } else { f64::NAN };
        let relative_error = mean(&|t| t.2) / other;
        Self { quantity: quantity.into(), entries: known.len(), correlation, relative_error, replay, other }
    }
}
