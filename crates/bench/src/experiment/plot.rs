//! Plot of an experiment: scores arm by arm, one bar per test.

use std::path::Path;

use egotac::error::{Error, Result};
use egotac::render::figure::{self, Drawn, Figure};
use egotac::render::font::FAMILY;
use egotac::render::plot::{self, LABEL, PALETTE};
use plotters::coord::Shift;
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};
use serde_json::Value;

use super::report::{Report, score};

/// Scores in the plot: name in the JSON, title, and whether more is better.
const DRAWN: [(&str, &str, bool); 6] = [
    ("frame_mean.f1", "contact F1, frame mean", true),
    ("frame_mean.auroc", "contact AUROC, frame mean", true),
    ("active_mae", "active MAE, N", false),
    ("temporal_pearson", "temporal Pearson", true),
    ("force_cosine", "force cosine", true),
    ("rise_f1", "rise F1", true),
];
/// The same for reports of before format 2, which were chosen by pooled scores.
const DRAWN_EARLIER: [(&str, &str, bool); 6] = [
    ("pooled.f1", "contact F1, pooled", true),
    ("pooled.iou", "contact IoU, pooled", true),
    ("pooled.auroc", "contact AUROC, pooled", true),
    ("active_mae", "active MAE, N", false),
    ("temporal_pearson", "temporal Pearson", true),
    ("force_cosine", "force cosine", true),
];
/// Tests of reports of before format 2.
const TESTS_EARLIER: [&str; 2] = ["in_domain", "out_of_domain"];
/// Space on the left of a panel, pixels.
const LEFT: u32 = 72;

/// Content of the plot.
#[derive(Debug, Clone, PartialEq)]
pub struct Plot {
    question: String,
    tests: Vec<String>,
    arms: Vec<String>,
    panels: Vec<Panel>,
}

/// One score.
#[derive(Debug, Clone, PartialEq)]
struct Panel {
    title: String,
    /// Values by test, arm and seed.
    values: Vec<Vec<Vec<f64>>>,
}

/// Writes `EXPERIMENT.png` and `EXPERIMENT.svg` into `folder`.
///
/// # Errors
/// If a file can't be written.
pub fn write(folder: &Path, report: &Report) -> Result<()> {
    let json = serde_json::to_value(report).map_err(|error| Error::file(folder, error))?;
    figure::write(folder, report.head.experiment, &Plot::new(&json))
}

impl Plot {
    /// Takes what is drawn from a report in JSON; missing parts are empty.
    pub fn new(json: &Value) -> Self {
        let list = |value: &Value| value.as_array().cloned().unwrap_or_default();
        let name = |value: &Value| value["name"].as_str().unwrap_or_default().to_owned();
        let is_earlier = json.get("tests").is_none();
        let tests: Vec<String> = match is_earlier {
            true => TESTS_EARLIER.map(str::to_owned).into(),
            false => list(&json["tests"]).iter().map(name).collect(),
        };
        let arms: Vec<Value> = list(&json["arms"]).into_iter().filter(|arm| arm["constant"] != true).collect();
        let seeds = |arm: &Value, test: &str| {
            let scores = if is_earlier { &arm[test] } else { &arm["tests"][test] };
            list(&scores["seeds"])
        };
        let panel = |(of, title, more): &(&str, &str, bool)| {
            let values = |test: &String| {
                arms.iter().map(|arm| seeds(arm, test).iter().filter_map(|seed| score(seed, of)).collect()).collect()
            };
            let better = if *more { "more" } else { "less" };
            Panel { title: format!("{title}: {better} is better"), values: tests.iter().map(values).collect() }
        };
        Self {
            question: json["question"].as_str().unwrap_or_default().to_owned(),
            panels: if is_earlier { &DRAWN_EARLIER } else { &DRAWN }
                .iter()
                .map(panel)
                .filter(Panel::compares)
                .collect(),
            arms: arms.iter().map(|arm| arm_title(&name(arm))).collect(),
            tests,
        }
    }
}

/// Returns the colour of a test, which is the same in all plots; `at`: its place in this plot.
fn color(test: &str, at: usize) -> RGBColor {
    const FIXED: [&str; 6] = ["force", "contact", "ood_force", "ood_contact", "elsewhere_force", "elsewhere_contact"];
    // Unseen episodes of the data sets are in the domain.
    let known = test.strip_prefix("unseen_").unwrap_or(test);
    let place = FIXED.iter().position(|fixed| *fixed == known);
    PALETTE[place.unwrap_or(at) % PALETTE.len()]
}

/// Returns the name of an arm for readers.
fn arm_title(name: &str) -> String {
    match name.split_once('_') {
        Some(("tau", "0")) => "equal shares".into(),
        Some(("tau", "05")) => "by root of size".into(),
        Some(("tau", "1")) => "by size".into(),
        Some(("tau", "1_quota")) => "by size, quotas".into(),
        Some(("share", percent)) => format!("{percent} %"),
        Some(("plus", sources)) => format!("+ {sources}"),
        _ => name.replace('_', " "),
    }
}

