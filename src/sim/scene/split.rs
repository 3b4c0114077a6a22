//! Splits: named sets of shipped scenes, with another camera, look or shapes where the split has them.

use std::collections::BTreeMap;

use serde::Deserialize;
use serde_yaml::{Mapping, Value};

use super::shipped::SHIPPED;
use crate::error::{Error, Result};
use crate::text::parse_yaml;

/// Splits that are part of the program, YAML.
const SPLITS: &str = include_str!("../../../sim/splits.yaml");
/// Sign between the name of a split and that of a scene.
const SEPARATOR: char = '/';

/// Set of shipped scenes, and what replaces parts of them.
///
/// ```
/// use egotac::sim::{Scene, scene::Split};
///
/// # fn main() -> egotac::Result<()> {
/// let held_out = Split::named("ood")?;
/// for name in held_out.scene_names("ood") {
///     println!("{}", Scene::load(&name)?.spec.description);
/// }
/// # Ok(())
/// # }
/// ```
#[derive(Debug, Clone, PartialEq, Default, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Split {
    /// Names of the shipped scenes.
    pub scenes: Vec<String>,
    /// Camera instead of the scenes', as in a scene file.
    pub camera: Option<Value>,
    /// Look instead of the scenes', as in a scene file.
    pub look: Option<Value>,
    /// Frames per second instead of the scenes'.
    pub rate: Option<f64>,
    /// Shapes by scene and object, as in a scene file.
    pub shapes: BTreeMap<String, BTreeMap<String, Value>>,
}

impl Split {
    /// Returns a split of the program: `train` or `ood`.
    ///
    /// # Errors
    /// If there is none of this name; the error lists the names.
    pub fn named(name: &str) -> Result<Self> {
        let mut splits = Self::shipped()?;
        match splits.remove(name) {
            Some(split) => Ok(split),
            None => Err(Error::unknown("split", name, splits.keys().map(String::as_str))),
        }
    }

    /// Parses splits by name from YAML, and checks that each changed scene still is one; `place` stands in errors.
    ///
    /// # Errors
    /// If the text is not such a list, or names a scene or object that does not exist.
    pub fn parse(place: &str, text: &str) -> Result<BTreeMap<String, Self>> {
        let splits: BTreeMap<String, Self> = parse_yaml(text).map_err(|e| Error::file(place, e))?;
        for (name, split) in &splits {
            split.check().map_err(|e| Error::file(place, format!("{name}: {e}")))?;
        }
        Ok(splits)
    }

    /// Returns the names by which [`Scene::load`](super::Scene::load) finds the scenes of this split, whose name is `split`.
    pub fn scene_names(&self, split: &str) -> Vec<String> {
        let name = |scene: &String| if self.is_plain() { scene.clone() } else { format!("{split}{SEPARATOR}{scene}") };
        self.scenes.iter().map(name).collect()
    }

    /// Returns the YAML text of a shipped scene with the split's camera, look, rate and shapes.
    ///
    /// # Errors
    /// If the split has a shape for an object that the scene lacks, or there is no such scene.
    pub fn text(&self, scene: &str) -> Result<String> {
        let Some((_, text)) = SHIPPED.iter().find(|(name, _)| *name == scene) else {
            return Err(Error::unknown("scene", scene, SHIPPED.iter().map(|(name, _)| *name)));
        };
        let mut tree: Mapping = parse_yaml(text).map_err(|e| Error::file(scene, e))?;
        let parts =
            [("camera", self.camera.clone()), ("look", self.look.clone()), ("rate", self.rate.map(Value::from))];
        for (key, value) in parts {
            value.into_iter().for_each(|value| drop(tree.insert(key.into(), value)));
        }
        for (object, shape) in self.shapes.get(scene).into_iter().flatten() {
            let objects = tree.get_mut("objects").and_then(Value::as_sequence_mut).into_iter().flatten();
            let mut named = objects.filter(|other| other.get("name").and_then(Value::as_str) == Some(object));
            match named.next().and_then(Value::as_mapping_mut) {
                Some(found) => drop(found.insert("shape".into(), shape.clone())),
                None => return Err(Error::value(format!("shapes.{scene}"), "an object of the scene", object)),
            }
        }
        serde_yaml::to_string(&tree).map_err(|e| Error::file(scene, e))
    }

