//! The store of one imported recording.

use std::path::Path;
use std::sync::Arc;

use ::image::RgbImage;
use serde_json::{Value, json};

use super::kind::Kind;
use super::known::{Known, POSE};
use super::labeller::{ContactRule, FORCE_RULE};
use super::recording::{Reader, RecordedObject};
use super::sensors::Sensor;
use super::shapes::MeshFile;
use super::source::RecordingSource;
use crate::dataset::copy::remove;
use crate::dataset::source::SourceFrame;
use crate::dataset::zarr::{
    ArraySpec, CAMERA_POSE, Contact, Dtype, OBJECT_POSE, Values, ZarrWriter, fitted, image_size, read_info, scaled,
};
use crate::dataset::{
    Attributes, EpisodeWriter, Frame, ImageSource, LabelCounts, LabelFrame, LabelInfo, LabelOutput, PROVENANCE_KEY,
    SourceLabels, UnlabelledImage,
};
use crate::error::{Error, Result};
use crate::file;
use crate::geometry::SIGMA;
use crate::tactile::{ForceKind, N_FIELD, TactileField, Validity};

/// Array (T, 1556) f32: signed distance from the nearest object's surface, m, at most 0.05; negative inside of a closed
/// surface, NaN = unknown.
pub const DISTANCE: &str = "data/mano_distance";
/// Array (T, 2) f32, left hand first: measured force that is on no vertex, N; only of recordings that measure force.
pub const FORCE_LOST: &str = "data/force_lost";
/// Array (T, 1556) f32: reading of a glove without a calibration at each vertex, as a share of its range, 0 to 1; NaN = no taxel, or
/// unknown. No newtons.
pub const READING: &str = "data/mano_reading";
/// Attribute that describes the origin of an imported store.
pub const IMPORT: &str = "import";

/// Writer of one recording's store.
pub struct ImportOutput {
    /// The recording.
    pub reader: Arc<dyn Reader>,
    /// Its images.
    pub source: Arc<RecordingSource>,
    /// Kind of the data set.
    pub kind: &'static Kind,
    /// Rule of contact.
    pub rule: ContactRule,
    /// SHA-256 of the MANO files, left first; empty = the built-in hand.
    pub hand_sha256: Vec<String>,
    /// Upper limit of the images' shorter side, pixels; None = original size.
    pub side: Option<u32>,
}

impl LabelOutput for ImportOutput {
    fn assemble(&self, labels: &dyn SourceLabels, info: &mut LabelInfo, at: &Path, out: &Path) -> Result<()> {
        remove(at)?;
        let recording = self.reader.recording();
        let views = self.views()?;
        let extra = self.extra_arrays(&views);
        let mut writer = ZarrWriter::create(at, self.attributes(info), Contact::Truth, extra)?;
        let mut labels = labels.labels(0)?;
        let (mut size, mut time) = (None, 0.0);
        for image in self.source.frames(0, 0)? {
            let image = image?;
            let Some(label) = labels.next().transpose()? else {
                return Err(Error::file(&recording.path, format!("expected {} images, got more", recording.frames)));
            };
            let size = match size {
                Some(size) => size,
                None => *size.insert(image_size(self.source.as_ref(), 0, &image, self.side)?),
            };
            let stamps = [label.stamp_secs, image.stamp_secs, time];
            time = stamps.into_iter().find(|stamp| stamp.is_finite()).unwrap_or(0.0);
            let mut known = Known::from_values(&label.further, recording);
            let (image, label) = self.decoded(image, label, size, writer.n_frames(), info);
            let extra = self.extra_values(&mut known, &views, writer.n_frames(), info);
            let (names, values): (Vec<String>, Vec<Values>) = extra.into_iter().unzip();
            let [left_hand_pose, right_hand_pose] = known.hands;
            let field = label.touch.unwrap_or_else(|_| unknown(info));
            let valid = |values: &[f32]| values.iter().map(|value| u8::from(!value.is_nan())).collect();
            let frame = Frame {
                timestamp: time,
                camera_ego_rgb: image,
                force_valid: valid(&field.force),
                contact_valid: valid(&field.contact),
                field,
                validity: Validity::Valid,
                left_hand_pose,
                right_hand_pose,
            };
            writer.push_with(frame, names.iter().map(String::as_str).zip(values).collect())?;
        }
        if writer.n_frames() != recording.frames {
            let (wanted, got) = (recording.frames, writer.n_frames());
            return Err(Error::file(
                &recording.path,
                format!("expected {wanted} images, got {got}; {} is left out", out.display()),
            ));
        }
        writer.end_episode()?;
        let spread = recording.measures_force.then_some(ForceKind::Spread);
        let kind = self.reader.force_kind().or(spread);
        writer.set_attribute(ForceKind::ATTRIBUTE, kind.map_or(Value::Null, |kind| kind.id().into()));
        writer.set_attribute(PROVENANCE_KEY, serde_json::to_value(&*info).unwrap_or_default());
        writer.set_attribute(IMPORT, self.description());
        writer.set_attribute("camera", recording.camera.clone());
        writer.finish()?;
        self.write_meshes(at)
    }

