//! A preset from what it may cost or how wrong it may be, by the committed table.

use std::fmt;
use std::path::Path;

use super::knob::Knob;
use super::table::Report;
use crate::error::{Error, Result};
use crate::mujoco::Preset;
use crate::text::significant;

/// The committed table: what `egotac bench sim` wrote.
const COMMITTED: (&str, &str) = ("docs/bench/sim.json", include_str!("../../../docs/bench/sim.json"));
/// Presets to choose from: those with forces, in which any scene can run.
const CANDIDATES: [Preset; 4] = [Preset::Fast, Preset::Default, Preset::Precise, Preset::Reference];

/// What is asked for; at least one of the two.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Request {
    /// Seconds of computation per simulated second at most, without labels and pictures.
    pub budget: Option<f64>,
    /// Relative error of quasi-static forces at most, against the one reference model.
    pub error: Option<f64>,
}

/// A preset with its row of the table.
#[derive(Debug, Clone, PartialEq)]
pub struct Choice {
    /// The preset.
    pub preset: Preset,
    /// Seconds of computation per simulated second.
    pub cost: f64,
    /// Relative error of quasi-static forces against the one reference model.
    pub error: f64,
    /// Why it and no other.
    pub reason: String,
    /// Which numbers decided: the scene's own, or the worst of all scenes.
    pub basis: String,
}

/// The committed table.
///
/// # Errors
/// If the program was built with a broken one.
pub fn committed() -> Result<Report> {
    Report::from_json(Path::new(COMMITTED.0), COMMITTED.1)
}

/// Chooses for `scene`: its own rows where the table has it with forces to compare, else the worst over all scenes.
///
/// With a budget the least error within it, with an error the least cost that keeps it, with both the least cost that
/// keeps both.
///
/// # Errors
/// If no preset fits; the error names the nearest that can be had. If nothing is asked for, or the table has no presets.
pub fn pick(report: &Report, scene: &str, request: Request) -> Result<Choice> {
    let own = candidates(report, Some(scene));
    let (all, whose) = match own.len() == CANDIDATES.len() {
        true => (own, format!("scene {scene}")),
        false => (
            candidates(report, None),
            format!("worst of {} scenes, as {scene} has no row with forces", report.scenes.len()),
        ),
    };
    let basis = format!("{whose}; table of {}", report.machine);
    let cheapest = |some: &[Choice]| some.iter().min_by(|a, b| a.cost.total_cmp(&b.cost)).cloned();
    let nearest = |some: &[Choice]| some.iter().min_by(|a, b| a.error.total_cmp(&b.error)).cloned();
    let (Some(first), Some(best)) = (cheapest(&all), nearest(&all)) else {
        return Err(Error::value("bench table", "presets with costs and errors", "none"));
    };
    let within = |choice: &&Choice| request.budget.is_none_or(|budget| choice.cost <= budget);
    let right = |choice: &&Choice| request.error.is_none_or(|error| choice.error <= error);
    let affordable: Vec<Choice> = all.iter().filter(within).cloned().collect();
    let accurate: Vec<Choice> = all.iter().filter(right).cloned().collect();
    let both: Vec<Choice> = affordable.iter().filter(right).cloned().collect();
    let (chosen, reason) = match (request.budget, request.error) {
        (None, None) => return Err(Error::value("request", "a budget, an error, or both", "none")),
        (Some(budget), None) => {
            let chosen = nearest(&affordable).ok_or_else(|| {
                Error::value("--budget", format!("at least what the cheapest takes: {first} ({basis})"), ms(budget))
            })?;
            (chosen, format!("the least error within {}", ms(budget)))
        }
        (None, Some(error)) => {
            let chosen = cheapest(&accurate).ok_or_else(|| {
                Error::value("--error", format!("at least the least there is: {best} ({basis})"), percent(error))
            })?;
            (chosen, format!("the cheapest within {}", percent(error)))
        }
        (Some(budget), Some(error)) => {
            let chosen = cheapest(&both).ok_or_else(|| {
                let near = nearest(&affordable).unwrap_or_else(|| first.clone());
                let far = cheapest(&accurate).unwrap_or_else(|| best.clone());
                let expected = format!("a pair that a preset keeps; nearest are {near} and {far} ({basis})");
                Error::value("--budget and --error", expected, format!("{} and {}", ms(budget), percent(error)))
            })?;
            (chosen, format!("the cheapest within {} and {}", ms(budget), percent(error)))
        }
    };
    Ok(Choice { reason, basis, ..chosen })
}

/// The candidates that have cost and error, in one scene or as the worst over all.
fn candidates(report: &Report, scene: Option<&str>) -> Vec<Choice> {
    let choice = |preset: Preset| {
        let row = report.row(Knob::Preset.name(), preset.name())?;
        let entry = match scene {
            Some(scene) => row.entries.iter().find(|entry| entry.scene == scene)?.clone(),
            None => row.worst(),
        };
        let (cost, error) = (entry.ms_per_second? * 1e-3, entry.model.force?);
        Some(Choice { preset, cost, error, reason: String::new(), basis: String::new() })
    };
    CANDIDATES.into_iter().filter_map(choice).collect()
}

impl fmt::Display for Choice {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "{} ({} per simulated second, force error {})",
            self.preset.name(),
            ms(self.cost),
            percent(self.error)
        )
    }
}

fn ms(seconds: f64) -> String {
    format!("{} ms", significant(1e3 * seconds))
}

