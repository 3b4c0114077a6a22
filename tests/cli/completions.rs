//! `egotac completions` and `egotac man`.

use std::fs;
use std::process::Command;

use crate::common::egotac;

#[test]
fn completions_are_scripts_that_know_commands_and_options() {
    for shell in ["bash", "zsh", "fish"] {
        let output = egotac(&["completions", shell]);
        assert!(output.status.success());
        let script = String::from_utf8(output.stdout).unwrap();
        assert!(["view", "label", "retarget", "labels-only"].iter().all(|word| script.contains(word)), "{shell}");
    }
    let folder = tempfile::tempdir().unwrap();
    let script = folder.path().join("egotac.bash");
    fs::write(&script, egotac(&["completions", "bash"]).stdout).unwrap();
    // What bash itself would offer behind `egotac la`.
    let ask = format!(
        ". {}; COMP_WORDS=(egotac la); COMP_CWORD=1; _egotac egotac la egotac; echo \"${{COMPREPLY[*]}}\"",
        script.display()
    );
    let output = Command::new("bash").args(["-c", &ask]).output().unwrap();
    assert_eq!(String::from_utf8_lossy(&output.stdout).trim(), "label", "{}", String::from_utf8_lossy(&output.stderr));
    assert_eq!(egotac(&["completions", "tcsh"]).status.code(), Some(2));
}

#[test]
fn every_command_has_a_manual_page() {
    let folder = tempfile::tempdir().unwrap();
    assert!(egotac(&["man", folder.path().to_str().unwrap()]).status.success());
    for name in
        ["egotac", "egotac-view", "egotac-label", "egotac-model-get", "egotac-retarget-inspect", "egotac-data-info"]
    {
        let page = fs::read_to_string(folder.path().join(format!("{name}.1"))).unwrap();
        assert!(page.contains(".TH ") && page.contains(".SH SYNOPSIS"), "{name}: {page}");
    }
    let page = fs::read_to_string(folder.path().join("egotac-view.1")).unwrap();
    assert!(page.contains("labels\\-only") && page.contains("loopback"), "{page}");
}
