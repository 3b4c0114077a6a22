//! Rules that all commands keep: names of options, help, JSON, old spellings, exit statuses.

use std::fs;
use std::process::Output;

use crate::common::egotac;

/// Returns standard output and standard error.
fn texts(output: &Output) -> (String, String) {
    let text = |bytes: &[u8]| String::from_utf8(bytes.to_vec()).unwrap();
    (text(&output.stdout), text(&output.stderr))
}

#[test]
fn an_old_spelling_ends_with_the_new_one() {
    for (command, old, new) in egotac::cli::renamed::RENAMED {
        // egotac-bench reads these; its own tests check them.
        if command.starts_with("bench") || command.starts_with("experiment") {
            continue;
        }
        let arguments: Vec<&str> = command.split(' ').chain([old, "x"]).collect();
        let output = egotac(&arguments);
        let (_, error) = texts(&output);
        assert_eq!(output.status.code(), Some(2), "{command} {old}: {error}");
        assert_eq!(error.trim_end(), format!("error: `egotac {command} {old}` is now {new}"));
    }
    // An option that never existed is reported as before.
    let (_, error) = texts(&egotac(&["verify", "--predictors", "x"]));
    assert!(error.contains("unexpected argument '--predictors'"), "{error}");
}

#[test]
fn a_length_without_a_unit_is_refused() {
    for arguments in [
        &["verify", "pinch_cube", "--thresholds", "0,5"][..],
        &["verify", "pinch_cube", "--sigma", "4"],
        &["data", "import", "hot3d", "a", "--out", "b", "--contact-distance", "2"],
    ] {
        let output = egotac(arguments);
        assert_eq!(output.status.code(), Some(2));
        assert!(texts(&output).1.contains("expected a length with its unit, such as 4mm"), "{arguments:?}");
    }
}

#[test]
fn the_short_help_is_shorter_and_both_end_with_an_example() {
    let (short, _) = texts(&egotac(&["label", "-h"]));
    let (long, _) = texts(&egotac(&["label", "--help"]));
    assert!(long.len() > short.len() + 1000, "{} {}", short.len(), long.len());
    for help in [&short, &long] {
        assert!(help.trim_end().ends_with("Example: egotac label mug_dataset --out mug_labelled"), "{help}");
    }
    assert!(long.contains("resumes") && !short.contains("resumes"));
    let (top, _) = texts(&egotac(&["--help"]));
    for group in ["Simulate:", "Predict:", "Label:", "Train:", "Robots and gloves:", "Measure:"] {
        assert!(top.contains(&format!("\n{group}\n")), "{top}");
    }
    // Standard output is not a terminal here: no colours.
    assert!(!top.contains('\u{1b}'));
}

#[test]
fn json_goes_to_standard_output_or_beside_the_text() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("info.json");
    let (text, _) = texts(&egotac(&["model", "info", "--checkpoint", "shipped"]));
    let (json, _) = texts(&egotac(&["model", "info", "--checkpoint", "shipped", "--json"]));
    let (beside, _) = texts(&egotac(&["model", "info", "--checkpoint", "shipped", "--json", file.to_str().unwrap()]));
    assert_eq!((beside, fs::read_to_string(&file).unwrap()), (text, json.clone()));
    assert!(serde_json::from_str::<serde_json::Value>(&json).unwrap()["sha256"].is_string());
    // An option written before a recording must not overwrite the recording.
    let recording = folder.path().join("a.mcap");
    fs::write(&recording, b"precious").unwrap();
    let output = egotac(&["data", "info", "--json", recording.to_str().unwrap(), "b.zarr"]);
    assert_eq!(output.status.code(), Some(2));
    assert!(texts(&output).1.contains(".json"));
    assert_eq!(fs::read(&recording).unwrap(), b"precious");
}

#[test]
fn a_command_without_a_terminal_shows_no_progress_and_tells_details_on_request() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let input = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/data/oxt/task.zarr.zip");
    let arguments = |out: &str| ["predict", "--data", input, "--unknown", "guess", "--out", out].map(str::to_owned);
    let run = |option: Option<&str>, out: &str| {
        let own = arguments(out);
        let all: Vec<&str> = option.into_iter().chain(own.iter().map(String::as_str)).collect();
        let output = egotac(&all);
        assert!(output.status.success(), "{}", texts(&output).1);
        texts(&output).1
    };
    assert_eq!(run(None, &at("a")), run(Some("--quiet"), &at("b")));
    let verbose = run(Some("-v"), &at("c"));
    assert!(verbose.contains("egotac: checkpoint ") && verbose.contains("egotac: done in "), "{verbose}");
}

#[test]
fn a_configuration_is_written_and_its_keys_are_set_by_name() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("train.yaml");
    let file = file.to_str().unwrap();
    assert!(egotac(&["train", "--init-config", file]).status.success());
    let text = fs::read_to_string(file).unwrap();
    assert!(text.contains("# Peak learning rate.") && text.contains("  learning_rate: 0.0001"), "{text}");
    // A second time the edited file would be lost.
    assert_eq!(egotac(&["train", "--init-config", file]).status.code(), Some(1));
    let (_, error) = texts(&egotac(&["train", "--config", file, "--set", "optimizer.rate=1"]));
    assert!(error.contains("optimizer.rate") && error.contains("learning_rate"), "{error}");
    let (_, error) = texts(&egotac(&["train", "--config", file, "--set", "steps=0"]));
    assert!(error.contains("steps: expected 1 to"), "{error}");
    assert_eq!(error.matches("steps: expected").count(), 1, "an error is printed once: {error}");
}
