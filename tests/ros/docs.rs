//! The documentation of the nodes agrees with the programs.

use std::process::Command;

use crate::harness::{self, Session};
use serde_json::Value;

fn document(name: &str) -> String {
    std::fs::read_to_string(std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join(name)).unwrap()
}

/// Returns a cell of a table row, counted from 1.
fn cell(row: &str, index: usize) -> &str {
    row.split('|').nth(index).unwrap_or_default().trim()
}

#[test]
fn each_parameter_is_documented_with_its_default() {
    let text = document("docs/nodes.md");
    let programs = [
        ("glove", env!("CARGO_BIN_EXE_egotac_glove")),
        ("predictor", env!("CARGO_BIN_EXE_egotac_predictor")),
        ("retargeter", env!("CARGO_BIN_EXE_egotac_retargeter")),
        ("simulator", env!("CARGO_BIN_EXE_egotac_simulator")),
        ("trainer", env!("CARGO_BIN_EXE_egotac_trainer")),
        ("verifier", env!("CARGO_BIN_EXE_egotac_verifier")),
    ];
    for (node, program) in programs {
        let section = text.split("\n## ").find(|section| section.starts_with(node)).unwrap();
        let (_, table) = section.split_once("| parameter | default |").unwrap();
        let output = Command::new(program).arg("--describe-parameters").output().unwrap();
        let described: Value = serde_json::from_slice(&output.stdout).unwrap();
        for (name, description) in described.as_object().unwrap() {
            let row =
                table.lines().find(|line| line.starts_with("| `") && cell(line, 1).contains(&format!("`{name}`")));
            let row = row.unwrap_or_else(|| panic!("docs/nodes.md lacks {node}'s parameter {name}"));
            let documented = cell(row, 2).trim_matches('`').to_owned();
            let same = match &description["default"] {
                Value::String(text) => documented == *text,
                Value::Number(number) => documented.parse().ok() == number.as_f64(),
                Value::Bool(value) => documented == value.to_string(),
                _ => true, // an array, which the table describes in words
            };
            assert!(same, "docs/nodes.md: default of {node}'s {name}: {documented:?}, not {}", description["default"]);
        }
    }
}

/// Returns the names of a node's topics, services and actions in its table, as full names in the root namespace.
fn documented_names(text: &str, node: &str) -> Vec<String> {
    let section = text.split("\n## ").find(|section| section.starts_with(node)).unwrap();
    let (table, _) = section.split_once("| parameter | default |").unwrap();
    let rows = table.lines().filter(|line| line.starts_with("| `"));
    let quoted = rows.flat_map(|row| cell(row, 1).split('`').skip(1).step_by(2));
    let full = |name: &str| match name.strip_prefix("~/") {
        Some(own) => format!("/{node}/{own}"),
        None => format!("/{}", name.trim_start_matches('/')),
    };
    quoted.map(|name| full(name).replace("SIDE_PART", "left_thumb")).collect()
}

#[test]
fn security_policies_allow_each_documented_name() {
    let (text, policies) = (document("docs/nodes.md"), document("launch/sros2/policies.xml"));
    for node in ["glove", "predictor", "retargeter", "simulator", "trainer", "verifier"] {
        let path = format!("<enclave path=\"/egotac/{node}\">");
        let (_, enclave) = policies.split_once(&path).unwrap();
        let enclave = enclave.split("</enclave>").next().unwrap();
        let names = documented_names(&text, node);
        assert!(names.len() > 2, "{node}: {names:?}");
        for name in names.into_iter().chain([format!("/{node}/set_parameters"), "/rosout".into()]) {
            assert!(enclave.contains(&format!(">{name}<")), "launch/sros2/policies.xml: {node} lacks {name}");
        }
    }
}

#[test]
fn topics_of_the_foxglove_layout_are_documented() {
    let text = document("docs/nodes.md");
    let names: Vec<String> = ["predictor", "simulator"].iter().flat_map(|node| documented_names(&text, node)).collect();
    let layout: Value = serde_json::from_str(&document("launch/foxglove.json")).unwrap();
    let layout = layout.to_string();
    let mut found = 0;
    for quoted in layout.split('"').filter(|part| part.starts_with("/predictor/") || part.starts_with("/truth/")) {
        let topic = quoted.split(['.', '[']).next().unwrap();
        assert!(names.iter().any(|name| name == topic), "{topic}");
        found += 1;
    }
    assert!(found > 5);
}

#[test]
fn listener_of_the_readme_prints_the_touch_of_each_image_with_its_stamp() {
    let readme = document("README.md");
    let (_, rest) = readme.split_once("<!-- file: listener.py -->\n```python\n").unwrap();
    let (script, _) = rest.split_once("```").unwrap();
    let predictor = readme.lines().find(|line| line.starts_with("egotac_predictor ")).unwrap();

    let session = Session::new();
    let path = session.path("listener.py");
    std::fs::write(&path, script).unwrap();
    let mut command = harness::python();
    command.arg(&path);
    let mut listener = session.spawn(command, "listener");
    let mut command = Command::new(env!("CARGO_BIN_EXE_egotac_predictor"));
    command.args(predictor.split_whitespace().skip(1));
    let mut node = session.spawn(command, "predictor");
    // DDS may connect the camera to the listener before it connects the predictor to the listener. On a busy machine the first
    // frames are then lost, as on a robot; the camera starts again.
    for _ in 0..10 {
        session.check("predictor_peer.py", &["camera"]);
        std::thread::sleep(std::time::Duration::from_millis(500));
        if listener.output().contains("1700000000.000000005 right: ") {
            break;
        }
    }
    for count in 0..10 {
        for side in ["left", "right"] {
            listener.prints(&format!("{}.{:09} {side}: ", 1_700_000_000 + count, 5 + count));
        }
    }
    node.ends_cleanly("INT");
}
