//! The experiments that train, and their conditions (arms).

use egotac::error::{Error, Result};
use egotac::model;
use egotac::train::Config;
use egotac::train::config::{LossWeights, ModelChoice};
use egotac::train::source::{Supervision, TrainingSource};

use super::data::{CONTACT_WORLDS, OOD, RECORDED_WORLDS, Stores};
use super::recording::Layout;
use crate::names::TRAINED;

/// One condition of an experiment.
#[derive(Debug, Clone, Copy)]
pub struct Arm {
    /// Name.
    pub name: &'static str,
    /// Difference from the usual run, in words.
    pub about: &'static str,
    /// Changes the configuration of the usual run.
    pub change: fn(&mut Config, &Stores) -> Result<()>,
    /// Input and task of the network.
    pub view: View,
    /// Origin of the forces that it learns.
    pub forces: Forces,
    /// True to score the force head as it is, although no force trains it.
    pub untrained_force: bool,
}

/// Part of the scene that a network sees and predicts.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum View {
    /// The whole picture and its history; force and contact of both hands.
    Scene,
    /// One frame, cut out around one hand; contact of this hand.
    Crop,
    /// Squares around both hands, which the network that all arms start from finds in the whole picture.
    Hands,
    /// Squares around both hands, where the recorded poses say that they are.
    KnownHands,
}

impl View {
    /// True if the network learns from squares around the hands.
    pub fn is_cut(self) -> bool {
        self != Self::Scene
    }
}

/// Origin of the forces of an arm's training data.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Forces {
    /// The simulator.
    True,
    /// Estimated from noisy poses, as `egotac label --physics` does.
    FromMotion,
}

/// Held-out frames with truth of one kind.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Test {
    /// Name in reports.
    pub name: &'static str,
    /// Title in tables.
    pub title: &'static str,
    /// Worlds whose held-out episodes are used.
    pub worlds: &'static [&'static str],
    /// Truth: force and contact of the simulator, or contact by distance.
    pub truth: Supervision,
    /// True if only the right hand counts.
    pub right_hand: bool,
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
    /// Held-out frames that all arms are scored on.
    pub tests: Vec<Test>,
    /// True if the arms learn from recordings that are imported.
    pub recorded: bool,
    /// True if the table says how long each arm takes per picture.
    pub timed: bool,
}

/// The source with force in the domain, as the paper's Table 1.
const FORCE: Test = test("force", "In the domain, the source with force", &["force"], Supervision::Both);
/// The sources by distance in the domain, as the paper's Table 2.
const CONTACT: Test =
    test("contact", "In the domain, the sources by distance", &CONTACT_WORLDS, Supervision::Proximity);
/// Out of the domain by force, as the paper's OpenTouch.
const OOD_FORCE: Test = test("ood_force", "Out of the domain, truth by force", &[OOD], Supervision::Both);
/// Out of the domain by distance, as the paper's OAKINK2.
const OOD_CONTACT: Test = test("ood_contact", "Out of the domain, truth by distance", &[OOD], Supervision::Proximity);

/// In scenes that no recording has, seen as in the recordings.
const ELSEWHERE_FORCE: Test =
    test("elsewhere_force", "In other scenes, truth by force", &["elsewhere"], Supervision::Both);
/// As [`ELSEWHERE_FORCE`], by distance.
const ELSEWHERE_CONTACT: Test =
    test("elsewhere_contact", "In other scenes, truth by distance", &["elsewhere"], Supervision::Proximity);

/// In episodes of both data sets' scenes that no training sees, seen as in the recordings.
const UNSEEN_FORCE: Test =
    test("unseen_force", "In unseen episodes of both data sets, truth by force", &RECORDED_WORLDS, Supervision::Both);
/// As [`UNSEEN_FORCE`], by distance.
const UNSEEN_CONTACT: Test = test(
    "unseen_contact",
    "In unseen episodes of both data sets, truth by distance",
    &RECORDED_WORLDS,
    Supervision::Proximity,
);

