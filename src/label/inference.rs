//! Inference over one unit: images are read and decoded on other threads, labels go to the journal.

use std::collections::BTreeMap;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use super::budget::{Budget, Share};
use super::journal::Journal;
use super::labeller::{InferenceTiming, Labeller};
use crate::dataset::source::{EncodedImage, SourceFrames};
use crate::dataset::{ImageSource, LabelFrame, SourceFrame};
use crate::error::{Error, Result};
use crate::model::Predictor;
use crate::model::predictor::{InputPreparation, Prediction, Prepared};
use crate::text::{printable_name, shortened, tell};

/// Number of labels in a journal block.
const BLOCK: usize = 64;
/// Longest time between two journal writes: the work that a killed process loses.
const AT_LATEST: Duration = Duration::from_secs(2);
/// Largest number of characters of the reason why an image has no label: it may quote the input.
const REASON: usize = 400;
/// Number of images that a decoder takes at a time; together with the queue lengths it bounds the memory.
const BATCH: usize = 4;

/// Number of a batch, and its images by index, each with its share of the memory.
type Batch = (usize, Vec<(usize, SourceFrame, Share)>);

/// An image prepared for the network.
struct PreparedImage {
    index: usize,
    stamp_secs: f64,
    /// Input of the network.
    input: std::result::Result<Prepared, String>,
    /// Width and height of the image, pixels; 0 if it can't be decoded.
    size: (u32, u32),
    note: Option<String>,
}

/// Maker of labels by a network.
pub(super) struct NetworkLabeller<'a> {
    /// The network and its window.
    pub predictor: &'a mut Predictor,
    /// Number of threads that decode images beside the network.
    pub decoders: usize,
    /// True to keep the keypoints of the hands.
    pub keypoints: bool,
    /// True once people know that the network does not see the whole picture.
    pub view_told: bool,
}

impl Labeller for NetworkLabeller<'_> {
    fn label_unit(
        &mut self,
        source: &dyn ImageSource,
        unit: usize,
        journal: &mut Journal,
        progress: &mut dyn FnMut(),
    ) -> Result<InferenceTiming> {
        label_unit(source, unit, self, journal, progress)
    }
}

/// Labels the images of unit `unit` that `journal` lacks; calls `progress` after every image. An image that is damaged, or
/// for which the network gives no finite numbers, gets a reason in place of a label.
///
/// # Errors
/// If the unit can't be opened or read to its end, the journal can't be written, or the network's device fails. The journal
/// then holds the labels of all images before the failure and stays open: the next run goes on there.
fn label_unit(
    source: &dyn ImageSource,
    unit: usize,
    labeller: &mut NetworkLabeller,
    journal: &mut Journal,
    mut progress: impl FnMut(),
) -> Result<InferenceTiming> {
    let NetworkLabeller { predictor, decoders, keypoints, view_told } = labeller;
    let mut timing = InferenceTiming::default();
    if journal.progress().complete {
        return Ok(timing);
    }
    let done = journal.progress().clone();
    // Replay the images that the window of the next one needs.
    let from = done.kept.first().copied().unwrap_or(done.frames).min(done.frames);
    let wanted = |index: usize| index >= done.frames || done.kept.contains(&index);
    let preparation = predictor.preparation();
    let frames = source.frames(unit, from)?;
    predictor.reset();
    let mut recent = Recent::default();
    let mut written = Instant::now();
    let end = prepare_images(frames, from, &wanted, &preparation, *decoders, |ready, waited| {
        timing.waiting_secs += waited;
        let PreparedImage { index, stamp_secs, input, size: (width, height), note } = ready;
        if index < done.frames {
            if let Ok(input) = input {
                let prediction = predictor.push_prepared(input, stamp_secs)?;
                recent.push(index, &prediction);
            }
            return Ok(());
        }
        if input.is_ok()
            && !*view_told
            && let Some(warning) = preparation.whole.warning(width as usize, height as usize)
        {
            *view_told = true;
            let name = &source.units()[unit].name;
            tell(format_args!("warning: {}: {warning} (--view)", printable_name(name)));
        }
        let started = Instant::now();
        let touch = input.and_then(|input| match predictor.push_prepared(input, stamp_secs) {
            Ok(prediction) => Ok(Ok(prediction)),
            Err(error) if error.is_recoverable() => Err(error.to_string()),
            Err(error) => Ok(Err(error)),
        });
        timing.network_secs += started.elapsed().as_secs_f64();
        let label = match touch {
            Ok(prediction) => {
                let prediction = prediction?;
                recent.push(index, &prediction);
                let warming_up = prediction.warming_up;
                let certainty = prediction.certainty;
                let found = keypoints.then(|| prediction.keypoints(&preparation.whole, width, height)).flatten();
                let further = found.map_or_else(Vec::new, |keypoints| keypoints.as_flattened().to_vec());
                LabelFrame { stamp_secs, warming_up, touch: Ok(prediction.field), certainty, further }
            }
            Err(reason) => LabelFrame::without(stamp_secs, reason),
        };
        let started = Instant::now();
        journal.push(&label, note);
        if journal.pending() >= BLOCK || written.elapsed() > AT_LATEST {
            journal.flush(recent.kept(predictor), false)?;
            written = Instant::now();
        }
        timing.journal_secs += started.elapsed().as_secs_f64();
        progress();
        Ok(())
    })?;
    journal.flush(recent.kept(predictor), end.is_ok())?;
    let (unit, frames) = (source.units()[unit].name.clone(), journal.progress().frames);
    end.map_err(|cause| Error::Stopped { unit, frames, cause: Box::new(cause) })?;
    Ok(timing)
}

