//! Two processes that label one recording, with their file operations in every order, by loom.
//!
//! The processes are threads that run [`Job::run`] itself on real files; `file::turn` marks where another one may go on.
//! Locks of files exclude two threads as they do two processes, since each has opened the file itself.

use std::fs;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};

use loom::model::Builder;
use loom::thread;

use super::job::{Job, LabelTiming, Outcome, Shard};
use crate::dataset::source::SourceFrames;
use crate::dataset::tensors::TensorOutput;
use crate::dataset::{ImageSource, InputFiles, Provenance, SourceFrame, Unit};
use crate::error::Result;
use crate::file::turn::model;
use crate::model::predictor::Options;
use crate::model::{Precision, Predictor, shipped};

/// Number of images of each unit.
const FRAMES: usize = 2;
/// Stack of a process, bytes; loom's own is too small for files.
const STACK: usize = 4 << 20;
/// All units in one process.
const ALL: Shard = Shard { index: 0, of: 1 };

/// A recording of damaged images, whose labels are the reasons for none: nothing is computed.
struct Recording {
    units: Vec<Unit>,
    file: PathBuf,
}

impl ImageSource for Recording {
    fn units(&self) -> &[Unit] {
        &self.units
    }

    fn files(&self) -> Result<InputFiles> {
        let mut files = InputFiles::new(&self.file);
        files.add([self.file.clone()]);
        Ok(files)
    }

    fn frames(&self, unit: usize, from: usize) -> Result<SourceFrames<'_>> {
        let frame = move |index: usize| {
            let reason = format!("image {index} of {unit} is damaged");
            Ok(SourceFrame::new((10 * unit + index) as f64, Err(reason)))
        };
        Ok(Box::new((from..FRAMES).map(frame)))
    }
}

/// A recording in a folder, and networks for the processes, which never use them.
struct Setting {
    folder: tempfile::TempDir,
    recording: Arc<Recording>,
    predictors: Mutex<Vec<Predictor>>,
    /// Output of a process that is alone.
    reference: Vec<u8>,
}

impl Setting {
    fn new(units: usize) -> Arc<Self> {
        // In memory where the system has such a folder: tests by turns write the same files thousands of times.
        let memory = Path::new("/dev/shm");
        let folder = match memory.is_dir() {
            true => tempfile::tempdir_in(memory).unwrap(),
            false => tempfile::tempdir().unwrap(),
        };
        let file = folder.path().join("input");
        fs::write(&file, b"content").unwrap();
        let units = (0..units).map(|unit| Unit { name: format!("unit {unit}"), frames: Some(FRAMES) }).collect();
        let predictor = || Predictor::load(&shipped::path().unwrap(), Options::default()).unwrap();
        let mut setting = Self {
            folder,
            recording: Arc::new(Recording { units, file }),
            predictors: Mutex::new(vec![predictor(), predictor()]),
            reference: Vec::new(),
        };
        assert!(matches!(setting.label(ALL), Ok(Outcome::Done(_))));
        setting.reference = fs::read(setting.out()).unwrap();
        Arc::new(setting)
    }

    fn out(&self) -> PathBuf {
        self.folder.path().join("out/labels")
    }

    /// Labels a share of the recording, as one process.
    fn label(&self, shard: Shard) -> Result<Outcome> {
        let mut predictor = self.predictors.lock().unwrap().pop().unwrap();
        let job = Job {
            source: self.recording.as_ref(),
            output: &TensorOutput { source: self.recording.clone(), with_info: true },
            out: self.out(),
            provenance: Provenance::of(&predictor, Precision::F32, vec!["a recording".into()]),
            decoders: 1,
        };
        let mut timing = LabelTiming::default();
        let run = || job.run(&mut predictor, shard, 0, &mut timing, &mut || {});
        let outcome = catch_unwind(AssertUnwindSafe(run));
        self.predictors.lock().unwrap().push(predictor);
        outcome.unwrap_or_else(|killed| resume_unwind(killed))
    }

