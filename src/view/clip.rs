//! Recordings, shown in any order of their images.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::about::{About, Kind};
use super::moment::{Moment, unknown_field};
use super::store_poses::StorePoses;
use super::trace::Course;
use crate::dataset::format::open_images;
use crate::dataset::random_images::RandomImages;
use crate::dataset::source::EncodedImage;
use crate::dataset::{DoubtRule, Format, ImageSource, Labelled, SourceFrame, base_name};
use crate::error::{Error, Result};
use crate::hand::{HandModel, Topology};
use crate::label::{FormatOptions, find_tasks};
use crate::model::Predictor;
use crate::render::color::MAX_COLOR_FORCE;
use crate::report;
use crate::tactile::{TactileField, TactileSequence, median_step};

/// Number of images whose stamps tell the rate of a recording that does not state it.
const RATE_IMAGES: usize = 30;
/// Largest number of images that the network sees before the one that is shown, to fill its window.
const MAX_LEAD: usize = 64;
/// Largest distance to a later image up to which the network sees all images in between.
const MAX_SKIP: usize = 96;

/// Options of [`open_clips`].
#[derive(Debug, Clone, Default)]
pub struct ClipOptions {
    /// Network that predicts touch where a recording has no predictions; None = truth and labels of the recording alone.
    pub predictor: Option<Predictor>,
    /// True to predict also where the recording has predictions.
    pub predicts_anew: bool,
    /// Hands that the touch is drawn on; None = the built-in ones.
    pub hands: Option<[HandModel; 2]>,
    /// Options for reading the formats: camera, topic, frame rate.
    pub format: FormatOptions,
}

/// A recording with its touch.
pub struct Clip {
    about: About,
    source: Arc<dyn ImageSource>,
    touch: Touch,
    truth: Option<TactileSequence>,
    poses: Option<StorePoses>,
    hands: [HandModel; 2],
}

/// Origin of the touch.
enum Touch {
    /// Labels of the recording.
    Labels(Box<TactileSequence>, Option<DoubtRule>),
    /// A network, and the number of images that its window reaches back.
    Network(Box<Predictor>, usize),
}

/// Opens the recordings at `path`: of several, those that can be opened.
///
/// # Errors
/// If there is none, the only one can't be opened, or its touch is on other vertices than the hands.
pub fn open_clips(path: &Path, options: &ClipOptions) -> Result<Vec<Clip>> {
    match Format::of(path).map(|_| Labelled::read(path)) {
        Some(Ok(labelled)) => Ok(vec![Clip::labelled(path, labelled, options)?]),
        _ => unlabelled(path, options),
    }
}

/// Opens the recordings at `path` without labels.
fn unlabelled(path: &Path, options: &ClipOptions) -> Result<Vec<Clip>> {
    let Some(predictor) = &options.predictor else {
        return Err(Error::file(path, "holds no labels, and no network is to predict them"));
    };
    let frame_dt = predictor.metadata().frame_dt;
    let format = FormatOptions { frame_dt, ..options.format.clone() };
    // Nothing is written: the outputs' paths are not used.
    let found = find_tasks(path, &PathBuf::from("/nonexistent/egotac-view"), &format)?;
    let several = found.tasks.len() > 1;
    let clip = |task: crate::label::LabelTask| {
        let place = if several { path.join(&task.name) } else { path.to_path_buf() };
        let clip = Clip::predicted(task.name, task.source, predictor, options, StorePoses::open(&place))?;
        // Of the stores in a folder, those with truth show it.
        match several.then(|| Labelled::read(&place)) {
            Some(Ok(labelled)) => Clip::labelled(&place, labelled, options),
            _ => Ok(clip),
        }
    };
    found.tasks.into_iter().map(clip).collect()
}

impl Clip {
    /// Creates the clip of a recording with labels: predictions, or truth alone.
    fn labelled(path: &Path, labelled: Labelled, options: &ClipOptions) -> Result<Self> {
        let source = open_images(path, labelled.info.as_ref());
        let source = source.ok_or_else(|| Error::file(path, "holds labels, but no images to show beside them"))?;
        Self::with_labels(path, source, labelled, options)
    }

