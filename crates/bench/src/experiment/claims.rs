//! Page that sets the experiments' results beside the paper's claims: one row per claim, with a verdict by rule.

use std::path::Path;

use egotac::error::{Error, Result};
use egotac::file::{input, limits};
use egotac::text::put;
use serde::Deserialize;
use serde_json::Value;

use super::report::{ArmReport, FORMAT};
use super::table;

/// Claims, with the paper's figures and what decides here; see the file.
const CLAIMS: &str = include_str!("claims.yaml");

/// One claim of the paper.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
struct Claim {
    claim: String,
    /// Figures in the paper.
    paper: String,
    /// Frames and truth that are compared here, and `yes` if they are of the paper's kind.
    split: String,
    /// Experiment whose JSON is read.
    experiment: String,
    #[serde(default)]
    comparisons: Vec<Comparison>,
    #[serde(default)]
    shares: Vec<AttentionShare>,
}

/// An arm beside the first arm of its experiment.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
struct Comparison {
    arm: String,
    test: String,
    score: String,
    expect: Expectation,
    /// With `keeps`: least share of the first arm's score.
    #[serde(default)]
    share: f64,
}

/// Attention on a region, expected above its share of area.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
struct AttentionShare {
    world: String,
    layer: String,
    region: String,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
enum Expectation {
    Up,
    Down,
    Same,
    Keeps,
}

/// Outcome of one comparison, or of a claim.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Verdict {
    Agrees,
    /// The interval contains both directions.
    Uncertain,
    Disagrees,
}

/// Results of an experiment, as far as claims need them.
#[derive(Debug, Deserialize)]
struct Results {
    format: u32,
    #[serde(default)]
    arms: Vec<ArmReport>,
    #[serde(default)]
    worlds: Vec<Value>,
}

/// Returns the page as Markdown, from the JSON files in `folder`. Experiments without a file of the current format count as
/// not measured.
///
/// # Errors
/// If a file can't be read, or lacks an arm or test that a claim compares.
pub fn page(folder: &Path) -> Result<String> {
    let claims: Vec<Claim> = serde_yaml::from_str(CLAIMS).map_err(|e| Error::file("claims.yaml", e))?;
    let mut text = String::from(
        "# Results beside the paper\n\n\
         Written by `egotac experiment results` from the JSON files beside it. Each experiment is one command, which stands at the \
         head of its table.\n\nThe paper trains a far larger network on recordings of people; here hands, objects and pictures are \
         rendered, and networks\nsmall. Levels can't be compared, directions can. Contact scores are means over frames with contact, \
         as the paper's; scores\nover time are means over episodes. Differences have 95 % intervals over episodes, the same ones for \
         both sides; with several\nseeds the interval spans those of all.\n\nA comparison *agrees* if its interval has the sign \
         that the paper's numbers have, *disagrees* if it has the other\nsign, and is *not certain* if it contains zero; where \
         no difference is expected, it agrees if the interval contains zero,\nwhich is weak evidence. A claim agrees, or disagrees, if \
         all its comparisons do.\n\nNetworks are trained for minutes. How far they have learned stands in each table, beside constant \
         predictions: where the first arm\nis hardly better than those, its comparisons say little.\n\n| claim | paper | ours | same split | verdict |\n|---|---|---|---|---|\n",
    );
    for claim in &claims {
        let (ours, verdict) = match results(folder, &claim.experiment)? {
            None => (format!("`egotac experiment {}`", claim.experiment), "not measured yet".to_string()),
            Some(results) => judge(claim, &results).map_err(|e| Error::file(named(folder, &claim.experiment), e))?,
        };
        put(&mut text, format_args!("| {} | {} | {ours} | {} | {verdict} |", claim.claim, claim.paper, claim.split));
    }
    text.push_str(&links(folder, &claims));
    Ok(text)
}

fn named(folder: &Path, experiment: &str) -> std::path::PathBuf {
    folder.join(format!("{experiment}.json"))
}