const fn test(name: &'static str, title: &'static str, worlds: &'static [&'static str], truth: Supervision) -> Test {
    Test { name, title, worlds, truth, right_hand: false }
}

const fn arm(name: &'static str, about: &'static str, change: fn(&mut Config, &Stores) -> Result<()>) -> Arm {
    Arm { name, about, change, view: View::Scene, forces: Forces::True, untrained_force: false }
}

/// The paper's main network: force of one source, contact by distance of three.
const MIXED: Arm = arm("mixed", "force of one source, contact by distance of three others", |_, _| Ok(()));
const NO_CONTEXT: Arm = arm("no_context", "one frame in place of the history (EgoTac-i)", |config, _| {
    geometry(config, |geometry| geometry.horizon = 1);
    Ok(())
});
const NO_CONSISTENCY: Arm = arm("no_consistency", "without the consistency loss L_cons", |config, _| {
    config.loss.consistency = 0.0;
    Ok(())
});

impl Test {
    /// Returns the name of the file that holds a run's predictions: tests on the same frames share it.
    pub fn file(&self) -> String {
        self.worlds.join("+")
    }
}

impl Experiment {
    /// Returns the experiment of this name.
    ///
    /// # Errors
    /// If there is none; the error lists the names.
    pub fn by_name(name: &str) -> Result<Self> {
        match name {
            "sources" => Ok(sources()),
            "consistency" => {
                Ok(mixed("consistency", "Does the consistency loss link force and contact?", [NO_CONSISTENCY]))
            }
            "sampling" => Ok(sampling()),
            "glove" => Ok(glove()),
            "history" => Ok(mixed("history", "Does the history of pictures help the dynamics of force?", [NO_CONTEXT])),
            "separation" => Ok(separation()),
            "scaling" => Ok(scaling()),
            "ablations" => Ok(ablations()),
            "limits" => Ok(limits()),
            "motion" => Ok(motion()),
            "recordings" => Ok(recordings()),
            "hands" => Ok(hands()),
            _ => Err(Error::unknown("experiment", name, TRAINED)),
        }
    }
}

/// Returns an experiment whose other arms differ from the mixed one.
fn mixed<const N: usize>(name: &'static str, question: &'static str, others: [Arm; N]) -> Experiment {
    let arms = [MIXED].into_iter().chain(others).collect();
    Experiment {
        name,
        question,
        arms,
        tests: vec![FORCE, CONTACT, OOD_FORCE, OOD_CONTACT],
        recorded: false,
        timed: false,
    }
}

fn ablations() -> Experiment {
    let others = [
        NO_CONTEXT,
        arm("no_active", "without the active-region loss L_A", |config, _| {
            config.loss.active = 0.0;
            Ok(())
        }),
        Arm {
            untrained_force: true,
            ..arm("no_force", "without force labels; its force head as the consistency loss left it", |config, _| {
                config.data[0].labels = Supervision::Contact;
                Ok(())
            })
        },
        NO_CONSISTENCY,
        arm(
            "shipped_weights",
            "loss weights of the shipped network, 50, 1, 8, 0.25 for 1, 0.2, 1, 0.05",
            |config, _| {
                config.loss = LossWeights { force: 50.0, active: 1.0, contact: 8.0, consistency: 0.25, ..config.loss };
                Ok(())
            },
        ),
    ];
    mixed("ablations", "What does each part of the method give?", others)
}

fn sources() -> Experiment {
    let only = arm("force_only", "the source with force alone", |config, stores| {
        config.data = stores.mixture(0)?;
        Ok(())
    });
    let others = [
        arm("plus_1", "and contact by distance of one other source", |config, stores| {
            config.data = stores.mixture(1)?;
            Ok(())
        }),
        arm("plus_2", "of two", |config, stores| {
            config.data = stores.mixture(2)?;
            Ok(())
        }),
        arm("plus_3", "of three (the arm `mixed` of other experiments)", |_, _| Ok(())),
        Arm {
            untrained_force: true,
            ..arm("contact_only", "the three by distance alone; the force head as it is", |config, _| {
                config.data.remove(0);
                Ok(())
            })
        },
    ];
    let arms = [only].into_iter().chain(others).collect();
    let question = "Do sources without force, labelled by distance, help force and contact across domains?";
    Experiment { arms, ..mixed("sources", question, []) }
}

