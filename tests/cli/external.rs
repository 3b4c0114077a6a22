//! `egotac bench` and `egotac experiment` run the program `egotac-bench`.

use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

/// A copy of `egotac` in a folder of its own, so that no `egotac-bench` of this build lies beside it.
fn lone_egotac(folder: &Path) -> PathBuf {
    let (built, alone) = (env!("CARGO_BIN_EXE_egotac"), folder.join("egotac"));
    fs::hard_link(built, &alone).or_else(|_| fs::copy(built, &alone).map(drop)).unwrap();
    alone
}

/// A program that prints its name and arguments and exits with status 7.
fn fake_bench(folder: &Path, name: &str) {
    fs::create_dir_all(folder).unwrap();
    let path = folder.join("egotac-bench");
    fs::write(&path, format!("#!/bin/sh\necho {name} \"$@\"\nexit 7\n")).unwrap();
    fs::set_permissions(&path, PermissionsExt::from_mode(0o755)).unwrap();
}

fn run(program: &Path, arguments: &[&str], path: &Path) -> Output {
    Command::new(program).args(arguments).env("PATH", format!("{}:/usr/bin:/bin", path.display())).output().unwrap()
}

#[test]
fn without_the_program_the_error_says_how_to_build_it() {
    let folder = tempfile::tempdir().unwrap();
    let egotac = lone_egotac(folder.path());
    for command in ["bench", "experiment"] {
        let output = run(&egotac, &[command, "sim"], &folder.path().join("nothing"));
        let error = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(1));
        assert!(error.contains(&format!("egotac {command}")) && error.contains("-p egotac-bench"), "{error}");
    }
}

#[test]
fn arguments_and_exit_status_are_passed_on() {
    let folder = tempfile::tempdir().unwrap();
    let egotac = lone_egotac(folder.path());
    let path = folder.path().join("path");
    fake_bench(&path, "in_path");
    let passed = [
        (&["bench", "sim", "--knobs", "cone", "-x", "--", "--out"][..], "bench sim --knobs cone -x -- --out"),
        (&["bench", "--help"], "bench --help"),
        (&["experiment", "-h"], "experiment -h"),
        (&["bench", "--version"], "bench --version"),
        (&["bench"], "bench"),
    ];
    for (arguments, expected) in passed {
        let output = run(&egotac, arguments, &path);
        assert_eq!(output.status.code(), Some(7));
        assert_eq!(String::from_utf8(output.stdout).unwrap(), format!("in_path {expected}\n"));
    }
    // The program beside this one comes first.
    fake_bench(folder.path(), "beside");
    let output = run(&egotac, &["bench", "label"], &path);
    assert_eq!(String::from_utf8(output.stdout).unwrap(), "beside bench label\n");
}
