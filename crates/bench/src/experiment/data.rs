//! The rendered data of all experiments: two sources that look different, and held-out episodes within and beyond them.

use std::path::{Path, PathBuf};

use egotac::train::source::TrainingSource;

/// Origin of held-out episodes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Domain {
    /// Unseen seeds of the training scenes, with the cameras of training.
    InDomain,
    /// Scenes with objects and a camera that training has not seen.
    OutOfDomain,
}

impl Domain {
    /// Both domains.
    pub const ALL: [Self; 2] = [Self::InDomain, Self::OutOfDomain];

    /// Returns the name in files.
    pub fn name(self) -> &'static str {
        match self {
            Self::InDomain => "in_domain",
            Self::OutOfDomain => "out_of_domain",
        }
    }
}

/// Camera of some scenes: the `camera` of a scene file.
struct Appearance {
    name: &'static str,
    camera: &'static str,
    scenes: [&'static str; 4],
}

/// Cameras of the two training sources, then the camera that training does not see.
const APPEARANCES: [Appearance; 3] = [
    // The usual camera of the scenes.
    Appearance {
        name: "plain",
        camera: "{ fovy: [40, 50] }",
        scenes: ["pinch_cube", "poke", "press_button", "palm_push"],
    },
    // A higher camera with a wide, distorted, noisy picture.
    Appearance {
        name: "field",
        camera: "{ eye: [[-0.1, 0.1], [-0.34, -0.24], [0.46, 0.56]], fovy: [54, 62], distortion: [[-0.15, -0.05], 0], noise: [2, 6], shutter: [0, 0.02] }",
        scenes: ["lift_mug", "open_door", "squeeze_ball", "tripod"],
    },
    // A camera at the side with a narrow picture.
    Appearance {
        name: "unseen",
        camera: "{ eye: [[0.12, 0.22], [-0.4, -0.3], [0.4, 0.5]], fovy: [32, 38], noise: [0, 3], distortion: [[0.05, 0.2], 0] }",
        scenes: ["turn_knob", "wipe_table", "power_grasp", "hold_plate"],
    },
];

/// Shares of a scene's episodes at which a store ends, per cent: the first n stores hold the n-th share.
const SHARES: [usize; 4] = [10, 20, 50, 100];
/// First seed of training episodes, and of held-out ones.
const SEEDS: [u64; 2] = [70_000, 570_000];
/// Width and height of the pictures, pixels.
pub const SIDE: u32 = 112;
/// Frames per second: at the usual 25, most windows would be nearly the same pictures.
pub const RATE: f64 = 10.0;

/// Paths of all stores.
#[derive(Debug, Clone, PartialEq)]
pub struct Stores {
    /// Stores of each training scene, in the order of [`APPEARANCES`]; the first n together hold the n-th share.
    training: Vec<Vec<PathBuf>>,
    held_out: [Vec<PathBuf>; 2],
    /// Recipes of all stores.
    recipes: Vec<Recipe>,
}

/// Scene and seeds of a store.
#[derive(Debug, Clone, PartialEq)]
pub struct Recipe {
    /// The store.
    pub path: PathBuf,
    /// Path of the scene file.
    pub scene: PathBuf,
    /// Text of the scene file.
    pub text: String,
    /// Episodes.
    pub episodes: usize,
    /// Seed of the first episode.
    pub seed: u64,
}

impl Stores {
    /// Plans the stores in `folder`, with `episodes` training episodes and `held_out` held-out episodes of each scene.
    pub fn plan(folder: &Path, episodes: usize, held_out: usize) -> Self {
        let mut stores = Self { training: vec![], held_out: [vec![], vec![]], recipes: vec![] };
        let scenes =
            APPEARANCES.iter().enumerate().flat_map(|(at, look)| look.scenes.map(|scene| (at < 2, look, scene)));
        for (index, (is_training, Appearance { name: appearance, camera, .. }, scene)) in (0..).zip(scenes) {
            let file = folder.join("scenes").join(format!("{scene}_{appearance}.yaml"));
            let mut add = |name: String, episodes: usize, seed: u64| {
                let text = text(scene, camera);
                // A changed scene makes a new store.
                let hash = egotac::file::sha256(text.as_bytes());
                let path = folder.join(format!("{scene}_{name}_{episodes}_{}.zarr", &hash[..8]));
                let recipe = Recipe { path: path.clone(), scene: file.clone(), text, episodes, seed };
                stores.recipes.push(recipe);
                path
            };
            let first = |of: u64| of + 1000 * index;
            if is_training {
                let (mut own, mut begun) = (vec![], 0);
                for share in SHARES {
                    let end = (episodes * share).div_ceil(100);
                    if end > begun {
                        own.push(add(format!("train{begun}"), end - begun, first(SEEDS[0]) + begun as u64));
                        begun = end;
                    }
                }
                stores.training.push(own);
            }
            stores.held_out[usize::from(!is_training)].push(add("test".into(), held_out, first(SEEDS[1])));
        }
        stores
    }

