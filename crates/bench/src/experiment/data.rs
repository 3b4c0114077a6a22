//! Rendered data of the experiments: worlds with training and held-out episodes.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use egotac::error::{Error, Result};
use egotac::sim::scene::Split;
use egotac::train::source::{Supervision, TrainingSource};

use super::Size;
use super::recipe::Recipe;
use super::recording::{Layout, Recorded};

/// Worlds of the experiments, YAML; see the file.
const WORLDS: &str = include_str!("worlds.yaml");
/// Name of the world that no training sees: the split of the same name.
pub const OOD: &str = "ood";
/// Worlds whose contact is labelled by distance, in the order in which experiments add them.
pub const CONTACT_WORLDS: [&str; 3] = ["contact_1", "contact_2", "contact_3"];
/// Shares of a scene's episodes at which a store ends, per cent: the first n stores hold the n-th share.
const SHARES: [usize; 4] = [10, 20, 50, 100];
/// Worlds that are recorded in the layout of a data set.
pub const RECORDED_WORLDS: [&str; 2] = ["recorded_hot3d", "recorded_glove"];
/// Their layouts.
const LAYOUTS: [Layout; 2] = [Layout::Hot3d, Layout::Glove];
/// Folder of the MANO-format files that stand in for MANO's, and their names.
pub const MANO_FOLDER: &str = "mano";
const MANO_FILES: [&str; 2] = ["MANO_LEFT.npz", "MANO_RIGHT.npz"];
/// First seed of training episodes, and of held-out ones.
const SEEDS: [u64; 2] = [70_000, 570_000];
/// Seeds from one repetition to the next, more than a scene has episodes.
pub const REPETITION: u64 = 1000;
/// Frames per second: at the usual 25, most windows would be nearly the same pictures.
pub const RATE: f64 = 10.0;

/// Returns the start of the text whose hash names a store; it differs from repetition to repetition.
fn again(size: &Size) -> String {
    if size.repetition == 0 { String::new() } else { format!("repetition {} ", size.repetition) }
}

/// Stores of one world.
#[derive(Debug, Clone, Default, PartialEq)]
struct World {
    /// Stores of each scene; the first n together hold the n-th share. Empty in worlds that only tests see.
    training: Vec<Vec<Recipe>>,
    held_out: Vec<Recipe>,
}

/// Stores of all worlds. Planning makes none: an experiment renders those that it uses.
#[derive(Debug, Clone, PartialEq)]
pub struct Stores {
    worlds: BTreeMap<String, World>,
    /// Data sets that are recorded in worlds of their own, and imported.
    recorded: Vec<Recorded>,
}

impl Stores {
    /// Plans the stores of an experiment of this size in `folder`.
    ///
    /// # Errors
    /// If the list of worlds does not fit the shipped scenes.
    pub fn plan(folder: &Path, size: &Size) -> Result<Self> {
        Self::with_hands(folder, size, None)
    }

    /// Plans as [`Self::plan`] stores whose hands are those of MANO-format files, and the recordings of the worlds `recorded_*`.
    ///
    /// # Errors
    /// As [`Self::plan`].
    pub fn recorded(folder: &Path, size: &Size) -> Result<Self> {
        let mano = MANO_FILES.map(|name| folder.join(MANO_FOLDER).join(name));
        let mut stores = Self::with_hands(folder, size, Some(mano.clone()))?;
        for (name, layout) in RECORDED_WORLDS.into_iter().zip(LAYOUTS) {
            let from: Vec<Recipe> = stores.world(name)?.training.iter().flatten().cloned().collect();
            let texts: String = from.iter().map(|recipe| format!("{} {}", recipe.episodes, recipe.text)).collect();
            let hash = &egotac::file::sha256(format!("{}{} {texts}", again(size), size.image).as_bytes())[..8];
            let at = |part: &str| folder.join(part).join(format!("{}_{hash}", layout.kind()));
            let (source, path) = (at("recordings"), at("imported"));
            stores.recorded.push(Recorded { layout, source, path, from, mano: mano.clone() });
        }
        Ok(stores)
    }

