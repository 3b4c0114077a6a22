//! `egotac data info`.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use serde_json::{Map, Value, json};

use super::store_info;
use crate::cli::options::Json;
use crate::dataset::image_folder::image_files;
use crate::dataset::lerobot::LeRobot;
use crate::dataset::mcap::{bag_files, survey};
use crate::dataset::{Format, LabelInfo, Labelled, video, zarr};
use crate::error::{Error, Result};
use crate::text::{printable_name, shortened};

/// Runs the command.
pub fn run(paths: &[PathBuf], json_option: &Json) -> anyhow::Result<ExitCode> {
    let mut infos = Vec::new();
    for path in paths {
        infos.extend(of(path)?);
    }
    let lines: Vec<String> = infos.iter().map(text).collect();
    let value = if infos.len() == 1 { infos.remove(0) } else { Value::Array(infos) };
    json_option.show(&value, || {
        lines.join(
            "
",
        )
    })?;
    Ok(ExitCode::SUCCESS)
}

fn of(path: &Path) -> Result<Vec<Value>> {
    let format = Format::of(path);
    let mut info = match format {
        None if path.is_file() => {
            let formats = "a Zarr store (folder or zip), bag, .mcap file, LeRobot data set, video, folder of images or .safetensors file";
            return Err(Error::file(path, format!("is none of these: {formats}")));
        }
        None | Some(Format::Store) => {
            return zarr::open_all(&[path.to_path_buf()])?.iter().map(store_info::info).collect();
        }
        Some(Format::Bag) => bag(path)?,
        Some(Format::LeRobot) => {
            let dataset = LeRobot::open(path)?;
            let frames: usize = dataset.episodes.iter().map(|episode| episode.length).sum();
            let features = dataset.info["features"].as_object().into_iter().flatten();
            let features: Map<String, Value> = features
                .map(|(name, feature)| (name.clone(), json!({ "dtype": feature["dtype"], "shape": feature["shape"] })))
                .collect();
            json!({
                "kind": "lerobot",
                "frames": frames,
                "episodes": dataset.episodes.len(),
                "fps": dataset.fps,
                "features": features,
            })
        }
        Some(Format::Video) => {
            let video::Video { size: (width, height), fps, frames, codec } = video::probe(path)?;
            json!({ "kind": "video", "frames": frames, "fps": fps, "image": { "width": width, "height": height }, "codec": codec })
        }
        Some(Format::Images) => {
            let files = image_files(path)?;
            json!({ "kind": "images", "frames": files.len(), "first": files.first(), "last": files.last() })
        }
        Some(Format::Tensors) => {
            let labels = Labelled::read(path)?.labels;
            json!({
                "kind": "tensors",
                "frames": labels.n_frames(),
                "episodes": labels.episode_ends.len(),
                "fps": labels.fps(),
                "topology": labels.topology,
            })
        }
    };
    info["path"] = path.display().to_string().into();
    let labels = format.and_then(|format| format.read_info(path));
    info["labels"] = labels.map_or(Value::Null, |labels| json!(labels));
    Ok(vec![info])
}

fn bag(path: &Path) -> Result<Value> {
    let (mut topics, mut files, mut span) = (Map::new(), Vec::new(), None::<(u64, u64)>);
    for file in bag_files(path)? {
        let survey = survey(&file)?;
        for topic in survey.topics.values() {
            let before = topics.get(&topic.name).and_then(|topic| topic["messages"].as_u64()).unwrap_or(0);
            topics.insert(topic.name.clone(), json!({ "type": topic.type_name, "messages": before + topic.messages }));
        }
        files.push(json!({
            "file": file.file_name().unwrap_or_default().to_string_lossy(),
            "messages": survey.messages(),
            "chunked": survey.chunked,
            "summary": survey.from_summary,
        }));
        if let Some((start, end)) = survey.times {
            let (first, last) = span.unwrap_or((start, end));
            span = Some((first.min(start), last.max(end)));
        }
    }
    let seconds = span.map(|(start, end)| (end - start) as f64 * 1e-9);
    Ok(
        json!({ "kind": "bag", "seconds": seconds, "start_ns": span.map(|span| span.0), "topics": topics, "files": files }),
    )
}

/// Returns a name from a file as a part of a line.
fn name_of(name: &str) -> String {
    /// Number of a name's characters that are printed.
    const MOST: usize = 200;
    printable_name(&shortened(name, MOST)).into_owned()
}

fn text(info: &Value) -> String {
    if info["kind"] == "store" {
        return store_info::text(info);
    }
    let mut text =
        format!("{}\n  {}", info["path"].as_str().unwrap_or_default(), info["kind"].as_str().unwrap_or_default());
    let part = |name: &str, unit: &str| match &info[name] {
        Value::Null => String::new(),
        Value::Number(number) => {
            let number = number.as_f64().unwrap_or_default();
            if number.fract() == 0.0 { format!(", {number} {unit}") } else { format!(", {number:.2} {unit}") }
        }
        value => format!(", {unit} {}", value.to_string().trim_matches('"')),
    };
    text += &[("frames", "frames"), ("episodes", "episodes"), ("fps", "fps"), ("seconds", "seconds")]
        .map(|(n, u)| part(n, u))
        .concat();
    text += &[("codec", "codec"), ("topology", "topology")].map(|(name, unit)| part(name, unit)).concat();
    if let Some(image) = info["image"].as_object() {
        text += &format!(", {} x {} pixels", image["width"], image["height"]);
    }
    for (name, feature) in info["features"].as_object().into_iter().flatten() {
        let name = name_of(name);
        text += &format!("\n  {name}: {} {}", feature["dtype"].as_str().unwrap_or_default(), feature["shape"]);
    }
    for (topic, about) in info["topics"].as_object().into_iter().flatten() {
        let (topic, type_name) = (name_of(topic), name_of(about["type"].as_str().unwrap_or_default()));
        text += &format!("\n  {topic}: {} messages of {type_name}", about["messages"]);
    }
    for file in info["files"].as_array().into_iter().flatten() {
        let cut =
            if file["summary"] == true { "" } else { "; it has no summary, so its recording was probably cut off" };
        text += &format!("\n  {}: {} messages{cut}", file["file"].as_str().unwrap_or_default(), file["messages"]);
    }
    if let Ok(LabelInfo { provenance, summary }) = serde_json::from_value(info["labels"].clone()) {
        let id = provenance.model_id();
        text += &format!(
            "\n  labels: {id} on {}, by {} {}",
            provenance.topology.id(),
            provenance.producer,
            provenance.version
        );
        text += &format!("\n  {}", summary.text().replace('\n', "\n  "));
    }
    text
}
