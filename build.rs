//! Checks the requirements of the features before linking, and sets the library paths of the binaries.

use std::env;
use std::path::PathBuf;
use std::process::Command;

#[path = "src/cli/doctor/idl_hash.rs"]
mod idl_hash;

fn main() {
    println!("cargo::rerun-if-changed=build.rs");
    println!("cargo::rerun-if-changed=src/cli/doctor/idl_hash.rs");
    println!("cargo::rustc-check-cfg=cfg(logger_levels)");
    for name in ["EGOTAC_RPATH", "AMENT_PREFIX_PATH", "IDL_PACKAGE_FILTER", "ROS_DISTRO", "MUJOCO_DYNAMIC_LINK_DIR"] {
        println!("cargo::rerun-if-env-changed={name}");
    }

    let mut library_dirs = paths("EGOTAC_RPATH");
    let mut facts = Facts::default();
    if env::var_os("CARGO_FEATURE_ROS").is_some() {
        check_messages(&mut facts);
    }
    if env::var_os("CARGO_FEATURE_SIM").is_some() {
        library_dirs.extend(check_engine(&mut facts));
    }
    write_rpaths(&library_dirs);
    // For the build script of crates/bench (`links = "egotac"` in Cargo.toml).
    if let Ok(list) = env::join_paths(&library_dirs) {
        println!("cargo::metadata=library_path={}", list.to_string_lossy());
    }
    facts.rustc = version_of_rustc();
    facts.write();
}

/// Properties of the build that `egotac doctor` compares with the machine; empty if the feature is off.
#[derive(Default)]
struct Facts {
    rustc: String,
    ros_distro: String,
    ament_prefix_path: String,
    idl_hash: String,
    mujoco_dir: String,
}

impl Facts {
    fn write(&self) {
        println!("cargo::rustc-env=EGOTAC_BUILD_RUSTC={}", self.rustc);
        println!("cargo::rustc-env=EGOTAC_BUILD_ROS_DISTRO={}", self.ros_distro);
        println!("cargo::rustc-env=EGOTAC_BUILD_AMENT_PREFIX_PATH={}", self.ament_prefix_path);
        println!("cargo::rustc-env=EGOTAC_BUILD_IDL_HASH={}", self.idl_hash);
        println!("cargo::rustc-env=EGOTAC_BUILD_MUJOCO_DIR={}", self.mujoco_dir);
    }
}

/// Finds egotac_msgs and checks that r2r generates its bindings from the installed messages.
fn check_messages(facts: &mut Facts) {
    let prefixes = paths("AMENT_PREFIX_PATH");
    let share = prefixes.iter().map(|prefix| prefix.join("share/egotac_msgs")).find(|share| share.is_dir());
    let Some(share) = share else {
        return println!(
            "cargo::error=feature `ros`: the message package egotac_msgs is not in AMENT_PREFIX_PATH ({}). \
             Run `make setup` and `. ./env.sh`, or in a colcon workspace `colcon build --packages-select egotac_msgs` \
             and `. install/setup.sh`",
            list(&prefixes)
        );
    };
    let found = idl_hash::idl_files(&share).and_then(|files| Ok((idl_hash::idl_hash(&share, &files)?, files)));
    let (hash, files) = match found {
        Ok(found) => found,
        Err(error) => return println!("cargo::error={}: {error}", share.display()),
    };
    for file in files {
        println!("cargo::rerun-if-changed={}", file.display());
    }
    // ROS 2 Humble has no services for the levels of loggers.
    let has_logger_levels = |prefix: &PathBuf| prefix.join("share/rcl_interfaces/srv/GetLoggerLevels.srv").exists();
    if prefixes.iter().any(has_logger_levels) {
        println!("cargo::rustc-cfg=logger_levels");
    }
    let filter = env::var("IDL_PACKAGE_FILTER").unwrap_or_default();
    match filter.split(';').find_map(|name| name.trim().strip_prefix("egotac_idl_")) {
        Some(marked) if marked != hash => println!(
            "cargo::error=feature `ros`: IDL_PACKAGE_FILTER marks another layout (egotac_idl_{marked}) than the \
             messages in {} have ({hash}), so r2r may keep bindings of the other layout. \
             Run `make setup` and `. ./env.sh` again",
            share.display()
        ),
        Some(_) => facts.idl_hash = hash,
        None => {
            println!(
                "cargo::warning=IDL_PACKAGE_FILTER does not contain the hash of the messages, so a changed .msg will \
                 not rebuild r2r's bindings. `. ./env.sh` sets it, and so does colcon"
            );
            facts.idl_hash = format!("unmarked-{hash}");
        }
    }
    facts.ros_distro = env::var("ROS_DISTRO").unwrap_or_default();
    facts.ament_prefix_path = env::var("AMENT_PREFIX_PATH").unwrap_or_default();
}

/// Checks for libmujoco and returns its directory; `None` if the environment names none.
fn check_engine(facts: &mut Facts) -> Option<PathBuf> {
    // Without the variable, mujoco-rs uses pkg-config, whose libraries are on the system's library path.
    let dir = PathBuf::from(env::var_os("MUJOCO_DYNAMIC_LINK_DIR")?);
    if !dir.join("libmujoco.so").exists() {
        println!(
            "cargo::error=feature `sim`: there is no libmujoco.so in {} (MUJOCO_DYNAMIC_LINK_DIR). \
             Run `make setup` and `. ./env.sh`",
            dir.display()
        );
    }
    facts.mujoco_dir = dir.display().to_string();
    Some(dir)
}

/// Adds directories to the library path of the binaries.
fn write_rpaths(dirs: &[PathBuf]) {
    if dirs.is_empty() {
        return;
    }
    // RPATH, not the newer RUNPATH: only the former also serves the libraries that the libraries load.
    println!("cargo::rustc-link-arg=-Wl,--disable-new-dtags");
    for dir in dirs {
        for argument in ["-rpath", &dir.display().to_string()] {
            println!("cargo::rustc-link-arg=-Xlinker");
            println!("cargo::rustc-link-arg={argument}");
        }
    }
}

fn version_of_rustc() -> String {
    let rustc = env::var_os("RUSTC").unwrap_or_else(|| "rustc".into());
    let output = Command::new(rustc).arg("--version").output();
    output.map(|output| String::from_utf8_lossy(&output.stdout).trim().to_string()).unwrap_or_default()
}

/// Returns the entries of a path list in the environment.
fn paths(name: &str) -> Vec<PathBuf> {
    let list = env::var_os(name).unwrap_or_default();
    env::split_paths(&list).filter(|path| !path.as_os_str().is_empty()).collect()
}

fn list(paths: &[PathBuf]) -> String {
    match paths {
        [] => "which is empty or not set".to_string(),
        _ => paths.iter().map(|path| path.display().to_string()).collect::<Vec<_>>().join(", "),
    }
}