    fn with_hands(folder: &Path, size: &Size, mano: Option<[PathBuf; 2]>) -> Result<Self> {
        let Size { episodes, held_out, image: side, scenes, repetition, .. } = *size;
        let [first, first_held_out] = SEEDS.map(|seed| seed + REPETITION * repetition);
        let mut splits = Split::parse("worlds.yaml", WORLDS)?;
        splits.insert(OOD.into(), Split { rate: Some(RATE), ..Split::named(OOD)? });
        let mut worlds = BTreeMap::new();
        for (name, split) in &splits {
            let mut world = World::default();
            for scene in split.scenes.iter().take(scenes) {
                let text = split.text(scene)?;
                let file = folder.join("scenes").join(format!("{name}_{scene}.yaml"));
                // A changed scene or another size makes a new store.
                let hands = if mano.is_some() { "mano " } else { "" };
                let hash = &egotac::file::sha256(format!("{}{hands}{side} {text}", again(size)).as_bytes())[..8];
                let recipe = |part: &str, episodes: usize, seed: u64| Recipe {
                    path: folder.join(format!("{name}_{scene}_{part}_{episodes}_{hash}.zarr")),
                    scene: file.clone(),
                    text: text.clone(),
                    episodes,
                    seed,
                    side,
                    mano: mano.clone(),
                };
                if name != OOD {
                    world.training.push(shares(episodes, |begin, count| {
                        recipe(&format!("train{begin}"), count, first + begin as u64)
                    }));
                }
                world.held_out.push(recipe("test", held_out, first_held_out));
            }
            worlds.insert(name.clone(), world);
        }
        Ok(Self { worlds, recorded: Vec::new() })
    }

    /// Returns the first `n` stores of each of a world's scenes (10, 20, 50, 100 % of the episodes) as a source.
    ///
    /// # Errors
    /// If there is no such world.
    pub fn share(&self, world: &str, n: usize, labels: Supervision) -> Result<TrainingSource> {
        let scenes = &self.world(world)?.training;
        let stores = scenes.iter().flat_map(|stores| stores.iter().take(n.max(1)).map(|recipe| recipe.path.clone()));
        Ok(TrainingSource { mirror: true, labels, ..TrainingSource::of(stores) })
    }

    /// Returns a world with all its episodes as a source.
    ///
    /// # Errors
    /// As [`Self::share`].
    pub fn source(&self, world: &str, labels: Supervision) -> Result<TrainingSource> {
        self.share(world, SHARES.len(), labels)
    }

    /// Returns the source with force and the first `n` sources by distance: the paper's mixture.
    ///
    /// # Errors
    /// As [`Self::share`].
    pub fn mixture(&self, n: usize) -> Result<Vec<TrainingSource>> {
        let mut sources = vec![self.source("force", Supervision::Both)?];
        for world in &CONTACT_WORLDS[..n.min(CONTACT_WORLDS.len())] {
            sources.push(self.source(world, Supervision::Proximity)?);
        }
        Ok(sources)
    }

    /// Returns the recipes of the held-out stores of some worlds.
    ///
    /// # Errors
    /// As [`Self::share`].
    pub fn held_out(&self, worlds: &[&str]) -> Result<Vec<Recipe>> {
        let mut recipes = Vec::new();
        for world in worlds {
            recipes.extend(self.world(world)?.held_out.iter().cloned());
        }
        Ok(recipes)
    }

    /// Returns the imported recordings of a data set as a source.
    ///
    /// # Errors
    /// If no recordings of this layout are planned.
    pub fn imported(&self, layout: Layout) -> Result<TrainingSource> {
        let known = || self.recorded.iter().map(|recorded| recorded.layout.kind());
        let found = self.recorded.iter().find(|recorded| recorded.layout == layout);
        let found = found.ok_or_else(|| Error::unknown("recordings", layout.kind(), known()))?;
        Ok(TrainingSource { mirror: true, ..TrainingSource::path(&found.path) })
    }

    /// Returns the recipe of a store of a training source.
    pub fn recipe(&self, path: &Path) -> Option<&Recipe> {
        self.worlds.values().flat_map(|world| world.training.iter().flatten()).find(|recipe| recipe.path == path)
    }

    /// Returns the recordings that are planned.
    pub fn recordings(&self) -> &[Recorded] {
        &self.recorded
    }

    fn world(&self, name: &str) -> Result<&World> {
        self.worlds.get(name).ok_or_else(|| Error::unknown("world", name, self.worlds.keys().map(String::as_str)))
    }
}

/// Makes a store for each share's part of `episodes` episodes; small numbers leave some shares without one.
fn shares(episodes: usize, mut store: impl FnMut(usize, usize) -> Recipe) -> Vec<Recipe> {
    let (mut own, mut begun) = (vec![], 0);
    for share in SHARES {
        let end = (episodes * share).div_ceil(100);
        if end > begun {
            own.push(store(begun, end - begun));
            begun = end;
        }
    }
    own
}