/// Reads the results of an experiment; `None` if there are none of the current format.
fn results(folder: &Path, experiment: &str) -> Result<Option<Results>> {
    let path = named(folder, experiment);
    if !path.exists() {
        return Ok(None);
    }
    let text = input::read_text(&path, limits::TEXT)?;
    let value: Value = serde_json::from_str(&text).map_err(|e| Error::file(&path, e))?;
    if value["format"].as_u64() != Some(FORMAT.into()) {
        return Ok(None);
    }
    serde_json::from_value(value).map(Some).map_err(|e| Error::file(&path, e))
}

/// Returns what was found, and the verdict, of a claim.
fn judge(claim: &Claim, results: &Results) -> Result<(String, String)> {
    let mut found: Vec<(String, Verdict)> = Vec::new();
    for comparison in &claim.comparisons {
        found.push(compare(comparison, results)?);
    }
    for share in &claim.shares {
        found.push(attention(share, results)?);
    }
    debug_assert_eq!(results.format, FORMAT);
    let all = |verdict: Verdict| found.iter().all(|(_, own)| *own == verdict);
    let any = |verdict: Verdict| found.iter().any(|(_, own)| *own == verdict);
    let verdict = if all(Verdict::Agrees) {
        "agrees"
    } else if all(Verdict::Disagrees) {
        "**disagrees**"
    } else if any(Verdict::Agrees) && any(Verdict::Disagrees) {
        "agrees in part, **disagrees in part**"
    } else if any(Verdict::Agrees) {
        "agrees in part, else not certain"
    } else if any(Verdict::Disagrees) {
        "**disagrees in part**, else not certain"
    } else {
        "not certain"
    };
    let ours: Vec<String> = found.into_iter().map(|(text, _)| text).collect();
    Ok((ours.join("; "), verdict.into()))
}

fn compare(comparison: &Comparison, results: &Results) -> Result<(String, Verdict)> {
    let Comparison { arm, test, score, expect, share } = comparison;
    let found = results.arms.iter().find(|own| own.name == *arm);
    let found = found.ok_or_else(|| Error::unknown("arm", arm, results.arms.iter().map(|own| own.name.as_str())))?;
    let scores =
        found.tests.get(test).ok_or_else(|| Error::unknown("test", test, found.tests.keys().map(String::as_str)))?;
    let title = table::FORCE.iter().chain(&table::CONTACT).find(|column| column.name == score);
    let title = title.map_or(score.as_str(), |column| column.title);
    let mean = |values: &[Option<f64>]| {
        let known = values.iter().copied().collect::<Option<Vec<f64>>>().filter(|known| !known.is_empty())?;
        Some(known.iter().sum::<f64>() / known.len() as f64)
    };
    let of = mean(&scores.score(score));
    let Some(((difference, [low, high]), of)) = scores.difference(score).zip(of) else {
        return Ok((format!("{title} of `{arm}` undefined"), Verdict::Uncertain));
    };
    let first = of - difference;
    let verdict = match expect {
        Expectation::Up | Expectation::Down if low <= 0.0 && high >= 0.0 => Verdict::Uncertain,
        Expectation::Up if low > 0.0 => Verdict::Agrees,
        Expectation::Down if high < 0.0 => Verdict::Agrees,
        Expectation::Same if low <= 0.0 && high >= 0.0 => Verdict::Agrees,
        Expectation::Keeps if of >= share * first => Verdict::Agrees,
        _ => Verdict::Disagrees,
    };
    Ok((format!("`{arm}`: {title} {first:.3} to {of:.3} ({low:+.3} .. {high:+.3})"), verdict))
}

fn attention(share: &AttentionShare, results: &Results) -> Result<(String, Verdict)> {
    let AttentionShare { world, layer, region } = share;
    let missing = || Error::value("worlds", format!("the share of {layer} on {region} in {world}"), "none");
    let own = results.worlds.iter().find(|own| own["name"] == world.as_str()).ok_or_else(missing)?;
    let shares = own["shares"].as_array().ok_or_else(missing)?;
    let found = shares.iter().find(|own| own["layer"] == layer.as_str() && own["region"] == region.as_str());
    let number = |key: &str| found.and_then(|own| own[key].as_f64()).ok_or_else(missing);
    let (area, on, ratio) = (number("area")?, number("attention")?, number("ratio")?);
    let interval = found.and_then(|own| own["interval"].as_array()).ok_or_else(missing)?;
    let [low, high] = [0, 1].map(|at| interval.get(at).and_then(Value::as_f64).unwrap_or(f64::NAN));
    let verdict = match (low > 1.0, high < 1.0) {
        (true, _) => Verdict::Agrees,
        (_, true) => Verdict::Disagrees,
        _ => Verdict::Uncertain,
    };
    Ok((
        format!(
            "{region}: {on:.3} of the attention on {area:.3} of the area, {ratio:.2} times ({low:.2} .. {high:.2})"
        ),
        verdict,
    ))
}

