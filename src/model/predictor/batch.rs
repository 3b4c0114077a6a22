//! Several streams on one network: the newest images of several cameras pass the encoder in one batch.

use std::sync::Arc;

use candle_core::Tensor;

use super::{Prediction, Predictor, Prepared};
use crate::error::{Error, Result};
use crate::model::stages::FrameTokens;

/// Prepared image of one stream, with its stamp, s.
pub type StreamImage<'a> = (&'a mut Predictor, Prepared, f64);

impl Predictor {
    /// Creates a predictor for another stream of images on the same network, whose weights exist once.
    #[must_use]
    pub fn another_stream(&self) -> Self {
        let mut stream = self.clone();
        stream.reset();
        stream
    }

    /// Predicts touch for one image of each of several streams of one network, as [`Predictor::push_prepared`] does, with one
    /// pass of the encoder over all images. On the CPU the results are bit-equal to those of single calls.
    ///
    /// Returns one result per image. An image that fails leaves the other streams untouched.
    pub fn push_together(images: Vec<StreamImage>) -> Vec<Result<Prediction>> {
        // Those whose images are not encoded whole.
        if images.iter().any(|(stream, ..)| stream.hands.is_some() || stream.focused.is_on()) {
            let push = |(stream, input, stamp_secs): StreamImage| stream.push_prepared(input, stamp_secs);
            return images.into_iter().map(push).collect();
        }
        let reusable = |(stream, input, stamp_secs): &StreamImage| {
            stream.check(&input.whole, *stamp_secs).ok().and_then(|()| stream.reusable(&input.whole))
        };
        let reusable: Vec<Option<Arc<FrameTokens>>> = images.iter().map(reusable).collect();
        let fresh: Vec<&StreamImage> =
            images.iter().zip(&reusable).filter(|(_, tokens)| tokens.is_none()).map(|(image, _)| image).collect();
        // One by one if the batch fails, so that an error is that of its own image.
        let encoded = if fresh.len() > 1 { encode(&fresh).ok() } else { None };
        let mut encoded = encoded.unwrap_or_default().into_iter();
        let push = |((stream, input, stamp_secs), reusable): (StreamImage, Option<Arc<FrameTokens>>)| {
            if let Some(tokens) = reusable {
                return stream.push_reused(&tokens, stamp_secs);
            }
            let Some(tokens) = encoded.next() else { return stream.push_prepared(input, stamp_secs) };
            let tokens = Arc::new(tokens);
            let prediction = stream.push_encoded(&tokens, stamp_secs)?;
            stream.reuse.keep(&input.whole, &tokens);
            Ok(prediction)
        };
        images.into_iter().zip(reusable).map(push).collect()
    }
}

/// Encodes all images in one batch.
fn encode(images: &[&StreamImage]) -> Result<Vec<FrameTokens>> {
    let Some((first, ..)) = images.first() else { return Ok(Vec::new()) };
    let side = first.config().image;
    let mut batch = Vec::with_capacity(images.len() * 3 * side * side);
    for (stream, input, stamp_secs) in images {
        stream.check(&input.whole, *stamp_secs)?;
        let network = |of: &Predictor| format!("{} in {}", of.sha256(), of.model().precision());
        if network(stream) != network(first) {
            return Err(Error::value("network of a batch", network(first), network(stream)));
        }
        batch.extend_from_slice(&input.whole);
    }
    let input = Tensor::from_vec(batch, (images.len(), 3, side, side), &first.device)?;
    let FrameTokens { projected, encoded } = first.model().frame_tokens(&input)?;
    let each = encoded.chunks_exact(encoded.len() / images.len()).enumerate();
    // Copies, so that a stream that keeps its frame does not keep those of all others.
    each.map(|(index, encoded)| {
        let projected = projected.narrow(0, index, 1)?.force_contiguous()?;
        Ok(FrameTokens { projected, encoded: encoded.to_vec() })
    })
    .collect()
}