/// Returns the recipes of held-out episodes of shipped scenes as they are, and of the split `ood`: for measurements of a
/// finished network. The first list is of scenes that the shipped network has learned from, in unseen episodes.
///
/// # Errors
/// If the split can't be read.
pub fn measured(folder: &Path, episodes: usize, side: u32, scenes: usize) -> Result<[Vec<Recipe>; 2]> {
    let recipe = |name: &str| Recipe {
        path: folder.join(format!("{}_{episodes}_{side}.zarr", name.replace('/', "_"))),
        scene: name.into(),
        text: String::new(),
        episodes,
        seed: MEASURED_SEED,
        side,
        mano: None,
    };
    let names: Vec<&str> = egotac::sim::SHIPPED.iter().map(|(name, _)| *name).collect();
    let known = names.iter().take(scenes).map(|name| recipe(name)).collect();
    let ood = Split::named(OOD)?.scene_names(OOD);
    Ok([known, ood.iter().take(scenes).map(|name| recipe(name)).collect()])
}

/// First seed of the episodes that finished networks are measured on: no training and no published score uses them.
pub const MEASURED_SEED: u64 = 810_000;

#[cfg(test)]
mod tests {
    use super::*;

    fn plan(episodes: usize) -> Stores {
        Stores::plan(Path::new("data"), &Size { held_out: 3, ..Size::of(episodes) }).unwrap()
    }

    #[test]
    fn shares_grow_to_the_whole_and_no_seed_is_used_twice() {
        let stores = plan(10);
        let all = stores.source("force", Supervision::Both).unwrap();
        let mut before = 0;
        for n in 1..=4 {
            let part = stores.share("force", n, Supervision::Both).unwrap();
            assert!(part.stores.len() > before && part.stores.iter().all(|path| all.stores.contains(path)));
            before = part.stores.len();
        }
        assert_eq!(before, all.stores.len());
        let recipes: Vec<&Recipe> = all.stores.iter().filter_map(|path| stores.recipe(path)).collect();
        assert_eq!(recipes.iter().map(|recipe| recipe.episodes).sum::<usize>(), 4 * 10);
        for scene in recipes.iter().map(|recipe| &recipe.scene) {
            let mut seeds: Vec<u64> = recipes
                .iter()
                .filter(|recipe| recipe.scene == *scene)
                .flat_map(|recipe| recipe.seed..recipe.seed + recipe.episodes as u64)
                .collect();
            seeds.sort_unstable();
            assert_eq!(seeds, (SEEDS[0]..SEEDS[0] + 10).collect::<Vec<_>>());
        }
    }

    #[test]
    fn a_repetition_has_other_stores_and_seeds() {
        let plans = [0, 1].map(|repetition| {
            Stores::plan(Path::new("data"), &Size { repetition, held_out: 900, ..Size::of(900) }).unwrap()
        });
        let [first, again] = plans.each_ref().map(|stores| {
            let training = stores.source("force", Supervision::Both).unwrap().stores.clone();
            let training = training.iter().filter_map(|path| stores.recipe(path).cloned()).collect::<Vec<_>>();
            training.into_iter().chain(stores.held_out(&[OOD]).unwrap()).collect::<Vec<Recipe>>()
        });
        for a in &first {
            for b in &again {
                let seeds = |recipe: &Recipe| recipe.seed..recipe.seed + recipe.episodes as u64;
                assert!(a.path != b.path && (seeds(a).end <= seeds(b).start || seeds(b).end <= seeds(a).start));
            }
        }
    }

    #[test]
    fn no_source_has_a_scene_of_the_worlds_that_only_tests_see() {
        let held_out = Split::named(OOD).unwrap().scenes;
        for (name, split) in Split::parse("worlds.yaml", WORLDS).unwrap() {
            assert!(split.scenes.iter().all(|scene| !held_out.contains(scene)), "{name}");
            assert_eq!(split.rate, Some(if name == "motion" { 50.0 } else { RATE }), "{name}");
        }
        assert_eq!(plan(10).held_out(&[OOD]).unwrap().len(), held_out.len());
        assert!(plan(10).share(OOD, 4, Supervision::Both).unwrap().stores.is_empty());
    }

    #[test]
    fn the_mixture_has_force_in_its_first_source_and_distance_in_the_others() {
        let sources = plan(1).mixture(3).unwrap();
        let labels: Vec<Supervision> = sources.iter().map(|source| source.labels).collect();
        use Supervision::{Both, Proximity};
        assert_eq!(labels, [Both, Proximity, Proximity, Proximity]);
        assert!(plan(1).source("force_", Both).unwrap_err().to_string().contains("force_gloved"));
    }
}
