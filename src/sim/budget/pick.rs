//! Choice of a preset by what it may cost or how wrong it may be.

use std::fmt;

use super::table::{Entry, Table};
use crate::error::{Error, Result};
use crate::machine::Machine;
use crate::mujoco::Preset;
use crate::text::significant;

/// Presets to choose from: those with forces, in which any scene can run.
const CANDIDATES: [Preset; 4] = [Preset::Fast, Preset::Default, Preset::Precise, Preset::Reference];

/// Limits that a preset has to keep; at least one of the two.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Request {
    /// Most computation per simulated second on this machine, without labels and pictures, s.
    pub budget: Option<f64>,
    /// Largest relative error of quasi-static forces against the reference model.
    pub error: Option<f64>,
}

/// A preset with its row of the table.
#[derive(Debug, Clone, PartialEq)]
pub struct Choice {
    /// The preset.
    pub preset: Preset,
    /// Computation per simulated second, s: the table's, times the factor.
    pub cost: f64,
    /// Relative error of quasi-static forces against the reference model.
    pub error: f64,
    /// Why this preset and no other.
    pub reason: String,
    /// The numbers that decided: whose row, which table, and the factor of this machine.
    pub basis: String,
}

/// Chooses a preset for `scene`: by the scene's own rows if the table has it with forces, else by the worst over all
/// scenes. `factor` is this machine's computation time over that of the table's machine.
///
/// With a budget the least error within it, with an error the least cost that keeps it, with both the least cost that
/// keeps both.
///
/// # Errors
/// If no preset fits; the error names the nearest that can be had. If nothing is asked for, or the table has no presets.
pub fn pick(table: &Table, factor: f64, scene: &str, request: Request) -> Result<Choice> {
    let own = candidates(table, factor, Some(scene));
    let (all, whose) = match own.len() == CANDIDATES.len() {
        true => (own, format!("scene {scene}")),
        false => (
            candidates(table, factor, None),
            format!("worst of {} scenes, as {scene} has no row with forces", table.scenes.len()),
        ),
    };
    let basis = match request.budget {
        Some(_) => format!(
            "{whose}; table of {}, times x {} for this machine ({})",
            table.machine,
            significant(factor),
            Machine::this()
        ),
        None => format!("{whose}; table of {}", table.machine),
    };
    let cheapest = |some: &[Choice]| some.iter().min_by(|a, b| a.cost.total_cmp(&b.cost)).cloned();
    let most_exact = |some: &[Choice]| some.iter().min_by(|a, b| a.error.total_cmp(&b.error)).cloned();
    let (Some(first), Some(best)) = (cheapest(&all), most_exact(&all)) else {
        return Err(Error::value("bench table", "presets with costs and errors", "none"));
    };
    let is_affordable = |choice: &&Choice| request.budget.is_none_or(|budget| choice.cost <= budget);
    let is_exact = |choice: &&Choice| request.error.is_none_or(|error| choice.error <= error);
    let affordable: Vec<Choice> = all.iter().filter(is_affordable).cloned().collect();
    let exact: Vec<Choice> = all.iter().filter(is_exact).cloned().collect();
    let both: Vec<Choice> = affordable.iter().filter(is_exact).cloned().collect();
    let (chosen, reason) = match (request.budget, request.error) {
        (None, None) => return Err(Error::value("request", "a budget, an error, or both", "none")),
        (Some(budget), None) => {
            let chosen = most_exact(&affordable).ok_or_else(|| {
                Error::value("--budget", format!("at least the cheapest preset's cost: {first} ({basis})"), ms(budget))
            })?;
            (chosen, format!("the least error within {}", ms(budget)))
        }
        (None, Some(error)) => {
            let chosen = cheapest(&exact).ok_or_else(|| {
                Error::value("--error", format!("at least the most exact preset's: {best} ({basis})"), percent(error))
            })?;
            (chosen, format!("the cheapest within {}", percent(error)))
        }
        (Some(budget), Some(error)) => {
            let chosen = cheapest(&both).ok_or_else(|| {
                let near = most_exact(&affordable).unwrap_or_else(|| first.clone());
                let far = cheapest(&exact).unwrap_or_else(|| best.clone());
                let expected = format!("a pair that a preset keeps; nearest are {near} and {far} ({basis})");
                Error::value("--budget and --error", expected, format!("{} and {}", ms(budget), percent(error)))
            })?;
            (chosen, format!("the cheapest within {} and {}", ms(budget), percent(error)))
        }
    };
    Ok(Choice { reason, basis, ..chosen })
}