/// Lists the tables that are there.
fn links(folder: &Path, claims: &[Claim]) -> String {
    let mut names: Vec<&str> = claims
        .iter()
        .map(|claim| claim.experiment.as_str())
        .chain(["hands", "limits", "motion", "policy", "recordings", "reuse"])
        .collect();
    names.sort_unstable();
    names.dedup();
    let there = names.iter().filter(|name| folder.join(format!("{name}.md")).exists());
    let links: Vec<String> = there
        .map(|name| {
            let plot = folder.join(format!("{name}.png")).exists();
            format!("[{name}]({name}.md){}", if plot { format!(" ([plot]({name}.png))") } else { String::new() })
        })
        .collect();
    match links.is_empty() {
        true => String::new(),
        false => format!("\nTables: {}.\n", links.join(", ")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::experiment::Experiment;
    use crate::names::MEASURED;

    fn claims() -> Vec<Claim> {
        serde_yaml::from_str(CLAIMS).unwrap()
    }

    #[test]
    fn claims_name_experiments_arms_and_tests_that_exist() {
        for claim in claims() {
            assert!(!claim.comparisons.is_empty() || !claim.shares.is_empty(), "{}", claim.claim);
            if MEASURED.contains(&claim.experiment.as_str()) {
                continue;
            }
            let experiment = Experiment::by_name(&claim.experiment).unwrap();
            for comparison in claim.comparisons {
                assert!(experiment.arms[1..].iter().any(|arm| arm.name == comparison.arm), "{}", comparison.arm);
                assert!(experiment.tests.iter().any(|test| test.name == comparison.test), "{}", comparison.test);
            }
        }
    }

    #[test]
    fn verdicts_follow_the_intervals() {
        let results = |low: f64, high: f64| -> Results {
            let difference = 0.5 * (low + high);
            serde_json::from_value(serde_json::json!({"format": FORMAT, "arms": [{
                "name": "plus", "about": "", "constant": false, "tests": {"ood": {
                    "seeds": [{"frame_mean": {"f1": 0.5}}],
                    "differences": [[{"name": "frame_mean.f1", "difference": difference, "interval": [low, high]}]],
                }},
            }]}))
            .unwrap()
        };
        let verdict = |expect: Expectation, low: f64, high: f64| {
            let (arm, test, score) = ("plus".into(), "ood".into(), "frame_mean.f1".into());
            compare(&Comparison { arm, test, score, expect, share: 0.8 }, &results(low, high)).unwrap().1
        };
        use Expectation::{Down, Keeps, Same, Up};
        assert_eq!(verdict(Up, 0.1, 0.3), Verdict::Agrees);
        assert_eq!(verdict(Up, -0.1, 0.3), Verdict::Uncertain);
        assert_eq!(verdict(Up, -0.3, -0.1), Verdict::Disagrees);
        assert_eq!(verdict(Down, -0.3, -0.1), Verdict::Agrees);
        assert_eq!(verdict(Same, -0.1, 0.1), Verdict::Agrees);
        assert_eq!(verdict(Same, 0.1, 0.2), Verdict::Disagrees);
        // 0.5 is 0.83 of 0.6, and 0.71 of 0.7.
        assert_eq!((verdict(Keeps, -0.15, -0.05), verdict(Keeps, -0.25, -0.15)), (Verdict::Agrees, Verdict::Disagrees));
    }

    #[test]
    fn a_folder_without_results_gives_a_page_that_says_so_for_every_claim() {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("ablations.json"), r#"{"arms": []}"#).unwrap();
        let page = page(folder.path()).unwrap();
        assert_eq!(page.matches("not measured yet").count(), claims().len());
        assert!(page.contains("`egotac experiment glove`") && !page.contains("Tables:"));
    }
}