    /// Returns the text of a scene that a name of the form `SPLIT/SCENE` means; `None` for other names.
    ///
    /// # Errors
    /// If the split does not contain the scene.
    pub(super) fn resolve(name: &str) -> Result<Option<String>> {
        let Some((split, scene)) = name.split_once(SEPARATOR) else { return Ok(None) };
        let Some(split) = Self::shipped()?.remove(split) else { return Ok(None) };
        match split.scenes.iter().any(|own| own == scene) {
            true => split.text(scene).map(Some),
            false => Err(Error::unknown("scene of the split", scene, split.scenes.iter().map(String::as_str))),
        }
    }

    fn shipped() -> Result<BTreeMap<String, Self>> {
        parse_yaml(SPLITS).map_err(|e| Error::file("sim/splits.yaml", e))
    }

    /// True if the scenes are the shipped ones as they are.
    fn is_plain(&self) -> bool {
        self.camera.is_none() && self.look.is_none() && self.rate.is_none() && self.shapes.is_empty()
    }

    fn check(&self) -> Result<()> {
        if self.scenes.is_empty() {
            return Err(Error::value("scenes", "at least one", "none"));
        }
        if let Some(other) = self.shapes.keys().find(|scene| !self.scenes.contains(scene)) {
            return Err(Error::unknown("shapes of scene", other, self.scenes.iter().map(String::as_str)));
        }
        for scene in &self.scenes {
            super::Scene::parse(scene, scene.as_ref(), &self.text(scene)?)?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;
    use crate::sim::scene::Scene;

    #[test]
    fn the_two_splits_share_no_scene_and_together_are_all() {
        let splits = Split::parse("splits.yaml", SPLITS).unwrap();
        let scenes = |name: &str| splits[name].scenes.iter().map(String::as_str).collect::<BTreeSet<_>>();
        let (train, ood) = (scenes("train"), scenes("ood"));
        assert!(train.is_disjoint(&ood) && ood.len() >= 5);
        let all: BTreeSet<&str> = SHIPPED.iter().map(|(name, _)| *name).collect();
        assert_eq!(train.union(&ood).copied().collect::<BTreeSet<_>>(), all);
    }

    #[test]
    fn held_out_scenes_have_another_camera_look_and_shapes_than_the_shipped_ones() {
        for name in Split::named("ood").unwrap().scene_names("ood") {
            let held_out = Scene::load(&name).unwrap();
            let shipped = Scene::load(name.split_once('/').unwrap().1).unwrap();
            assert_eq!(held_out.name, name);
            assert_ne!(held_out.spec.camera, shipped.spec.camera);
            assert_ne!(held_out.spec.look, shipped.spec.look);
            assert_ne!(held_out.spec.objects[0].shape, shipped.spec.objects[0].shape);
            assert_eq!(held_out.spec.hands, shipped.spec.hands, "the acts stay the same");
        }
        let train = Split::named("train").unwrap();
        assert_eq!(train.scene_names("train"), train.scenes);
    }

    #[test]
    fn a_split_that_names_what_is_not_there_is_refused() {
        let error = |text: &str| Split::parse("own.yaml", text).unwrap_err().to_string();
        assert!(error("{a: {scenes: [pinch_cub]}}").contains("pinch_cube"));
        assert!(error("{a: {scenes: [poke], cameras: {}}}").contains("cameras"));
        assert!(error("{a: {scenes: [poke], camera: {fovy: 400}}}").contains("fovy"));
        assert!(error("{a: {scenes: [poke], shapes: {poke: {ghost: {cube: {size: 0.03}}}}}}").contains("ghost"));
        assert!(error("{a: {scenes: [poke], shapes: {tripod: {}}}}").contains("tripod"));
        assert!(error("{a: {scenes: []}}").contains("at least one"));
        assert!(Split::named("test").unwrap_err().to_string().contains("ood, train"));
        assert!(Scene::load("ood/pinch_cube").unwrap_err().to_string().contains("wipe_table"));
    }
}
