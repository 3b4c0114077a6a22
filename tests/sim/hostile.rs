//! Scenes, meshes and numbers made to hang or fill the memory, and runs that are killed or started twice.

use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use egotac::dataset::EpisodeReader;
use egotac::dataset::zarr::ZarrReader;
use egotac::sim::SHIPPED;

/// Guard against hangs.
const HANG: Duration = Duration::from_secs(120);

fn start(arguments: &[&str]) -> Child {
    let mut command = Command::new(env!("CARGO_BIN_EXE_egotac"));
    command.args(arguments).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap()
}

/// Waits until `is_so`, at most for the guard time.
fn wait_until(what: &str, mut is_so: impl FnMut() -> bool) {
    let deadline = Instant::now() + HANG;
    while !is_so() {
        assert!(Instant::now() < deadline, "{what}");
        std::thread::sleep(Duration::from_millis(2));
    }
}

/// Returns the clean error of a command.
fn refused(arguments: &[&str]) -> String {
    let mut child = start(arguments);
    wait_until("hangs", || child.try_wait().unwrap().is_some());
    let output = child.wait_with_output().unwrap();
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(1), "{arguments:?}: {:?}, {said}", output.status);
    assert!(said.starts_with("egotac: ") && !said.contains("panicked"), "{said}");
    said
}

/// Writes the scene `hover` with the object of a mesh file.
fn scene_with_mesh(folder: &Path, mesh: &str) -> PathBuf {
    let scene = SHIPPED.iter().find(|(name, _)| *name == "hover").unwrap().1;
    let start = scene.find("    shape:").unwrap();
    let end = start + scene[start..].find('\n').unwrap();
    let shape = format!("    shape: {{ mesh: {{ file: {mesh}, scale: 0.001 }} }}");
    let path = folder.join(format!("{mesh}.yaml"));
    std::fs::write(&path, format!("{}{shape}{}", &scene[..start], &scene[end..])).unwrap();
    path
}

#[test]
fn mesh_files_with_false_counts_and_special_files_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let mut stl = vec![0u8; 80];
    stl.extend(u32::MAX.to_le_bytes());
    stl.extend([0; 200]);
    std::fs::write(at("count.stl"), stl).unwrap();
    std::fs::write(at("short.stl"), b"1234").unwrap();
    std::fs::write(at("index.obj"), "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 4000000000\nf 1 2 -99999\n").unwrap();
    std::fs::write(at("huge.obj"), format!("v 1e300 1e300 1e300\nf {}\n", "1 ".repeat(1_000_000))).unwrap();
    std::fs::File::create(at("sparse.obj")).unwrap().set_len(1 << 40).unwrap();
    std::os::unix::fs::symlink("/dev/zero", at("zero.stl")).unwrap();
    assert!(Command::new("mkfifo").arg(at("pipe.obj")).status().unwrap().success());
    for (mesh, expected) in [
        ("count.stl", "expected 4294967295 triangles"),
        ("short.stl", "got 4 bytes"),
        ("index.obj", ""),
        ("huge.obj", ""),
        ("sparse.obj", "raises the limit"),
        ("zero.stl", "got a device"),
        ("pipe.obj", "got a pipe"),
    ] {
        let scene = scene_with_mesh(folder.path(), mesh);
        let out = at("out").display().to_string();
        for command in ["run", "show"] {
            let error = refused(&["sim", command, scene.to_str().unwrap(), "--out", &out]);
            assert!(error.contains(mesh) && error.contains(expected), "{error}");
        }
    }
}

#[test]
fn absurd_numbers_are_refused_before_the_first_episode() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out").display().to_string();
    let scene = SHIPPED.iter().find(|(name, _)| *name == "pinch_cube").unwrap().1;
    let write = |name: &str, text: String| {
        let path = folder.path().join(name);
        std::fs::write(&path, text).unwrap();
        path.display().to_string()
    };
    let rate = write("rate.yaml", scene.replacen("hands:", "rate: 500000\nphysics: { timestep: 0.000001 }\nhands:", 1));
    let objects = "{ name: a, shape: { cube: { size: 1 } }, mass: 1, friction: 1, position: [0, 0] },".repeat(100_000);
    let objects = write("objects.yaml", format!("description: d\nobjects: [{objects}]\nhands: [{{ side: right }}]\n"));
    let deep = write("deep.yaml", format!("description: {}", "[".repeat(1_000_000)));
    let big = u64::MAX.to_string();
    for (arguments, expected) in [
        (vec!["run", &rate], "rate"),
        (vec!["run", &objects], "objects: expected at most 100, got 100000"),
        (vec!["run", &deep], "deep.yaml"),
        (vec!["run", "/dev/zero"], "got a device"),
        (vec!["generate", "hover", "--episodes", &big], "episodes: expected 1 to 1000000"),
        (vec!["generate", "hover", "--jobs", "1000000"], "jobs: expected 1 to 1024"),
        (vec!["generate", "hover", "--seed", &big], "seed: expected at most"),
        (vec!["show", "hover", "--sheet", "100", "--size", "1024"], "EGOTAC_LIMIT_IMAGE_PIXELS raises the limit"),
    ] {
        let error = refused(&[&["sim"], arguments.as_slice(), &["--out", &out]].concat());
        assert!(error.contains(expected), "{error}");
        assert_eq!(folder.path().read_dir().unwrap().count(), 3, "{arguments:?} leaves files");
    }
}

