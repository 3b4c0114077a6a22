//! The checks of `egotac doctor`: one function for each row of the table.

use std::path::{Path, PathBuf};
use std::process::Command;

use super::Row;
use crate::error::Error;
use crate::hand::{HandModel, HandParams, N_VERTICES, Side};
use crate::model::{Checkpoint, Metadata, shipped};

/// Commands that install the missing parts and rebuild.
const SET_UP: &str = "`make setup`, `. ./env.sh`, then build again";

/// Runs all checks, in the order of the table.
pub fn all(hand_model: &str) -> Vec<Row> {
    let ros = Ros::find();
    vec![
        egotac(),
        rust(),
        ros_distro(&ros),
        middleware(&ros),
        messages(&ros),
        engine(),
        renderer(),
        gpu(),
        ffmpeg(),
        hand(hand_model),
        checkpoint(),
    ]
}

/// Reports the version and the features of this build.
fn egotac() -> Row {
    let features = [
        ("ros", cfg!(feature = "ros")),
        ("sim", cfg!(feature = "sim")),
        ("cuda", cfg!(feature = "cuda")),
        ("nccl", cfg!(feature = "nccl")),
        ("mpi", cfg!(feature = "mpi")),
        ("rerun", cfg!(feature = "rerun")),
    ];
    let built: Vec<_> = features.iter().filter(|(_, built)| *built).map(|(name, _)| *name).collect();
    let built = if built.is_empty() { "none".to_string() } else { built.join(", ") };
    Row::ok("egotac", format!("{}, features: {built}", env!("CARGO_PKG_VERSION")))
}

/// Reports cargo and the compiler of this build.
fn rust() -> Row {
    let built = env!("EGOTAC_BUILD_RUSTC");
    match first_line("cargo", &["--version"]) {
        Some(cargo) => Row::ok("Rust", format!("{cargo}; this build: {built}")),
        None => {
            Row::ok("Rust", format!("no cargo (install it from https://rustup.rs to rebuild); this build: {built}"))
        }
    }
}

/// The ROS 2 installation that a node would use.
struct Ros {
    distro: String,
    prefixes: Vec<PathBuf>,
    /// True if the shell's environment names the installation; otherwise it is the one of the build.
    sourced: bool,
}

impl Ros {
    /// Finds the installation of the shell, or else of the build.
    fn find() -> Self {
        let variable = |name| std::env::var(name).ok().filter(|value| !value.is_empty());
        let (distro, prefixes) = (variable("ROS_DISTRO"), variable("AMENT_PREFIX_PATH"));
        let sourced = distro.is_some() && prefixes.is_some();
        let prefixes = prefixes.unwrap_or_else(|| env!("EGOTAC_BUILD_AMENT_PREFIX_PATH").to_string());
        Self {
            distro: distro.unwrap_or_else(|| env!("EGOTAC_BUILD_ROS_DISTRO").to_string()),
            prefixes: std::env::split_paths(&prefixes).filter(|path| !path.as_os_str().is_empty()).collect(),
            sourced,
        }
    }

    /// Returns the first prefix that contains a file.
    fn prefix_of(&self, file: &str) -> Option<&Path> {
        self.prefixes.iter().map(PathBuf::as_path).find(|prefix| prefix.join(file).exists())
    }
}

/// Checks that ROS 2 is installed in the distribution of the build.
fn ros_distro(ros: &Ros) -> Row {
    const NAME: &str = "ROS 2";
    let prefix = ros.prefix_of("share/rcl");
    let origin = if ros.sourced { "sourced in this shell" } else { "used for this build" };
    let found = match prefix {
        Some(prefix) => format!("{} in {} ({origin})", ros.distro, prefix.display()),
        None if ros.prefixes.is_empty() => "not found: no ROS 2 is sourced in this shell".to_string(),
        None => format!("{}, but none of its prefixes contains rcl: {} ({origin})", ros.distro, list(&ros.prefixes)),
    };
    let built = env!("EGOTAC_BUILD_ROS_DISTRO");
    if cfg!(not(feature = "ros")) {
        Row::not_needed(NAME, "ros", found)
    } else if prefix.is_none() {
        Row::missing(NAME, found, SET_UP)
    } else if ros.distro != built {
        let fix = format!("source ROS 2 {built}, or rebuild for {}", ros.distro);
        Row::missing(NAME, format!("{found}; this build needs {built}"), fix)
    } else {
        Row::ok(NAME, found)
    }
}

