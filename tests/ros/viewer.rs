//! `egotac view` on topics, beside the real nodes.

use std::process::Command;

use egotac::model::Config;

use crate::harness::Session;
use crate::view_client::Page;

#[test]
fn topics_are_shown_with_the_predictors_touch_the_truth_and_the_poses_of_their_stamp() {
    let session = Session::new();
    let model = format!("model:={}", session.checkpoint(&Config::toy()).display());
    let simulator = ["-p", "scenes:=[pinch_cube]", "-p", "wait_secs:=60.0", "-p", "wait_listeners:=2"];
    let _simulator = session.node(env!("CARGO_BIN_EXE_egotac_simulator"), &simulator);
    let _predictor = session.node(env!("CARGO_BIN_EXE_egotac_predictor"), &["-p", &model, "-r", "image:=image_raw"]);
    let topic = |name: &str| format!("{}/{name}", session.namespace());
    let mut command = Command::new(env!("CARGO_BIN_EXE_egotac"));
    command.args(["view", &topic("image_raw"), "--labels-only", "--listen", "127.0.0.1:0"]);
    command.args(["--tactile", &topic("predictor/tactile"), "--truth", &topic("truth/tactile")]);
    command.args(["--hand-pose", &topic("truth/hand_pose")]);
    let mut view = session.spawn(command, "view");
    view.prints("http://");
    let output = view.output();
    let address = output.lines().find_map(|line| line.strip_prefix("http://")?.strip_suffix('/')).unwrap();
    let mut page = Page::open(address, None).unwrap();
    let (mut last, mut with_truth, mut posed) = (0, 0, 0);
    for _ in 0..20 {
        let answer = page.ask(&format!("{{\"source\": 0, \"after\": {last}}}"));
        let sequence = answer.head["sequence"].as_u64().unwrap_or_else(|| panic!("{}", answer.head));
        assert!(sequence > last && !answer.jpeg.is_empty());
        last = sequence;
        // The toy network knows no unfamiliar image: its touch is known, and never negative.
        let force = &answer.arrays["force"];
        assert!(force.len() == 1556 && force.iter().all(|force| *force >= 0.0), "{}", answer.head);
        let sum: f64 = force[778..].iter().map(|force| f64::from(*force)).sum();
        assert!((sum - answer.head["total"][1].as_f64().unwrap()).abs() < 1e-3 * sum.max(1.0));
        with_truth += usize::from(answer.arrays.contains_key("truth"));
        posed += usize::from(["left_posed", "right_posed"].iter().any(|name| answer.arrays.contains_key(*name)));
    }
    // The first images may come before the other topics are connected.
    assert!(with_truth >= 10 && posed >= 10, "{with_truth} with truth, {posed} with poses");
}
