//! One labelling, from an input to its output; resumes where an earlier process stopped.

use std::fs;
use std::path::{Path, PathBuf};
use std::time::Instant;

use super::inference::NetworkLabeller;
use super::labeller::{InferenceTiming, Labeller};
use super::workspace::{self, Workspace};
use crate::dataset::{ImageSource, InputState, LabelInfo, LabelOutput, LabelSummary, Provenance, UnlabelledImage};
use crate::error::{Error, Result};
use crate::file::turn::turn;
use crate::model::Predictor;

/// A share of the units: those whose number modulo `of` is `index`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Shard {
    /// Index of the shard, from 0 on.
    pub index: usize,
    /// Number of shards.
    pub of: usize,
}

/// One recording to label, and its output.
pub struct Job<'a> {
    /// Source of the images.
    pub source: &'a dyn ImageSource,
    /// Writer of the output.
    pub output: &'a dyn LabelOutput,
    /// Path of the output.
    pub out: PathBuf,
    /// Origin and meaning of the labels, which the output states; the job sets the identity of the input.
    pub provenance: Provenance,
    /// Number of threads that decode images beside the network.
    pub decoders: usize,
}

/// Result of a job.
#[derive(Debug, Clone)]
pub enum Outcome {
    /// The output is complete.
    Done(LabelInfo),
    /// An earlier run completed the output from the same input and settings.
    DoneBefore(LabelInfo),
    /// The units of this shard are labelled; other units are not.
    Waiting,
}

/// Number of images that a run labelled, and its wall time.
#[derive(Debug, Clone, Copy, Default)]
pub struct LabelTiming {
    /// Number of images labelled by this run, without earlier ones.
    pub frames: u64,
    /// Wall time of inference, s.
    pub inference_secs: f64,
    /// Wall time of assembly, s.
    pub assembly_secs: f64,
    /// Parts of the inference time.
    pub inference: InferenceTiming,
}