/// Returns the candidates that have cost and error, in one scene or as the worst over all.
fn candidates(table: &Table, factor: f64, scene: Option<&str>) -> Vec<Choice> {
    let choice = |preset: Preset| {
        let entries = table.entries(preset).iter().filter(|entry| scene.is_none_or(|scene| entry.scene == scene));
        let worst = |value: fn(&Entry) -> Option<f64>| entries.clone().filter_map(value).reduce(f64::max);
        let (ms, error) = (worst(|entry| entry.ms_per_second)?, worst(|entry| entry.model.force)?);
        Some(Choice { preset, cost: factor * ms * 1e-3, error, reason: String::new(), basis: String::new() })
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
    use crate::sim::budget::table::{ModelErrors, Row};

    /// Two scenes with forces and one without: cost in ms, error in percent.
    fn table() -> Table {
        let entry = |scene: &str, cost: f64, error: Option<f64>| {
            let model = ModelErrors { force: error.map(|percent| percent / 100.0) };
            Entry { scene: scene.into(), model, ms_per_second: Some(cost) }
        };
        let row = |preset: Preset, [a, b]: [(f64, f64); 2]| Row {
            knob: "preset".into(),
            setting: preset.name().into(),
            entries: vec![entry("poke", a.0, Some(a.1)), entry("mug", b.0, Some(b.1)), entry("hover", 0.5 * a.0, None)],
        };
        Table {
            machine: Machine { cpu: "abacus".into(), cores: 2 },
            seed: 0,
            scenes: Vec::new(),
            rows: vec![
                row(Preset::Fast, [(5.0, 3.0), (12.0, 6.0)]),
                row(Preset::Default, [(10.0, 1.0), (25.0, 2.0)]),
                row(Preset::Precise, [(30.0, 0.2), (70.0, 0.5)]),
                row(Preset::Reference, [(400.0, 0.0), (900.0, 0.0)]),
                // Not a candidate: cheap and exact, but for other cases.
                row(Preset::Stiff, [(1.0, 0.0), (1.0, 0.0)]),
            ],
            sha256: String::new(),
        }
    }

    fn pick_for(scene: &str, budget_ms: Option<f64>, percent: Option<f64>) -> Result<Choice> {
        pick(&table(), 1.0, scene, Request { budget: budget_ms.map(|b| b * 1e-3), error: percent.map(|p| p / 100.0) })
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
    fn a_slower_machine_gets_less_for_its_budget_and_is_told_why() {
        let request = Request { budget: Some(0.02), error: None };
        let choice = pick(&table(), 3.0, "poke", request).unwrap();
        assert_eq!(choice.preset, Preset::Fast);
        assert!((choice.cost - 0.015).abs() < 1e-12);
        assert!(choice.basis.contains("table of abacus") && choice.basis.contains("times x 3.00"), "{}", choice.basis);
        assert!(choice.basis.contains(&Machine::this().to_string()), "{}", choice.basis);
        assert_eq!(pick(&table(), 0.5, "poke", request).unwrap().preset, Preset::Precise);
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
    fn impossible_limits_name_the_nearest_presets() {
        let error = pick_for("mug", Some(3.0), None).unwrap_err().to_string();
        assert!(error.contains("--budget") && error.contains("fast (12.0 ms") && error.contains("3.00 ms"), "{error}");
        let error = pick_for("mug", Some(30.0), Some(1.0)).unwrap_err().to_string();
        for part in ["--budget and --error", "default (25.0 ms", "precise (70.0 ms", "0.500 %"] {
            assert!(error.contains(part), "{part}: {error}");
        }
        let mut table = table();
        table.rows[3].entries = table.rows[2].entries.clone();
        let error = pick(&table, 1.0, "mug", Request { error: Some(0.001), budget: None }).unwrap_err().to_string();
        assert!(error.contains("--error") && error.contains("0.500 %") && error.contains("0.100 %"), "{error}");
        assert!(pick_for("mug", None, None).is_err());
    }

    #[test]
    fn the_shipped_table_chooses_for_known_and_unknown_scenes() {
        let table = Table::shipped().unwrap();
        for scene in ["pinch_cube", "my_own"] {
            let choice = pick(&table, 1.0, scene, Request { error: Some(0.05), budget: None }).unwrap();
            assert!(choice.error <= 0.05, "{choice}");
        }
    }
}