    /// Runs two processes in every order of their file operations in which at most `preemptions` of them are held up;
    /// `killed_after`: turns after which the first is killed. Calls `check` with the outcomes, None for the killed one's.
    fn interleave(
        self: &Arc<Self>,
        shards: [Shard; 2],
        preemptions: usize,
        killed_after: Option<usize>,
        check: fn(&Self, Vec<Option<Result<Outcome>>>),
    ) {
        let mut model = Builder::new();
        model.preemption_bound = Some(preemptions);
        model.max_branches = 10_000;
        let setting = Arc::clone(self);
        model.check(move || {
            let setting = Arc::clone(&setting);
            let all = move || {
                setting.clear();
                model::begin();
                let processes = [0, 1].map(|index| {
                    let setting = Arc::clone(&setting);
                    start(move || setting.label_until(shards[index], killed_after.filter(|_| index == 0)))
                });
                let outcomes = processes.into_iter().map(|process| process.join().unwrap()).collect();
                model::end();
                check(&setting, outcomes);
            };
            start(all).join().unwrap();
        });
    }

    /// Labels a share of the recording; None = was killed after that number of turns.
    fn label_until(&self, shard: Shard, killed_after: Option<usize>) -> Option<Result<Outcome>> {
        if let Some(turns) = killed_after {
            model::kill_after(turns);
        }
        match catch_unwind(AssertUnwindSafe(|| self.label(shard))) {
            Ok(outcome) => Some(outcome),
            Err(killed) if killed.is::<model::Killed>() => None,
            Err(other) => resume_unwind(other),
        }
    }

    /// Removes the output and what was left beside it.
    fn clear(&self) {
        let out = self.out();
        let outputs = out.parent().unwrap();
        fs::remove_dir_all(outputs).unwrap();
        fs::create_dir(outputs).unwrap();
    }

    /// Checks that the output is that of one process alone, and that nothing else is left.
    fn check_output(&self) {
        let out = self.out();
        assert!(fs::read(&out).unwrap() == self.reference, "the output differs");
        let names = fs::read_dir(out.parent().unwrap()).unwrap().map(|entry| entry.unwrap().file_name());
        assert_eq!(names.collect::<Vec<_>>(), ["labels"]);
    }
}

/// Starts a thread of loom with enough stack.
fn start<R: Send + 'static>(work: impl FnOnce() -> R + Send + 'static) -> thread::JoinHandle<R> {
    thread::Builder::new().stack_size(STACK / size_of::<usize>()).spawn(work).unwrap()
}

#[test]
fn two_shards_assemble_one_output_in_every_order() {
    let shards = [0, 1].map(|index| Shard { index, of: 2 });
    Setting::new(2).interleave(shards, 2, None, |setting, outcomes| {
        let done = |outcome: &Option<Result<Outcome>>| match outcome {
            Some(Ok(outcome)) => matches!(outcome, Outcome::Done(_)),
            other => panic!("a shard fails: {other:?}"),
        };
        assert_eq!(outcomes.iter().filter(|outcome| done(outcome)).count(), 1, "{outcomes:?}");
        setting.check_output();
    });
}

#[test]
fn of_two_runs_at_once_one_labels_and_the_other_is_refused_or_finds_it_done() {
    Setting::new(1).interleave([ALL; 2], 2, None, |setting, outcomes| {
        for outcome in &outcomes {
            if let Some(Err(error)) = outcome {
                assert!(error.to_string().contains("another process is labelling it"), "{error}");
            }
        }
        assert!(outcomes.iter().any(|outcome| matches!(outcome, Some(Ok(Outcome::Done(_))))), "{outcomes:?}");
        setting.check_output();
    });
}

#[test]
fn a_process_that_is_killed_at_any_turn_costs_the_other_one_nothing() {
    let shards = [0, 1].map(|index| Shard { index, of: 2 });
    let setting = Setting::new(2);
    for turns in 0..40 {
        setting.interleave(shards, 1, Some(turns), |setting, outcomes| {
            let others = outcomes.into_iter().flatten();
            others.for_each(|outcome| assert!(outcome.is_ok(), "{outcome:?}"));
            // The same command again, as often as there are shards.
            let again = (0..2).map(|index| setting.label(Shard { index, of: 2 }).unwrap());
            assert!(again.filter(|outcome| !matches!(outcome, Outcome::Waiting)).count() > 0);
            setting.check_output();
        });
    }
}