impl Job<'_> {
    /// Returns the number of images, of all units, that earlier runs labelled.
    ///
    /// # Errors
    /// If an unfinished job of another input or other settings lies there, or a journal can't be read.
    pub fn done(&self) -> Result<u64> {
        if self.out.exists() || !workspace::exists(&self.out)? {
            return Ok(0);
        }
        let input = self.input()?;
        let workspace = Workspace::open(&self.out, &self.provenance(&input), &input, self.source.units())?;
        let mut done = 0;
        for unit in 0..self.source.units().len() {
            done += workspace.progress(unit)?.frames as u64;
        }
        Ok(done)
    }

    /// Labels the unfinished units of `shard`, and assembles the output once all units are complete. Unit numbers start at
    /// `first_number`, so that shards divide the units of several jobs.
    ///
    /// # Errors
    /// If `out` exists but is not the output of this job, another process labels one of the units, the input can't be
    /// opened, can't be read to its end or changes meanwhile, or the output can't be written.
    pub fn run(
        &self,
        predictor: &mut Predictor,
        shard: Shard,
        first_number: usize,
        timing: &mut LabelTiming,
        progress: &mut dyn FnMut(),
    ) -> Result<Outcome> {
        let mut labeller = NetworkLabeller {
            predictor,
            decoders: self.decoders,
            keypoints: self.provenance.keypoints,
            view_told: false,
        };
        self.run_with(&mut labeller, shard, first_number, timing, progress)
    }

    /// As [`Job::run`], with labels of any origin.
    ///
    /// # Errors
    /// As [`Job::run`].
    pub fn run_with(
        &self,
        labeller: &mut dyn Labeller,
        shard: Shard,
        first_number: usize,
        timing: &mut LabelTiming,
        progress: &mut dyn FnMut(),
    ) -> Result<Outcome> {
        let input = self.input()?;
        let provenance = self.provenance(&input);
        turn();
        if self.out.exists() {
            return self.done_before(&provenance).map(Outcome::DoneBefore);
        }
        let outcome = self.label(labeller, shard, first_number, (&input, &provenance), timing, progress);
        turn();
        match outcome {
            // Another process has published the output meanwhile, and taken the workspace away.
            Err(_) | Ok(Outcome::Waiting) if self.out.exists() => {
                self.done_before(&provenance).map(Outcome::DoneBefore)
            }
            outcome => outcome,
        }
    }

    /// As [`run_with`](Self::run_with), of an output that does not exist yet.
    fn label(
        &self,
        labeller: &mut dyn Labeller,
        shard: Shard,
        first_number: usize,
        (input, provenance): (&InputState, &Provenance),
        timing: &mut LabelTiming,
        progress: &mut dyn FnMut(),
    ) -> Result<Outcome> {
        self.output.check(self.provenance.topology)?;
        if self.provenance.keypoints && !self.output.holds_keypoints() {
            return Err(Error::file(
                &self.out,
                "keypoints: expected a format that holds them, got a bag; use --to store",
            ));
        }
        if let Some(parent) = self.out.parent().filter(|parent| !parent.as_os_str().is_empty()) {
            fs::create_dir_all(parent).map_err(Error::io(parent))?;
        }
        let units = self.source.units();
        let workspace = Workspace::open(&self.out, provenance, input, units)?;
        let started = Instant::now();
        for unit in (0..units.len()).filter(|unit| (first_number + unit) % shard.of == shard.index) {
            let Some(mut journal) = workspace.journal(unit)? else {
                return Err(Error::file(&self.out, format!("{}: another process is labelling it", units[unit].name)));
            };
            let of_unit = labeller.label_unit(self.source, unit, &mut journal, &mut || {
                timing.frames += 1;
                progress()
            })?;
            timing.inference.add(&of_unit);
        }
        timing.inference_secs += started.elapsed().as_secs_f64();
        if !workspace.is_complete(units.len())? {
            return Ok(Outcome::Waiting);
        }
        let Some(lock) = workspace.lock()? else { return Ok(Outcome::Waiting) };
        // Another shard may have published the output before this one took the lock, and this one made its workspace anew:
        // it is a leftover, which nobody removes while it is locked.
        turn();
        if self.out.exists() {
            drop(lock);
            return self.done_before(provenance).map(Outcome::DoneBefore);
        }
        let started = Instant::now();
        self.check_unchanged(input)?;
        let mut info = LabelInfo { provenance: provenance.clone(), summary: self.summary(&workspace)? };
        self.output.assemble(&workspace, &mut info, &workspace.unfinished(), &self.out)?;
        self.check_unchanged(input)?;
        workspace.publish(&self.out)?;
        timing.assembly_secs += started.elapsed().as_secs_f64();
        Ok(Outcome::Done(info))
    }

    /// Returns the description of an output that an earlier run completed, and removes files that the earlier run may have left.
    fn done_before(&self, provenance: &Provenance) -> Result<LabelInfo> {
        const ADVICE: &str = "choose another output, or remove it";
        let refused = |is: String| Err(Error::file(&self.out, format!("{is}; {ADVICE}")));
        let Some(info) = self.output.info(&self.out) else {
            return refused("exists, and is not an output of this command".into());
        };
        let there = &info.provenance;
        if !there.has_input_of(provenance) {
            let [there, here] = [there, provenance].map(Provenance::input_text);
            return refused(format!("holds the labels of another input, {there}, not of {here}"));
        }
        if there != provenance {
            return refused(format!("holds the labels of {} with other settings", there.input_text()));
        }
        Workspace::remove_leftovers(&self.out)?;
        Ok(info)
    }

    fn input(&self) -> Result<InputState> {
        InputState::of(&self.source.files()?)
    }

    fn provenance(&self, input: &InputState) -> Provenance {
        Provenance { input: Some(input.identity.clone()), ..self.provenance.clone() }
    }

    /// Checks that the input is still as it was: labels of images that have changed since belong to no input.
    fn check_unchanged(&self, before: &InputState) -> Result<()> {
        match before.is_same(&self.input()?) {
            true => Ok(()),
            false => Err(Error::file(
                before.place(),
                "has changed while it was labelled; label it again once it is complete",
            )),
        }
    }

    fn summary(&self, workspace: &Workspace) -> Result<LabelSummary> {
        let mut summary = LabelSummary::default();
        for (index, unit) in self.source.units().iter().enumerate() {
            let before = summary.counts.frames;
            for head in workspace.heads(index)? {
                let head = head?;
                let fault = |(place, reason): (usize, String)| {
                    let frame = (head.first + place) as u64;
                    UnlabelledImage { unit: unit.name.clone(), frame, reason }
                };
                summary.add_images(&head.counts, head.faults.into_iter().map(fault));
            }
            summary.lost.extend(self.source.damage(index, (summary.counts.frames - before) as usize)?);
        }
        Ok(summary)
    }
}

impl std::fmt::Debug for Job<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Job").field("out", &self.out).finish_non_exhaustive()
    }
}