    /// Returns the two sources with all episodes.
    pub fn sources(&self) -> Vec<TrainingSource> {
        self.up_to(SHARES.len() - 1)
    }

    /// Returns the two sources with the `n`-th share (10, 20, 50, 100 %) of each scene.
    pub fn share(&self, n: usize) -> Vec<TrainingSource> {
        self.up_to(n)
    }

    /// Returns the first `n` scenes, each as a source, in turn from both training cameras.
    pub fn scenes(&self, n: usize) -> Vec<TrainingSource> {
        let half = self.training.len() / 2;
        let in_turn = (0..half).flat_map(|i| [i, half + i]);
        in_turn.take(n).map(|scene| mirrored(self.training[scene].clone())).collect()
    }

    /// Returns the held-out stores of a domain.
    pub fn held_out(&self, domain: Domain) -> &[PathBuf] {
        &self.held_out[usize::from(domain == Domain::OutOfDomain)]
    }

    /// Returns the recipes of all stores.
    pub fn recipes(&self) -> &[Recipe] {
        &self.recipes
    }

    fn up_to(&self, n: usize) -> Vec<TrainingSource> {
        let of = |scenes: &[Vec<PathBuf>]| {
            mirrored(scenes.iter().flat_map(|stores| stores[..(n + 1).min(stores.len())].to_vec()).collect())
        };
        self.training.chunks(self.training.len().div_ceil(2).max(1)).map(of).collect()
    }
}

fn mirrored(stores: Vec<PathBuf>) -> TrainingSource {
    TrainingSource { mirror: true, ..TrainingSource::of(stores) }
}

/// Returns the text of a shipped scene with another camera.
fn text(scene: &str, camera: &str) -> String {
    #[cfg(feature = "sim")]
    let own = egotac::sim::SHIPPED.iter().find(|(name, _)| *name == scene).map_or("", |(_, text)| *text);
    #[cfg(not(feature = "sim"))]
    let own = scene;
    let kept = own.lines().filter(|line| !line.starts_with("camera:") && !line.starts_with("rate:"));
    let mut text: String = kept.map(|line| format!("{line}\n")).collect();
    text += &format!("camera: {camera}\nrate: {RATE}\n");
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shares_grow_to_the_whole_and_no_seed_is_used_twice() {
        let stores = Stores::plan(Path::new("data"), 10, 3);
        let paths =
            |sources: &[TrainingSource]| sources.iter().flat_map(|source| source.stores.clone()).collect::<Vec<_>>();
        let all = paths(&stores.sources());
        let mut before = 0;
        for share in 0..4 {
            let part = paths(&stores.share(share));
            assert!(part.len() > before && part.iter().all(|path| all.contains(path)));
            before = part.len();
        }
        assert_eq!((before, stores.sources().len()), (all.len(), 2));
        assert_eq!((stores.scenes(6).len(), stores.scenes(1).len()), (6, 1));
        let training = |recipe: &&Recipe| all.contains(&recipe.path);
        let episodes: usize = stores.recipes().iter().filter(training).map(|recipe| recipe.episodes).sum();
        assert_eq!(episodes, 8 * 10);
        let mut seeds: Vec<u64> =
            stores.recipes().iter().flat_map(|recipe| recipe.seed..recipe.seed + recipe.episodes as u64).collect();
        let count = seeds.len();
        seeds.sort_unstable();
        seeds.dedup();
        assert_eq!((seeds.len(), count), (count, 8 * 13 + 4 * 3));
        assert_eq!(stores.held_out(Domain::InDomain).len(), 8);
        assert_eq!(stores.held_out(Domain::OutOfDomain).len(), 4);
    }

    #[test]
    fn one_episode_of_each_scene_is_enough() {
        let stores = Stores::plan(Path::new("data"), 1, 1);
        assert_eq!(stores.sources()[0].stores.len(), 4);
        assert_eq!(stores.share(0), stores.sources());
    }

    #[cfg(feature = "sim")]
    #[test]
    fn every_scene_file_parses() {
        for recipe in Stores::plan(Path::new("data"), 1, 1).recipes() {
            egotac::sim::Scene::parse("own", &recipe.scene, &recipe.text).unwrap();
        }
    }
}
