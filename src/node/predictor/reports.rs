//! Reports of the predictor on `/diagnostics`: one per camera, and one about their fusion.

use super::certainty::Certainties;
use super::inference::Inference;
use super::input::Input;
use crate::node::diagnostics::{self, Level, TaskReport};
use crate::node::lock::lock;
use crate::node::runtime::Runtime;

/// Counts of one camera.
struct CameraCounts {
    input: Input,
    certainties: Certainties,
    /// Images refused up to the last report.
    refused_before: u64,
}

/// Starts to publish /diagnostics.
///
/// # Errors
/// If ROS refuses it.
pub(super) fn publish(runtime: &mut Runtime, inference: &Inference) -> anyhow::Result<()> {
    let mut cameras: Vec<CameraCounts> = inference
        .streams
        .iter()
        .map(|stream| CameraCounts {
            input: stream.input.clone(),
            certainties: stream.certainties.clone(),
            refused_before: 0,
        })
        .collect();
    let model_id = inference.model_id.clone();
    let chosen = inference.fusion.as_ref().map(|fusion| fusion.chosen().clone());
    diagnostics::publish(
        runtime,
        move || model_id.get().clone(),
        move |runtime| {
            let enabled = runtime.parameters().get::<bool>("enabled");
            let mut reports: Vec<TaskReport> = cameras.iter_mut().map(|camera| camera.report(enabled)).collect();
            if let Some(chosen) = &chosen {
                reports.push(fusion_report(&cameras, &lock(chosen)));
            }
            reports
        },
    )
}

impl CameraCounts {
    fn report(&mut self, enabled: bool) -> TaskReport {
        let Self { input, certainties, refused_before } = self;
        input.tally.set_dropped("superseded", input.superseded());
        let mut counts = input.tally.counts();
        let rates = counts.rates();
        let refused = ["malformed", "failed"].iter().filter_map(|cause| counts.drops.get(cause)).sum();
        let newly_refused = refused > std::mem::replace(refused_before, refused);
        let topic = &input.topic;
        let (level, message) = if !enabled {
            (Level::Ok, "disabled".to_owned())
        } else if rates.received == 0.0 {
            (Level::Stale, format!("no images on {topic}"))
        } else if newly_refused {
            (Level::Warn, format!("images on {topic} could not be processed"))
        } else if let Some(doubt) = certainties.doubt() {
            (Level::Warn, format!("touch is unknown: {doubt}"))
        } else {
            (Level::Ok, format!("{:.1} of {:.1} images per second", rates.processed, rates.received))
        };
        let mut values = counts.values(rates);
        values.extend(certainties.values());
        TaskReport { task: input.camera.task(), level, message, values }
    }
}

/// Reports how often each camera gave each hand of `~/tactile`.
fn fusion_report(cameras: &[CameraCounts], chosen: &[[u64; 2]]) -> TaskReport {
    let values: Vec<(String, String)> = cameras
        .iter()
        .zip(chosen)
        .flat_map(|(camera, counts)| {
            let name = camera.input.camera.name();
            [(format!("left_from_{name}"), counts[0]), (format!("right_from_{name}"), counts[1])]
        })
        .map(|(name, count)| (name, count.to_string()))
        .collect();
    let frames: u64 = chosen.iter().map(|[left, _]| left).sum();
    TaskReport { task: "fusion".into(), level: Level::Ok, message: format!("{frames} frames fused"), values }
}
