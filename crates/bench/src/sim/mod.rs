//! Accuracy against time in simulation: errors against fine references, beside the time of each setting.
//!
//! ```text
//! knob -> setup --+-> trace (forces on hands and objects) -> errors --+-> table (JSON) -> markdown, pareto
//!                 +-> times (interleaved, least of many) -------------+
//! ```
//!
//! Quasi-static forces, impulses and contact sets are compared, not trajectories: these diverge between any two settings.
//! Each error comes twice: against a fine reference of the same model (the numerical error), and against one reference
//! model (numerical and modelling error).

pub mod errors;
pub mod hands;
pub mod knob;
pub mod labels;
pub mod markdown;
pub mod pareto;
pub mod pictures;
pub mod replay;
pub mod table;
pub mod throughput;
pub mod times;
pub mod trace;
pub mod wrapper;

use egotac::error::Result;
use egotac::machine::Machine;
use egotac::mujoco::{PhysicsOptions, Preset};
use egotac::sim::{RolloutOptions, Scene, WorkerCommand};
use rayon::prelude::*;

use self::errors::{Errors, Pool};
use self::knob::{Change, Knob, Setup, Variant};
use self::table::{Entry, RECOMMENDED, Row, SceneNote, SimReport};
use self::trace::Trace;

/// Shipped scenes in which single knobs are compared if no scenes are named; presets are compared in all scenes.
pub const KNOB_SCENES: [&str; 2] = ["pinch_cube", "lift_mug"];
/// Timestep below which a run takes so long that it is timed only once, while its forces are recorded, s.
const TIMED_WITH_FORCES: f64 = 2e-4;
/// Episodes for the speed of `generate`: enough that all jobs end at about the same time.
const EPISODES: usize = 12;

/// Settings of a measurement.
#[derive(Debug, Clone)]
pub struct Plan {
    /// The command that measures the same again.
    pub command: String,
    /// Scenes in which presets are compared.
    pub scenes: Vec<Scene>,
    /// Names of the scenes in which the other knobs are compared too.
    pub knob_scenes: Vec<String>,
    /// Knobs to compare.
    pub knobs: Vec<Knob>,
    /// First seed.
    pub seed: u64,
    /// Seeds over which errors are pooled.
    pub seeds: u64,
    /// Interleaved repetitions; the least time counts.
    pub repetitions: usize,
    /// Worker processes for the speed of `generate`, which know the scenes of `knob_scenes` in the order of `scenes` and
    /// draw pictures of [`throughput::SIZE`]; `None` leaves out this speed and the wrapper's overhead.
    pub workers: Option<WorkerCommand>,
    /// Hands and kernel; pictures are drawn only for the knobs of pictures.
    pub options: RolloutOptions,
}

/// Measures all knobs; `progress` is called with the next part, the number of scenes done, and the number of all.
///
/// # Errors
/// If a scene can't be simulated with the reference's options, or the speed can't be measured.
pub fn run(plan: &Plan, progress: impl Fn(&str, usize, usize)) -> Result<SimReport> {
    let mut rows = Vec::new();
    let mut scenes = Vec::new();
    let count = plan.scenes.len() + usize::from(plan.workers.is_some());
    for (index, scene) in plan.scenes.iter().enumerate() {
        let (all, soft) = (plan.knob_scenes.contains(&scene.name), scene.spec.has_soft_object());
        let fits = |knob: &Knob| (all || *knob == Knob::Preset) && (soft || *knob != Knob::Grid);
        let knobs: Vec<Knob> = plan.knobs.iter().copied().filter(fits).collect();
        if knobs.is_empty() {
            continue;
        }
        let bench = SceneBench { plan, scene, knobs };
        scenes.push(bench.physics(&mut rows, |what| progress(&format!("{}: {what}", scene.name), index, count))?);
        progress(&format!("{}: labels and pictures", scene.name), index, count);
        bench.labels(&mut rows)?;
        bench.pictures(&mut rows);
    }
    let position = |row: &Row| Knob::ALL.iter().position(|knob| knob.name() == row.knob);
    rows.sort_by_key(position);
    let (mut wrapper, mut throughput) = (None, None);
    if let (Some(workers), Some(first)) = (&plan.workers, plan.scenes.first()) {
        progress("wrapper and generate", count - 1, count);
        wrapper = Some(wrapper::measure(first, plan.seed, &plan.options, plan.repetitions)?);
        let scenes_of_knobs: Vec<Scene> =
            plan.scenes.iter().filter(|s| plan.knob_scenes.contains(&s.name)).cloned().collect();
        let mut jobs = vec![1, Machine::this().cores];
        jobs.dedup();
        let repetitions = plan.repetitions.min(2);
        throughput = Some(throughput::measure(
            &scenes_of_knobs,
            EPISODES,
            plan.seed,
            &jobs,
            &plan.options,
            workers,
            repetitions,
        )?);
    }
    Ok(SimReport {
        command: plan.command.clone(),
        seed: plan.seed,
        seeds: plan.seeds,
        egotac: egotac::VERSION.into(),
        mujoco: egotac::mujoco::version().into(),
        machine: Machine::this(),
        recommended: RECOMMENDED,
        model: PhysicsOptions::preset(Preset::Reference),
        scenes,
        rows,
        wrapper,
        throughput,
    })
}

