//! Nothing fails silently: each hard case is right as a user writes it, or flagged; and its remedy is right.

use egotac_bench::hard_cases::{Family, registry, run};

/// Runs a family's cases and names those that fail.
fn family(family: Family) {
    let cases: Vec<_> = registry().into_iter().filter(|case| case.family == family).collect();
    assert!(!cases.is_empty(), "{family:?} has no cases");
    let mut failed = Vec::new();
    for case in cases {
        match run(&case) {
            Ok(row) => failed.extend(row.outcome.verdict().err().map(|why| format!("{}: {why}", case.name))),
            Err(error) => failed.push(format!("{}: {error}", case.name)),
        }
    }
    assert!(failed.is_empty(), "{failed:#?}");
}

#[cfg(feature = "sim")]
mod engine {
    use egotac_bench::hard_cases::report;

    use super::*;

    #[test]
    fn bodies_that_touch() {
        family(Family::Contact);
    }

    #[test]
    fn stiffness_and_damping_against_the_timestep() {
        family(Family::Stability);
    }

    #[test]
    fn meshes_and_inertias() {
        family(Family::Mesh);
    }

    #[test]
    fn servos_and_constraints() {
        family(Family::Actuation);
    }

    #[test]
    fn holding_for_long() {
        family(Family::Hold);
    }

    #[test]
    fn states_and_memory() {
        family(Family::State);
    }

    #[test]
    fn hands_that_robots_follow() {
        family(Family::Retargeting);
    }

    #[test]
    fn what_would_end_the_process() {
        family(Family::Process);
    }

    #[test]
    fn scene_files_with_extreme_values() {
        family(Family::Scene);
    }

    /// Which guard it is that speaks, where several could.
    #[test]
    fn each_guard_sees_what_it_is_for() {
        let expected = [
            ("mass_ratio_1000", "1000 times as heavy"),
            ("sunken_start", "start 10.0 mm inside"),
            ("thin_plate", "above 0.47 m/s they pass through"),
            ("thin_plate_fast", "a velocity is beyond its bound"),
            ("tiny_ball", "deeper than the bodies allow"),
            ("stiff_without_refsafe", "half of the contact's time constant"),
            ("stiff_without_refsafe", "kinetic energy came or went"),
            ("direct_1e6", "without the integrator `discrete`"),
            ("direct_1e6", "kinetic energy came or went"),
            ("underdamped", "damping ratio is 0.1"),
            ("underdamped", "kinetic energy came or went"),
            ("fast_spin", "kinetic energy came or went"),
            ("paper_thin_mesh", "1.0e-7 m thick"),
            ("tiny_inertia", "radius of gyration"),
            ("creep_elliptic", "a held object slips slowly"),
            ("creep_pyramidal", "a held object slips slowly"),
            ("full_memory", "memory for contacts is nearly full"),
            ("sleeping_bodies", "bodies may sleep"),
        ];
        for (name, words) in expected {
            let case = registry().into_iter().find(|case| case.name == name).unwrap();
            let said = run(&case).unwrap().outcome.guard;
            assert!(said.contains(words), "{name}: {said}");
        }
    }

    #[test]
    fn the_committed_document_lists_these_cases() {
        let names: Vec<_> = registry().iter().map(|case| case.name).collect();
        let text = std::fs::read_to_string(concat!(env!("CARGO_MANIFEST_DIR"), "/../../docs/hard-cases.md")).unwrap();
        assert_eq!(report::names(&text), names, "write it anew: {}", report::COMMAND);
        let json = std::fs::read_to_string(concat!(env!("CARGO_MANIFEST_DIR"), "/../../docs/hard-cases.json")).unwrap();
        let json: serde_json::Value = serde_json::from_str(&json).unwrap();
        let cases = json["cases"].as_array().unwrap();
        assert_eq!(cases.iter().map(|case| case["name"].as_str().unwrap()).collect::<Vec<_>>(), names);
    }
}

#[test]
fn rotations_near_nothing_half_a_turn_and_a_whole_one() {
    family(Family::Rotation);
}

#[test]
fn hands_in_poses_that_no_hand_takes() {
    family(Family::Hand);
}

#[test]
fn labels_on_meshes_that_are_no_good() {
    family(Family::Label);
}

#[test]
fn no_number_enters_that_is_none() {
    family(Family::Entrance);
}

#[test]
fn networks_at_the_edge_of_numbers() {
    family(Family::Network);
}

#[test]
fn training_on_what_is_no_number() {
    family(Family::Training);
}

#[test]
fn names_are_unique_and_everything_is_said() {
    let cases = registry();
    let names: std::collections::BTreeSet<_> = cases.iter().map(|case| case.name).collect();
    assert_eq!(names.len(), cases.len());
    assert!(cases.iter().all(|case| !case.recipe.is_empty() && !case.remedy.is_empty()));
}
