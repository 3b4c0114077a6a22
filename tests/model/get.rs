//! `egotac model get`, and checkpoints of other programs where one of egotac is expected.

use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::process::Command;

use egotac::model::published::PUBLISHED;
use egotac::model::shipped;

use crate::common::{egotac, model_data, refused};

#[test]
fn a_file_is_checked_and_copied_without_a_network() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("mine.safetensors");
    let shipped = shipped::path().unwrap();
    let output = egotac(&["model", "get", shipped.to_str().unwrap(), "--out", out.to_str().unwrap()]);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    assert!(fs::read(&out).unwrap() == fs::read(&shipped).unwrap());
}

#[test]
fn a_pytorch_file_in_place_of_a_checkpoint_names_the_command_that_imports_it() {
    let foreign = model_data("foreign.pth");
    let foreign = foreign.to_str().unwrap();
    let hint = format!("egotac model import --checkpoint {foreign} --mapping TABLE.yaml");
    refused(&["predict", "--checkpoint", foreign, "--data", "x", "--out", "y"], &hint);
    refused(&["model", "get", foreign], "--mapping imports one of another program");
}

#[test]
fn every_published_network_is_listed_with_its_page_and_licence() {
    let text = String::from_utf8(egotac(&["model", "get"]).stdout).unwrap();
    for published in PUBLISHED {
        assert!(published.page.starts_with("https://"));
        assert!([published.name, published.page, published.licence].iter().all(|part| text.contains(part)), "{text}");
    }
    assert!(text.contains("unofficial"));
    refused(&["model", "get", "nothing"], "dinov2-small");
    refused(&["model", "get", "http://example.org/x.safetensors"], "neither a file, nor an https address");
}

#[test]
fn a_download_needs_the_licence_accepted_and_goes_over_https_alone() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    // A stand-in for curl that writes down its arguments and "downloads" the shipped checkpoint.
    let script = format!(
        "#!/bin/sh\necho \"$@\" > {}\nwhile [ \"$1\" != --output ]; do shift; done\ncp {} \"$2\"\n",
        at("arguments"),
        shipped::path().unwrap().display()
    );
    fs::create_dir(at("bin")).unwrap();
    fs::write(at("bin/curl"), script).unwrap();
    fs::set_permissions(at("bin/curl"), fs::Permissions::from_mode(0o755)).unwrap();
    let get = |more: &[&str]| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_egotac"));
        command.args(["model", "get", "https://example.org/nets/a.safetensors?x=1", "--out", &at("a.safetensors")]);
        command.args(more).env("PATH", format!("{}:{}", at("bin"), std::env::var("PATH").unwrap()));
        command.output().unwrap()
    };
    let without = get(&[]);
    assert_eq!(without.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&without.stderr).contains("--accept-licence"));
    assert!(!folder.path().join("arguments").exists());
    let output = get(&["--accept-licence"]);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let arguments = fs::read_to_string(at("arguments")).unwrap();
    assert!(
        arguments.contains("--proto =https --proto-redir =https")
            && arguments.contains("-- https://example.org/nets/a.safetensors?x=1")
    );
    assert!(fs::read(at("a.safetensors")).unwrap() == fs::read(shipped::path().unwrap()).unwrap());
}