    fn info(&self, out: &Path) -> Option<LabelInfo> {
        read_info(out)
    }
}

impl ImportOutput {
    /// Decodes an image. One that can't be decoded is black, and its label is unknown: it would teach touch without a view.
    fn decoded(
        &self,
        image: SourceFrame,
        label: LabelFrame,
        size: (u32, u32),
        index: usize,
        info: &mut LabelInfo,
    ) -> (RgbImage, LabelFrame) {
        let reason = match image.image.map(|image| image.decode().and_then(|image| fitted(image, size))) {
            Ok(Ok(image)) => return (image, label),
            Ok(Err(error)) => error.to_string(),
            Err(reason) => reason,
        };
        if label.touch.is_ok() {
            let mut counts = LabelCounts::default();
            counts.count(&label);
            info.summary.counts.labelled -= counts.labelled;
            info.summary.counts.touched -= counts.touched;
            info.summary.counts.known -= counts.known;
            let bins = info.summary.counts.confidence.iter_mut().zip(counts.confidence);
            bins.for_each(|(sum, lost)| *sum -= lost);
            let unit = self.reader.recording().name.clone();
            let fault = UnlabelledImage { unit, frame: index as u64, reason: reason.clone() };
            info.summary.add_images(&LabelCounts::default(), [fault]);
        }
        (RgbImage::new(size.0, size.1), LabelFrame::without(label.stamp_secs, reason))
    }

    /// Returns the arrays that the recording has beyond those of every store; `views`: names and sizes of its further views.
    fn extra_arrays(&self, views: &[(&str, (u32, u32))]) -> Vec<ArraySpec> {
        let recording = self.reader.recording();
        let n_objects = recording.objects.len();
        let f32s = |name: &str, shape: &[usize]| ArraySpec::new(name, shape, Dtype::F32);
        let mut arrays = vec![f32s(DISTANCE, &[N_FIELD]), f32s(CAMERA_POSE, &[POSE])];
        if n_objects > 0 {
            arrays.push(f32s(OBJECT_POSE, &[n_objects, POSE]));
        }
        if recording.measures_force {
            arrays.push(f32s(FORCE_LOST, &[2]));
        }
        if recording.glove.is_some() {
            arrays.push(f32s(READING, &[N_FIELD]));
        }
        arrays.extend(recording.sensors.iter().map(|sensor| f32s(&sensor.array(), &sensor.shape)));
        let pictures =
            views.iter().map(|(name, (w, h))| ArraySpec::new(*name, [*h as usize, *w as usize, 3], Dtype::U8));
        arrays.extend(pictures);
        arrays
    }

