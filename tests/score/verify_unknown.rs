//! Scores of rollouts leave out the hands that a predictor does not know.

use crate::common::save_network_with_presence;
use egotac::model::predictor::{Options, Predictor};
use egotac::score::agreement::Sums;
use egotac::score::verify::SweepSettings;
use egotac::sim::verify::rollout;
use egotac::sim::{RolloutOptions, Scene};
use egotac::tactile::N_FIELD;

/// Scores an episode in which both hands touch each other, by a network that sees the hands `present`.
fn scored(present: [bool; 2]) -> Sums {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("model.safetensors");
    save_network_with_presence(&path, present);
    let mut predictor = Predictor::load(&path, Options::default()).unwrap();
    let scene = Scene::load("rub_hands").unwrap();
    let options = RolloutOptions { picture: Some((48, 48)), ..RolloutOptions::default() };
    let mut episode = rollout::score(&scene, 0, &options, &SweepSettings::default(), Some(&mut predictor)).unwrap();
    episode.sums.remove(0)
}

#[test]
fn a_hand_out_of_view_is_left_out_of_the_scores_of_a_rollout() {
    let of = |sums: &Sums| {
        let counts = sums.counts;
        (counts.tp + counts.fp + counts.fn_ + counts.tn, counts.unknown)
    };
    let both = scored([true, true]);
    assert!(both.frames > 20);
    assert_eq!(of(&both), (both.frames * N_FIELD as u64, 0));
    let [left, right] = [scored([true, false]), scored([false, true])];
    for hand in [&left, &right] {
        assert_eq!(of(hand), (hand.frames * N_FIELD as u64 / 2, 0), "the other hand is neither right nor wrong");
        assert!(hand.force > 0.5, "each hand is touched: {} N", hand.force);
        assert!(hand.missed_force <= hand.force);
    }
    // Each run leaves out the hand that is the only one scored in the other run.
    assert!((left.force + right.force - both.force).abs() < 1e-6 * both.force, "{} {}", left.force, right.force);
    let missed = left.missed_force + right.missed_force;
    assert!((missed - both.missed_force).abs() < 1e-6 * both.force, "{missed} {}", both.missed_force);
    let none = scored([false, false]);
    assert_eq!((of(&none), none.force, none.missed_force), ((0, 0), 0.0, 0.0));
}