fn percent(share: f64) -> String {
    format!("{} %", significant(100.0 * share))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bench::Machine;
    use crate::bench::sim::errors::Errors;
    use crate::bench::sim::table::{Entry, Row};
    use crate::mujoco::PhysicsOptions;

    /// Two scenes with forces and one without: cost in ms, error in percent.
    fn table() -> Report {
        let entry = |scene: &str, cost: f64, error: Option<f64>| {
            let model = Errors { force: error.map(|percent| percent / 100.0), ..Errors::default() };
            Entry { scene: scene.into(), model, ms_per_second: Some(cost), ..Entry::default() }
        };
        let row = |preset: Preset, [a, b]: [(f64, f64); 2]| Row {
            knob: "preset".into(),
            setting: preset.name().into(),
            entries: vec![entry("poke", a.0, Some(a.1)), entry("mug", b.0, Some(b.1)), entry("hover", 0.5 * a.0, None)],
        };
        Report {
            command: "by hand".into(),
            seed: 0,
            seeds: 1,
            egotac: "0".into(),
            mujoco: "3".into(),
            machine: Machine { cpu: "abacus".into(), cores: 2 },
            recommended: Preset::Default,
            model: PhysicsOptions::preset(Preset::Reference),
            scenes: Vec::new(),
            rows: vec![
                row(Preset::Fast, [(5.0, 3.0), (12.0, 6.0)]),
                row(Preset::Default, [(10.0, 1.0), (25.0, 2.0)]),
                row(Preset::Precise, [(30.0, 0.2), (70.0, 0.5)]),
                row(Preset::Reference, [(400.0, 0.0), (900.0, 0.0)]),
                // Not to be chosen: cheap and exact, but for other cases.
                row(Preset::Stiff, [(1.0, 0.0), (1.0, 0.0)]),
            ],
            wrapper: None,
            throughput: None,
        }
    }

    fn pick_for(scene: &str, budget_ms: Option<f64>, percent: Option<f64>) -> Result<Choice> {
        pick(&table(), scene, Request { budget: budget_ms.map(|b| b * 1e-3), error: percent.map(|p| p / 100.0) })
    }

    #[test]
    fn a_budget_buys_the_least_error_and_an_error_the_least_cost() {
        let cases = [
            ("poke", Some(20.0), None, Preset::Default),
            ("poke", Some(5.0), None, Preset::Fast),
            ("mug", Some(20.0), None, Preset::Fast),
            ("mug", None, Some(1.0), Preset::Precise),
            ("poke", None, Some(1.0), Preset::Default),
            ("poke", None, Some(0.0), Preset::Reference),
            ("mug", Some(100.0), Some(3.0), Preset::Default),
            ("mug", Some(5000.0), None, Preset::Reference),
        ];
        for (scene, budget, error, preset) in cases {
            assert_eq!(pick_for(scene, budget, error).unwrap().preset, preset, "{scene}, {budget:?}, {error:?}");
        }
    }

    #[test]
    fn a_scene_without_forces_or_outside_the_table_gets_the_worst_of_all() {
        for scene in ["hover", "my_own"] {
            // The mug's numbers are the worst.
            let choice = pick_for(scene, None, Some(1.0)).unwrap();
            assert_eq!((choice.preset, choice.error), (Preset::Precise, 0.005));
            assert!((choice.cost - 0.07).abs() < 1e-12);
            assert!(choice.basis.contains("worst") && choice.basis.contains(scene) && choice.basis.contains("abacus"));
            assert_eq!(pick_for(scene, Some(20.0), None).unwrap().preset, Preset::Fast);
        }
    }

    #[test]
    fn what_cannot_be_had_names_the_nearest() {
        let error = pick_for("mug", Some(3.0), None).unwrap_err().to_string();
        assert!(error.contains("--budget") && error.contains("fast (12.0 ms") && error.contains("3.00 ms"), "{error}");
        let error = pick_for("mug", Some(30.0), Some(1.0)).unwrap_err().to_string();
        for part in ["--budget and --error", "default (25.0 ms", "precise (70.0 ms", "0.500 %"] {
            assert!(error.contains(part), "{part}: {error}");
        }
        let mut table = table();
        table.rows[3].entries = table.rows[2].entries.clone();
        let error = pick(&table, "mug", Request { error: Some(0.001), budget: None }).unwrap_err().to_string();
        assert!(error.contains("--error") && error.contains("0.500 %") && error.contains("0.100 %"), "{error}");
        assert!(pick_for("mug", None, None).is_err());
    }

    #[test]
    fn the_committed_table_has_all_presets_and_chooses() {
        let report = committed().unwrap();
        for preset in Preset::ALL {
            assert!(report.row("preset", preset.name()).is_some(), "{}", preset.name());
        }
        for knob in Knob::ALL {
            assert!(report.rows.iter().any(|row| row.knob == knob.name()), "{}", knob.name());
        }
        for scene in ["pinch_cube", "my_own"] {
            let choice = pick(&report, scene, Request { error: Some(0.05), budget: None }).unwrap();
            assert!(choice.error <= 0.05, "{choice}");
        }
    }

    #[test]
    fn a_report_reads_back_as_written() {
        let report = table();
        let path = Path::new("table");
        assert_eq!(Report::from_json(path, &report.to_json().unwrap()).unwrap(), report);
        assert!(Report::from_json(path, "{}").unwrap_err().to_string().contains("table"));
    }
}