/// Checks that the library of the chosen ROS middleware is installed.
fn middleware(ros: &Ros) -> Row {
    const NAME: &str = "rmw";
    let chosen = std::env::var("RMW_IMPLEMENTATION").ok().filter(|name| !name.is_empty());
    let by_default = if chosen.is_some() { "" } else { " (default)" };
    let name = chosen.unwrap_or_else(|| "rmw_fastrtps_cpp".to_string());
    let library = format!("lib/lib{name}.so");
    match ros.prefix_of(&library) {
        _ if cfg!(not(feature = "ros")) => Row::not_needed(NAME, "ros", format!("{name}{by_default}")),
        Some(prefix) => Row::ok(NAME, format!("{name}{by_default}: {}", prefix.join(&library).display())),
        None => Row::missing(
            NAME,
            format!("{name}{by_default}: no {library} in {}", list(&ros.prefixes)),
            format!(
                "`unset RMW_IMPLEMENTATION`, or with ROS 2 from apt `apt-get install ros-{}-{}`",
                ros.distro,
                name.replace('_', "-")
            ),
        ),
    }
}

/// Reports the message package; not used by this build.
#[cfg(not(feature = "ros"))]
fn messages(ros: &Ros) -> Row {
    let found = match ros.prefix_of("share/egotac_msgs") {
        Some(prefix) => format!("egotac_msgs in {}", prefix.display()),
        None => "egotac_msgs is not in AMENT_PREFIX_PATH".to_string(),
    };
    Row::not_needed("messages", "ros", found)
}

/// Checks that egotac_msgs is installed with the message layout that r2r's bindings in this program were generated
/// from.
#[cfg(feature = "ros")]
fn messages(ros: &Ros) -> Row {
    use super::idl_hash::{idl_files, idl_hash};

    const NAME: &str = "messages";
    let Some(prefix) = ros.prefix_of("share/egotac_msgs") else {
        return Row::missing(NAME, format!("no egotac_msgs in {}", list(&ros.prefixes)), SET_UP);
    };
    let share = prefix.join("share/egotac_msgs");
    let found = match idl_files(&share).and_then(|files| idl_hash(&share, &files)) {
        Ok(hash) => hash,
        Err(error) => return Row::missing(NAME, format!("{}: {error}", share.display()), SET_UP),
    };
    let place = format!("egotac_msgs in {}", prefix.display());
    let built = env!("EGOTAC_BUILD_IDL_HASH");
    if built == found {
        Row::ok(NAME, format!("{place}, bindings fit (layout {found})"))
    } else if built == format!("unmarked-{found}") {
        let note =
            "bindings fit, but IDL_PACKAGE_FILTER had no layout mark at build time, so later changes go unnoticed";
        Row::ok(NAME, format!("{place}, {note}"))
    } else {
        Row::missing(NAME, format!("{place}, bindings are stale (layout {found}, this build needs {built})"), SET_UP)
    }
}

/// Reports the physics engine; not used by this build.
#[cfg(not(feature = "sim"))]
fn engine() -> Row {
    let dir = std::env::var("MUJOCO_DYNAMIC_LINK_DIR").unwrap_or_default();
    let library = Path::new(&dir).join("libmujoco.so");
    let found = match library.exists() {
        true => library.display().to_string(),
        false => "no libmujoco.so in MUJOCO_DYNAMIC_LINK_DIR".to_string(),
    };
    Row::not_needed("MuJoCo", "sim", found)
}

/// Checks the version of the loaded physics engine.
#[cfg(feature = "sim")]
fn engine() -> Row {
    // The struct layouts of mujoco-rs are those of this version.
    const NEEDED: &str = "3.17.0";
    let version = mujoco_rs::mujoco_version();
    let maps = std::fs::read_to_string("/proc/self/maps").unwrap_or_default();
    let place = maps.lines().find(|line| line.contains("/libmujoco")).and_then(|line| Some(&line[line.find('/')?..]));
    let found = format!("{version}: {}", place.unwrap_or("linked into the program"));
    match version == NEEDED {
        true => Row::ok("MuJoCo", found),
        false => Row::missing("MuJoCo", found, format!("needs {NEEDED}: {SET_UP}")),
    }
}

