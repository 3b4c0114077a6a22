//! No hard case fails silently: each is right as a user writes it, or flagged; and its remedy is right.

use egotac_bench::hard_cases::{Family, registry, run};

/// Runs the cases of a family; fails with the names of those that fail.
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
    fn contacts() {
        family(Family::Contact);
    }

    #[test]
    fn stiffness_and_damping() {
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
    fn long_holds() {
        family(Family::Hold);
    }

    #[test]
    fn states_and_memory() {
        family(Family::State);
    }

    #[test]
    fn retargeting() {
        family(Family::Retargeting);
    }

    #[test]
    fn inputs_that_would_end_the_process() {
        family(Family::Process);
    }

    #[test]
    fn scene_files_with_extreme_values() {
        family(Family::Scene);
    }

    /// Checks which guard reports a case, because several could.
    #[test]
    fn each_guard_reports_its_own_case() {
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
            let guard = run(&case).unwrap().outcome.guard;
            assert!(guard.contains(words), "{name}: {guard}");
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
fn rotations_near_zero_half_a_turn_and_a_whole_turn() {
    family(Family::Rotation);
}

#[test]
fn impossible_hand_poses() {
    family(Family::Hand);
}

#[test]
fn forces_from_motion_that_misleads() {
    family(Family::Motion);
}

#[test]
fn labels_on_faulty_meshes() {
    family(Family::Label);
}

#[test]
fn no_function_accepts_a_non_finite_value() {
    family(Family::Entrance);
}

#[test]
fn extreme_network_inputs() {
    family(Family::Network);
}

#[test]
fn training_on_non_finite_values() {
    family(Family::Training);
}

#[test]
fn names_are_unique_and_every_case_has_recipe_and_remedy() {
    let cases = registry();
    let names: std::collections::BTreeSet<_> = cases.iter().map(|case| case.name).collect();
    assert_eq!(names.len(), cases.len());
    assert!(cases.iter().all(|case| !case.recipe.is_empty() && !case.remedy.is_empty()));
}