fn sampling() -> Experiment {
    /// Keeps a tenth of the episodes of the source with force, and sets how sources are drawn.
    fn scarce(config: &mut Config, stores: &Stores, temperature: f64, quota: f64) -> Result<()> {
        config.data[0] = stores.share("force", 1, Supervision::Both)?;
        config.data[0].quota = quota;
        config.sampling.temperature = temperature;
        Ok(())
    }
    let arms = vec![
        arm("tau_1", "sources in proportion to their size", |config, stores| scarce(config, stores, 1.0, 0.0)),
        arm("tau_05", "to the root of it, as in the paper", |config, stores| scarce(config, stores, 0.5, 0.0)),
        arm("tau_0", "all alike", |config, stores| scarce(config, stores, 0.0, 0.0)),
        arm("tau_1_quota", "in proportion, but a tenth at least from the small one", |config, stores| {
            scarce(config, stores, 1.0, 0.1)
        }),
    ];
    let question = "Do temperature and quotas keep a small source, here a tenth of the one with force, from starving?";
    Experiment { arms, ..mixed("sampling", question, []) }
}

fn glove() -> Experiment {
    let bare = Test { title: "Bare hands, otherwise the same world", ..FORCE };
    let gloved = test("gloved", "Gloved hands, as in training", &["force_gloved"], Supervision::Both);
    let force_of = |name, about, change| arm(name, about, change);
    let arms = vec![
        force_of("gloved", "force from gloved hands alone", |config, stores| {
            config.data = vec![stores.source("force_gloved", Supervision::Both)?];
            Ok(())
        }),
        force_of("bare", "force from bare hands alone: the bound", |config, stores| {
            config.data = stores.mixture(0)?;
            Ok(())
        }),
        force_of("mixed", "force from gloved hands, contact by distance from bare ones", |config, stores| {
            config.data[0] = stores.source("force_gloved", Supervision::Both)?;
            Ok(())
        }),
        force_of("recoloured", "force from gloved hands painted in the tone of skin", |config, stores| {
            config.data = vec![stores.source("force_recoloured", Supervision::Both)?];
            Ok(())
        }),
    ];
    let question = "Is a glove's look a domain gap, and do bare hands in other sources or recolouring close it?";
    let tests = vec![bare, gloved, OOD_FORCE, OOD_CONTACT];
    Experiment { name: "glove", question, arms, tests, recorded: false, timed: false }
}

fn separation() -> Experiment {
    let right = |of: Test| Test { right_hand: true, ..of };
    let crop = Arm {
        view: View::Crop,
        ..arm("crop", "one frame cut out around the hand, contact alone: a per-frame baseline", |config, _| {
            geometry(config, |geometry| geometry.horizon = 1);
            let LossWeights { contact, positive_weight, .. } = config.loss;
            let none =
                LossWeights { force: 0.0, contact, active: 0.0, consistency: 0.0, keypoints: 0.0, positive_weight };
            config.loss = none;
            Ok(())
        })
    };
    let question = "Does the network separate touch from no touch better than a baseline that sees one crop at a time?";
    let tests = vec![right(CONTACT), right(OOD_CONTACT), right(OOD_FORCE)];
    Experiment { tests, ..mixed("separation", question, [crop]) }
}

fn hands() -> Experiment {
    /// Halves the side of the network's input, in whole patches: two squares have half as many patches as the whole picture.
    fn half(config: &mut Config, _: &Stores) -> Result<()> {
        geometry(config, |geometry| geometry.image = (geometry.image / 2 / geometry.patch).max(1) * geometry.patch);
        Ok(())
    }
    let found = arm("hands", "squares of half the side around the hands, found by the shipped network", half);
    let known = arm("known_hands", "the same network, on squares that the true poses give", half);
    let others = [Arm { view: View::Hands, ..found }, Arm { view: View::KnownHands, ..known }];
    let question =
        "Does a network see touch better on squares around the hands than on the whole picture, in the same time?";
    Experiment { timed: true, ..mixed("hands", question, others) }
}

