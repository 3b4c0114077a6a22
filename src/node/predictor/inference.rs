//! Inference loop of the predictor: takes the newest image of each camera, predicts on all in one batch, and publishes.

use std::time::{Duration, Instant};

use rayon::prelude::*;

use super::fusion::Fusion;
use super::input::{Input, NewestImages, Seen};
use super::load_model::{LoadedModel, PendingModel};
use super::model_id::ModelId;
use super::stream::CameraStream;
use crate::message::HandModelInfo;
use crate::model::Predictor;
use crate::node::log::Log;
use crate::node::publisher::Publisher;
use crate::node::shutdown::Shutdown;

/// Longest wait for an image; bounds the delay of shutdown and of a network exchange.
const IMAGE_TIMEOUT: Duration = Duration::from_millis(50);

/// Inference loop; runs on its own thread.
pub(super) struct Inference {
    /// Streams of all cameras, on one network.
    pub(super) streams: Vec<CameraStream>,
    /// Images that wait; sources are places in `streams`.
    pub(super) newest: NewestImages,
    /// Result of all cameras together, if there are several.
    pub(super) fusion: Option<Fusion>,
    pub(super) model_id: ModelId,
    /// Network that replaces the present one before the next image.
    pub(super) pending: PendingModel,
    /// Publisher of `~/model_info`.
    pub(super) info: Publisher<HandModelInfo>,
    pub(super) log: Log,
}

impl Inference {
    /// Processes images until `shutdown`; an image that fails is logged and counted.
    pub(super) fn run(mut self, shutdown: &Shutdown) {
        while !shutdown.requested() {
            let images = self.newest.take(IMAGE_TIMEOUT);
            if let Some(loaded) = self.pending.take() {
                self.replace(loaded);
            }
            if !images.is_empty() {
                self.process(&images);
            }
        }
    }

    /// Replaces the network; the observation windows of the new one are empty.
    fn replace(&mut self, LoadedModel { predictor, info }: LoadedModel) {
        self.streams.iter_mut().for_each(|stream| stream.replace(predictor.another_stream()));
        self.model_id.get().clone_from(&info.model_id);
        if let Err(error) = self.info.publish(&info) {
            self.log.warn_throttled("publish", format!("~/model_info: {error:#}"));
        }
    }

    /// Processes at most one image of each camera, in the order of the cameras.
    fn process(&mut self, images: &[(usize, Vec<u8>)]) {
        let started = Instant::now();
        let mut seen = self.decode(images);
        let mut waiting = seen.iter_mut().peekable();
        let mut batch = Vec::with_capacity(images.len());
        for (camera, stream) in self.streams.iter_mut().enumerate() {
            if let Some((_, seen)) = waiting.next_if(|next| next.0 == camera) {
                batch.push((&mut stream.predictor, std::mem::take(&mut seen.prepared), seen.stamp_secs));
            }
        }
        let results = Predictor::push_together(batch);
        let secs = started.elapsed().as_secs_f64();
        let mut frames = Vec::with_capacity(seen.len());
        for ((camera, seen), result) in seen.into_iter().zip(results) {
            let stream = &mut self.streams[camera];
            if let Some(frame) = stream.finish(&seen, result, secs) {
                frames.push((camera, frame));
            }
            stream.input.give_back(seen.image);
        }
        if let Some(fusion) = &mut self.fusion {
            fusion.publish(frames, &self.log);
        }
    }

    /// Decodes images, those of several cameras on several threads; leaves out those that are not usable.
    fn decode(&self, images: &[(usize, Vec<u8>)]) -> Vec<(usize, Seen)> {
        // The publishers beside them must stay on this thread.
        let inputs: Vec<(&Input, &Predictor)> =
            self.streams.iter().map(|stream| (&stream.input, &stream.predictor)).collect();
        let decode = |(camera, payload): &(usize, Vec<u8>)| {
            let (input, predictor) = inputs[*camera];
            Some((*camera, input.decode(payload, predictor)?))
        };
        match images {
            [only] => decode(only).into_iter().collect(),
            several => several.par_iter().filter_map(decode).collect(),
        }
    }
}
