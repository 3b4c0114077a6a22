//! The short form of each target finds nothing.

use std::process::Command;

/// Makes a test of each target, and a list of all.
macro_rules! short {
    ($($(#[$condition:meta])? $target:ident),+ $(,)?) => {
        const TARGETS: &[&str] = &[$($(#[$condition])? stringify!($target)),+];

        $(
            $(#[$condition])?
            #[test]
            fn $target() {
                no_input_ends_the_reader(stringify!($target));
            }
        )+
    };
}

short!(
    pickle,
    npz,
    safetensors,
    pt,
    mcap,
    cdr,
    image_raw,
    image_file,
    zarr,
    lerobot,
    yaml_train,
    yaml_import,
    yaml_bag,
    #[cfg(feature = "sim")]
    yaml_scene,
    #[cfg(feature = "sim")]
    yaml_robot,
    #[cfg(feature = "sim")]
    mjcf,
    #[cfg(feature = "sim")]
    urdf,
);

#[test]
fn every_target_has_a_test() {
    let list = Command::new(env!("CARGO_BIN_EXE_egotac-fuzz")).arg("--list").output().unwrap();
    assert_eq!(String::from_utf8(list.stdout).unwrap().lines().collect::<Vec<_>>(), TARGETS);
}

fn no_input_ends_the_reader(target: &str) {
    let out = tempfile::tempdir().unwrap();
    let mut command = Command::new(env!("CARGO_BIN_EXE_egotac-fuzz"));
    let output = command.args(["--short", "--target", target, "--out"]).arg(out.path()).output().unwrap();
    let [text, errors] = [&output.stdout, &output.stderr].map(|text| String::from_utf8_lossy(text).into_owned());
    println!("{text}");
    // The name of a kept input tells the reason; `scripts/fuzz --short` keeps it in out/fuzz.
    assert!(output.status.success(), "{text}{errors}");
    assert!(text.starts_with(target) && text.trim_end().ends_with(" 0 findings"), "{text}");
}
