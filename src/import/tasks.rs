//! Recordings of a data set with their outputs, ready for the jobs of `label`.

use std::path::Path;
use std::sync::Arc;

use super::hands::HandModels;
use super::kind::{Kind, Mano, Options};
use super::labeller::{ContactRule, GeometryLabeller};
use super::output::ImportOutput;
use super::recording::Reader;
use super::shapes::ShapeCache;
use super::source::RecordingSource;
use crate::dataset::{CONTACT_THRESHOLD, Provenance, Thresholds};
use crate::error::{Error, Result};
use crate::label::{Job, LabelTask, is_within};
use crate::tactile::{CONTACT_FORCE_N, ForceKind};

/// Choices of an import.
#[derive(Debug)]
pub struct Settings {
    /// Kind of the data set.
    pub kind: &'static Kind,
    /// Hand models.
    pub hands: HandModels,
    /// Rule of contact.
    pub rule: ContactRule,
    /// Upper limit of the images' shorter side, pixels; None = original size.
    pub side: Option<u32>,
    /// Choice of files.
    pub options: Options,
}

/// Recordings to import.
pub struct ImportTasks {
    settings: Settings,
    shapes: Arc<ShapeCache>,
    readers: Vec<Arc<dyn Reader>>,
    /// True if the data set measures force.
    measures_force: bool,
    /// Outputs, in the order of the recordings.
    pub tasks: Vec<LabelTask>,
    /// Names of recordings that can't be read, and the reasons.
    pub unreadable: Vec<(String, Error)>,
}

impl ImportTasks {
    /// Finds the recordings of the data set at `source`. A single recording becomes the store `out`; of several ones, each
    /// becomes a store in the folder `out`.
    ///
    /// # Errors
    /// If there is no recording, if the kind needs MANO files and there are none, or if `out` lies in `source`.
    pub fn find(source: &Path, out: &Path, settings: Settings) -> Result<Self> {
        let kind = settings.kind;
        if kind.mano == Mano::Required && !settings.hands.are_mano() {
            let why = format!("{}: hand poses", kind.name);
            return Err(Error::value(
                why,
                "MANO's files by --mano-left and --mano-right, whose basis they refer to",
                "none",
            ));
        }
        if !source.exists() {
            return Err(Error::file(source, "does not exist"));
        }
        if is_within(out, source) {
            return Err(Error::file(
                out,
                format!("lies in the source {}, which is never written to", source.display()),
            ));
        }
        let found = (kind.find)(source, &settings.options)?;
        let (readers, unreadable) = (found.readers, found.unreadable);
        if readers.is_empty() && unreadable.is_empty() {
            return Err(Error::file(
                source,
                format!("holds no recording of kind {}: expected {}", kind.name, kind.origin),
            ));
        }
        let several = readers.len() + unreadable.len() > 1;
        let shapes = Arc::new(ShapeCache::default());
        let task = |reader: &Arc<dyn Reader>| {
            let recording = reader.recording();
            let source = Arc::new(RecordingSource::new(Arc::clone(reader), Arc::clone(&shapes)));
            let output = Arc::new(ImportOutput {
                reader: Arc::clone(reader),
                source: Arc::clone(&source),
                kind,
                rule: settings.rule,
                hand_sha256: settings.hands.sha256().to_vec(),
                side: settings.side,
            });
            let out = if several { out.join(file_name(&recording.name)) } else { out.to_path_buf() };
            LabelTask {
                name: recording.name.clone(),
                source,
                output,
                out,
                description: settings.description(reader.as_ref()),
            }
        };
        let tasks: Vec<LabelTask> = readers.iter().map(task).collect();
        let mut outs: Vec<&Path> = tasks.iter().map(|task| task.out.as_path()).collect();
        outs.sort();
        if let Some(pair) = outs.windows(2).find(|pair| pair[0] == pair[1]) {
            return Err(Error::file(pair[0], "would be the output of two recordings"));
        }
        let measures_force = readers.iter().any(|reader| reader.recording().measures_force);
        Ok(Self { settings, shapes, readers, measures_force, tasks, unreadable })
    }

    /// Returns the job of each task.
    pub fn jobs(&self) -> Vec<Job<'_>> {
        let job = |task| {
            let LabelTask { source, output, out, description, .. }: &LabelTask = task;
            let kind = self.readers.iter().find_map(|reader| reader.force_kind());
            let has_force = self.measures_force || kind.is_some();
            let provenance = self.settings.provenance(description.clone(), has_force, kind.unwrap_or_default());
            Job { source: source.as_ref(), output: output.as_ref(), out: out.clone(), provenance, decoders: 1 }
        };
        self.tasks.iter().map(job).collect()
    }

    /// Returns the maker of the labels of task `index`.
    pub fn labeller(&self, index: usize) -> GeometryLabeller<'_> {
        let Self { settings, shapes, readers, .. } = self;
        GeometryLabeller { reader: readers[index].as_ref(), hands: &settings.hands, shapes, rule: settings.rule }
    }
}

impl Settings {
    /// Describes the choices that decide about a store's content.
    fn description(&self, reader: &dyn Reader) -> Vec<String> {
        let recording = &reader.recording().name;
        let side = self.side.map_or("original size".into(), |side| format!("shorter side at most {side} pixels"));
        let mut all =
            vec![format!("{} recording {recording}", self.kind.name), format!("contact: {}", self.rule.text()), side];
        if let Some(glove) = &reader.recording().glove {
            all.push(format!("contact: {}, taxel map: {}", glove.rule(), glove.layout().name));
        }
        if let Some(kind) = reader.force_kind() {
            let sensor = self.options.sensor.as_deref().unwrap_or("the data set's glove");
            all.push(format!("forces: {}, taxel map: {sensor}", kind.id()));
        }
        all
    }

    fn provenance(&self, source: Vec<String>, has_force: bool, force_kind: ForceKind) -> Provenance {
        let topology = self.hands.topology();
        Provenance {
            producer: "egotac data import".into(),
            version: crate::VERSION.into(),
            model: self.rule.text(),
            model_sha256: self.hands.sha256().join(" "),
            precision: "f32".into(),
            topology,
            hand_model: topology.hand_model().into(),
            mano_sha256: Vec::new(),
            horizon: 1,
            frame_dt: 0.0,
            force_kind,
            has_force,
            thresholds: Thresholds {
                contact: CONTACT_THRESHOLD,
                contact_force: CONTACT_FORCE_N.to_string().parse().unwrap_or(f64::from(CONTACT_FORCE_N)),
            },
            doubt: None,
            view: None,
            keypoints: false,
            source,
            input: None,
        }
    }
}

/// Returns the name of a recording's store: letters, digits, dots, hyphens and underscores alone.
fn file_name(recording: &str) -> String {
    let plain = |c: char| c.is_ascii_alphanumeric() || "._-".contains(c);
    let mut name: String = recording.chars().map(|c| if plain(c) { c } else { '_' }).collect();
    while name.contains("__") {
        name = name.replace("__", "_");
    }
    format!("{}.zarr", name.trim_matches(['_', '.']))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_stores_have_no_separators_and_no_hidden_files() {
        assert_eq!(file_name("(stir, spoon, bowl)/20231105_019"), "stir_spoon_bowl_20231105_019.zarr");
        assert_eq!(file_name("../subject1/h1/0"), "subject1_h1_0.zarr");
    }
}
