//! The experiments and their conditions (arms).

use egotac::error::{Error, Result};
use egotac::model;
use egotac::train::Config;
use egotac::train::config::ModelChoice;
use egotac::train::source::Supervision;

use super::data::Stores;

/// One condition of an experiment.
#[derive(Debug, Clone, Copy)]
pub struct Arm {
    /// Name.
    pub name: &'static str,
    /// Difference from the usual run, in words.
    pub about: &'static str,
    /// Changes the configuration of the usual run.
    pub change: fn(&mut Config, &Stores),
}

/// A question with the conditions that answer it.
#[derive(Debug, Clone)]
pub struct Experiment {
    /// Name.
    pub name: &'static str,
    /// The question.
    pub question: &'static str,
    /// The conditions; the others are compared with the first.
    pub arms: Vec<Arm>,
}

const fn arm(name: &'static str, about: &'static str, change: fn(&mut Config, &Stores)) -> Arm {
    Arm { name, about, change }
}

/// The usual run.
const FULL: Arm = arm("full", "everything", |_, _| ());

impl Experiment {
    /// Names of all experiments.
    pub const NAMES: [&'static str; 4] = ["ablations", "sources", "scaling", "limits"];

    /// Returns the experiment of this name.
    ///
    /// # Errors
    /// If there is none; the error lists the names.
    pub fn by_name(name: &str) -> Result<Self> {
        match name {
            "ablations" => Ok(ablations()),
            "sources" => Ok(sources()),
            "scaling" => Ok(scaling()),
            "limits" => Ok(limits()),
            _ => Err(Error::unknown("experiment", name, Self::NAMES)),
        }
    }
}

fn ablations() -> Experiment {
    Experiment {
        name: "ablations",
        question: "What does each part of the method give?",
        arms: vec![
            FULL,
            arm("no_context", "one frame in place of three (EgoTac-i)", |config, _| {
                geometry(config, |geometry| geometry.horizon = 1);
            }),
            arm("no_active", "without the active-region loss L_A", |config, _| config.loss.active = 0.0),
            arm("no_force", "contact labels alone: L_F and L_A have nothing to learn from", |config, _| {
                config.data.iter_mut().for_each(|source| source.labels = Supervision::Contact);
            }),
            arm("no_consistency", "without the consistency loss L_cons", |config, _| config.loss.consistency = 0.0),
        ],
    }
}

fn sources() -> Experiment {
    Experiment {
        name: "sources",
        question: "Does a second source that looks different and has contact labels alone help?",
        arms: vec![
            arm("mixed", "force and contact of the first source, contact of the second", |config, stores| {
                config.data = stores.sources();
                config.data[1].labels = Supervision::Contact;
            }),
            arm("force_supervised", "the first source alone, force and contact", |config, stores| {
                config.data = stores.sources()[..1].to_vec();
            }),
            arm("contact_only", "the second source alone, contact", |config, stores| {
                config.data = stores.sources()[1..].to_vec();
                config.data[0].labels = Supervision::Contact;
            }),
        ],
    }
}

fn scaling() -> Experiment {
    Experiment {
        name: "scaling",
        question: "What do more data and more sources give?",
        arms: vec![
            arm("share_100", "all episodes of all eight scenes", |_, _| ()),
            arm("share_50", "half of each scene's episodes", |config, stores| config.data = stores.share(2)),
            arm("share_20", "a fifth", |config, stores| config.data = stores.share(1)),
            arm("share_10", "a tenth", |config, stores| config.data = stores.share(0)),
            arm("scenes_6", "all episodes of six scenes", |config, stores| config.data = stores.scenes(6)),
            arm("scenes_4", "of four", |config, stores| config.data = stores.scenes(4)),
            arm("scenes_1", "of one", |config, stores| config.data = stores.scenes(1)),
        ],
    }
}

/// Returns the experiment on the limits of the scores: time, resolution and capacity, each reduced and, where possible,
/// increased. `scaling` asks the same for data.
fn limits() -> Experiment {
    Experiment {
        name: "limits",
        question: "What limits the scores: time, resolution or capacity?",
        arms: vec![
            arm("usual", "as in all experiments", |_, _| ()),
            arm("steps_half", "half the steps", |config, _| config.steps = config.steps.div_ceil(2)),
            arm("steps_double", "twice the steps", |config, _| config.steps *= 2),
            arm("pixels_56", "pictures of 56 pixels, 16 patches", |config, _| geometry(config, |own| own.image = 56)),
            arm("pixels_84", "of 84 pixels, 36 patches", |config, _| geometry(config, |own| own.image = 84)),
            arm("width_half", "half as wide", |config, _| widths(config, 48)),
            arm("width_more", "half as wide again", |config, _| widths(config, 144)),
        ],
    }
}

fn geometry(config: &mut Config, change: impl FnOnce(&mut model::Config)) {
    if let ModelChoice::Explicit(geometry) = &mut config.model {
        change(geometry);
    }
}

fn widths(config: &mut Config, width: usize) {
    geometry(config, |own| (own.vision_width, own.width) = (width, width));
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_known_and_others_are_refused_with_the_list() {
        for name in Experiment::NAMES {
            assert_eq!(Experiment::by_name(name).unwrap().name, name);
        }
        assert!(
            Experiment::by_name("ablation").unwrap_err().to_string().contains("ablations, sources, scaling, limits")
        );
    }
}