    /// Creates the clip of a recording whose labels at `path` lie beside the images of `source` or elsewhere.
    ///
    /// # Errors
    /// If the touch is on other vertices than the hands.
    pub fn with_labels(
        path: &Path,
        source: Arc<dyn ImageSource>,
        labelled: Labelled,
        options: &ClipOptions,
    ) -> Result<Self> {
        let topology = labelled.labels.topology;
        let is_truth = labelled.info.is_none() && Format::of(path) == Some(Format::Store);
        let (name, poses) = (base_name(path), StorePoses::open(path));
        let network = options.predictor.as_ref().filter(|predictor| {
            (is_truth || options.predicts_anew) && topology.is_none_or(|topology| topology == predictor.topology())
        });
        if let Some(predictor) = network {
            let mut clip = Self::predicted(name, source, predictor, options, poses)?;
            let truth = if is_truth { Some(labelled.labels) } else { labelled.truth };
            clip.about.truth = truth.is_some();
            clip.about.fps = truth.as_ref().and_then(TactileSequence::fps).or(clip.about.fps);
            clip.about.scale = truth.as_ref().map_or(clip.about.scale, report::scale);
            clip.truth = truth.map(hidden);
            return Ok(clip);
        }
        let hands = hands(path, options, topology)?;
        let truth = labelled.truth.clone().map(hidden);
        let rule = labelled.info.as_ref().and_then(|info| info.provenance.doubt);
        let about = About {
            name,
            kind: Kind::Recording,
            frames: Some(labelled.labels.n_frames()),
            fps: labelled.labels.fps(),
            scale: report::scale(labelled.truth.as_ref().unwrap_or(&labelled.labels)),
            touch: match &labelled.info {
                Some(info) => format!("labels by {}", info.provenance.model_id()),
                None => "labels of the recording".into(),
            },
            truth: truth.is_some(),
            familiarity_threshold: rule.and_then(|rule| rule.familiarity),
            presence_threshold: rule.and_then(|rule| rule.presence),
            course: Some(Course::of(&labelled, truth.as_ref())),
        };
        let touch = Touch::Labels(Box::new(labelled.labels), rule);
        Ok(Self { about, source, touch, truth, poses, hands })
    }

    /// Creates the clip of a recording whose touch a network predicts.
    fn predicted(
        name: String,
        source: Arc<dyn ImageSource>,
        predictor: &Predictor,
        options: &ClipOptions,
        poses: Option<StorePoses>,
    ) -> Result<Self> {
        let hands = hands(Path::new(&name), options, Some(predictor.topology()))?;
        let fps = rate(source.as_ref());
        let metadata = predictor.metadata();
        let window_secs = predictor.config().horizon.saturating_sub(1) as f64 * metadata.frame_dt;
        let lead = ((window_secs * fps.unwrap_or(0.0)).ceil() as usize).min(MAX_LEAD);
        let rule = DoubtRule::of(predictor);
        let about = About {
            name,
            kind: Kind::Recording,
            frames: source.units().iter().map(|unit| unit.frames).sum(),
            fps,
            scale: MAX_COLOR_FORCE,
            touch: format!("predicted by {}", metadata.name),
            truth: false,
            familiarity_threshold: rule.and_then(|rule| rule.familiarity),
            presence_threshold: rule.and_then(|rule| rule.presence),
            course: None,
        };
        let touch = Touch::Network(Box::new(predictor.clone()), lead);
        Ok(Self { about, source, touch, truth: None, poses, hands })
    }

    /// Description for the page.
    pub fn about(&self) -> &About {
        &self.about
    }

    /// Hands that the touch is drawn on, left first.
    pub fn hands(&self) -> &[HandModel; 2] {
        &self.hands
    }

    /// Starts to show the clip.
    pub fn player(&mut self) -> Player<'_> {
        let Self { source, touch, truth, poses, .. } = self;
        Player { images: RandomImages::new(&**source), touch, truth: truth.as_ref(), poses: poses.as_ref(), seen: None }
    }

    /// Calls `show` with what is shown of each image, in their order. Returns the number of images.
    ///
    /// # Errors
    /// If the recording can't be read, the network fails, or `show` does.
    pub(super) fn each(&mut self, mut show: impl FnMut(&Moment) -> Result<()>) -> Result<usize> {
        let (mut player, mut frames) = (self.player(), 0);
        while let Some(moment) = player.moment(frames)? {
            show(&moment)?;
            frames += 1;
        }
        Ok(frames)
    }
}

/// Returns the hands that touch of `topology` is drawn on.
fn hands(path: &Path, options: &ClipOptions, topology: Option<Topology>) -> Result<[HandModel; 2]> {
    let needed =
        || Error::file(path, "has touch on MANO's vertices; name your MANO files with --mano-left and --mano-right");
    report::hands_of(options.hands.as_ref(), topology)?.ok_or_else(needed)
}

