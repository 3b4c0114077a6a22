//! Colours on a terminal.

use std::process::{Command, Stdio};

/// Runs its arguments on a terminal of their own.
const ON_TERMINAL: &str = "import pty, sys; sys.exit(0 if pty.spawn(sys.argv[1:]) >= 0 else 1)";

/// Runs `egotac` on a terminal and returns what it prints there. `no_color`: value of the variable NO_COLOR.
fn on_terminal(no_color: Option<&str>, arguments: &[&str]) -> String {
    let python = std::env::var("EGOTAC_PYTHON").expect("EGOTAC_PYTHON: source env.sh, which `make setup` writes");
    let mut command = Command::new(python);
    command.args(["-c", ON_TERMINAL, env!("CARGO_BIN_EXE_egotac")]).args(arguments).stdin(Stdio::null());
    command.env_remove("NO_COLOR").env_remove("CLICOLOR").env_remove("CLICOLOR_FORCE").env("TERM", "xterm-256color");
    if let Some(value) = no_color {
        command.env("NO_COLOR", value);
    }
    let output = command.output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).unwrap()
}

/// Returns true if a text sets a colour or a weight: the terminal's sequence `ESC [ numbers m`.
fn is_coloured(text: &str) -> bool {
    text.split("\u{1b}[")
        .skip(1)
        .any(|rest| rest.trim_start_matches(|c: char| c.is_ascii_digit() || c == ';').starts_with('m'))
}

#[test]
fn no_color_removes_colours_from_help_errors_and_progress() {
    let input = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/data/oxt/task.zarr.zip");
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("fields.safetensors");
    let predict = ["predict", "--data", input, "--unknown", "guess", "--out", out.to_str().unwrap()];
    for (arguments, word) in [
        (&["--help"][..], "Usage:"),
        (&["label", "-h"], "Example:"),
        (&["label", "--sizes", "3"], "unexpected argument"),
        (&["model", "info", "shipped"], "is now --checkpoint FILE"),
        (&["data", "info", "nothing"], "nothing"),
        // Progress is shown on terminals alone; its bar counts images.
        (&predict, " images "),
    ] {
        let plain = on_terminal(Some("1"), arguments);
        assert!(plain.contains(word) && !is_coloured(&plain), "{arguments:?}: {plain:?}");
    }
    // The terminal is one: without the variable, help and errors have colours; an empty value does not count.
    for no_color in [None, Some("")] {
        for arguments in [&["--help"][..], &["label", "--sizes", "3"]] {
            let coloured = on_terminal(no_color, arguments);
            assert!(is_coloured(&coloured), "{arguments:?}: {coloured:?}");
        }
    }
}
