//! The knob `label`: cost of each kind of label, and its agreement with the force label of 4 mm.

use egotac::error::Result;
use egotac::geometry::{ForceSpreader, PROXIMITY};
use egotac::mujoco::World;
use egotac::sim::budget::clock::{Clock, Stopwatch};
use egotac::sim::contact::hand_force;
use egotac::sim::scene_object::SceneObject;
use egotac::sim::{Rollout, RolloutOptions, Scene};
use egotac::tactile::CONTACT_FORCE_N;
use glam::{DVec3, Vec3};

use super::errors::{Errors, Pool};
use super::hands::Hand;

/// Kind of label with its parameter, m.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Kind {
    /// Contact within this distance of a point of the resampled object.
    A(f32),
    /// Contact within this distance of the object's surface.
    B(f64),
    /// Contact where the force spread with this sigma is above the threshold.
    C(f64),
}

/// Kinds of labels with their names in the table.
const KINDS: [(&str, Kind); 8] = [
    ("a, 10 mm", Kind::A(PROXIMITY)),
    ("b, 1 mm", Kind::B(0.001)),
    ("b, 2 mm", Kind::B(0.002)),
    ("b, 5 mm", Kind::B(0.005)),
    ("b, 10 mm", Kind::B(0.01)),
    ("c, 2 mm", Kind::C(0.002)),
    ("c, 4 mm", Kind::C(0.004)),
    ("c, 8 mm", Kind::C(0.008)),
];
/// Index of the kind that the others are compared with.
const TRUTH: usize = 6;

/// Name of a kind, its agreement with the truth, and its computation per simulated second, s.
pub type LabelResult = (&'static str, Errors, f64);

/// Labels an episode with every kind.
///
/// # Errors
/// If the rollout fails.
pub fn label_kinds(scene: &Scene, seed: u64, options: &RolloutOptions, repetitions: usize) -> Result<Vec<LabelResult>> {
    let mut rollout = Rollout::new(scene, seed, options)?;
    let hands = Hand::of(&rollout)?;
    let mut spreaders = Vec::new();
    for (_, kind) in KINDS {
        let sigma = if let Kind::C(sigma) = kind { sigma } else { options.sigma };
        spreaders.push(hands.iter().map(|hand| hand.spreader(sigma)).collect::<Result<Vec<_>>>()?);
    }
    let mut clocks = vec![Clock::default(); KINDS.len()];
    let mut touched: Vec<Vec<Vec<u32>>> = vec![Vec::new(); KINDS.len()];
    let mut index = 0;
    while rollout.next_frame()?.is_some() {
        let world = rollout.world();
        let vertices: Vec<Vec<Vec3>> = hands.iter().map(|hand| hand.vertices(world)).collect();
        for repetition in 0..repetitions.max(1) {
            for (kind, (_, parameters)) in KINDS.iter().enumerate() {
                let mut found = Vec::new();
                let begun = Stopwatch::start();
                for ((hand, spreader), vertices) in hands.iter().zip(&spreaders[kind]).zip(&vertices) {
                    let first = hand.side.range().start as u32;
                    let label = label(*parameters, world, hand, spreader, vertices, rollout.objects())?;
                    found.extend((first..).zip(label).filter(|(_, touched)| *touched).map(|(vertex, _)| vertex));
                }
                clocks[kind].add(index, begun.seconds());
                if repetition == 0 {
                    touched[kind].push(found);
                }
            }
        }
        index += 1;
    }
    let time = rollout.interval() * index.max(1) as f64;
    let results = KINDS.iter().enumerate().map(|(kind, (name, _))| {
        let mut pool = Pool::default();
        pool.add_sets(&touched[kind], &touched[TRUTH]);
        (*name, pool.errors(), clocks[kind].total() / time)
    });
    Ok(results.collect())
}

/// Returns the contact of each vertex.
fn label(
    kind: Kind,
    world: &World,
    hand: &Hand,
    spreader: &ForceSpreader,
    vertices: &[Vec3],
    objects: &[SceneObject],
) -> Result<Vec<bool>> {
    let any = |holds: &dyn Fn(&SceneObject, DVec3) -> bool| {
        vertices.iter().map(|v| objects.iter().any(|object| holds(object, v.as_dvec3()))).collect()
    };
    Ok(match kind {
        Kind::A(most) => any(&|object, point| object.is_within(point, most)),
        Kind::B(most) => any(&|object, point| object.distance(point) <= most),
        Kind::C(_) => {
            let force = hand_force(world, &hand.links, vertices, spreader)?.force;
            force.iter().map(|force| *force > CONTACT_FORCE_N).collect()
        }
    })
}
