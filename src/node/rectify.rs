//! Rectification of live images by the camera's `camera_info`, where the parameter `rectify` asks for it.

use std::sync::{Arc, Mutex};

use ::image::RgbImage;

use super::input_topics::{InputTopic, Need};
use super::lock::lock;
use super::params::{Allowed, Parameter};
use super::qos;
use super::runtime::Runtime;
use crate::error::{Error, Result};
use crate::image::rectify::{Calibration, Rectifier};
use crate::message::{CameraInfo, Header};

/// Rectifies images; clones share the calibration.
#[derive(Debug, Clone, Default)]
pub(crate) struct Rectification(Arc<Mutex<State>>);

#[derive(Debug, Default)]
struct State {
    /// Newest calibration, without header.
    newest: Option<CameraInfo>,
    /// Calibration that the rectifier was made of.
    prepared: Option<(CameraInfo, Rectifier)>,
}

impl Rectification {
    /// Declares the parameter `rectify`.
    pub(crate) fn parameter() -> Parameter {
        Parameter::fixed(
            "rectify",
            false,
            Allowed::Any,
            "Rectify images by the topic camera_info (plumb_bob, rational_polynomial, equidistant); images before the first \
             message are dropped.",
        )
    }

    /// Subscribes to the calibrations on `topic` if the parameter `rectify` is set; otherwise returns None.
    ///
    /// # Errors
    /// If ROS refuses the topic.
    pub(crate) fn subscribe(runtime: &mut Runtime, topic: &str) -> anyhow::Result<Option<Self>> {
        if !runtime.parameters().get::<bool>("rectify") {
            return Ok(None);
        }
        let rectification = Self::default();
        let (newest, log) = (rectification.clone(), runtime.log().clone());
        let input = InputTopic::new(runtime, topic, "calibrations", qos::newest_input(), Need::Required);
        runtime.input::<CameraInfo>(input, move |info| match info {
            Ok(info) => newest.update(info),
            Err(error) => log.warn_throttled("camera_info", format!("camera_info: message left out: {error}")),
        })?;
        Ok(Some(rectification))
    }

    fn update(&self, info: CameraInfo) {
        lock(&self.0).newest = Some(CameraInfo { header: Header::default(), ..info });
    }

    /// Rectifies an image.
    ///
    /// # Errors
    /// If no calibration came yet, or the newest one is unusable or of another size than the image.
    pub(crate) fn apply(&self, image: &RgbImage) -> Result<RgbImage> {
        let mut state = lock(&self.0);
        let State { newest, prepared } = &mut *state;
        let Some(info) = newest else {
            return Err(Error::value("camera_info", "a message before the image", "none"));
        };
        if prepared.as_ref().is_none_or(|(of, _)| of != info) {
            *prepared = Some((info.clone(), rectifier(info)?));
        }
        match prepared {
            Some((_, rectifier)) => rectifier.apply(image),
            None => Err(Error::value("camera_info", "a calibration", "none")),
        }
    }
}

fn rectifier(info: &CameraInfo) -> Result<Rectifier> {
    let is_whole = |length: u32, whole: u32| length == 0 || length == whole;
    let roi = &info.roi;
    if info.binning_x > 1
        || info.binning_y > 1
        || !is_whole(roi.width, info.width)
        || !is_whole(roi.height, info.height)
    {
        let got = format!("binning {} x {}, region {} x {}", info.binning_x, info.binning_y, roi.width, roi.height);
        return Err(Error::value("camera_info", "images without binning or region of interest", got));
    }
    let CameraInfo { width, height, distortion_model, d, k, r, p, .. } = info;
    Rectifier::new(&Calibration { width: *width, height: *height, model: distortion_model, d, k, r, p })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::message::RegionOfInterest;

    fn info() -> CameraInfo {
        CameraInfo {
            header: Header { frame_id: "camera".into(), ..Header::default() },
            height: 6,
            width: 8,
            distortion_model: "plumb_bob".into(),
            d: vec![0.1],
            k: [50.0, 0.0, 4.0, 0.0, 50.0, 3.0, 0.0, 0.0, 1.0],
            r: [0.0; 9],
            p: [0.0; 12],
            binning_x: 0,
            binning_y: 0,
            roi: RegionOfInterest::default(),
        }
    }

    #[test]
    fn images_are_rectified_by_the_newest_calibration() {
        let rectification = Rectification::default();
        let image = RgbImage::from_fn(8, 6, |x, y| ::image::Rgb([x as u8 * 30, y as u8 * 40, 0]));
        assert!(rectification.apply(&image).unwrap_err().to_string().contains("camera_info"));
        rectification.update(info());
        let bent = rectification.apply(&image).unwrap();
        rectification.update(CameraInfo { d: Vec::new(), ..info() });
        assert_eq!(rectification.apply(&image).unwrap(), image);
        assert_ne!(bent, image);
        rectification.update(CameraInfo { binning_x: 2, ..info() });
        assert!(rectification.apply(&image).unwrap_err().to_string().contains("binning 2"));
    }
}