/// True if `out` lies in `input` or is `input`: a job never writes to its input.
pub fn is_within(out: &Path, input: &Path) -> bool {
    // `out` need not exist: resolve its longest existing ancestor.
    let real = |path: &Path| {
        path.ancestors().find_map(|up| Some((up.canonicalize().ok()?, path.strip_prefix(up).ok()?.to_path_buf())))
    };
    match (real(out), input.canonicalize()) {
        (Some((there, rest)), Ok(input)) => there.join(rest).starts_with(input),
        _ => false,
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;
    use std::sync::atomic::{AtomicBool, Ordering};

    use ::image::{Rgb, RgbImage};

    use super::*;
    use crate::dataset::source::{EncodedImage, SourceFrames};
    use crate::dataset::tensors::TensorOutput;
    use crate::dataset::{InputFiles, SourceFrame, Unit};
    use crate::model::predictor::Options;
    use crate::model::{Precision, shipped};

    const FRAMES: usize = 12;
    const BAD: usize = 3;
    const STOP: usize = 7;

    /// A source with an image that can't be decoded; its medium fails at an image as long as `fails`.
    struct FailingSource {
        units: [Unit; 1],
        file: PathBuf,
        fails: AtomicBool,
    }

    impl ImageSource for FailingSource {
        fn units(&self) -> &[Unit] {
            &self.units
        }

        fn files(&self) -> Result<InputFiles> {
            let mut files = InputFiles::new(&self.file);
            files.add([self.file.clone()]);
            Ok(files)
        }

        fn frames(&self, _: usize, from: usize) -> Result<SourceFrames<'_>> {
            Ok(Box::new((from..FRAMES).map(|index| {
                if index == STOP && self.fails.load(Ordering::Relaxed) {
                    return Err(Error::io("disk")(std::io::Error::from_raw_os_error(libc::EIO)));
                }
                let pixels = RgbImage::from_pixel(40, 32, Rgb([20 * index as u8, 90, 40]));
                let image = match index {
                    BAD => EncodedImage::File(b"no image".to_vec()),
                    _ => EncodedImage::Pixels(pixels),
                };
                Ok(SourceFrame::new(0.04 * index as f64, Ok(image)))
            })))
        }
    }

    fn run(source: &Arc<FailingSource>, out: &Path) -> Result<(Outcome, u64)> {
        let mut predictor = Predictor::load(&shipped::path()?, Options::default())?;
        let job = Job {
            source: source.as_ref(),
            output: &TensorOutput { source: source.clone(), with_info: true },
            out: out.to_path_buf(),
            provenance: Provenance::of(&predictor, Precision::F32, vec!["a source".into()]),
            decoders: 2,
        };
        let mut timing = LabelTiming::default();
        let outcome = job.run(&mut predictor, Shard { index: 0, of: 1 }, 0, &mut timing, &mut || {})?;
        Ok((outcome, timing.frames))
    }

    #[test]
    fn a_medium_that_fails_stops_the_recording_and_the_next_run_goes_on_there() {
        let folder = tempfile::tempdir().unwrap();
        let [file, out, whole] = ["input", "out", "whole"].map(|name| folder.path().join(name));
        fs::write(&file, b"content").unwrap();
        let units = [Unit { name: "the only unit".into(), frames: Some(FRAMES) }];
        let source = Arc::new(FailingSource { units, file: file.clone(), fails: AtomicBool::new(true) });
        for _ in 0..2 {
            let error = run(&source, &out).unwrap_err().to_string();
            assert_eq!(
                error,
                "disk: Input/output error (os error 5); 7 images of the only unit are labelled, and the same command goes on there"
            );
            assert!(!out.exists());
        }
        source.fails.store(false, Ordering::Relaxed);
        let (Outcome::Done(info), frames) = run(&source, &out).unwrap() else { panic!("the output is complete") };
        assert_eq!((frames, info.summary.counts.labelled), ((FRAMES - STOP) as u64, FRAMES as u64 - 1));
        assert_eq!(info.summary.faults[0].frame, BAD as u64);
        run(&source, &whole).unwrap();
        assert!(fs::read(&out).unwrap() == fs::read(&whole).unwrap());
        // The input changes while it is labelled.
        source.fails.store(true, Ordering::Relaxed);
        fs::remove_file(&out).unwrap();
        run(&source, &out).unwrap_err();
        fs::write(&file, b"content and more").unwrap();
        source.fails.store(false, Ordering::Relaxed);
        let error = run(&source, &out).unwrap_err().to_string();
        assert!(error.contains("as it was before it changed") && error.contains("or remove"), "{error}");
    }
}