/// Index of the reference model among the setups of a scene.
const MODEL: usize = 0;
/// Index of the default preset's reference.
const DEFAULT_REFERENCE: usize = 1;

/// Setups that are run in a scene, and the settings that use them.
struct Setups<'v> {
    setups: Vec<Setup>,
    settings: Vec<Setting<'v>>,
}

/// A variant with the indices of its setup, of its reference, and of the model that it is compared with.
struct Setting<'v> {
    variant: &'v Variant,
    setup: usize,
    reference: usize,
    model: usize,
}

/// Measurements in one scene.
struct SceneBench<'a> {
    plan: &'a Plan,
    scene: &'a Scene,
    knobs: Vec<Knob>,
}

impl SceneBench<'_> {
    /// Measures all settings of physics and hulls.
    fn physics(&self, rows: &mut Vec<Row>, progress: impl Fn(&str)) -> Result<SceneNote> {
        let variants: Vec<Variant> = self.knobs.iter().flat_map(|knob| knob.variants()).collect();
        let Setups { setups, settings } = self.setups(&variants)?;

        progress("forces");
        let seeds: Vec<u64> = (0..self.plan.seeds.max(1)).map(|i| self.plan.seed + i).collect();
        let runs: Vec<Vec<Result<(Trace, f64)>>> =
            setups.par_iter().map(|setup| seeds.par_iter().map(|seed| self.trace(setup, *seed)).collect()).collect();
        let first = |runs: &Vec<Result<(Trace, f64)>>| runs.first().and_then(|run| run.as_ref().ok()).map(|run| run.1);
        let mut times: Vec<Option<f64>> = runs.iter().map(first).collect();
        let traces: Vec<Vec<Result<Trace>>> =
            runs.into_iter().map(|runs| runs.into_iter().map(|run| run.map(|(trace, _)| trace)).collect()).collect();
        // Without the reference nothing can be compared. A setting that the scene refuses keeps the refusal in its row.
        let models = collect(&traces[MODEL])?;
        let quiet: Vec<Vec<usize>> = models.iter().map(|trace| trace.quiet()).collect();

        progress("times");
        let used = unique(settings.iter().map(|setting| setting.setup));
        let short = |index: &usize| setups[*index].physics.timestep >= TIMED_WITH_FORCES;
        let timed: Vec<usize> = used.into_iter().filter(short).collect();
        let timed_setups: Vec<&Setup> = timed.iter().map(|index| &setups[*index]).collect();
        let repetitions = self.plan.repetitions.max(1);
        let least = times::time_setups(self.scene, self.plan.seed, &timed_setups, &self.blind(), repetitions);
        timed.iter().zip(least).for_each(|(index, time)| times[*index] = time);

        if self.knobs.contains(&Knob::Preset) {
            let entry = self.replay(&traces[DEFAULT_REFERENCE], &models)?;
            put(rows, Knob::Preset.name(), Preset::Replay.name(), entry);
        }
        for Setting { variant, setup, reference, model } in settings {
            let mut entry = self.entry(&traces[setup], &traces[reference], &collect(&traces[model])?);
            if let Some(seconds) = times[setup] {
                entry.set_cost(seconds);
            }
            put(rows, variant.knob.name(), &variant.name, entry);
        }
        let interval = 1.0 / self.scene.spec.rate;
        let frames: usize = models.iter().map(|trace| trace.impulses.len()).sum();
        let quiet: usize = quiet.iter().map(Vec::len).sum();
        Ok(SceneNote {
            name: self.scene.name.clone(),
            seconds: frames as f64 * interval,
            quiet_seconds: quiet as f64 * interval,
        })
    }

    /// Returns the setups to run, each once: the reference model, the default's reference, then those of the variants.
    fn setups<'v>(&self, variants: &'v [Variant]) -> Result<Setups<'v>> {
        let physics = &self.scene.spec.physics;
        let default = Setup::new(physics, Change::Preset(Preset::Default))?;
        let mut setups = vec![Setup::model(physics)?, default.reference(physics)?];
        let mut settings = Vec::new();
        for variant in variants {
            let setup = Setup::new(physics, variant.change)?;
            let reference = setup.reference(physics)?;
            let model = Setup::model_for(physics, variant.change)?;
            let [setup, reference, model] = [setup, reference, model].map(|setup| index_of(&mut setups, setup));
            settings.push(Setting { variant, setup, reference, model });
        }
        Ok(Setups { setups, settings })
    }

    /// Returns the errors of a setting's runs, or the reason why the scene refuses it.
    fn entry(&self, runs: &[Result<Trace>], references: &[Result<Trace>], models: &[&Trace]) -> Entry {
        let quiet: Vec<Vec<usize>> = models.iter().map(|trace| trace.quiet()).collect();
        let mut entry = Entry { scene: self.scene.name.clone(), ..Entry::default() };
        match (collect(runs), collect(references)) {
            (Ok(runs), Ok(references)) => {
                entry.same = errors(&runs, &references, &quiet);
                entry.model = errors(&runs, models, &quiet);
                let lifts = runs.iter().zip(&quiet).filter_map(|(run, bins)| run.lift(bins));
                entry.lift = lifts.max_by(|a, b| (a - 1.0).abs().total_cmp(&(b - 1.0).abs()));
                let frames: usize = runs.iter().map(|run| run.touched.len()).sum();
                let invalid: usize = runs.iter().map(|run| run.invalid).sum();
                entry.invalid = Some(invalid as f64 / frames.max(1) as f64);
            }
            (Err(error), _) | (_, Err(error)) => entry.refused = Some(error.to_string()),
        }
        entry
    }

    fn trace(&self, setup: &Setup, seed: u64) -> Result<(Trace, f64)> {
        Trace::record_timed(&setup.scene(self.scene), seed, &setup.options(self.scene, &self.blind())?)
    }

    /// Measures the preset `replay`, which has no forces: its contacts on the recorded poses of the default model.
    fn replay(&self, recorded: &[Result<Trace>], models: &[&Trace]) -> Result<Entry> {
        let recorded = collect(recorded)?;
        let (mut same, mut model) = (Pool::default(), Pool::default());
        let mut entry = Entry { scene: self.scene.name.clone(), ..Entry::default() };
        for (index, (trace, other)) in recorded.iter().zip(models).enumerate() {
            let seed = self.plan.seed + index as u64;
            let replay = replay::replay(self.scene, seed, &trace.states, &self.blind(), self.plan.repetitions)?;
            same.add_sets(&replay.touched, &trace.touched);
            model.add_sets(&replay.touched, &other.touched);
            if index == 0 {
                entry.set_cost(replay.cost);
            }
        }
        (entry.same, entry.model) = (same.errors(), model.errors());
        Ok(entry)
    }

    fn labels(&self, rows: &mut Vec<Row>) -> Result<()> {
        if !self.knobs.contains(&Knob::Label) {
            return Ok(());
        }
        for (name, same, cost) in labels::label_kinds(self.scene, self.plan.seed, &self.blind(), self.plan.repetitions)?
        {
            let mut entry = Entry { scene: self.scene.name.clone(), same, ..Entry::default() };
            entry.set_cost(cost);
            put(rows, Knob::Label.name(), name, entry);
        }
        Ok(())
    }

    fn pictures(&self, rows: &mut Vec<Row>) {
        for (knob, name, cost) in
            pictures::picture_kinds(self.scene, self.plan.seed, &self.knobs, &self.plan.options, self.plan.repetitions)
        {
            let mut entry = Entry { scene: self.scene.name.clone(), ..Entry::default() };
            match cost {
                Ok(seconds) => entry.set_cost(seconds),
                Err(error) => entry.refused = Some(error.to_string()),
            }
            put(rows, knob.name(), name, entry);
        }
    }

    /// Returns the options without pictures.
    fn blind(&self) -> RolloutOptions {
        RolloutOptions { picture: None, ..self.plan.options.clone() }
    }
}

