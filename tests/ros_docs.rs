//! The nodes' documentation names each parameter that the programs have.
#![cfg(all(feature = "ros", feature = "sim"))]

use std::process::Command;

#[test]
fn each_parameter_is_documented_under_its_node() {
    let text = std::fs::read_to_string(concat!(env!("CARGO_MANIFEST_DIR"), "/docs/nodes.md")).unwrap();
    let programs = [
        ("predictor", env!("CARGO_BIN_EXE_egotac_predictor")),
        ("simulator", env!("CARGO_BIN_EXE_egotac_simulator")),
        ("verifier", env!("CARGO_BIN_EXE_egotac_verifier")),
    ];
    for (node, program) in programs {
        let section = text.split("\n## ").find(|section| section.starts_with(node)).unwrap();
        let output = Command::new(program).arg("--describe-parameters").output().unwrap();
        let described: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
        for name in described.as_object().unwrap().keys() {
            assert!(section.contains(&format!("`{name}`")), "docs/nodes.md lacks {node}'s parameter {name}");
        }
    }
}
