//! The rows of the table, one function each.

use std::path::{Path, PathBuf};
use std::process::Command;

use super::Row;
use crate::error::Error;
use crate::hand::{HandModel, HandParams, N_VERTICES, Side};
use crate::model::{Checkpoint, Metadata, shipped};

/// What makes a machine whole again.
const SET_UP: &str = "`make setup`, `. ./env.sh`, then build again";

/// All rows, in the order of the table.
pub fn all(hand_model: &str) -> Vec<Row> {
    let ros = Ros::look();
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

fn egotac() -> Row {
    let features = [("ros", cfg!(feature = "ros")), ("sim", cfg!(feature = "sim")), ("cuda", cfg!(feature = "cuda"))];
    let built: Vec<_> = features.iter().filter(|(_, built)| *built).map(|(name, _)| *name).collect();
    let built = if built.is_empty() { "none".to_string() } else { built.join(", ") };
    Row::ok("egotac", format!("{}, features: {built}", env!("CARGO_PKG_VERSION")))
}

fn rust() -> Row {
    let built = env!("EGOTAC_BUILD_RUSTC");
    match first_line("cargo", &["--version"]) {
        Some(cargo) => Row::ok("Rust", format!("{cargo}; built by {built}")),
        None => Row::ok("Rust", format!("built by {built}; no cargo here, to build again see https://rustup.rs")),
    }
}

/// The ROS 2 that a node started here would meet.
struct Ros {
    distro: String,
    prefixes: Vec<PathBuf>,
    /// Whether this shell says so; otherwise it is the one of the build, which the programs remember.
    sourced: bool,
}

impl Ros {
    fn look() -> Self {
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

    /// The first prefix that has this file.
    fn prefix_of(&self, file: &str) -> Option<&Path> {
        self.prefixes.iter().map(PathBuf::as_path).find(|prefix| prefix.join(file).exists())
    }
}

fn ros_distro(ros: &Ros) -> Row {
    const NAME: &str = "ROS 2";
    let prefix = ros.prefix_of("share/rcl");
    let whence = if ros.sourced { "sourced" } else { "of the build" };
    let found = match prefix {
        Some(prefix) => format!("{} in {} ({whence})", ros.distro, prefix.display()),
        None if ros.prefixes.is_empty() => "none sourced".to_string(),
        None => format!("{}, but rcl is in none of {} ({whence})", ros.distro, list(&ros.prefixes)),
    };
    let built = env!("EGOTAC_BUILD_ROS_DISTRO");
    if cfg!(not(feature = "ros")) {
        Row::not_needed(NAME, "ros", found)
    } else if prefix.is_none() {
        Row::missing(NAME, found, SET_UP)
    } else if ros.distro != built {
        Row::missing(NAME, format!("{found}; this build is for {built}"), "source the other one, or build again")
    } else {
        Row::ok(NAME, found)
    }
}

fn middleware(ros: &Ros) -> Row {
    const NAME: &str = "rmw";
    let chosen = std::env::var("RMW_IMPLEMENTATION").ok().filter(|name| !name.is_empty());
    let by_default = if chosen.is_some() { "" } else { ", the default" };
    let name = chosen.unwrap_or_else(|| "rmw_fastrtps_cpp".to_string());
    let library = format!("lib/lib{name}.so");
    match ros.prefix_of(&library) {
        _ if cfg!(not(feature = "ros")) => Row::not_needed(NAME, "ros", format!("{name}{by_default}")),
        Some(prefix) => Row::ok(NAME, format!("{name}{by_default}: {}", prefix.join(&library).display())),
        None => Row::missing(
            NAME,
            format!("{name}{by_default}, but there is no {library} in {}", list(&ros.prefixes)),
            format!(
                "`unset RMW_IMPLEMENTATION`, or with an installed ROS 2 `apt-get install ros-{}-{}`",
                ros.distro,
                name.replace('_', "-")
            ),
        ),
    }
}

#[cfg(not(feature = "ros"))]
fn messages(ros: &Ros) -> Row {
    let found = match ros.prefix_of("share/egotac_msgs") {
        Some(prefix) => format!("egotac_msgs in {}", prefix.display()),
        None => "egotac_msgs is not in AMENT_PREFIX_PATH".to_string(),
    };
    Row::not_needed("messages", "ros", found)
}

/// Whether egotac_msgs is there, and is what r2r's bindings in this program were made from.
#[cfg(feature = "ros")]
fn messages(ros: &Ros) -> Row {
    use super::idl_hash::{idl_files, idl_hash};

    const NAME: &str = "messages";
    let Some(prefix) = ros.prefix_of("share/egotac_msgs") else {
        return Row::missing(NAME, format!("egotac_msgs is in none of {}", list(&ros.prefixes)), SET_UP);
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
        let note = "built without the layout's mark in IDL_PACKAGE_FILTER, so bindings can go stale unnoticed";
        Row::ok(NAME, format!("{place}, {note}"))
    } else {
        Row::missing(NAME, format!("{place}, bindings are stale (layout {found}, built for {built})"), SET_UP)
    }
}

#[cfg(not(feature = "sim"))]
fn engine() -> Row {
    let dir = std::env::var("MUJOCO_DYNAMIC_LINK_DIR").unwrap_or_default();
    let library = Path::new(&dir).join("libmujoco.so");
    let found = match library.exists() {
        true => library.display().to_string(),
        false => "MUJOCO_DYNAMIC_LINK_DIR names no folder with libmujoco.so".to_string(),
    };
    Row::not_needed("MuJoCo", "sim", found)
}

#[cfg(feature = "sim")]
fn engine() -> Row {
    // The version that mujoco-rs's structs were written for.
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

#[cfg(not(feature = "sim"))]
fn renderer() -> Row {
    Row::not_needed("GL renderer", "sim", "not looked for")
}

#[cfg(feature = "sim")]
fn renderer() -> Row {
    const FIX: &str = "`apt-get install libegl1 libegl-mesa0 libgl1-mesa-dri` (as root), or a GPU driver with EGL";
    match super::gl::renderer() {
        Ok(name) => Row::ok("GL renderer", name),
        Err(error) => Row::missing("GL renderer", format!("{error:#}"), FIX),
    }
}

fn gpu() -> Row {
    const NAME: &str = "GPU";
    let query = ["--query-gpu=name,driver_version", "--format=csv,noheader"];
    let card = first_line("nvidia-smi", &query);
    let found = card.unwrap_or_else(|| "no NVIDIA GPU found".to_string());
    if cfg!(not(feature = "cuda")) {
        return Row::not_needed(NAME, "cuda", found);
    }
    match candle_core::Device::new_cuda(0) {
        Ok(_) => Row::ok(NAME, found),
        Err(error) => Row::missing(
            NAME,
            format!("{found}; {}", error.to_string().lines().next().unwrap_or_default()),
            "install an NVIDIA driver, or build without the feature `cuda`",
        ),
    }
}

/// What reads videos.
fn ffmpeg() -> Row {
    const NAME: &str = "ffmpeg";
    match (first_line("ffmpeg", &["-version"]), first_line("ffprobe", &["-version"])) {
        (Some(found), Some(_)) => Row::ok(NAME, found.split(" Copyright").next().unwrap_or_default()),
        _ => Row::missing(NAME, "not found; videos can't be read", "`apt-get install ffmpeg` (as root)"),
    }
}

/// The hand model: loaded and posed for real.
fn hand(model: &str) -> Row {
    const NAME: &str = "hand";
    let loaded = match model {
        "builtin" => Ok(HandModel::builtin(Side::Right)),
        path => HandModel::load(Path::new(path), Side::Right),
    };
    let fix = "give --hand builtin, or a MANO file from https://mano.is.tue.mpg.de";
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

/// The checkpoint that a predictor takes when it is given none: loaded for real.
fn checkpoint() -> Row {
    const NAME: &str = "checkpoint";
    const FIX: &str = "`git checkout models`, or give programs one of your own";
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

/// The first line that a program prints, if it runs and succeeds.
fn first_line(program: &str, arguments: &[&str]) -> Option<String> {
    let output = Command::new(program).args(arguments).output().ok().filter(|output| output.status.success())?;
    let text = String::from_utf8_lossy(&output.stdout);
    text.lines().next().map(|line| line.trim().to_string()).filter(|line| !line.is_empty())
}

fn list(paths: &[PathBuf]) -> String {
    match paths {
        [] => "no prefix (AMENT_PREFIX_PATH is not set)".to_string(),
        _ => paths.iter().map(|path| path.display().to_string()).collect::<Vec<_>>().join(", "),
    }
}