fn errors(runs: &[&Trace], references: &[&Trace], quiet: &[Vec<usize>]) -> Errors {
    let mut pool = Pool::default();
    for ((run, reference), bins) in runs.iter().zip(references).zip(quiet) {
        pool.add(run, reference, bins);
    }
    pool.errors()
}

fn collect(traces: &[Result<Trace>]) -> Result<Vec<&Trace>> {
    let first_error = traces.iter().find_map(|trace| trace.as_ref().err());
    match first_error {
        Some(error) => Err(egotac::Error::Engine(error.to_string())),
        None => Ok(traces.iter().flatten().collect()),
    }
}

/// Returns the index of `setup` in `setups`, and adds it if it is missing.
fn index_of(setups: &mut Vec<Setup>, setup: Setup) -> usize {
    setups.iter().position(|there| *there == setup).unwrap_or_else(|| {
        setups.push(setup);
        setups.len() - 1
    })
}

fn unique(values: impl Iterator<Item = usize>) -> Vec<usize> {
    let mut values: Vec<usize> = values.collect();
    values.sort_unstable();
    values.dedup();
    values
}

/// Adds an entry to the row of a setting, and the row if it is missing.
fn put(rows: &mut Vec<Row>, knob: &str, setting: &str, entry: Entry) {
    match rows.iter_mut().find(|row| row.knob == knob && row.setting == setting) {
        Some(row) => row.entries.push(entry),
        None => rows.push(Row { knob: knob.into(), setting: setting.into(), entries: vec![entry] }),
    }
}