/// Returns the name of a test for readers.
pub(super) fn test_title(name: &str) -> String {
    match name {
        "known" => "known scenes".into(),
        "ood" => "new shapes, camera and look".into(),
        "force" => "known scenes, truth by force".into(),
        "contact" => "known scenes, truth by distance".into(),
        "ood_force" => "new scenes, truth by force".into(),
        "ood_contact" => "new scenes, truth by distance".into(),
        "unseen_force" => "unseen episodes of both data sets, truth by force".into(),
        "unseen_contact" => "unseen episodes of both data sets, truth by distance".into(),
        "elsewhere_force" => "other scenes in a known look, truth by force".into(),
        "elsewhere_contact" => "other scenes in a known look, truth by distance".into(),
        name => name.replace('_', " "),
    }
}

impl Figure for Plot {
    const SIZE: (u32, u32) = (1200, 1180);

    fn draw<B: DrawingBackend>(&self, root: &DrawingArea<B, Shift>) -> Drawn<()>
    where
        B::ErrorType: 'static,
    {
        root.fill(&WHITE)?;
        let titles: Vec<String> = self.tests.iter().map(|test| test_title(test)).collect();
        let keys: Vec<(&str, RGBColor)> = titles
            .iter()
            .zip(self.tests.iter().enumerate())
            .map(|(title, (at, test))| (title.as_str(), color(test, at)))
            .collect();
        let panels = plot::head(root, &self.question, &keys)?.split_evenly((self.panels.len().div_ceil(2).max(1), 2));
        for (area, panel) in panels.iter().zip(&self.panels) {
            panel.draw(area, &self.arms, &self.tests)?;
        }
        root.present()?;
        Ok(())
    }
}

impl Panel {
    /// True if at least two arms have values to compare.
    fn compares(&self) -> bool {
        let arms = self.values.first().map_or(0, Vec::len);
        (0..arms).filter(|arm| self.values.iter().any(|test| !test[*arm].is_empty())).count() >= arms.min(2)
    }

    /// Draws a bar for each mean over seeds, and a dot for each seed.
    fn draw<B: DrawingBackend>(&self, area: &DrawingArea<B, Shift>, arms: &[String], tests: &[String]) -> Drawn<()>
    where
        B::ErrorType: 'static,
    {
        let all = || self.values.iter().flatten().flatten().copied();
        let (most, least) = (all().fold(0.0, f64::max), all().fold(0.0, f64::min));
        let top = if most > 0.0 { 1.1 * most } else { 1.0 };
        // Scores end at 1.
        let top = if most <= 1.0 { top.min(1.03) } else { top };
        let names: Vec<&str> = arms.iter().map(String::as_str).collect();
        let pitch = area.dim_in_pixel().0.saturating_sub(LEFT + 2 * plot::MARGIN) / arms.len().max(1) as u32;
        let below = plot::names_height(&names, pitch);
        let mut chart = plot::chart(area, &self.title, [below, LEFT])
            .build_cartesian_2d(-0.5..arms.len() as f64 - 0.5, 1.15 * least..top)?;
        plot::categories(area, &mut chart, &names, ("", &|y| format!("{}", (y * 1e3).round() / 1e3)))?;
        let drawn = self.values.iter().filter(|arms| arms.iter().any(|seeds| !seeds.is_empty())).count();
        let width = 0.8 / drawn.max(1) as f64;
        let mut place = 0.0;
        for (arms, color) in self.values.iter().zip(tests.iter().enumerate().map(|(at, test)| color(test, at))) {
            if arms.iter().all(Vec::is_empty) {
                continue;
            }
            let shift = width * (place + 0.5) - 0.4;
            place += 1.0;
            for (arm, seeds) in arms.iter().enumerate() {
                let x = arm as f64 + shift;
                if seeds.is_empty() {
                    let grey = BLACK.mix(0.6);
                    let style = TextStyle::from((FAMILY, LABEL)).color(&grey);
                    let style = style.transform(FontTransform::Rotate270).pos(Pos::new(HPos::Left, VPos::Center));
                    chart.draw_series([EmptyElement::at((x, 0.0)) + Text::new("no value", (0, -8), style)])?;
                    continue;
                }
                let mean = seeds.iter().sum::<f64>() / seeds.len() as f64;
                let bar = [(x - 0.45 * width, 0.0), (x + 0.45 * width, mean)];
                chart.draw_series([Rectangle::new(bar, color.mix(0.55).filled())])?;
                chart.draw_series(seeds.iter().map(|value| Circle::new((x, *value), 3, color.filled())))?;
            }
        }
        Ok(())
    }
}
