//! Computation time of setups, measured in turn.

use egotac::sim::budget::clock::Clock;
use egotac::sim::{Rollout, RolloutOptions, Scene};

use super::knob::Setup;

/// Returns the computation time per simulated second of each setup, s: steps, control, guards and the state at each frame,
/// without labels and pictures. `None` for a setup that the scene refuses.
///
/// Setups take turns in each repetition, so that a slow moment of the machine does not hit one setup alone.
pub fn time_setups(
    scene: &Scene,
    seed: u64,
    setups: &[&Setup],
    options: &RolloutOptions,
    repetitions: usize,
) -> Vec<Option<f64>> {
    let mut clocks = vec![Clock::default(); setups.len()];
    let mut simulated = vec![0.0; setups.len()];
    for _ in 0..repetitions {
        for ((setup, clock), simulated) in setups.iter().zip(&mut clocks).zip(&mut simulated) {
            let options = setup.options(scene, options);
            let rollout = options.and_then(|options| Rollout::new(&setup.scene(scene), seed, &options));
            let Ok(rollout) = rollout else { continue };
            *simulated = clock.add_episode(rollout);
        }
    }
    clocks.iter().zip(simulated).map(|(clock, time)| (time > 0.0).then(|| clock.total() / time)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sim::knob::Change;
    use egotac::sim::budget::calibration;

    #[test]
    fn the_calibration_of_budgets_runs_what_the_table_was_measured_with() {
        let scene = Scene::load(calibration::SCENE).unwrap();
        let setup = Setup::new(&scene.spec.physics, Change::Preset(calibration::PRESET)).unwrap();
        let ours = setup.options(&scene, &RolloutOptions { picture: None, ..RolloutOptions::default() }).unwrap();
        let theirs = calibration::options(&scene);
        assert_eq!(ours.physics, theirs.physics);
        assert_eq!((ours.hull_corners, ours.picture, ours.guards), (None, theirs.picture, theirs.guards));
        assert_eq!(theirs.hull_corners, None);
    }
}