fn scaling() -> Experiment {
    /// Keeps the first `n` shares of every source.
    fn share(config: &mut Config, stores: &Stores, n: usize) -> Result<()> {
        config.data[0] = stores.share("force", n, Supervision::Both)?;
        for (source, world) in config.data[1..].iter_mut().zip(CONTACT_WORLDS) {
            *source = stores.share(world, n, Supervision::Proximity)?;
        }
        Ok(())
    }
    let arms = vec![
        arm("share_100", "all episodes of all four sources", |_, _| Ok(())),
        arm("share_50", "half of each scene's episodes", |config, stores| share(config, stores, 3)),
        arm("share_20", "a fifth", |config, stores| share(config, stores, 2)),
        arm("share_10", "a tenth", |config, stores| share(config, stores, 1)),
        arm("sources_3", "all episodes of three sources", |config, stores| {
            config.data = stores.mixture(2)?;
            Ok(())
        }),
        arm("sources_2", "of two", |config, stores| {
            config.data = stores.mixture(1)?;
            Ok(())
        }),
        arm("sources_1", "of one, the source with force", |config, stores| {
            config.data = stores.mixture(0)?;
            Ok(())
        }),
    ];
    Experiment { arms, ..mixed("scaling", "What do more data and more sources give?", []) }
}

/// Returns the experiment on the limits of the scores: time, resolution and capacity, each reduced and, where possible,
/// increased. `scaling` asks the same for data.
fn limits() -> Experiment {
    fn pixels(config: &mut Config, factor: f64) {
        geometry(config, |own| {
            own.image = (((own.image / own.patch) as f64 * factor).round() as usize).max(1) * own.patch
        });
    }
    let others = [
        arm("steps_half", "half the steps", |config, _| {
            config.steps = config.steps.div_ceil(2);
            Ok(())
        }),
        arm("steps_double", "twice the steps", |config, _| {
            config.steps *= 2;
            Ok(())
        }),
        arm("pixels_half", "half the resolution, a quarter of the patches", |config, _| {
            pixels(config, 0.5);
            Ok(())
        }),
        arm("pixels_more", "a quarter more resolution, from the same pictures", |config, _| {
            pixels(config, 1.25);
            Ok(())
        }),
        arm("decoder_half", "a decoder half as wide", |config, _| {
            geometry(config, |own| own.width = own.width.div_ceil(2 * own.heads) * own.heads);
            Ok(())
        }),
        arm("decoder_more", "half as wide again", |config, _| {
            geometry(config, |own| own.width = (3 * own.width).div_ceil(2 * own.heads) * own.heads);
            Ok(())
        }),
    ];
    mixed("limits", "What limits the scores: time, resolution or capacity?", others)
}

/// Returns the experiment on forces from motion: without force, with the true one, and with the estimated one.
fn motion() -> Experiment {
    let known = Test { title: "In the domain, truth by force", worlds: &["motion"], ..FORCE };
    let estimated = Arm {
        forces: Forces::FromMotion,
        ..arm("from_motion", "forces estimated from noisy poses, weighted by their deviation", |config, stores| {
            config.data = vec![stores.source("motion", Supervision::Both)?];
            config.data[0].weigh_by_std = true;
            Ok(())
        })
    };
    let arms = vec![
        arm("true_force", "the simulator's forces: the bound", |config, stores| {
            config.data = vec![stores.source("motion", Supervision::Both)?];
            Ok(())
        }),
        estimated,
        Arm {
            forces: Forces::FromMotion,
            ..arm("unweighted", "the same, all forces with equal weight", |config, stores| {
                config.data = vec![stores.source("motion", Supervision::Both)?];
                Ok(())
            })
        },
        Arm {
            untrained_force: true,
            ..arm("contact_only", "contact alone; the force head as the consistency loss left it", |config, stores| {
                config.data = vec![stores.source("motion", Supervision::Contact)?];
                Ok(())
            })
        },
    ];
    let question = "How much of what true forces teach do forces estimated from motion teach?";
    Experiment { name: "motion", question, arms, tests: vec![OOD_FORCE, known], recorded: false, timed: false }
}

