//! This machine's speed beside the machine of a table: measured once, then read from a cache.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use super::clock::Clock;
use super::table::Table;
use crate::error::{Error, Result};
use crate::file::{self, input, limits};
use crate::machine::Machine;
use crate::mujoco::Preset;
use crate::sim::{Rollout, RolloutOptions, Scene};

/// Shipped scene whose episode is timed: 4.6 simulated seconds of grasping, about 0.1 s of computation.
pub const SCENE: &str = "pinch_cube";
/// Preset it is timed with.
pub const PRESET: Preset = Preset::Default;
/// Repetitions of the episode, of which each frame's least time counts: half a second of computation altogether.
const REPETITIONS: usize = 5;

/// Factors by machine, program version and table, as the cache file holds them.
type Cached = BTreeMap<String, f64>;

/// Returns this machine's computation time over that of the table's machine: from the user's cache, or measured and then
/// cached. A cache that cannot be read or written only means that the factor is measured anew.
///
/// # Errors
/// If the factor has to be measured and cannot be.
pub fn this_machines_factor(table: &Table) -> Result<f64> {
    factor(table, &Machine::this(), cache_file().as_deref(), || measure(table))
}

/// Returns the factor of `machine` from the cache file, or takes it from `measure` and writes it there.
fn factor(
    table: &Table,
    machine: &Machine,
    cache: Option<&Path>,
    measure: impl FnOnce() -> Result<f64>,
) -> Result<f64> {
    let key = format!("{machine}; egotac {}; table {}", crate::VERSION, table.sha256);
    let text = cache.and_then(|path| input::read_text(path, limits::TEXT).ok());
    let mut cached: Cached = text.and_then(|text| serde_json::from_str(&text).ok()).unwrap_or_default();
    let is_factor = |factor: &f64| factor.is_finite() && *factor > 0.0;
    if let Some(factor) = cached.get(&key).copied().filter(is_factor) {
        return Ok(factor);
    }
    let factor = measure()?;
    if !is_factor(&factor) {
        return Err(Error::value("calibration", "a time above 0", factor));
    }
    cached.insert(key, factor);
    if let (Some(path), Ok(text)) = (cache, serde_json::to_string_pretty(&cached)) {
        // A read-only home is not an error: the next run measures again.
        let _ = file::write(path, text.as_bytes());
    }
    Ok(factor)
}

/// Returns `egotac/budget.json` in the user's cache folder, if there is such a folder.
fn cache_file() -> Option<PathBuf> {
    let folder = |name: &str| std::env::var_os(name).map(PathBuf::from).filter(|path| path.is_absolute());
    let cache = folder("XDG_CACHE_HOME").or_else(|| Some(folder("HOME")?.join(".cache")))?;
    Some(cache.join("egotac").join("budget.json"))
}

/// Times [`SCENE`] and divides by the table's time of it.
fn measure(table: &Table) -> Result<f64> {
    let of_table = table.entry(PRESET, SCENE).and_then(|entry| entry.ms_per_second);
    let of_table = of_table.ok_or_else(|| Error::value("bench table", format!("a time of {SCENE}"), "none"))?;
    let scene = Scene::load(SCENE)?;
    let mut clock = Clock::default();
    let mut simulated = 0.0;
    for _ in 0..REPETITIONS {
        simulated = clock.add_episode(Rollout::new(&scene, table.seed, &options(&scene))?);
    }
    Ok(1e3 * clock.total() / simulated / of_table)
}

