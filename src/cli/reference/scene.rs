//! Page about the keys of a scene file.

use super::keys::Types;
use super::table::Form;
use crate::sim::scene::SceneSpec;
use crate::text::put;

/// Sources of the types of a scene; their doc comments describe the keys.
const SOURCES: [&str; 7] = [
    include_str!("../../sim/scene/spec.rs"),
    include_str!("../../sim/scene/object.rs"),
    include_str!("../../sim/scene/act.rs"),
    include_str!("../../sim/scene/look.rs"),
    include_str!("../../sim/effect.rs"),
    include_str!("../../mujoco/options.rs"),
    include_str!("../../sensor/simulated.rs"),
];
/// A scene with all of its optional parts, in which each part has the keys that it must have.
const WHOLE: &str = "
description: Press a cube.
glove: { sensor: opentouch_169 }
objects:
  - { name: cube, shape: { cube: { size: 0.05 } }, mass: 0.1, friction: 0.8, position: [0, 0] }
hands:
  - act:
      object: cube
      fingers: [1, 0, 0]
      palm: [0, 0, -1]
      from: [0, 0, 1]
      contacts: { index: { at: [0, 0, 1] } }
      wrap: { fingers: [thumb], torque: 0.1 }
      start: {}
      script: [{ phase: rest, seconds: 1 }]
";

/// Returns the page.
///
/// # Errors
/// If a default can't be written as YAML.
pub(super) fn page() -> anyhow::Result<String> {
    let mut page = String::from(
        "# Keys of a scene\n\nWritten by `scripts/reference` from the types. A number can be a value (`0.3`) or a range (`[0.2, 0.4]`), from \
         which each seed draws. `[]` stands for each entry of a list, `SITE` for a part of a hand. A default is that of a key whose part is \
         given; *none* means that the part or value is left out. [How to write a scene](../howto/scene.md) has an example, and \
         [sim/README.md](../../sim/README.md#writing-a-scene) tells how the keys work together.\n\n",
    );
    let keys = Types::read(&SOURCES).keys("SceneSpec");
    let shapes = Form::of::<SceneSpec>(WHOLE, "SITE")?.write(&keys, &mut page)?;
    page.push_str("\n## Shapes\n\nEach object has one of these, with all of its keys. Lengths are in metres.\n\n| key | meaning |\n|---|---|\n");
    for shape in shapes {
        put(&mut page, format_args!("| `shape.{}` | {} |", shape.name, shape.text));
        for key in &shape.below {
            put(&mut page, format_args!("| `shape.{}.{}` | {} |", shape.name, key.name, key.text));
        }
    }
    Ok(page)
}

#[cfg(test)]
mod tests {
    use serde_yaml::Value;

    use super::super::used;
    use super::*;
    use crate::sim::scene::SHIPPED;

    #[test]
    fn each_key_of_the_shipped_scenes_stands_on_the_page_with_a_meaning() {
        let page = page().unwrap();
        let used = used::keys(SHIPPED.map(|(_, text)| text.to_owned()), &|name, value| match value {
            Value::Mapping(sites) if name.ends_with(".contacts") => {
                Some(sites.values().map(|entry| (entry, format!("{name}.SITE."))).collect())
            }
            Value::Mapping(shape) if name.ends_with("[].shape") => {
                Some(shape.iter().map(|(form, keys)| (keys, format!("shape.{}.", form.as_str().unwrap()))).collect())
            }
            _ => None,
        });
        assert!(used.len() > 50, "{used:?}");
        used::assert_explained(&page, &used);
    }

    #[test]
    fn a_scene_reads_back_as_written() {
        for (name, text) in SHIPPED {
            let scene: SceneSpec = serde_yaml::from_str(text).unwrap();
            let written = serde_yaml::to_string(&scene).unwrap();
            assert_eq!(serde_yaml::from_str::<SceneSpec>(&written).unwrap(), scene, "{name}");
        }
    }

    #[test]
    fn keys_without_a_default_are_required_and_the_others_have_that_of_the_type() {
        let page = page().unwrap();
        for row in [
            "| `description` | required |",
            "| `rate` | `25.0` |",
            "| `effects` | `\"auto\"` |",
            "| `objects[].mass` | required |",
            "| `objects[].solid` | `true` |",
            "| `hands[].act` | none |",
            "| `hands[].act.curl` | `[0.3,0.6]` |",
            "| `hands[].act.contacts.SITE.share` | `0.0` |",
            "| `physics.timestep` | `0.002` |",
            "| `look.lamps` | `1.0` |",
            "| `glove.noise` | `0.0` |",
            "| `shape.mug.wall` |",
        ] {
            assert!(page.lines().any(|line| line.starts_with(row)), "{row} in {page}");
        }
    }
}
