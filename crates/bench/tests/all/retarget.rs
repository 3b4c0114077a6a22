//! Retargeting against independent measures: the best known optimum of an objective, and a grip in simulation.
#![cfg(feature = "sim")]

use egotac::retarget::Robot;
use egotac::retarget::solver::Stop;
use egotac_bench::retarget::grip::{self, Hold};
use egotac_bench::retarget::objective::{Setup, solve, vectors};
use egotac_bench::retarget::trajectory::{Noise, Trajectory};

#[test]
fn the_vector_objective_ends_at_the_best_known_optimum() {
    let names = ["thumb_distal", "index_distal", "middle_distal", "ring_distal"];
    let setup =
        Setup { robot: "four_finger".into(), wrist: "palm".into(), tips: names.map(String::from).into(), scale: 1.0 };
    let clean = Trajectory::generate(300, 5).unwrap();
    for noise in [0.0, 0.002, 0.005] {
        let mut robot = Robot::load("four_finger", None).unwrap();
        let targets = vectors(&robot, &setup, &clean.with(Noise::White(noise), 6)).unwrap();
        let solved = solve(&mut robot, &setup, &targets, Stop::default(), 10).unwrap();
        assert!(solved.compared >= 30 && solved.within >= 0.999, "{noise}: {solved:?}");
    }
}

#[test]
fn an_object_between_two_fingertips_is_pressed_as_hard_as_expected() {
    let trajectory = Trajectory::generate(900, 2).unwrap();
    for hold in [Hold::Fixed, Hold::Free] {
        let grips = grip::measure(&trajectory, 60, hold).unwrap();
        eprintln!("{hold:?} {grips:?}");
        assert!(grips.count >= 24 && grips.lost * 10 <= grips.count, "{hold:?}: {grips:?}");
        assert!(grips.error_median <= 0.2, "{hold:?}: {grips:?}");
    }
}
