//! Scores of simulated rollouts while they run.

use glam::{DVec3, Vec3};

use crate::error::{Error, Result};
use crate::hand::Side;
use crate::model::Predictor;
use crate::score::agreement::{TruthFrame, VertexGroups};
use crate::score::verify::candidate::{Candidate, SweepSettings};
use crate::score::verify::episode::{Episode, EpisodeScorer, VertexDistances};
use crate::sim::effect::Observation;
use crate::sim::{Rollout, RolloutOptions, Scene, SimFrame, Touchables};
use crate::tactile::{N_FIELD, TactileField, Validity};

/// Runs an episode of `scene` and scores it: the predictions for the rendered images if there is a predictor, else the sweep
/// of labels (a) and (b).
///
/// # Errors
/// If the rollout fails (the error names scene and seed), the predictor is on another topology, or a predictor needs images
/// and `options` has none.
pub fn score(
    scene: &Scene,
    seed: u64,
    options: &RolloutOptions,
    settings: &SweepSettings,
    predictor: Option<&mut Predictor>,
) -> Result<Episode> {
    let named = |error: Error| Error::file(format!("{} with seed {seed}", scene.name), error);
    run(scene, seed, options, settings, predictor).map_err(named)
}

fn run(
    scene: &Scene,
    seed: u64,
    options: &RolloutOptions,
    settings: &SweepSettings,
    mut predictor: Option<&mut Predictor>,
) -> Result<Episode> {
    let observes = |observation| scene.spec.observe.contains(&observation);
    if !observes(Observation::Force) {
        return Err(Error::value(
            "observe",
            "force among it, for it is the truth",
            format!("{:?}", scene.spec.observe),
        ));
    }
    if predictor.is_some() && !observes(Observation::Rgb) {
        return Err(Error::value("observe", "rgb among it, for the predictor", format!("{:?}", scene.spec.observe)));
    }
    let groups = VertexGroups::links(&options.hands);
    let mut rollout = Rollout::new(scene, seed, options)?;
    if let Some(predictor) = &mut predictor {
        predictor.topology().must_match(rollout.topology())?;
        if options.picture.is_none() {
            return Err(Error::value("picture", "a size, for a predictor needs pictures", "none"));
        }
        predictor.reset();
    }
    let mut near = match predictor {
        None => Some(Touchables::new(rollout.episode(), options.hands.each_ref(), settings.spacing)?),
        Some(_) => None,
    };
    let candidates = if predictor.is_some() { Candidate::PREDICTIONS.to_vec() } else { settings.sweep() };
    let mut scorer = EpisodeScorer::new(&groups, &candidates);
    while let Some(sim) = rollout.next_frame()? {
        // The predictor also sees the images of refused frames, because its window needs them.
        let prediction = match &mut predictor {
            Some(predictor) => Some(predictor.push(&sim.frame.camera_ego_rgb, sim.frame.timestamp)?.field),
            None => None,
        };
        if sim.frame.validity != Validity::Valid {
            scorer.refuse(sim.frame.validity);
            continue;
        }
        let vertices = vertices(&rollout, &sim);
        // Hands that the predictor does not know leave all scores.
        let known = prediction.as_ref().map(TactileField::known_hands).unwrap_or_default();
        let truth = truth(&sim, &vertices, known)?;
        let distances = match &mut near {
            Some(touchables) => {
                let hands = vertices.each_ref().map(|hand| hand.as_deref());
                Some(touchables.distances(hands, &sim.objects, settings.reach())?)
            }
            None => None,
        };
        let near = distances.as_ref().map(|d| VertexDistances { points: &d.points, surface: &d.surface });
        scorer.push(&truth, near, prediction.as_ref())?;
    }
    let samplings = near.map(|touchables| touchables.samplings()).unwrap_or_default();
    Ok(scorer.finish(&scene.name, Some(seed), samplings))
}

/// Posed vertices of the hands that are there, world frame, m.
fn vertices(rollout: &Rollout, sim: &SimFrame) -> [Option<Vec<Vec3>>; 2] {
    let poses = [&sim.frame.left_hand_pose, &sim.frame.right_hand_pose];
    Side::BOTH.map(|side| {
        let params = poses[side as usize].as_ref()?;
        Some(rollout.rigs()[side as usize].model.forward(params).vertices)
    })
}

/// Creates the truth of a frame; `known`: mask of the vertices to score, empty = all.
fn truth(sim: &SimFrame, vertices: &[Option<Vec<Vec3>>; 2], known: Vec<u8>) -> Result<TruthFrame> {
    let mut positions = vec![Vec3::ZERO; N_FIELD];
    let mut contacts: [Vec<DVec3>; 2] = Default::default();
    for side in Side::BOTH {
        if let Some(vertices) = &vertices[side as usize] {
            positions[side.range()].copy_from_slice(vertices);
        }
        if let Some(hand) = &sim.hands[side as usize] {
            contacts[side as usize].clone_from(&hand.places);
        }
    }
    TruthFrame::new(sim.frame.timestamp, sim.frame.field.force.clone(), known, positions, Some(&contacts))
}