/// Reports the renderer; not used by this build.
#[cfg(not(feature = "sim"))]
fn renderer() -> Row {
    Row::not_needed("GL renderer", "sim", "not checked")
}

/// Checks that an OpenGL context opens without a display.
#[cfg(feature = "sim")]
fn renderer() -> Row {
    const FIX: &str = "`apt-get install libegl1 libegl-mesa0 libgl1-mesa-dri` (as root), or a GPU driver with EGL";
    match super::gl::renderer() {
        Ok(name) => Row::ok("GL renderer", name),
        Err(error) => Row::missing("GL renderer", format!("{error:#}"), FIX),
    }
}

/// Checks that the CUDA device opens, if the build uses it.
fn gpu() -> Row {
    const NAME: &str = "GPU";
    let query = ["--query-gpu=name,driver_version", "--format=csv,noheader"];
    let card = first_line("nvidia-smi", &query);
    let found = card.unwrap_or_else(|| "no NVIDIA GPU found".to_string());
    if cfg!(not(feature = "cuda")) {
        return Row::not_needed(NAME, "cuda", found);
    }
    match egotac_kernels::gpu::open(0) {
        Ok(_) => Row::ok(NAME, found),
        Err(error) => Row::missing(
            NAME,
            format!("{found}; {}", error.to_string().lines().next().unwrap_or_default()),
            "install an NVIDIA driver, or build without the feature `cuda`",
        ),
    }
}

/// Checks for ffmpeg and ffprobe, which read videos.
fn ffmpeg() -> Row {
    const NAME: &str = "ffmpeg";
    match (first_line("ffmpeg", &["-version"]), first_line("ffprobe", &["-version"])) {
        (Some(found), Some(_)) => Row::ok(NAME, found.split(" Copyright").next().unwrap_or_default()),
        _ => Row::missing(NAME, "not found; it reads videos", "`apt-get install ffmpeg` (as root)"),
    }
}

/// Loads a hand model and poses it.
fn hand(model: &str) -> Row {
    const NAME: &str = "hand";
    let loaded = match model {
        "builtin" => Ok(HandModel::builtin(Side::Right)),
        path => HandModel::load(Path::new(path), Side::Right),
    };
    let fix = "use --hand builtin, or a MANO file from https://mano.is.tue.mpg.de";
    match loaded {
        Err(error) => Row::missing(NAME, error.to_string(), fix),
        Ok(hand) => {
            let posed = hand.forward(&HandParams::default());
            let finite = posed.vertices.iter().filter(|vertex| vertex.is_finite()).count();
            let found = format!("{model} ({}), {finite} vertices, {} triangles", hand.topology.id(), hand.faces.len());
            match finite == N_VERTICES {
                true => Row::ok(NAME, found),
                false => Row::missing(NAME, format!("{found}: expected {N_VERTICES} finite vertices"), fix),
            }
        }
    }
}

/// Loads the shipped checkpoint, which is the default of all programs.
fn checkpoint() -> Row {
    const NAME: &str = "checkpoint";
    const FIX: &str = "`git checkout models`, or pass another checkpoint to the programs";
    let loaded = shipped::path().and_then(|path| {
        let checkpoint = Checkpoint::load(&path, &candle_core::Device::Cpu)?;
        let megabytes = path.metadata().map_err(Error::io(&path))?.len() as f64 / 1e6;
        let Metadata { name, topology, .. } = &checkpoint.metadata;
        Ok(format!("{name} for {}, {megabytes:.1} MB: {}", topology.id(), path.display()))
    });
    match loaded {
        Ok(found) => Row::ok(NAME, found),
        Err(error) => Row::missing(NAME, error.to_string(), FIX),
    }
}

/// Returns the first line that a program prints; `None` if it does not run or fails.
fn first_line(program: &str, arguments: &[&str]) -> Option<String> {
    let output = Command::new(program).args(arguments).output().ok().filter(|output| output.status.success())?;
    let text = String::from_utf8_lossy(&output.stdout);
    text.lines().next().map(|line| line.trim().to_string()).filter(|line| !line.is_empty())
}

/// Joins paths for a message.
fn list(paths: &[PathBuf]) -> String {
    match paths {
        [] => "any prefix (AMENT_PREFIX_PATH is not set)".to_string(),
        _ => paths.iter().map(|path| path.display().to_string()).collect::<Vec<_>>().join(", "),
    }
}
