//! Results as the JSON file holds them. `egotac::sim::budget::table` reads the part that `--budget` needs.

use std::path::Path;

use egotac::error::{Error, Result};
use egotac::machine::Machine;
use egotac::mujoco::{PhysicsOptions, Preset};
use serde::{Deserialize, Serialize};

use super::errors::Errors;
use super::throughput::Throughput;
use super::wrapper::Wrapper;

/// The preset recommended by default.
pub const RECOMMENDED: Preset = Preset::Default;

/// Results of one call.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SimReport {
    /// The command that measures the same again.
    pub command: String,
    /// First seed.
    pub seed: u64,
    /// Seeds over which errors are pooled; times are those of the first.
    pub seeds: u64,
    /// Version of this program.
    pub egotac: String,
    /// Version of the engine.
    pub mujoco: String,
    /// The machine that it was measured on.
    pub machine: Machine,
    /// The recommended preset.
    pub recommended: Preset,
    /// The reference model.
    pub model: PhysicsOptions,
    /// The scenes.
    pub scenes: Vec<SceneNote>,
    /// The settings.
    pub rows: Vec<Row>,
    /// Overhead of our code over the engine's steps.
    pub wrapper: Option<Wrapper>,
    /// Speed of `egotac sim generate`.
    pub throughput: Option<Throughput>,
}

/// A simulated scene.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SceneNote {
    /// Name.
    pub name: String,
    /// Simulated seconds, over all seeds.
    pub seconds: f64,
    /// Part of it in which forces are compared: the hands press, and neither forces nor objects change, s.
    pub quiet_seconds: f64,
}

/// One setting in all scenes.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Row {
    /// Name of the knob.
    pub knob: String,
    /// Name of the setting.
    pub setting: String,
    /// One entry per scene.
    pub entries: Vec<Entry>,
}

/// One setting in one scene.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Entry {
    /// The scene.
    pub scene: String,
    /// Errors against the fine reference of the same model.
    pub same: Errors,
    /// Errors against the reference model.
    pub model: Errors,
    /// Upward contact force on the objects over their weight, in the quiet seconds.
    pub lift: Option<f64>,
    /// Share of frames that a guard refused.
    pub invalid: Option<f64>,
    /// Computation per simulated second, ms; without labels and pictures, except for their own knobs.
    pub ms_per_second: Option<f64>,
    /// Simulated seconds per second.
    pub real_time_factor: Option<f64>,
    /// Reason why the scene refuses the setting.
    pub refused: Option<String>,
}

impl Entry {
    /// Sets the computation per simulated second, s.
    pub fn set_cost(&mut self, seconds: f64) {
        self.ms_per_second = Some(1e3 * seconds);
        self.real_time_factor = (seconds > 0.0).then(|| 1.0 / seconds);
    }
}

impl Row {
    /// Returns the worst over all scenes, value by value.
    pub fn worst(&self) -> Entry {
        self.worst_of(|_| true)
    }

    /// Returns the worst over the `wanted` scenes, value by value.
    pub fn worst_of(&self, wanted: impl Fn(&str) -> bool) -> Entry {
        let entries: Vec<&Entry> = self.entries.iter().filter(|entry| wanted(&entry.scene)).collect();
        let values = |value: fn(&Entry) -> Option<f64>| entries.iter().filter_map(move |entry| value(entry));
        let most = |value: fn(&Entry) -> Option<f64>| values(value).reduce(f64::max);
        let least = |value: fn(&Entry) -> Option<f64>| values(value).reduce(f64::min);
        let off = |lift: f64| (lift - 1.0).abs();
        let lifts = values(|entry| entry.lift);
        Entry {
            scene: String::new(),
            same: Errors {
                force: most(|e| e.same.force),
                impulse: most(|e| e.same.impulse),
                f1: least(|e| e.same.f1),
                agreement: least(|e| e.same.agreement),
            },
            model: Errors {
                force: most(|e| e.model.force),
                impulse: most(|e| e.model.impulse),
                f1: least(|e| e.model.f1),
                agreement: least(|e| e.model.agreement),
            },
            lift: lifts.max_by(|a, b| off(*a).total_cmp(&off(*b))),
            invalid: most(|e| e.invalid),
            ms_per_second: most(|e| e.ms_per_second),
            real_time_factor: least(|e| e.real_time_factor),
            refused: entries.iter().find_map(|e| e.refused.clone()),
        }
    }
}

impl SimReport {
    /// Reads `sim.json`.
    ///
    /// # Errors
    /// If the text is not a report; `path` is for the message.
    pub fn from_json(path: &Path, text: &str) -> Result<Self> {
        serde_json::from_str(text).map_err(|error| Error::file(path, error))
    }

    /// Returns the scenes in which all settings of physics were measured.
    pub fn shared_scenes(&self) -> Vec<&str> {
        let physics = |row: &&Row| row.entries.iter().any(|entry| entry.same.force.is_some());
        let has = |row: &Row, name: &str| row.entries.iter().any(|entry| entry.scene == name);
        let names = self.scenes.iter().map(|scene| scene.name.as_str());
        names.filter(|name| self.rows.iter().filter(physics).all(|row| has(row, name))).collect()
    }

    /// Returns the row of a setting.
    pub fn row(&self, knob: &str, setting: &str) -> Option<&Row> {
        self.rows.iter().find(|row| row.knob == knob && row.setting == setting)
    }
}