fn generate(out: &Path, episodes: &str) -> Child {
    let out = out.to_str().unwrap();
    start(&[
        "sim",
        "generate",
        "pinch_cube",
        "--seed",
        "30",
        "--size",
        "32",
        "--jobs",
        "2",
        "--episodes",
        episodes,
        "--out",
        out,
    ])
}

/// Returns the child processes of a process.
fn children(parent: u32) -> Vec<u32> {
    let tasks = std::fs::read_dir(format!("/proc/{parent}/task")).into_iter().flatten().flatten();
    let lists = tasks.map(|task| std::fs::read_to_string(task.path().join("children")).unwrap_or_default());
    lists.flat_map(|list| list.split_whitespace().filter_map(|pid| pid.parse().ok()).collect::<Vec<_>>()).collect()
}

/// True if a process runs: it exists and is not a zombie.
fn runs(process: u32) -> bool {
    std::fs::read_to_string(format!("/proc/{process}/stat")).is_ok_and(|stat| !stat.contains(") Z "))
}

fn begun(out: &Path) -> bool {
    let unfinished = PathBuf::from(format!("{}.parts/.unfinished", out.display()));
    unfinished.read_dir().is_ok_and(|mut entries| entries.next().is_some())
}

#[test]
fn a_killed_run_takes_its_workers_with_it_and_the_next_run_resumes() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("set");
    for pause in [0, 150, 400] {
        let mut running = generate(&out, "8");
        wait_until("no episode was started", || begun(&out) && !children(running.id()).is_empty());
        std::thread::sleep(Duration::from_millis(pause));
        let workers = children(running.id());
        running.kill().unwrap();
        running.wait().unwrap();
        wait_until("workers outlive their parent", || !workers.iter().any(|worker| runs(*worker)));
    }
    let output = generate(&out, "8").wait_with_output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    assert_eq!(ZarrReader::open(&out).unwrap().episode_ends().len(), 8);
    assert_eq!(folder.path().read_dir().unwrap().count(), 1, "leftovers");
}

#[test]
fn a_second_run_of_the_same_data_set_is_refused_and_the_first_one_finishes() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("set");
    let first = generate(&out, "6");
    wait_until("no episode was started", || begun(&out));
    let second = generate(&out, "6").wait_with_output().unwrap();
    let said = String::from_utf8_lossy(&second.stderr);
    assert!(!second.status.success() && said.contains("set: is being generated by another run"), "{said}");
    let first = first.wait_with_output().unwrap();
    assert!(first.status.success(), "{}", String::from_utf8_lossy(&first.stderr));
    assert_eq!(ZarrReader::open(&out).unwrap().episode_ends().len(), 6);
}

#[test]
fn a_run_killed_between_publication_and_clean_up_is_cleaned_up_by_the_next() {
    let folder = tempfile::tempdir().unwrap();
    let [out, parts, kept] = ["set", "set.parts", "kept"].map(|name| folder.path().join(name));
    // A link to nowhere lets the run fail when it publishes, with all parts recorded.
    std::os::unix::fs::symlink("nowhere/set", &out).unwrap();
    assert!(!generate(&out, "2").wait_with_output().unwrap().status.success());
    std::fs::remove_file(&out).unwrap();
    assert!(Command::new("cp").arg("-r").args([&parts, &kept]).status().unwrap().success());
    assert!(generate(&out, "2").wait_with_output().unwrap().status.success());
    std::fs::rename(&kept, &parts).unwrap();
    let output = generate(&out, "2").wait_with_output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    assert!(!parts.exists() && ZarrReader::open(&out).is_ok());
    // The folder of another data set of the same name stays.
    assert!(!generate(&out, "2").wait_with_output().unwrap().status.success());
}