/// Stamps and indices of the images that the predictor's window may hold; a resumed run replays these images.
#[derive(Debug, Default)]
struct Recent(Vec<(f64, usize)>);

impl Recent {
    fn push(&mut self, index: usize, prediction: &Prediction) {
        if prediction.restarted {
            self.0.clear();
        }
        // The predictor replaces an image by a later one of the same stamp.
        self.0.retain(|(stamp, _)| *stamp != prediction.stamp_secs);
        self.0.push((prediction.stamp_secs, index));
    }

    fn kept(&mut self, predictor: &Predictor) -> Vec<usize> {
        self.0.retain(|(stamp, _)| predictor.kept_stamps().any(|kept| kept == *stamp));
        self.0.iter().map(|(_, index)| *index).collect()
    }
}

/// Reads, decodes and prepares the `wanted` images on other threads. Calls `take` with each in order, and with the seconds
/// spent waiting for it. The inner error says why the images could not be read to their end.
///
/// # Errors
/// If `take` fails.
fn prepare_images(
    frames: SourceFrames,
    from: usize,
    wanted: &(dyn Fn(usize) -> bool + Sync),
    preparation: &InputPreparation,
    decoders: usize,
    mut take: impl FnMut(PreparedImage, f64) -> Result<()>,
) -> Result<Result<()>> {
    let decoders = decoders.max(1);
    let (to_decode, taken) = sync_channel::<Batch>(decoders);
    let (to_label, ready) = sync_channel::<(usize, Vec<PreparedImage>)>(decoders);
    let taken = Arc::new(Mutex::new(taken));
    std::thread::scope(|scope| {
        let reader = scope.spawn(move || read(frames, from, wanted, to_decode));
        for _ in 0..decoders {
            let (taken, to_label) = (Arc::clone(&taken), to_label.clone());
            scope.spawn(move || decode(&taken, preparation, to_label));
        }
        // Drop our ends, so that threads see the channels close.
        drop((taken, to_label));
        in_order(ready, &mut take)?;
        Ok(reader.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic)))
    })
}

/// Sends the `wanted` images in batches. The images before one that can't be read are sent before the error is returned.
fn read(
    frames: SourceFrames,
    from: usize,
    wanted: &(dyn Fn(usize) -> bool + Sync),
    to_decode: SyncSender<Batch>,
) -> Result<()> {
    let budget = Budget::default();
    let mut batch = Vec::with_capacity(BATCH);
    let mut number = 0;
    let mut send = |batch: &mut Vec<_>| {
        let sent = to_decode.send((number, std::mem::take(batch)));
        number += 1;
        // Receiver gone: there is nothing left to do.
        sent.is_ok()
    };
    let mut first = true;
    let mut end = Ok(());
    for (index, frame) in (from..).zip(frames) {
        let frame = match frame {
            Ok(frame) if wanted(index) => frame,
            Ok(_) => continue,
            Err(error) => {
                end = Err(error);
                break;
            }
        };
        let bytes = frame.image.as_ref().map_or(0, EncodedImage::memory);
        let share = match budget.try_take(bytes) {
            Some(share) => share,
            None => {
                if !send(&mut batch) {
                    return Ok(());
                }
                budget.take(bytes)
            }
        };
        batch.push((index, frame, share));
        // Send the first image at once: the network waits for it.
        if (batch.len() == BATCH || first) && !send(&mut batch) {
            return Ok(());
        }
        first = false;
    }
    send(&mut batch);
    end
}

fn decode(
    taken: &Mutex<Receiver<Batch>>,
    preparation: &InputPreparation,
    to_label: SyncSender<(usize, Vec<PreparedImage>)>,
) {
    loop {
        let batch = taken.lock().unwrap_or_else(PoisonError::into_inner).recv();
        let Ok((number, frames)) = batch else { return };
        let prepare = |(index, frame, _share): (usize, SourceFrame, Share)| {
            let SourceFrame { stamp_secs, offset, image, note } = frame;
            let mut size = (0, 0);
            let input = image.and_then(|image| {
                let image = image.decode().map_err(|error| error.to_string())?;
                size = image.dimensions();
                preparation.apply(&image).map_err(|error| error.to_string())
            });
            let placed = |reason: String| match (shortened(&reason, REASON), offset) {
                (reason, Some(offset)) => format!("at byte {offset}: {reason}"),
                (reason, None) => reason.into_owned(),
            };
            PreparedImage { index, stamp_secs, input: input.map_err(placed), size, note }
        };
        if to_label.send((number, frames.into_iter().map(prepare).collect())).is_err() {
            return;
        }
    }
}

/// Restores the order of the images, which decoders finish out of order.
fn in_order(
    ready: Receiver<(usize, Vec<PreparedImage>)>,
    take: &mut impl FnMut(PreparedImage, f64) -> Result<()>,
) -> Result<()> {
    let mut waiting: BTreeMap<usize, Vec<PreparedImage>> = BTreeMap::new();
    let mut next = 0;
    loop {
        let started = Instant::now();
        let Ok((number, batch)) = ready.recv() else { return Ok(()) };
        let mut waited = started.elapsed().as_secs_f64();
        waiting.insert(number, batch);
        while let Some(batch) = waiting.remove(&next) {
            for image in batch {
                take(image, std::mem::take(&mut waited))?;
            }
            next += 1;
        }
    }
}
