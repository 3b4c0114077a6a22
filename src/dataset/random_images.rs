//! Images of a source by their index.

use super::source::{ImageSource, SourceFrame, SourceFrames};
use crate::error::Result;

/// Largest distance to a later image of the same unit that is read forward; a new start costs a video more.
const FORWARD: usize = 128;

/// Images of a source by their index over all units. Neighbouring images in growing order are read as one stream.
pub struct RandomImages<'a> {
    source: &'a dyn ImageSource,
    open: Option<Stream<'a>>,
}

/// An open stream of one unit.
struct Stream<'a> {
    unit: usize,
    /// Index within the unit of the next image.
    next: usize,
    frames: SourceFrames<'a>,
}

impl<'a> RandomImages<'a> {
    /// Creates the access to the images of `source`.
    pub fn new(source: &'a dyn ImageSource) -> Self {
        Self { source, open: None }
    }

    /// Returns the unit of image `frame`, and its index there; None beyond the last unit. Images behind a unit whose length is not
    /// known are taken for images of that unit.
    pub fn place(&self, mut frame: usize) -> Option<(usize, usize)> {
        for (index, unit) in self.source.units().iter().enumerate() {
            match unit.frames {
                Some(length) if frame >= length => frame -= length,
                _ => return Some((index, frame)),
            }
        }
        None
    }

    /// Returns image `frame`; None beyond the last one.
    ///
    /// # Errors
    /// If the unit can't be opened or read.
    pub fn get(&mut self, frame: usize) -> Result<Option<SourceFrame>> {
        let Some((unit, index)) = self.place(frame) else { return Ok(None) };
        let follows = |open: &&mut Stream| open.unit == unit && (open.next..=open.next + FORWARD).contains(&index);
        let stream = match self.open.as_mut().filter(follows) {
            Some(stream) => stream,
            None => self.open.insert(Stream { unit, next: index, frames: self.source.frames(unit, index)? }),
        };
        let skipped = index - stream.next;
        stream.next = index + 1;
        let image = stream.frames.nth(skipped).transpose();
        if !matches!(image, Ok(Some(_))) {
            self.open = None;
        }
        image
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Mutex;

    use ::image::{Rgb, RgbImage};

    use super::*;
    use crate::dataset::InputFiles;
    use crate::dataset::source::{EncodedImage, Unit};

    /// Two units of 200 and 3 images; each image's stamp is its index over both. Notes where streams begin.
    struct Numbers {
        units: [Unit; 2],
        starts: Mutex<Vec<(usize, usize)>>,
    }

    impl ImageSource for Numbers {
        fn units(&self) -> &[Unit] {
            &self.units
        }

        fn files(&self) -> Result<InputFiles> {
            Ok(InputFiles::default())
        }

        fn frames(&self, unit: usize, from: usize) -> Result<SourceFrames<'_>> {
            self.starts.lock().unwrap().push((unit, from));
            let before = 200 * unit;
            let frame = move |index: usize| {
                let image = RgbImage::from_pixel(1, 1, Rgb([0; 3]));
                Ok(SourceFrame::new((before + index) as f64, Ok(EncodedImage::Pixels(image))))
            };
            Ok(Box::new((from..self.units[unit].frames.unwrap()).map(frame)))
        }
    }

    #[test]
    fn every_order_of_indices_gives_the_image_of_the_index() {
        let unit = |frames| Unit { name: String::new(), frames: Some(frames) };
        let source = Numbers { units: [unit(200), unit(3)], starts: Mutex::default() };
        let mut images = RandomImages::new(&source);
        for frame in [0, 1, 5, 4, 199, 200, 202, 201, 0] {
            assert_eq!(images.get(frame).unwrap().unwrap().stamp_secs, frame as f64);
        }
        assert!(images.get(203).unwrap().is_none());
        // Forward steps within 128 images stay in their stream.
        let starts = source.starts.lock().unwrap().clone();
        assert_eq!(starts, [(0, 0), (0, 4), (0, 199), (1, 0), (1, 1), (0, 0)]);
    }
}
