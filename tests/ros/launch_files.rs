//! The launch files and the parameter file name only programs, parameters and files that exist.

use std::path::{Path, PathBuf};
use std::process::Command;

use serde_json::Value;

const NODES: [&str; 6] = ["glove", "predictor", "retargeter", "simulator", "trainer", "verifier"];

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

fn stdout(command: &mut Command) -> String {
    let output = command.output().unwrap_or_else(|error| panic!("{command:?}: {error}"));
    assert!(output.status.success(), "{command:?}: {}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).unwrap()
}

/// Describes what a launch file of the source tree starts with these arguments.
fn describe(file: &str, arguments: &[&str]) -> Value {
    describe_in(&root().join("launch"), file, arguments)
}

fn describe_in(folder: &Path, file: &str, arguments: &[&str]) -> Value {
    let python = std::env::var("EGOTAC_PYTHON").expect("source env.sh");
    let mut command = Command::new(python);
    command.arg(root().join("tests/data/launch/describe.py")).arg(folder.join(file)).args(arguments);
    command.env("PYTHONDONTWRITEBYTECODE", "1");
    command.env_remove("FASTRTPS_DEFAULT_PROFILES_FILE").env_remove("FASTDDS_DEFAULT_PROFILES_FILE");
    serde_json::from_str(&stdout(&mut command)).unwrap()
}

/// Returns the parameters that a node describes: name to type, default and range.
fn parameter_table(node: &str) -> Value {
    let program = Path::new(env!("CARGO_BIN_EXE_egotac")).with_file_name(format!("egotac_{node}"));
    serde_json::from_str(&stdout(Command::new(program).arg("--describe-parameters"))).unwrap()
}

/// Checks a value against a node's parameters: name, type, range and choices.
fn check_parameter(node: &str, name: &str, value: &Value) {
    let table = parameter_table(node);
    let entry = table.get(name).unwrap_or_else(|| panic!("{node} has no parameter {name}: {table:#}"));
    let default = &entry["default"];
    let fits = match value {
        Value::Number(number) if default.is_f64() => number.as_f64().is_some(),
        Value::Number(number) => default.is_i64() && number.is_i64(),
        _ => std::mem::discriminant(value) == std::mem::discriminant(default),
    };
    assert!(fits, "{node}: {name} is {value}, but the default is {default}");
    if let (Some(low), Some(high), Some(value)) = (entry["minimum"].as_f64(), entry["maximum"].as_f64(), value.as_f64())
    {
        assert!((low..=high).contains(&value), "{node}: {name} is {value}, outside of {low} to {high}");
    }
    if let Some(choices) = entry["one_of"].as_array() {
        assert!(choices.contains(value), "{node}: {name} is {value}, not one of {choices:?}");
    }
}

fn program_names() -> Vec<String> {
    let metadata =
        stdout(Command::new(env!("CARGO")).args(["metadata", "--no-deps", "--format-version=1"]).current_dir(root()));
    let metadata: Value = serde_json::from_str(&metadata).unwrap();
    let packages = metadata["packages"].as_array().unwrap();
    let package = packages.iter().find(|package| package["name"] == "egotac").unwrap();
    let targets = package["targets"].as_array().unwrap().clone();
    let programs = targets.into_iter().filter(|target| target["kind"][0] == "bin");
    programs.map(|target| target["name"].as_str().unwrap().to_owned()).collect()
}

fn nodes_of(description: &Value) -> Vec<&Value> {
    description["nodes"].as_array().unwrap().iter().filter(|node| node["package"] == "egotac").collect()
}

/// Returns the path in the source tree of a file of the installed package.
fn in_source(installed: &str) -> PathBuf {
    let relative = installed.strip_prefix("<share of egotac>/").unwrap_or_else(|| panic!("{installed}"));
    root().join(relative)
}

#[test]
fn launch_files_start_our_programs_with_valid_parameters() {
    let programs = program_names();
    let given =
        ["use_sim_time:=true", "image_transport:=compressed", "model:=/m.safetensors", "device:=cpu", "rviz:=true"];
    let demo_given = ["scenes:=pinch_cube,lift_mug", "seed:=3", "rviz:=true"];
    let training = ["config:=/run.yaml", "folder:=/data", "notify:=/other/load_model", "use_sim_time:=true"];
    let gloves = ["image_topic:=/camera", "sensor:=opentouch_169", "image_transport:=compressed", "use_sim_time:=true"];
    let retargeting =
        ["robot:=gripper", "side:=left", "rate_hz:=100", "use_sim_time:=1", "demo:=true", "scenes:=lift_mug,hover"];
    let files = [
        ("egotac.launch.py", &given[..]),
        ("demo.launch.py", &demo_given[..]),
        ("retarget.launch.py", &retargeting[..]),
        ("glove.launch.py", &gloves[..]),
        ("trainer.launch.py", &training[..]),
    ];
    for (file, given) in files {
        for arguments in [&[], given] {
            let description = describe(file, arguments);
            for node in nodes_of(&description) {
                let (name, executable) = (node["name"].as_str().unwrap(), node["executable"].as_str().unwrap());
                assert!(programs.iter().any(|program| program == executable), "{executable} is not in {programs:?}");
                assert_eq!(executable, format!("egotac_{name}"));
                for (parameter, value) in node["parameters"].as_object().unwrap() {
                    check_parameter(name, parameter, value);
                }
                for parameter_file in node["parameter_files"].as_array().unwrap() {
                    assert!(in_source(parameter_file.as_str().unwrap()).is_file(), "{parameter_file}");
                }
            }
        }
    }
}

#[test]
fn demo_starts_three_nodes_and_connects_their_topics() {
    let description = describe("demo.launch.py", &["namespace:=left", "model:=/m.safetensors"]);
    let mut started: Vec<_> =
        nodes_of(&description).iter().map(|node| node["name"].as_str().unwrap().to_owned()).collect();
    for include in description["includes"].as_array().unwrap() {
        let file = in_source(include["file"].as_str().unwrap());
        let arguments = include["arguments"].as_object().unwrap();
        let arguments: Vec<_> = arguments.iter().map(|(k, v)| format!("{k}:={}", v.as_str().unwrap())).collect();
        let arguments: Vec<_> = arguments.iter().map(String::as_str).collect();
        let included = describe(file.file_name().unwrap().to_str().unwrap(), &arguments);
        for node in nodes_of(&included) {
            assert_eq!(node["remappings"]["image"], "image_raw");
            assert_eq!(node["namespace"], "left");
            assert_eq!(node["parameters"]["model"], "/m.safetensors");
            started.push(node["name"].as_str().unwrap().to_owned());
        }
    }
    started.sort();
    assert_eq!(started, ["predictor", "simulator", "verifier"]);
    let nodes = nodes_of(&description);
    let verifier = nodes.iter().find(|node| node["name"] == "verifier").unwrap();
    assert_eq!(verifier["remappings"]["tactile"], "predictor/tactile");
    assert_eq!(verifier["remappings"]["truth"], "truth/tactile");
    assert_eq!(verifier["namespace"], "left");
}

#[test]
fn retarget_demo_connects_the_retargeter_to_simulator_and_predictor() {
    let description = describe("retarget.launch.py", &["demo:=true", "namespace:=right"]);
    let nodes = nodes_of(&description);
    let names: Vec<_> = nodes.iter().map(|node| node["name"].as_str().unwrap()).collect();
    assert_eq!(names, ["retargeter", "simulator"]);
    assert!(nodes.iter().all(|node| node["namespace"] == "right"));
    assert_eq!(nodes[0]["remappings"]["hand_pose"], "truth/hand_pose");
    assert_eq!(nodes[0]["remappings"]["tactile"], "predictor/tactile");
    let includes = description["includes"].as_array().unwrap();
    assert!(includes.iter().any(|include| include["file"].as_str().unwrap().ends_with("egotac.launch.py")));
    // Nobody measures the joints of a simulated robot; for a real one the node waits for them.
    assert_eq!(nodes[0]["parameters"]["start"], "rest");
    let real = describe("retarget.launch.py", &["deadman:=true", "joint_states_topic:=/joint_states"]);
    let real = nodes_of(&real)[0];
    assert_eq!((&real["parameters"]["start"], &real["parameters"]["deadman"]), (&Value::Null, &Value::Bool(true)));
    assert_eq!(real["remappings"]["joint_states"], "/joint_states");
    // Without demo:=true the retargeter starts alone.
    let description = describe("retarget.launch.py", &["keypoints_topic:=/tracker/hand"]);
    assert_eq!(description["includes"], serde_json::json!([]));
    assert_eq!(nodes_of(&description).len(), 1);
    assert_eq!(nodes_of(&description)[0]["remappings"]["keypoints"], "/tracker/hand");
}

#[test]
fn an_argument_of_a_launch_file_does_not_reach_an_included_one_by_its_name_alone() {
    let description = describe("retarget.launch.py", &["demo:=true", "model:=/hand.xml", "hand_pose_topic:=/mine"]);
    let retargeter = nodes_of(&description)[0];
    assert_eq!(retargeter["parameters"]["model"], "/hand.xml");
    assert_eq!(retargeter["remappings"]["hand_pose"], "/mine");
    assert_eq!(description["includes"][0]["arguments"]["model"], "", "the predictor takes its own checkpoint");
    // Launch shows an included file all arguments of the one that includes it, so those that both have must be given.
    for (file, arguments) in [
        ("demo.launch.py", &[][..]),
        ("egotac.launch.py", &[]),
        ("realsense_allegro.launch.py", &[]),
        ("retarget.launch.py", &["demo:=true"]),
        ("trainer.launch.py", &[]),
    ] {
        let description = describe(file, arguments);
        for include in description["includes"].as_array().unwrap() {
            let included = in_source(include["file"].as_str().unwrap());
            let included = describe(included.file_name().unwrap().to_str().unwrap(), &[]);
            let of_both = |name: &&String| included["arguments"].get(name.as_str()).is_some();
            for name in description["arguments"].as_object().unwrap().keys().filter(of_both) {
                assert!(include["arguments"].get(name).is_some(), "{file}: {name} leaks into {}", include["file"]);
            }
        }
    }
}

#[test]
fn the_allegro_launch_connects_camera_tracker_predictor_retargeter_and_controllers() {
    let file = "realsense_allegro.launch.py";
    let description = describe(file, &["tracker_python:=/env/bin/python", "forward_controller:=forward"]);
    let nodes: Vec<&Value> = description["nodes"].as_array().unwrap().iter().collect();
    let node = |name: &str| *nodes.iter().find(|node| node["name"] == name).unwrap();
    assert_eq!(nodes.len(), 3);
    let camera = node("camera");
    assert_eq!(camera["package"], "realsense2_camera");
    let tracker = node("hand_tracker");
    assert_eq!(tracker["prefix"], "/env/bin/python");
    let script = root().join("examples").join(tracker["executable"].as_str().unwrap());
    assert!(script.is_file(), "{}", script.display());
    let cmake = std::fs::read_to_string(root().join("launch/CMakeLists.txt")).unwrap();
    assert!(cmake.contains("examples/hand_tracker.py"), "the tracker is not installed");
    let image = &tracker["remappings"]["image"];
    assert_eq!(&camera["remappings"]["~/color/image_raw"], image);
    assert_eq!(camera["remappings"]["~/color/camera_info"], tracker["remappings"]["camera_info"]);
    let include = &description["includes"][0];
    assert!(include["file"].as_str().unwrap().ends_with("egotac.launch.py"));
    assert_eq!(&include["arguments"]["image_topic"], image);

    let retargeter = node("retargeter");
    for (name, value) in retargeter["parameters"].as_object().unwrap() {
        check_parameter("retargeter", name, value);
    }
    assert_eq!(retargeter["parameters"]["robot"], "allegro_right");
    assert_eq!(retargeter["parameters"]["publish_positions"], true);
    let topics = &retargeter["remappings"];
    assert_eq!(topics["keypoints"], "hand_tracker/right/keypoints");
    assert_eq!(topics["~/joint_trajectory"], "/allegro_hand_controller/joint_trajectory");
    assert_eq!(topics["~/position_commands"], "/forward/commands");

    let left = describe(file, &["hand:=left", "robot:=allegro_left", "camera:=false", "namespace:=a"]);
    let left = left["nodes"].as_array().unwrap();
    assert_eq!(left.len(), 2, "no camera");
    assert_eq!(left[1]["remappings"]["keypoints"], "hand_tracker/left/keypoints");
    assert_eq!((&left[1]["parameters"]["publish_positions"], &left[1]["namespace"]), (&false.into(), &"a".into()));
}

#[test]
fn a_launched_node_can_have_another_name() {
    for (file, argument, executable) in [
        ("egotac.launch.py", "name:=eyes", "egotac_predictor"),
        ("retarget.launch.py", "retargeter_name:=eyes", "egotac_retargeter"),
        ("trainer.launch.py", "name:=eyes", "egotac_trainer"),
    ] {
        let description = describe(file, &[argument]);
        let node = nodes_of(&description)[0];
        assert_eq!((&node["name"], &node["executable"]), (&"eyes".into(), &executable.into()), "{file}");
    }
}

#[test]
fn a_launched_trainer_has_a_minute_to_save_its_work() {
    let description = describe("trainer.launch.py", &[]);
    assert_eq!(nodes_of(&description)[0]["timeouts"], serde_json::json!([60.0, 60.0]));
}

#[test]
fn installed_launch_files_find_the_module_that_they_share() {
    // Installs by the patterns of launch/CMakeLists.txt.
    let cmake = std::fs::read_to_string(root().join("launch/CMakeLists.txt")).unwrap();
    let (_, rule) = cmake.split_once("FILES_MATCHING").unwrap();
    let (rule, _) = rule.split_once(')').unwrap();
    let patterns: Vec<&str> =
        rule.split('"').skip(1).step_by(2).map(|pattern| pattern.trim_start_matches('*')).collect();
    let folder = tempfile::tempdir().unwrap();
    for entry in std::fs::read_dir(root().join("launch")).unwrap() {
        let name = entry.unwrap().file_name().into_string().unwrap();
        if patterns.iter().any(|pattern| name.ends_with(pattern)) && name.contains('.') {
            std::fs::copy(root().join("launch").join(&name), folder.path().join(&name)).unwrap();
        }
    }
    for file in [
        "egotac.launch.py",
        "demo.launch.py",
        "glove.launch.py",
        "images.launch.py",
        "realsense_allegro.launch.py",
        "retarget.launch.py",
        "trainer.launch.py",
    ] {
        assert_eq!(describe_in(folder.path(), file, &[]), describe(file, &[]), "{file}");
    }
    for file in ["params.yaml", "fastdds.xml", "egotac.rviz"] {
        assert!(folder.path().join(file).is_file(), "{file} is not installed");
    }
}

#[test]
fn arguments_that_are_not_given_do_not_override_the_parameter_file() {
    let description = describe("egotac.launch.py", &["image_topic:=/camera/image"]);
    let nodes = nodes_of(&description);
    assert_eq!(nodes[0]["parameters"], serde_json::json!({}));
    assert_eq!(nodes[0]["remappings"]["image"], "/camera/image");
    assert_eq!(description["nodes"].as_array().unwrap().len(), 1, "RViz starts only when asked for");
}

#[test]
fn the_package_depends_on_all_packages_whose_messages_are_bound() {
    let read = |name: &str| std::fs::read_to_string(root().join(name)).unwrap();
    let (package, bound) = (read("launch/package.xml"), read("scripts/idl_packages.txt"));
    for name in bound.lines() {
        let is_named =
            package.lines().any(|line| line.contains("<depend") && line.contains(&format!(">{name}</depend>")));
        assert!(is_named, "launch/package.xml lacks <depend>{name}</depend>");
    }
}

#[test]
fn each_argument_has_a_description() {
    let expected = [
        "image_topic",
        "image_transport",
        "params_file",
        "namespace",
        "use_sim_time",
        "model",
        "device",
        "rviz",
        "log_level",
    ];
    let description = describe("egotac.launch.py", &[]);
    for name in expected {
        assert!(description["arguments"].get(name).is_some(), "egotac.launch.py has no argument {name}");
    }
    for file in [
        "egotac.launch.py",
        "demo.launch.py",
        "glove.launch.py",
        "realsense_allegro.launch.py",
        "retarget.launch.py",
        "trainer.launch.py",
    ] {
        for (name, argument) in describe(file, &[])["arguments"].as_object().unwrap() {
            assert!(argument["description"].as_str().is_some_and(|text| text.len() > 10), "{file}: {name}");
        }
    }
}

#[test]
fn images_launch_sets_the_fast_dds_profile_unless_it_is_empty() {
    let description = describe("images.launch.py", &[]);
    for name in ["FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE"] {
        let profile = description["environment"][name].as_str().unwrap();
        assert!(in_source(profile).is_file(), "{profile}");
    }
    let description = describe("images.launch.py", &["fastdds_profile:="]);
    assert_eq!(description["environment"], serde_json::json!({}));
    // Launch files of nodes that take camera images include it.
    for file in ["egotac.launch.py", "trainer.launch.py"] {
        let description = describe(file, &["fastdds_profile:=/mine.xml"]);
        let include = &description["includes"][0];
        assert_eq!(in_source(include["file"].as_str().unwrap()), root().join("launch/images.launch.py"), "{file}");
        assert_eq!(include["arguments"], serde_json::json!({ "fastdds_profile": "/mine.xml" }), "{file}");
    }
}

#[test]
fn the_parameter_file_names_existing_nodes_and_parameters() {
    let text = std::fs::read_to_string(root().join("launch/params.yaml")).unwrap();
    let file: Value = serde_yaml::from_str(&text).unwrap();
    for (node, content) in file.as_object().unwrap() {
        assert!(NODES.contains(&node.as_str()), "{node} is not one of {NODES:?}");
        for (name, value) in content["ros__parameters"].as_object().unwrap() {
            check_parameter(node, name, value);
        }
    }
}
