//! Scenes that a store was simulated from.

use serde_json::{Map, Value};

use super::Scene;
use crate::dataset::zarr::ZarrReader;
use crate::error::{Error, Result};

/// Name of the attribute that describes the episodes.
pub(super) const EPISODES: &str = "episodes";
/// Name of the attribute with the content of each scene, by name.
pub(super) const SCENES: &str = "scenes";

/// Returns the name of the scene and the seed of episode `index` of a store, where it has them.
pub(crate) fn origin(store: &ZarrReader, index: usize) -> (Option<&str>, Option<u64>) {
    let entry = store.raw_attributes().get(EPISODES).and_then(|episodes| episodes.get(index));
    let scene = entry.and_then(|entry| entry.get("scene")).and_then(Value::as_str);
    (scene, entry.and_then(|entry| entry.get("seed")).and_then(Value::as_u64))
}

/// Returns the value of the attribute [`SCENES`].
///
/// # Errors
/// If a scene holds a number that JSON can't.
pub(super) fn attribute(scenes: &[Scene]) -> Result<Value> {
    let entry = |scene: &Scene| {
        let spec =
            serde_json::to_value(&scene.spec).map_err(|e| Error::value(&scene.name, "a scene that JSON holds", e))?;
        Ok((scene.name.clone(), spec))
    };
    Ok(Value::Object(scenes.iter().map(entry).collect::<Result<Map<_, _>>>()?))
}

/// Returns the scene `name` of a store as it was simulated. Stores of earlier versions hold no scenes: theirs are loaded by
/// name.
///
/// # Errors
/// If the stored scene is not valid, or the store holds none and the name is not that of a shipped scene.
pub(crate) fn scene(store: &ZarrReader, name: &str) -> Result<Scene> {
    let Some(stored) = store.raw_attributes().get(SCENES).and_then(|scenes| scenes.get(name)) else {
        return Scene::load(name);
    };
    let invalid =
        |error: &dyn std::fmt::Display| Error::file(store.path(), format!("attribute {SCENES}.{name}: {error}"));
    let spec = serde_json::from_value(stored.clone()).map_err(|error| invalid(&error))?;
    Scene::checked(name, spec).map_err(|error| invalid(&error))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sim::scene::Split;

    #[test]
    fn every_scene_survives_the_way_through_an_attribute() {
        let held_out = Split::named("ood").unwrap().scene_names("ood");
        let names = crate::sim::SHIPPED.iter().map(|(name, _)| name.to_string()).chain(held_out);
        let scenes: Vec<Scene> = names.map(|name| Scene::load(&name).unwrap()).collect();
        let text = attribute(&scenes).unwrap().to_string();
        let stored: Map<String, Value> = serde_json::from_str(&text).unwrap();
        for scene in scenes {
            let spec = serde_json::from_value(stored[&scene.name].clone()).unwrap();
            assert_eq!(Scene::checked(&scene.name, spec).unwrap(), scene);
        }
    }
}