/// Makes truth NaN where it is not supervised or its frame is invalid.
fn hidden(mut truth: TactileSequence) -> TactileSequence {
    let masks = [truth.counted_force().into_owned(), truth.counted_contact().into_owned()];
    for (values, mask) in [&mut truth.force, &mut truth.contact].into_iter().zip(masks) {
        values.iter_mut().zip(mask).filter(|(_, mask)| *mask == 0).for_each(|(value, _)| *value = f32::NAN);
    }
    truth
}

/// Returns the images per second of a source by its first stamps.
fn rate(source: &dyn ImageSource) -> Option<f64> {
    let frames = source.frames(0, 0).ok()?;
    let stamps: Vec<f64> = frames.take(RATE_IMAGES).map_while(Result::ok).map(|frame| frame.stamp_secs).collect();
    median_step(&stamps).map(|step| 1.0 / step)
}

/// Shows the images of a clip in any order.
pub struct Player<'a> {
    images: RandomImages<'a>,
    touch: &'a mut Touch,
    truth: Option<&'a TactileSequence>,
    poses: Option<&'a StorePoses>,
    /// Image that the network saw last.
    seen: Option<usize>,
}

impl Player<'_> {
    /// Returns what is shown of image `frame`; None beyond the last one.
    ///
    /// # Errors
    /// If the recording can't be read, or the network fails.
    pub fn moment(&mut self, frame: usize) -> Result<Option<Moment>> {
        let Some((episode, index)) = self.images.place(frame) else { return Ok(None) };
        let moment = match self.touch {
            Touch::Labels(..) => self.labelled(frame, episode)?,
            Touch::Network(..) => self.predicted(frame, episode, index)?,
        };
        Ok(moment.map(|moment| self.with_known(moment)))
    }

    fn labelled(&mut self, frame: usize, episode: usize) -> Result<Option<Moment>> {
        let Touch::Labels(labels, rule) = &*self.touch else { return Ok(None) };
        if frame >= labels.n_frames() {
            return Ok(None);
        }
        let mut moment = Moment::unknown(frame, episode, labels.stamp_or_index(frame), labels.field(frame)?);
        let estimate = |values: &[f32], at: usize| values.get(at).copied().unwrap_or(f32::NAN);
        let familiarity = estimate(&labels.familiarity, frame);
        let presence = [0, 1].map(|side| estimate(&labels.presence, 2 * frame + side));
        let known = |value: f32| (!value.is_nan()).then_some(value);
        (moment.familiarity, moment.presence) = (known(familiarity), presence.map(known));
        moment.reason = rule.map(|rule| rule.judge(familiarity, presence).reason()).unwrap_or_default();
        moment.image = match self.images.get(frame)? {
            Some(image) => image.image.and_then(decoded),
            None => Err("there is no image for this label".into()),
        };
        Ok(Some(moment))
    }

    fn predicted(&mut self, frame: usize, episode: usize, index: usize) -> Result<Option<Moment>> {
        let Touch::Network(predictor, lead) = &mut *self.touch else { return Ok(None) };
        let follows = self.seen.is_some_and(|seen| seen < frame && frame - seen <= MAX_SKIP && frame - seen <= index);
        let first = match self.seen {
            Some(seen) if follows => seen + 1,
            _ => {
                predictor.reset();
                frame - index.min(*lead)
            }
        };
        for current in first..=frame {
            let Some(SourceFrame { stamp_secs, image, .. }) = self.images.get(current)? else { return Ok(None) };
            self.seen = Some(current);
            let image = image.and_then(decoded);
            let unknown = unknown_field(predictor.topology());
            let mut moment = Moment::unknown(current, episode, stamp_secs, unknown);
            match image.as_ref().map(|image| predictor.push(image, stamp_secs)) {
                Ok(Ok(prediction)) => moment.predicted(prediction),
                Ok(Err(error)) if error.is_recoverable() => moment.reason = error.to_string(),
                Ok(Err(error)) => return Err(error),
                Err(reason) => moment.reason.clone_from(reason),
            }
            moment.image = image;
            if current == frame {
                return Ok(Some(moment));
            }
        }
        Ok(None)
    }

    /// Adds truth and poses.
    fn with_known(&self, moment: Moment) -> Moment {
        let frame = moment.frame;
        let truth = self.truth.filter(|truth| frame < truth.n_frames());
        let truth: Option<TactileField> = truth.and_then(|truth| truth.field(frame).ok());
        let hands = self.poses.map(|poses| poses.hands(frame)).unwrap_or_default();
        let sight = self.poses.and_then(|poses| poses.sight(frame));
        Moment { truth, hands, sight, ..moment }
    }
}

/// Decodes an image.
fn decoded(image: EncodedImage) -> std::result::Result<::image::RgbImage, String> {
    image.decode().map_err(|error| error.to_string())
}
