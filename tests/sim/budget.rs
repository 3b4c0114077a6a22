//! `egotac sim run --budget` and `--error`: the preset that fits, and why.

use std::process::Command;

#[test]
fn sim_run_takes_the_preset_that_fits_and_says_so() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("a.zarr");
    let run = |extra: &[&str]| {
        Command::new(env!("CARGO_BIN_EXE_egotac"))
            .args(["sim", "run", "pinch_cube", "--size", "8", "--out", out.to_str().unwrap()])
            .args(extra)
            .env("XDG_CACHE_HOME", folder.path().join("cache"))
            .output()
            .unwrap()
    };
    // The table's times are scaled by this machine's factor, which is measured once.
    let failed = |extra: &[&str]| {
        let output = run(extra);
        assert!(!output.status.success() && !out.exists());
        String::from_utf8(output.stderr).unwrap()
    };
    let error = failed(&["--budget", "0.001ms"]);
    assert!(error.contains("--budget") && error.contains("fast ("), "{error}");
    assert!(error.contains("times x ") && error.contains("for this machine ("), "{error}");
    let cached = std::fs::read_to_string(folder.path().join("cache/egotac/budget.json")).unwrap();
    assert_eq!(cached.matches("; egotac ").count(), 1, "{cached}");
    let error = failed(&["--budget", "0.001ms", "--error", "0%"]);
    assert!(error.contains("fast (") && error.contains("reference ("), "{error}");
    assert!(failed(&["--budget", "20"]).contains("20ms"));
    assert!(failed(&["--preset", "fats"]).contains("precise"));
    assert!(failed(&["--preset", "fast", "--error", "1%"]).contains("cannot be used with"));
    let output = run(&["--error", "90%"]);
    let said = String::from_utf8(output.stdout).unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    assert!(said.contains("pinch_cube: preset fast (") && said.contains("the cheapest within 90.0 %"), "{said}");
    assert!(out.exists());
}