    /// Returns the values of [`Self::extra_arrays`] at frame `index`; takes them out of `known`.
    fn extra_values(
        &self,
        known: &mut Known,
        views: &[(&'static str, (u32, u32))],
        index: usize,
        info: &mut LabelInfo,
    ) -> Vec<(String, Values)> {
        let sensors = self.reader.recording().sensors.iter().map(Sensor::array);
        let readings = std::mem::take(&mut known.readings);
        let values = [
            (DISTANCE, &mut known.distances),
            (CAMERA_POSE, &mut known.camera),
            (OBJECT_POSE, &mut known.objects),
            (FORCE_LOST, &mut known.lost),
            (READING, &mut known.relative),
        ];
        let values = values.map(|(name, values)| (name.to_owned(), std::mem::take(values)));
        let values = values.into_iter().chain(sensors.zip(readings)).filter(|(_, values)| !values.is_empty());
        let mut values: Vec<_> = values.map(|(name, values)| (name, Values::F32(values))).collect();
        for (view, size) in views {
            values.push(((*view).to_owned(), Values::U8(self.further_image(view, *size, index, info).into_raw())));
        }
        values
    }

    /// Returns names and sizes of the further views.
    fn views(&self) -> Result<Vec<(&'static str, (u32, u32))>> {
        let recording = self.reader.recording();
        let size = |name: &&'static str| {
            let mut images = (0..recording.frames).map(|index| self.reader.further_image(name, index));
            let image = images.find_map(Result::ok).ok_or_else(|| {
                Error::file(&recording.path, format!("{name}: expected at least one image that can be read, got none"))
            })?;
            Ok((*name, scaled(image.dimensions(), self.side)))
        };
        recording.further_views.iter().map(size).collect()
    }

    /// Reads an image of a further view. One that can't be read is black, and listed.
    fn further_image(&self, view: &'static str, size: (u32, u32), index: usize, info: &mut LabelInfo) -> RgbImage {
        match self.reader.further_image(view, index).and_then(|image| fitted(image, size)) {
            Ok(image) => image,
            Err(error) => {
                let unit = self.reader.recording().name.clone();
                let fault = UnlabelledImage { unit, frame: index as u64, reason: error.to_string() };
                info.summary.add_images(&LabelCounts::default(), [fault]);
                RgbImage::new(size.0, size.1)
            }
        }
    }

    /// Writes the meshes that the data set keeps within other files into the store, since readers of the store don't know those files.
    fn write_meshes(&self, store: &Path) -> Result<()> {
        for (index, object) in self.reader.recording().objects.iter().enumerate() {
            // An object without a usable mesh is among the faults of the import.
            if let Some(Ok(mesh)) = object.mesh.as_ref().filter(|mesh| mesh.part.is_some()).map(MeshFile::read) {
                file::write(&store.join(mesh_in_store(index)), file::mesh::to_obj(&mesh).as_bytes())?;
            }
        }
        Ok(())
    }

    fn attributes(&self, info: &LabelInfo) -> Attributes {
        let provenance = &info.provenance;
        Attributes {
            topology: provenance.topology,
            sigma: if self.reader.recording().measures_force { SIGMA } else { 0.0 },
            contact_force: provenance.thresholds.contact_force,
            producer: provenance.producer.clone(),
            version: provenance.version.clone(),
            scene: format!("{}: {}", self.kind.name, self.reader.recording().name),
            seed: 0,
        }
    }

    /// Describes the rule of contact.
    fn contact_rule(&self) -> String {
        let recording = self.reader.recording();
        match &recording.glove {
            Some(glove) => glove.rule(),
            None if recording.measures_force || self.reader.force_kind().is_some() => FORCE_RULE.into(),
            None => self.rule.text(),
        }
    }

    /// Describes origin and meaning of the store's content.
    fn description(&self) -> Value {
        let recording = self.reader.recording();
        let hand = match self.hand_sha256.as_slice() {
            [] => json!({
                "exact": false,
                "note": "approximation: the built-in hand, posed by the recorded rotations; recorded shape not applied",
            }),
            [left, right] => json!({ "exact": true, "mano_left_sha256": left, "mano_right_sha256": right }),
            _ => Value::Null,
        };
        json!({
            "kind": self.kind.name,
            "recording": recording.name,
            "data_set": self.kind.origin,
            "licence": self.kind.licence,
            "contact_rule": self.contact_rule(),
            "reading": recording.glove.as_ref().map(|glove| json!({
                "array": READING, "kind": "relative", "unit": "share of the glove's range, 0 to 1; no newtons",
                "taxel_map": glove.layout().name, "taxel_places": glove.layout().placement.name(),
            })),
            "force": if recording.measures_force || self.reader.force_kind().is_some() { "measured" } else { "unknown" },
            "force_kind": self.reader.force_kind().map(ForceKind::id).or(recording.measures_force.then_some("spread")),
            "hand": hand,
            "scanned_hands": recording.templates.iter().any(Option::is_some),
            "translation": recording.convention.translation.name(),
            "mean_pose_added": recording.convention.adds_mean,
            "left_shapedirs_fixed": recording.convention.fixes_left_shapedirs,
            "objects": recording.objects.iter().map(|object| object.name.as_str()).collect::<Vec<_>>(),
            "object_meshes": recording.objects.iter().enumerate().map(mesh).collect::<Vec<_>>(),
            "object_joints": recording.joints,
            "view": recording.view.name(),
            "sensors": recording.sensors.iter().map(Sensor::description).collect::<Vec<_>>(),
            "about": recording.about,
        })
    }
}

/// Describes the file of an object's mesh, from which forces follow later; null without one. A relative path is one in the store.
fn mesh((index, object): (usize, &RecordedObject)) -> Value {
    match &object.mesh {
        None => Value::Null,
        Some(MeshFile { part: Some(_), .. }) => json!({ "file": mesh_in_store(index), "to_metres": 1.0 }),
        Some(mesh) => {
            let path = std::path::absolute(&mesh.path).unwrap_or_else(|_| mesh.path.clone());
            json!({ "file": path, "to_metres": mesh.to_metres })
        }
    }
}

/// Returns the path in a store of the mesh of an object.
fn mesh_in_store(index: usize) -> String {
    format!("meshes/{index}.obj")
}

fn unknown(info: &LabelInfo) -> TactileField {
    let nothing = || vec![f32::NAN; N_FIELD];
    TactileField { topology: info.provenance.topology, force: nothing(), contact: nothing() }
}
