//! Page about the keys of a robot's YAML file.

use super::keys::Types;
use super::table::Form;
use crate::retarget::robot::spec::RobotSpec;

/// Source of the types of a robot's file; their doc comments describe the keys.
const SOURCE: &str = include_str!("../../retarget/robot/spec.rs");
/// A robot with all of its optional parts, in which each part has the keys that it must have.
const WHOLE: &str = "
robot: mine
model: { mjcf: mine.xml }
wrist: { body: palm }
fingers: { index: { tip: { body: index_tip } } }
couplings: [{ joint: index_2, of: index_1, ratio: 1.0 }]
";

/// Returns the page.
///
/// # Errors
/// If a default can't be written as YAML.
pub(super) fn page() -> anyhow::Result<String> {
    let mut page = String::from(
        "# Keys of a robot hand\n\nWritten by `scripts/reference` from the types. `egotac retarget new MODEL --out FILE` writes a file with the \
         values that egotac derives from a model; `egotac retarget inspect FILE` prints and draws what a file means. `FINGER` stands for a human \
         finger (`thumb`, `index`, `middle`, `ring`, `little`), `[]` for each entry of a list; *none* means that the key is left out. [How to use \
         your own robot hand](../howto/robot.md) has the steps.\n\n",
    );
    Form::of::<RobotSpec>(WHOLE, "FINGER")?.write(&Types::read(&[SOURCE]).keys("RobotSpec"), &mut page)?;
    Ok(page)
}

#[cfg(test)]
mod tests {
    use std::fs;

    use serde_yaml::Value;

    use super::super::used;
    use super::*;

    #[test]
    fn each_key_of_the_shipped_robots_stands_on_the_page_with_a_meaning() {
        let page = page().unwrap();
        let files = fs::read_dir(concat!(env!("CARGO_MANIFEST_DIR"), "/sim/robots")).unwrap();
        let paths = files.map(|entry| entry.unwrap().path());
        let yaml = paths.filter(|path| path.extension().is_some_and(|extension| extension == "yaml"));
        let used = used::keys(yaml.map(|path| fs::read_to_string(path).unwrap()), &|name, value| match value {
            Value::Sequence(_) => None,
            Value::Mapping(fingers) if name == "fingers" => {
                Some(fingers.values().map(|finger| (finger, "fingers.FINGER.".into())).collect())
            }
            // Names of fingers and joints.
            _ => ["merge", "scale", "fixed_joints", "neutral"].contains(&name).then(Vec::new),
        });
        assert!(used.len() > 10, "{used:?}");
        used::assert_explained(&page, &used);
    }

    #[test]
    fn defaults_are_those_of_the_types() {
        let page = page().unwrap();
        for row in [
            "| `robot` | required |",
            "| `side` | none |",
            "| `wrist.frame` | `\"auto\"` |",
            "| `fingers.FINGER.tip` | required |",
            "| `couplings` | `\"auto\"` |",
            "| `couplings[].ratio` | required |",
            "| `couplings[].offset` | `0.0` |",
            "| `weights` | as below |",
            "| `weights.pinch` | `1000.0` |",
            "| `contact.max_force` | none |",
        ] {
            assert!(page.lines().any(|line| line.starts_with(row)), "{row} in {page}");
        }
    }
}
