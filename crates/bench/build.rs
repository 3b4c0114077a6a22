//! Passes on to a package's programs where egotac's libraries are; crates/bench and crates/fuzz share it.

use std::env;
use std::path::PathBuf;

fn main() {
    println!("cargo::rerun-if-env-changed=DEP_EGOTAC_LIBRARY_PATH");
    let list = env::var_os("DEP_EGOTAC_LIBRARY_PATH").unwrap_or_default();
    let dirs: Vec<PathBuf> = env::split_paths(&list).filter(|path| !path.as_os_str().is_empty()).collect();
    if dirs.is_empty() {
        return;
    }
    // RPATH, not RUNPATH, as in egotac's own build.rs: only RPATH also serves the libraries that the libraries load.
    println!("cargo::rustc-link-arg=-Wl,--disable-new-dtags");
    for dir in dirs {
        for argument in ["-rpath", &dir.display().to_string()] {
            println!("cargo::rustc-link-arg=-Xlinker");
            println!("cargo::rustc-link-arg={argument}");
        }
    }
}
