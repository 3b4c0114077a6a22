//! Help texts: groups of commands, one example for each command, short and long descriptions of options.

use std::fmt::Write;

use clap::{Arg, Command};

/// Groups of the commands in the help of `egotac`.
const GROUPS: [(&str, &[&str]); 7] = [
    ("Simulate", &["sim", "hand", "demo"]),
    ("Predict", &["predict", "view", "model"]),
    ("Label", &["label", "data", "report"]),
    ("Train", &["train", "experiment"]),
    ("Robots and gloves", &["retarget", "sensor"]),
    ("Measure", &["eval", "verify", "bench"]),
    ("This machine", &["doctor", "limits", "completions", "man"]),
];

/// Example of each command, without the program's name.
#[doc(hidden)]
pub const EXAMPLES: [&str; 47] = [
    "doctor",
    "hand forward --params pose.safetensors --out hand.safetensors",
    "hand show --side left --out hand.png",
    "hand build --out hand.safetensors",
    "hand map --mano MANO_RIGHT.pkl --out map.safetensors",
    "sim list",
    "sim show lift_mug --touch --out mug.png",
    "sim explain lift_mug --no-cost",
    "sim run lift_mug --seed 3 --out mug.zarr",
    "sim replay mug.zarr",
    "sim generate pinch_cube lift_mug --episodes 20 --out train.zarr",
    "train --config train.yaml --set steps=200",
    "label mug_dataset --out mug_labelled",
    "report mug_labelled.zarr --out mug.html",
    "view mug_labelled.zarr",
    "predict --data mug.zarr --out fields.safetensors",
    "eval --checkpoint shipped --data mug.zarr --by scene",
    "verify lift_mug --checkpoint shipped --seeds 2 --require f1=0.5",
    "retarget run --robot four_finger --input hand.safetensors --fps 30 --out robot.safetensors",
    "retarget inspect four_finger --out hand.png",
    "retarget new my_hand.xml --out my_hand.yaml",
    "retarget list",
    "retarget demo --robot four_finger",
    "sensor list",
    "sensor show opentouch_169 --out glove.png",
    "sensor new layout.yaml --out my_glove.yaml",
    "sensor convert aether_132 --field readings.zarr --to spread --out forces.zarr",
    "model forward --checkpoint shipped --input images.safetensors --out stages.safetensors",
    "model attention frame.png --out attention.png",
    "model import --checkpoint net.pth --mapping names.yaml --out net.safetensors",
    "model get dinov2-small --accept-licence",
    "model init --encoder dinov2.safetensors --out start.safetensors",
    "model grow --checkpoint run/checkpoint.safetensors --width 192 --out larger.safetensors",
    "model half --checkpoint run/checkpoint.safetensors --out half.safetensors",
    "model familiarity --checkpoint run/checkpoint.safetensors --data train.zarr --out net.safetensors",
    "model presence --checkpoint run/checkpoint.safetensors --data train.zarr --out net.safetensors",
    "model calibrate --checkpoint run/checkpoint.safetensors --data val.zarr --out net.safetensors",
    "model doubt --data mug.zarr",
    "model info --checkpoint shipped",
    "data info mug.zarr",
    "data diff mug_labelled.zarr mug.zarr",
    "data crop train.zarr --out hands.zarr",
    "data import --list",
    "demo --duration 15s",
    "limits",
    "completions bash",
    "man ~/.local/share/man/man1",
];

/// Options that `-h` leaves out and `--help` shows, by their name in the code: what few users need.
const RARE: [&str; 43] = [
    "follow_links",
    // Hands, network, images.
    "mano_left",
    "mano_right",
    "sigma",
    "precision",
    "view",
    "unknown",
    "familiarity_threshold",
    "presence_threshold",
    // Simulation.
    "backgrounds",
    "budget",
    "error",
    "in_process",
    "skip_failed",
    "spacing",
    "tactile_topic",
    "truth_topic",
    // Labels.
    "time_unit",
    "labels_topic",
    "prefix",
    "decoders",
    "keypoints",
    "foxglove",
    "rerun",
    "mass",
    "density",
    "friction",
    "meshes",
    "gravity",
    "bandwidth",
    "refine",
    // Scores.
    "untrained_force",
    "baselines_from",
    "persistence",
    "calibration",
    "calibration_from",
    "calibration_pred",
    "calibration_out",
    "right_hand_only",
    "by_scene",
    // Live view.
    "host",
    "hand_pose",
    "hand_poses",
];

