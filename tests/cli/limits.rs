//! `egotac limits` and the variables that raise limits.

use std::process::Command;

fn egotac(args: &[&str], variable: Option<(&str, &str)>) -> std::process::Output {
    Command::new(env!("CARGO_BIN_EXE_egotac")).args(args).envs(variable).output().unwrap()
}

#[test]
fn the_documented_table_is_the_printed_one() {
    let output = egotac(&["limits"], None);
    assert!(output.status.success());
    let documented = include_str!("../../docs/limits.md");
    assert_eq!(String::from_utf8(output.stdout).unwrap(), documented, "`egotac limits > docs/limits.md` writes it");
}

#[test]
fn a_variable_raises_and_lowers_its_limit() {
    let folder = tempfile::tempdir().unwrap();
    let image = folder.path().join("a.png");
    image::RgbImage::new(64, 48).save(&image).unwrap();
    let out = folder.path().join("out.safetensors");
    let args = ["predict", "--data", image.to_str().unwrap(), "--out", out.to_str().unwrap()];
    let refused = egotac(&args, Some(("EGOTAC_LIMIT_IMAGE_PIXELS", "3000")));
    let message = String::from_utf8(refused.stderr).unwrap();
    assert!(!refused.status.success() && message.contains("EGOTAC_LIMIT_IMAGE_PIXELS"), "{message}");
    let read = egotac(&args, Some(("EGOTAC_LIMIT_IMAGE_PIXELS", "3072")));
    assert!(read.status.success(), "{}", String::from_utf8_lossy(&read.stderr));
}

#[test]
fn a_variable_that_names_no_limit_or_no_number_is_refused() {
    for (name, value) in [("EGOTAC_LIMIT_IMAGES", "1"), ("EGOTAC_LIMIT_FRAMES", "many"), ("EGOTAC_LIMIT_FRAMES", "0")] {
        let output = egotac(&["limits"], Some((name, value)));
        let message = String::from_utf8(output.stderr).unwrap();
        assert!(!output.status.success() && message.contains(name.trim_start_matches("EGOTAC_LIMIT_")), "{message}");
    }
}
