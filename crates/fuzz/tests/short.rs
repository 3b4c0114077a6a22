//! The short form of all targets finds nothing.

use std::process::Command;

#[test]
fn no_input_of_the_short_form_ends_a_reader() {
    let out = tempfile::tempdir().unwrap();
    let mut command = Command::new(env!("CARGO_BIN_EXE_egotac-fuzz"));
    let output = command.arg("--short").arg("--out").arg(out.path()).output().unwrap();
    let [text, errors] = [&output.stdout, &output.stderr].map(|text| String::from_utf8_lossy(text).into_owned());
    println!("{text}");
    // The name of a kept input tells the reason; `scripts/fuzz --short` keeps it in out/fuzz.
    assert!(output.status.success(), "{text}{errors}");
    let targets = text.lines().filter(|line| line.ends_with(" 0 findings")).count();
    assert!(targets >= 13, "{text}");
}