/// Returns the experiment on recordings in the layouts of two data sets, each of scenes that the other does not have.
fn recordings() -> Experiment {
    let arms = vec![
        arm("mixed", "all labels of both, in as many steps as either alone", |config, stores| {
            both_recordings(config, stores, Supervision::Both)
        }),
        arm("glove", "the recordings of gloves alone: force and contact", |config, stores| {
            config.data = vec![stores.imported(Layout::Glove)?];
            Ok(())
        }),
        arm("hot3d", "the HOT3D clips alone: contact by distance, no force", |config, stores| {
            config.data = vec![stores.imported(Layout::Hot3d)?];
            Ok(())
        }),
        arm("no_contact", "as `mixed`, without the contact of the gloves", |config, stores| {
            both_recordings(config, stores, Supervision::Force)
        }),
        arm("felt", "as `mixed`, without the \"no contact\" of the gloves", |config, stores| {
            both_recordings(config, stores, Supervision::Felt)
        }),
    ];
    let question =
        "Does training on two imported data sets, poses without force and gloves without poses, beat either alone?";
    let tests = vec![UNSEEN_FORCE, UNSEEN_CONTACT, ELSEWHERE_FORCE, ELSEWHERE_CONTACT, OOD_FORCE, OOD_CONTACT];
    Experiment { name: "recordings", question, arms, tests, recorded: true, timed: false }
}

/// Takes some labels of the gloves and all of the clips. The steps are those of training on one alone, so that no network
/// learns longer than another.
fn both_recordings(config: &mut Config, stores: &Stores, glove: Supervision) -> Result<()> {
    let glove = TrainingSource { labels: glove, ..stores.imported(Layout::Glove)? };
    config.data = vec![glove, stores.imported(Layout::Hot3d)?];
    Ok(())
}

fn geometry(config: &mut Config, change: impl FnOnce(&mut model::Config)) {
    if let ModelChoice::Explicit(geometry) = &mut config.model {
        change(geometry);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_known_and_others_are_refused_with_the_list() {
        for name in TRAINED {
            let experiment = Experiment::by_name(name).unwrap();
            assert_eq!(experiment.name, name);
            assert!(experiment.arms.len() > 1 && !experiment.tests.is_empty());
            assert!(experiment.tests.iter().any(|test| test.worlds == [OOD]), "{name} is scored out of the domain");
            let mut names: Vec<_> = experiment.arms.iter().map(|arm| arm.name).collect();
            names.sort_unstable();
            names.dedup();
            assert_eq!(names.len(), experiment.arms.len(), "{name}: arms have names of their own");
        }
        let error = Experiment::by_name("ablation").unwrap_err().to_string();
        assert!(error.contains("sources, consistency, sampling"), "{error}");
    }

    #[test]
    fn ablations_start_from_the_mixture_and_change_one_thing() {
        let stores = Stores::plan(std::path::Path::new("data"), &super::super::Size::of(10)).unwrap();
        let text = "{name: a, data: [.], out: x, model: {vision_width: 48, vision_depth: 2, vision_heads: 3, width: 32, \
                    depth: 2, heads: 4, image: 56, patch: 14, pretrain_image: 70, horizon: 3, predict: 1}, seed: 1, steps: 9}";
        let usual = Config { data: stores.mixture(3).unwrap(), ..serde_yaml::from_str(text).unwrap() };
        for arm in ablations().arms {
            let mut config = usual.clone();
            (arm.change)(&mut config, &stores).unwrap();
            let changed = [config.data != usual.data, config.model != usual.model, config.loss != usual.loss];
            let expected = usize::from(arm.name != "mixed");
            assert_eq!(changed.iter().filter(|changed| **changed).count(), expected, "{}", arm.name);
            assert!(config.data[1..].iter().all(|source| source.labels == Supervision::Proximity), "{}", arm.name);
        }
    }
}
