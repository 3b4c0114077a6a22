//! Description of a store.

use serde_json::{Value, json};

use crate::dataset::zarr::{self, TIMESTAMPS, ZarrReader, read_labels};
use crate::dataset::{EpisodeReader, time_unit_of};
use crate::error::Result;
use crate::tactile::{CONTACT_FORCE_N, N_FIELD, Validity, fps};

/// Returns attributes, arrays, episodes, and the amount of touch.
pub fn info(store: &ZarrReader) -> Result<Value> {
    const BLOCK: usize = 256;
    let timestamps = store.read(TIMESTAMPS, 0..store.len())?.into_f64();
    let time_unit = time_unit_of(&timestamps);
    let (mut touched, mut active, mut supervised, mut largest, mut sum) = (0u64, 0u64, 0u64, 0f32, 0f64);
    for start in (0..store.len()).step_by(BLOCK) {
        let labels = read_labels(store, start..(start + BLOCK).min(store.len()))?;
        for (force, mask) in labels.force.chunks_exact(N_FIELD).zip(labels.mask_force.chunks_exact(N_FIELD)) {
            let known = || force.iter().zip(mask).filter(|(_, mask)| **mask == 1).map(|(force, _)| *force);
            let in_contact = known().filter(|force| *force > CONTACT_FORCE_N).count() as u64;
            touched += u64::from(in_contact > 0);
            active += in_contact;
            supervised += known().count() as u64;
            largest = known().fold(largest, f32::max);
            sum += known().map(f64::from).sum::<f64>();
        }
    }
    let mut refused = serde_json::Map::new();
    if store.has(zarr::FRAME_VALIDITY) {
        for code in store.read_u8(zarr::FRAME_VALIDITY, 0..store.len())?.into_iter().filter(|code| *code != 0) {
            let reason = Validity::ALL.get(usize::from(code)).map_or("unknown code", |validity| validity.reason());
            let count = refused.get(reason).and_then(Value::as_u64).unwrap_or(0);
            refused.insert(reason.into(), (count + 1).into());
        }
    }
    let arrays: Vec<Value> = store
        .arrays()
        .into_iter()
        .map(|a| json!({"name": a.name, "shape": a.shape, "dtype": a.dtype, "chunks": a.chunks}))
        .collect();
    let ends = store.episode_ends();
    Ok(json!({
        "path": store.path().display().to_string(),
        "kind": "store",
        "attributes": store.raw_attributes(),
        "episodes": ends.len(),
        "frames": store.len(),
        "fps": fps(&timestamps).map(|fps| fps / time_unit),
        "time_unit_secs": time_unit,
        "image": {"height": store.image_size().0, "width": store.image_size().1},
        "frames_refused": refused,
        "supervised_entries": supervised,
        "active_entries": active,
        "frames_in_contact": touched,
        "max_force": (supervised > 0).then_some(largest),
        "mean_total_force": (supervised > 0).then_some(sum / store.len().max(1) as f64),
        "arrays": arrays,
    }))
}

/// Returns the description as text.
pub fn text(info: &Value) -> String {
    let share = |part: &str, whole: &str| {
        100.0 * info[part].as_f64().unwrap_or(0.0) / info[whole].as_f64().unwrap_or(0.0).max(1.0)
    };
    let mut text = format!(
        "{}\n  {} frames in {} episodes, {} fps, {} x {} pixels",
        info["path"].as_str().unwrap_or_default(),
        info["frames"],
        info["episodes"],
        info["fps"].as_f64().map_or("unknown".into(), |fps| format!("{fps:.1}")),
        info["image"]["width"],
        info["image"]["height"]
    );
    text += &match (info["max_force"].as_f64(), info["mean_total_force"].as_f64()) {
        (Some(largest), Some(mean)) => format!(
            "\n  {:.1} % of the frames and {:.2} % of the supervised entries in contact; largest force {largest:.3} N, mean \
             total force {mean:.3} N",
            share("frames_in_contact", "frames"),
            share("active_entries", "supervised_entries"),
        ),
        _ => "\n  no true forces on the hands' vertices".to_owned(),
    };
    for (reason, count) in info["frames_refused"].as_object().into_iter().flatten() {
        text += &format!("\n  {count} frames refused: {reason}");
    }
    for (name, value) in info["attributes"].as_object().into_iter().flatten() {
        text += &format!("\n  {name}: {}", shortened(&value.to_string()));
    }
    for array in info["arrays"].as_array().into_iter().flatten() {
        let name = array["name"].as_str().unwrap_or_default();
        let dtype = array["dtype"].as_str().unwrap_or_default();
        text += &format!("\n  {name:28} {dtype:4} {} in chunks of {}", array["shape"], array["chunks"]);
    }
    text
}

/// Shortens a long text.
pub fn shortened(text: &str) -> String {
    const LONGEST: usize = 100;
    match text.char_indices().nth(LONGEST) {
        Some((end, _)) => format!("{} ... ({} characters; --json shows all)", &text[..end], text.chars().count()),
        None => text.to_string(),
    }
}