/// Returns the options that `egotac bench sim` times [`PRESET`] with.
pub fn options(scene: &Scene) -> RolloutOptions {
    let physics = Some(scene.spec.physics.with_preset(PRESET));
    RolloutOptions { picture: None, physics, ..RolloutOptions::default() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sim::budget::{Request, pick};

    /// A table measured on a machine that takes `slowness` times as long as the shipped table's.
    fn slower(slowness: f64) -> Table {
        let mut table = Table::shipped().unwrap();
        for entry in table.rows.iter_mut().flat_map(|row| &mut row.entries) {
            entry.ms_per_second = entry.ms_per_second.map(|ms| slowness * ms);
        }
        Table { sha256: format!("slower by {slowness}"), ..table }
    }

    /// This machine's time of the calibration, ms per simulated second, as an injected measurement.
    fn measured(ms: f64) -> impl FnOnce(&Table) -> Result<f64> {
        move |table| Ok(ms / table.entry(PRESET, SCENE).unwrap().ms_per_second.unwrap())
    }

    #[test]
    fn the_choice_does_not_depend_on_the_speed_of_the_tables_machine() {
        let machine = Machine { cpu: "abacus".into(), cores: 2 };
        for budget in [0.015, 0.05, 0.2, 2.0] {
            let request = Request { budget: Some(budget), error: None };
            let choose = |table: &Table, factor: f64| pick(table, factor, SCENE, request).unwrap();
            let choices = [1.0, 10.0].map(|slowness| {
                let table = slower(slowness);
                let factor = factor(&table, &machine, None, || measured(20.0)(&table)).unwrap();
                choose(&table, factor)
            });
            assert_eq!(choices[0].preset, choices[1].preset, "{budget}");
            assert!((choices[0].cost - choices[1].cost).abs() < 1e-9, "{choices:?}");
            assert!(choices[0].cost <= budget);
        }
        // Without calibration, the slow machine's table buys less: in this time just its cheapest preset.
        let cheapest = Table::shipped().unwrap().entry(Preset::Fast, SCENE).unwrap().ms_per_second.unwrap();
        let request = Request { budget: Some(10.1e-3 * cheapest), error: None };
        let by_table = |slowness: f64| pick(&slower(slowness), 1.0, SCENE, request).unwrap().preset;
        assert_ne!(by_table(1.0), by_table(10.0));
    }

    #[test]
    fn a_cached_factor_is_reused_for_the_same_machine_version_and_table() {
        let folder = tempfile::tempdir().unwrap();
        let cache = folder.path().join("egotac/budget.json");
        let machine = |cpu: &str| Machine { cpu: cpu.into(), cores: 2 };
        let ask = |table: &Table, cpu: &str, measured: f64| {
            factor(table, &machine(cpu), Some(&cache), || Ok(measured)).unwrap()
        };
        let table = slower(1.0);
        assert_eq!((ask(&table, "abacus", 2.0), ask(&table, "abacus", 3.0)), (2.0, 2.0));
        assert_eq!((ask(&table, "slide rule", 4.0), ask(&slower(2.0), "abacus", 5.0)), (4.0, 5.0));
        assert_eq!(ask(&table, "abacus", 6.0), 2.0);
    }

    #[test]
    fn a_broken_or_unwritable_cache_is_measured_anew() {
        let folder = tempfile::tempdir().unwrap();
        let (table, machine) = (slower(1.0), Machine { cpu: "abacus".into(), cores: 2 });
        let cache = folder.path().join("budget.json");
        let ask = |path: &Path, measured: f64| factor(&table, &machine, Some(path), || Ok(measured)).unwrap();
        for (broken, measured) in [("{\"half a fi", 2.0), ("[1, 2]", 3.0), ("", 4.0)] {
            std::fs::write(&cache, broken).unwrap();
            assert_eq!((ask(&cache, measured), ask(&cache, 9.0)), (measured, measured), "{broken}");
        }
        let text = std::fs::read_to_string(&cache).unwrap().replace("4.0", "-1.0");
        std::fs::write(&cache, text).unwrap();
        assert_eq!(ask(&cache, 5.0), 5.0);
        // A file stands where the folder should be.
        let unwritable = cache.join("egotac/budget.json");
        assert_eq!((ask(&unwritable, 6.0), ask(&unwritable, 7.0)), (6.0, 7.0));
        assert!(factor(&table, &machine, None, || Ok(0.0)).is_err());
    }

    #[test]
    fn the_calibration_measures_a_factor_on_this_machine() {
        let factor = measure(&Table::shipped().unwrap()).unwrap();
        assert!(factor.is_finite() && factor > 0.0, "{factor}");
    }
}
