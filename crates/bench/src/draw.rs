//! Plots drawn again from the JSON files that benchmarks and experiments wrote; nothing is measured.

use std::path::Path;

use anyhow::{Context as _, bail};
use egotac::file::{input, limits};
use egotac::render::figure::{self, Drawn, Figure};
use egotac::score::verify::picture;
use serde::Deserialize;
use serde_json::Value;

use crate::experiment::{decline, plot as bars, reuse};
use crate::model::sweep::ModelReport;
use crate::physics::determined::Determined;
use crate::sim::table::SimReport;
use crate::{glove, physics, policy, retarget};

/// Plots that belong to one JSON file.
enum Plots {
    Model(Box<ModelReport>),
    Sim(Box<SimReport>),
    Glove(glove::Plot),
    Physics(physics::plot::Plot),
    Retarget(retarget::plot::Plot),
    Decline(decline::Plot),
    Reuse(reuse::Plot),
    Policy(policy::plot::Plot),
    Bars(bars::Plot),
    Verify(picture::Plot),
}

/// Operation on a plot of any kind.
trait Draw {
    fn draw<F: Figure>(&mut self, name: &str, figure: &F) -> anyhow::Result<()>;
}

impl Plots {
    /// Reads the content of the plots of a report. The report's command tells the kind.
    fn read(path: &Path) -> anyhow::Result<Self> {
        let text = input::read_text(path, limits::FILE)?;
        let json: Value = serde_json::from_str(&text).with_context(|| path.display().to_string())?;
        let plots = Self::of(&json).with_context(|| path.display().to_string())?;
        plots.with_context(|| {
            format!(
                "{}: expected the JSON of bench model, sim, glove, physics or retarget, of an experiment with bars or curves, or of \
                 verify, got another one",
                path.display()
            )
        })
    }

    fn of(json: &Value) -> anyhow::Result<Option<Self>> {
        let words: Vec<&str> = json["command"].as_str().unwrap_or_default().split(' ').take(3).collect();
        Ok(Some(match words[..] {
            ["egotac", "bench", "model"] => Self::Model(Deserialize::deserialize(json)?),
            ["egotac", "bench", "sim"] => Self::Sim(Deserialize::deserialize(json)?),
            ["egotac", "bench", "glove"] => Self::Glove(Deserialize::deserialize(json)?),
            ["egotac", "bench", "physics"] => Self::Physics(Deserialize::deserialize(json)?),
            ["egotac", "bench", "retarget"] => Self::Retarget(Deserialize::deserialize(json)?),
            ["egotac", "experiment", "decline"] => Self::Decline(decline::Plot(json.clone())),
            ["egotac", "experiment", "reuse"] => Self::Reuse(Deserialize::deserialize(json)?),
            ["egotac", "experiment", "policy"] => Self::Policy(Deserialize::deserialize(json)?),
            ["egotac", "experiment", name] if name != "attention" => Self::Bars(bars::Plot::new(json)),
            _ if json.get("candidates").is_some() => Self::Verify(Deserialize::deserialize(json)?),
            _ => return Ok(None),
        }))
    }

    /// Hands each plot to `draw` with the name of its files.
    fn each(&self, name: &str, draw: &mut impl Draw) -> anyhow::Result<()> {
        match self {
            Self::Model(plot) => draw.draw(name, plot.as_ref()),
            Self::Sim(plot) => draw.draw(name, plot.as_ref()),
            Self::Glove(plot) => draw.draw(name, plot),
            Self::Physics(plot) => {
                draw.draw(name, plot)?;
                draw.draw(&format!("{name}-determined"), &Determined::new()?)
            }
            Self::Retarget(plot) => draw.draw(name, plot),
            Self::Decline(plot) => draw.draw(name, plot),
            Self::Reuse(plot) => draw.draw(name, plot),
            Self::Policy(plot) => draw.draw(name, plot),
            Self::Bars(plot) => draw.draw(name, plot),
            Self::Verify(plot) => draw.draw(name, plot),
        }
    }
}

/// Writes plots into a folder.
struct Files<'a> {
    folder: &'a Path,
    is_svg: bool,
    names: Vec<String>,
}

impl Draw for Files<'_> {
    fn draw<F: Figure>(&mut self, name: &str, figure: &F) -> anyhow::Result<()> {
        match self.is_svg {
            true => figure::write(self.folder, name, figure)?,
            false => figure::write_png(&self.folder.join(format!("{name}.png")), figure)?,
        }
        self.names.push(name.to_owned());
        Ok(())
    }
}

/// Draws the plots of the report `path` beside it, as the command that measured does; returns their names without ending.
///
/// # Errors
/// If the file is not the JSON of a report with a plot, or a picture can't be written.
pub fn beside(path: &Path) -> anyhow::Result<Vec<String>> {
    let plots = Plots::read(path)?;
    let Some(name) = path.file_stem().and_then(|name| name.to_str()) else { bail!("{}: no file name", path.display()) };
    // `egotac verify` writes no SVG.
    let is_svg = !matches!(plots, Plots::Verify(_));
    let folder = path.parent().unwrap_or(Path::new(""));
    let mut files = Files { folder, is_svg, names: Vec::new() };
    plots.each(name, &mut files)?;
    Ok(files.names)
}

/// Returns the plots of a report as the texts of SVG files, by name.
///
/// # Errors
/// As [`beside`].
pub fn svgs(path: &Path) -> anyhow::Result<Vec<(String, String)>> {
    struct Texts(Vec<(String, String)>);
    impl Draw for Texts {
        fn draw<F: Figure>(&mut self, name: &str, figure: &F) -> anyhow::Result<()> {
            let text: Drawn<String> = figure::svg(figure);
            self.0.push((name.to_owned(), text.map_err(|error| anyhow::anyhow!("{name}: {error}"))?));
            Ok(())
        }
    }
    let plots = Plots::read(path)?;
    let mut texts = Texts(Vec::new());
    plots.each(path.file_stem().and_then(|name| name.to_str()).unwrap_or("plot"), &mut texts)?;
    Ok(texts.0)
}
