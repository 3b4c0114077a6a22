//! The network's pass over one unit: images are read and decoded on other threads, labels go to the journal.

use std::collections::BTreeMap;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use super::journal::{Journal, Label};
use super::source::{Shot, Shots, Source};
use crate::error::Result;
use crate::image::Preparation;
use crate::model::Predictor;
use crate::model::predictor::Prediction;

/// Labels after which the journal is written.
const BLOCK: usize = 64;
/// Time after which it is written at the latest: what a killed process loses.
const AT_LATEST: Duration = Duration::from_secs(2);
/// Images that a decoder takes at a time; with the queues between the threads this bounds the memory.
const BATCH: usize = 4;

/// Where the time went, s.
#[derive(Debug, Clone, Copy, Default)]
pub struct Times {
    /// In the network.
    pub network: f64,
    /// Waiting for images.
    pub waiting: f64,
    /// Writing the journal.
    pub journal: f64,
}

/// Number of a batch, and its images by number.
type Batch = (usize, Vec<(usize, Shot)>);

/// An image ready for the network.
struct Ready {
    index: usize,
    stamp_secs: f64,
    input: std::result::Result<Vec<f32>, String>,
    note: Option<String>,
}

/// Labels what `journal` lacks of unit `unit`; `progress` hears of every finished image.
///
/// # Errors
/// If the unit can't be opened, the journal can't be written, or the device that the network runs on fails. An image that
/// can't be read or makes the network's numbers overflow gets its reason in place of a label.
pub fn label_unit(
    source: &dyn Source,
    unit: usize,
    predictor: &mut Predictor,
    journal: &mut Journal,
    decoders: usize,
    mut progress: impl FnMut(),
) -> Result<Times> {
    let mut times = Times::default();
    if journal.progress().complete {
        return Ok(times);
    }
    let done = journal.progress().clone();
    let from = done.kept.first().copied().unwrap_or(done.frames).min(done.frames);
    let wanted = |index: usize| index >= done.frames || done.kept.contains(&index);
    let preparation = predictor.metadata().preparation(predictor.config());
    let shots = source.shots(unit, from)?;
    predictor.reset();
    let mut recent = Recent::default();
    let mut written = Instant::now();
    read_ahead(shots, from, &wanted, &preparation, decoders, |ready, waited| {
        times.waiting += waited;
        let Ready { index, stamp_secs, input, note } = ready;
        if index < done.frames {
            if let Ok(input) = input {
                let prediction = predictor.push_prepared(input, stamp_secs)?;
                recent.push(index, &prediction);
            }
            return Ok(());
        }
        let started = Instant::now();
        let touch = input.and_then(|input| match predictor.push_prepared(input, stamp_secs) {
            Ok(prediction) => Ok(Ok(prediction)),
            Err(error) if error.is_recoverable() => Err(error.to_string()),
            Err(error) => Ok(Err(error)),
        });
        times.network += started.elapsed().as_secs_f64();
        let label = match touch {
            Ok(prediction) => {
                let prediction = prediction?;
                recent.push(index, &prediction);
                Label { stamp_secs, warming_up: prediction.warming_up, touch: Ok(prediction.field) }
            }
            Err(reason) => Label { stamp_secs, warming_up: false, touch: Err(reason) },
        };
        let started = Instant::now();
        journal.push(&label, note);
        if journal.pending() >= BLOCK || written.elapsed() > AT_LATEST {
            journal.flush(recent.kept(predictor), false)?;
            written = Instant::now();
        }
        times.journal += started.elapsed().as_secs_f64();
        progress();
        Ok(())
    })?;
    journal.flush(recent.kept(predictor), true)?;
    Ok(times)
}

/// Numbers and stamps of the images that the predictor may still hold.
#[derive(Debug, Default)]
struct Recent(Vec<(f64, usize)>);

impl Recent {
    fn push(&mut self, index: usize, prediction: &Prediction) {
        if prediction.restarted {
            self.0.clear();
        }
        // The same stamp again replaces the image.
        self.0.retain(|(stamp, _)| *stamp != prediction.stamp_secs);
        self.0.push((prediction.stamp_secs, index));
    }

    fn kept(&mut self, predictor: &Predictor) -> Vec<usize> {
        self.0.retain(|(stamp, _)| predictor.kept_stamps().any(|kept| kept == *stamp));
        self.0.iter().map(|(_, index)| *index).collect()
    }
}

/// Reads, decodes and prepares images on other threads; `take` gets those that are `wanted` in order, and the seconds
/// it was waited for each.
fn read_ahead(
    shots: Shots,
    from: usize,
    wanted: &(dyn Fn(usize) -> bool + Sync),
    preparation: &Preparation,
    decoders: usize,
    mut take: impl FnMut(Ready, f64) -> Result<()>,
) -> Result<()> {
    let decoders = decoders.max(1);
    let (to_decode, taken) = sync_channel::<Batch>(decoders);
    let (to_label, ready) = sync_channel::<(usize, Vec<Ready>)>(decoders);
    let taken = Arc::new(Mutex::new(taken));
    std::thread::scope(|scope| {
        scope.spawn(move || read(shots, from, wanted, to_decode));
        for _ in 0..decoders {
            let (taken, to_label) = (Arc::clone(&taken), to_label.clone());
            scope.spawn(move || decode(&taken, preparation, to_label));
        }
        // Whoever is left alone must learn it: channels close with the last thread that has the other end.
        drop((taken, to_label));
        in_order(ready, &mut take)
    })
}

fn read(shots: Shots, from: usize, wanted: &(dyn Fn(usize) -> bool + Sync), to_decode: SyncSender<Batch>) {
    let mut batch = Vec::with_capacity(BATCH);
    let mut number = 0;
    for (index, shot) in (from..).zip(shots).filter(|(index, _)| wanted(*index)) {
        batch.push((index, shot));
        // The first image goes on at once: the network waits for it.
        if batch.len() == BATCH || number == 0 {
            if to_decode.send((number, std::mem::take(&mut batch))).is_err() {
                return;
            }
            number += 1;
        }
    }
    // Nobody to hear the rest: nothing to do about it.
    let _ = to_decode.send((number, batch));
}

fn decode(taken: &Mutex<Receiver<Batch>>, preparation: &Preparation, to_label: SyncSender<(usize, Vec<Ready>)>) {
    loop {
        let batch = taken.lock().unwrap_or_else(PoisonError::into_inner).recv();
        let Ok((number, shots)) = batch else { return };
        let prepare = |(index, Shot { stamp_secs, offset, picture, note }): (usize, Shot)| {
            let input = picture.and_then(|picture| {
                let image = picture.decode().map_err(|error| error.to_string())?;
                preparation.apply(&image).map_err(|error| error.to_string())
            });
            let placed = |reason: String| match offset {
                Some(offset) => format!("at byte {offset}: {reason}"),
                None => reason,
            };
            Ready { index, stamp_secs, input: input.map_err(placed), note }
        };
        if to_label.send((number, shots.into_iter().map(prepare).collect())).is_err() {
            return;
        }
    }
}

/// Decoders finish out of order; the stream needs the images in order.
fn in_order(ready: Receiver<(usize, Vec<Ready>)>, take: &mut impl FnMut(Ready, f64) -> Result<()>) -> Result<()> {
    let mut waiting: BTreeMap<usize, Vec<Ready>> = BTreeMap::new();
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