/// Adds the examples to `command` and the commands below it, shortens the descriptions that `-h` shows to their first
/// sentence, and keeps all text for `--help`. `program` stands before each example.
#[doc(hidden)]
pub fn arrange(command: Command, program: &str, examples: &[&str]) -> Command {
    arrange_below(command, &mut Vec::new(), program, examples)
}

fn arrange_below(mut command: Command, path: &mut Vec<String>, program: &str, examples: &[&str]) -> Command {
    let names: Vec<String> = command.get_subcommands().map(|below| below.get_name().to_owned()).collect();
    for name in names {
        path.push(name.clone());
        command = command.mut_subcommand(&name, |below| arrange_below(below, path, program, examples));
        path.pop();
    }
    let is_own = |example: &&&str| {
        let mut words = example.split(' ');
        let is_below = |word: &str| command.find_subcommand(word).is_some();
        !path.is_empty() && path.iter().all(|name| words.next() == Some(name)) && !words.next().is_some_and(is_below)
    };
    if is_runnable(&command)
        && let Some(example) = examples.iter().find(is_own)
    {
        let example = format!("Example: {program} {example}");
        let long = command.get_after_help().map_or(String::new(), |text| format!("{text}\n\n"));
        command = command.after_long_help(format!("{long}{example}")).after_help(example);
    }
    let is_rare = |arg: &Arg| RARE.contains(&arg.get_id().as_str()) && !arg.is_required_set() && !arg.is_positional();
    if !path.is_empty() && is_runnable(&command) && command.get_arguments().any(is_rare) {
        let more = format!("`{program} {} --help` shows all options.", path.join(" "));
        let short = command.get_after_help().map_or(String::new(), |text| format!("\n\n{text}"));
        command = command.after_help(format!("{more}{short}"));
    }
    let command = command.mut_args(|arg| if is_rare(&arg) { arg.hide_short_help(true) } else { arg });
    command.mut_args(|arg| match (arg.get_help().map(ToString::to_string), arg.get_long_help()) {
        (Some(text), None) if first_sentence(&text).len() < text.len() => {
            let short = first_sentence(&text).to_owned();
            arg.help(short).long_help(text)
        }
        _ => arg,
    })
}

/// Returns true if a command runs without the name of a command below it.
pub(super) fn is_runnable(command: &Command) -> bool {
    !command.has_subcommands() || command.is_args_conflicts_with_subcommands_set()
}

/// Returns the runnable commands below `command`, each behind its names in one text. Hidden commands are left out.
#[doc(hidden)]
pub fn runnable(command: &Command) -> Vec<(String, &Command)> {
    let mut found = Vec::new();
    for below in command.get_subcommands().filter(|below| !below.is_hide_set()) {
        let name = below.get_name();
        if is_runnable(below) {
            found.push((name.to_owned(), below));
        }
        found.extend(runnable(below).into_iter().map(|(path, below)| (format!("{name} {path}"), below)));
    }
    found
}

/// Returns the first sentence of a text without its full stop. A sentence ends at a full stop before a capital letter.
fn first_sentence(text: &str) -> &str {
    let ends = text.match_indices(". ").map(|(at, _)| at);
    let mut ends = ends.filter(|at| text[at + 2..].starts_with(char::is_uppercase));
    ends.next().map_or(text, |at| &text[..at])
}

