//! Page about the keys of a glove's layout and of a taxel map.

use super::keys::Types;
use super::table::Form;
use crate::hand::JOINT_NAMES;
use crate::sensor::{KEYPOINT_NAMES, Layout};
use crate::text::put;

/// Sources of the types of a layout and of a map; their doc comments describe the keys.
const SOURCES: [&str; 2] = [include_str!("../../sensor/layout.rs"), include_str!("../../sensor/file.rs")];
/// A layout with all of its parts, in which each part has the keys that it must have.
const WHOLE: &str = "
name: mine
title: A pad on the palm
placement: exact
source: ruler
unit: N
channels: 12
pads:
- name: palm
  from: wrist
  to: middle_base
  corners: [[0.9, 0.3], [0.9, -0.3], [0.4, -0.3], [0.4, 0.3]]
  grid: [4, 3]
  links: [wrist]
";

/// Returns the page.
///
/// # Errors
/// If a default can't be written as YAML.
pub(super) fn page() -> anyhow::Result<String> {
    let mut page = String::from(
        "# Keys of a glove\n\nWritten by `scripts/reference` from the types. [How to use your own glove](../howto/glove.md) has an example, and \
         [gloves.md](../gloves.md#a-map-of-your-own) explains it. `[]` stands for each entry of a list; *none* means that the key is left \
         out.\n\n## Layout\n\nA layout outlines pads on the right hand at rest; the left hand is its mirror image. Corners of a pad are (u, v) in the plane \
         that the pad faces: u is 0 at the keypoint `from` and 1 at the keypoint `to`; v points to the thumb's side, and its unit is the distance \
         between the bases of index and little finger.\n\n",
    );
    let types = Types::read(&SOURCES);
    Form::of::<Layout>(WHOLE, "NAME")?.write(&types.keys("Layout"), &mut page)?;
    for (what, names) in [("Keypoints", &KEYPOINT_NAMES[..]), ("Links", &JOINT_NAMES[..])] {
        let names: Vec<String> = names.iter().map(|name| format!("`{name}`")).collect();
        put(&mut page, format_args!("\n{what}: {}.", names.join(", ")));
    }
    page += "\n## Taxel map\n\n`egotac sensor new LAYOUT --out MAP.yaml` writes a map with these keys, and its weights beside it.\n\n\
             | key | meaning |\n|---|---|\n";
    for key in types.keys("Written") {
        put(&mut page, format_args!("| `{}` | {} |", key.name, key.text));
    }
    Ok(page)
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::super::used;
    use super::*;
    use crate::sensor::{map_path, shipped_names};

    #[test]
    fn each_key_of_the_shipped_maps_stands_on_the_page_with_a_meaning() {
        let page = page().unwrap();
        let texts = shipped_names().into_iter().map(|name| fs::read_to_string(map_path(&name).unwrap()).unwrap());
        // The keys of a map's layout are those of a layout.
        let used = used::keys(texts, &|_, value| (!value.is_sequence()).then(|| vec![(value, String::new())]));
        assert!(used.contains("weights_sha256") && used.contains("pads[].corners"), "{used:?}");
        used::assert_explained(&page, &used);
    }

    #[test]
    fn choices_have_the_names_of_files() {
        let page = page().unwrap();
        assert!(
            page.contains("| `placement` | required |") && page.contains("One of `exact`, `drawn by us`."),
            "{page}"
        );
        assert!(page.contains("| `pads[].first` | none |") && page.contains("`middle_base`"), "{page}");
    }
}
