//! Inputs that once ended a reader are read or refused, within the limits of memory and time.

use std::path::Path;
use std::process::Command;

#[test]
fn every_hostile_input_is_read_or_refused() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/data/hostile");
    let program = env!("CARGO_BIN_EXE_egotac-fuzz");
    let list = Command::new(program).arg("--list").output().unwrap();
    let known = String::from_utf8(list.stdout).unwrap();
    let mut failures = Vec::new();
    // Targets of features that are off have regressions too.
    for target in known.lines().filter(|target| folder.join(target).is_dir()) {
        for entry in std::fs::read_dir(folder.join(target)).unwrap() {
            let path = entry.unwrap().path();
            let output = Command::new(program).args(["--target", target, "--replay"]).arg(&path).output().unwrap();
            if !output.status.success() {
                let [out, err] =
                    [&output.stdout, &output.stderr].map(|text| String::from_utf8_lossy(text).into_owned());
                failures.push(out + &err);
            }
        }
    }
    assert!(failures.is_empty(), "{}", failures.concat());
}

#[test]
fn the_hostile_inputs_belong_to_targets() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/data/hostile");
    let targets = std::fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("src/targets/mod.rs")).unwrap();
    for entry in std::fs::read_dir(folder).unwrap() {
        let name = entry.unwrap().file_name().into_string().unwrap();
        assert!(
            name.ends_with(".md") || name.ends_with(".py") || targets.contains(&format!("name: \"{name}\"")),
            "{name}"
        );
    }
}