/// Groups the commands of `egotac` in its help.
pub fn group(command: Command) -> Command {
    let (header, literal) = (*command.get_styles().get_header(), *command.get_styles().get_literal());
    let mut text = String::from("{about-with-newline}\n{usage-heading} {usage}\n");
    for (group, names) in GROUPS {
        // Writing to a String cannot fail.
        let _ = write!(text, "\n{header}{group}:{header:#}\n");
        for name in names {
            let about = command.find_subcommand(name).and_then(Command::get_about).map(ToString::to_string);
            let about = about.unwrap_or_default();
            let _ = writeln!(text, "  {literal}{name:<12}{literal:#} {}", first_sentence(&about));
        }
    }
    let _ = write!(text, "\n{header}Options:{header:#}\n{{options}}{{after-help}}");
    let hint = "`egotac COMMAND -h` shows the options of a command and an example; `--help` shows all text.";
    command.help_template(text).after_help(hint)
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use clap::CommandFactory;

    use super::*;
    use crate::cli::Cli;

    #[test]
    fn each_command_stands_in_one_group() {
        let command = Cli::command();
        let shown = command.get_subcommands().filter(|below| !below.is_hide_set()).map(|below| below.get_name());
        let shown: BTreeSet<&str> = shown.collect();
        let grouped: Vec<&str> = GROUPS.iter().flat_map(|(_, names)| names.iter().copied()).collect();
        assert_eq!(grouped.len(), shown.len());
        assert_eq!(grouped.into_iter().collect::<BTreeSet<_>>(), shown);
    }

    #[test]
    fn each_command_has_an_example_that_parses() {
        for (path, _) in own(&Cli::command()) {
            let found = EXAMPLES.iter().find(|example| format!("{example} ").starts_with(&format!("{path} ")));
            let example = found.unwrap_or_else(|| panic!("no example of {path}"));
            let words = std::iter::once("egotac").chain(example.split(' '));
            Cli::command().try_get_matches_from(words).unwrap_or_else(|error| panic!("{example}: {error}"));
        }
    }

    /// Returns the runnable commands, except for those of egotac-bench, whose own tests check them.
    fn own(command: &Command) -> Vec<(String, &Command)> {
        let is_own = |path: &str| !["bench", "experiment"].contains(&path);
        runnable(command).into_iter().filter(|(path, _)| is_own(path)).collect()
    }

    #[test]
    fn each_short_help_fits_on_a_screen_and_long_help_has_every_option() {
        let mut command = arrange(Cli::command(), "egotac", &EXAMPLES).disable_help_subcommand(true);
        command.build();
        for (path, command) in own(&command) {
            let (short, long) =
                (command.clone().render_help().to_string(), command.clone().render_long_help().to_string());
            assert!(short.len() < 2500, "{path} -h has {} bytes:\n{short}", short.len());
            for arg in command.get_arguments().filter(|arg| !arg.is_hide_set()) {
                let Some(name) = arg.get_long() else { continue };
                assert!(long.contains(&format!("--{name}")), "{path} --help leaves out --{name}");
            }
        }
    }

    #[test]
    fn a_command_with_commands_below_it_shows_an_example_of_its_own() {
        let command = Command::new("egotac").subcommand(
            Command::new("try")
                .args_conflicts_with_subcommands(true)
                .arg(Arg::new("name"))
                .subcommand(Command::new("all")),
        );
        let command = arrange(command, "egotac", &["try all --quick", "try one"]);
        let ends: Vec<String> = runnable(&command)
            .into_iter()
            .map(|(path, below)| format!("{path}: {}", below.get_after_help().unwrap()))
            .collect();
        assert_eq!(ends, ["try: Example: egotac try one", "try all: Example: egotac try all --quick"]);
    }

    #[test]
    fn the_short_help_ends_at_the_first_sentence() {
        assert_eq!(first_sentence("Seed, e.g. 3. Next has more"), "Seed, e.g. 3");
        assert_eq!(first_sentence("Size. 0 = original, e.g. 20ms"), "Size. 0 = original, e.g. 20ms");
    }
}
