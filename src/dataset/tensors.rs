//! Fields in safetensors files, as `egotac predict` writes them and `egotac eval` reads them.
//!
//! | tensor | shape | other names taken |
//! |---|---|---|
//! | `force` | (T, 1556) N | `mano_force` |
//! | `contact` | (T, 1556) probability or truth | `mano_contact`, `mano_contact_score` |
//! | `mask_force`, `mask_contact` | (T, 1556), optional | `mano_force_valid`, `mano_contact_valid` |
//! | `familiarity`, `presence` | (T) and (T, 2), optional | |
//! | `timestamps` | (T) s, optional | |
//! | `episode_ends` | (E), optional | |
//!
//! Floats may be f16, bf16, f32 or f64, the rest any integer or bool. The metadata carries `topology` and `force_kind`.

mod labels;

use std::collections::BTreeMap;
use std::path::Path;

use safetensors::tensor::{Dtype, SafeTensors, TensorView};

use crate::error::{Error, Result};
use crate::file::{self, input, limits};
use crate::hand::Topology;
use crate::tactile::{ForceKind, N_FIELD, TactileSequence};

pub(crate) use labels::{TensorOutput, read_info, read_labelled};

/// Reads a field file. A file with one field alone leaves the other unknown (NaN), except that contact truth follows from
/// force.
///
/// # Errors
/// If it is not a safetensors file, holds neither field, or a tensor has another shape or dtype than its name demands.
pub fn read(path: &Path) -> Result<TactileSequence> {
    let bytes = input::read(path, limits::ARRAY)?;
    let tensors =
        SafeTensors::deserialize(&bytes).map_err(|e| Error::file(path, format!("expected a safetensors file: {e}")))?;
    let (_, metadata) = SafeTensors::read_metadata(&bytes).map_err(|e| Error::file(path, e))?;
    let topology = match metadata.metadata().as_ref().and_then(|map| map.get("topology")) {
        Some(id) => Some(Topology::from_id(id).map_err(|e| Error::file(path, e))?),
        None => None,
    };
    let force_kind = match metadata.metadata().as_ref().and_then(|map| map.get(ForceKind::ATTRIBUTE)) {
        Some(id) => Some(ForceKind::from_id(id).map_err(|e| Error::file(path, e))?),
        None => None,
    };
    let get = |names: &[&str]| names.iter().find_map(|name| Some((name.to_string(), tensors.tensor(name).ok()?)));
    let force = get(&["force", "mano_force"]);
    let contact = get(&["contact", "mano_contact", "mano_contact_score"]);
    let Some(n_frames) = force.as_ref().or(contact.as_ref()).map(|(_, t)| t.shape().first().copied().unwrap_or(0))
    else {
        let present = tensors.names().join(", ");
        return Err(Error::Missing { name: "force or contact".into(), place: path.display().to_string(), present });
    };
    let field = |tensor: Option<(String, TensorView)>| -> Result<Option<Vec<f64>>> {
        let Some((name, tensor)) = tensor else { return Ok(None) };
        numbers(&name, &tensor, &[n_frames, N_FIELD]).map(Some).map_err(|e| Error::file(path, e))
    };
    let f32s = |values: Vec<f64>| values.into_iter().map(|x| x as f32).collect::<Vec<_>>();
    let mask = |names: &[&str]| -> Result<Vec<u8>> {
        Ok(field(get(names))?.unwrap_or_default().into_iter().map(|x| u8::from(x != 0.0)).collect())
    };
    let row = |name: &str| -> Result<Vec<f64>> {
        let Ok(tensor) = tensors.tensor(name) else { return Ok(Vec::new()) };
        let expected = if name == "timestamps" { n_frames } else { tensor.shape().iter().product() };
        numbers(name, &tensor, &[expected]).map_err(|e| Error::file(path, e))
    };
    let estimates = |name: &str, row: &[usize]| -> Result<Vec<f32>> {
        let Ok(tensor) = tensors.tensor(name) else { return Ok(Vec::new()) };
        let values = numbers(name, &tensor, &[&[n_frames], row].concat()).map_err(|e| Error::file(path, e))?;
        Ok(values.into_iter().map(|x| x as f32).collect())
    };
    let fields = match (field(force)?.map(f32s), field(contact)?.map(f32s)) {
        (Some(force), Some(contact)) => TactileSequence { topology, force, contact, ..Default::default() },
        (Some(force), None) => TactileSequence::from_force(topology, force),
        (None, contact) => TactileSequence {
            topology,
            force: vec![f32::NAN; n_frames * N_FIELD],
            contact: contact.unwrap_or_default(),
            ..Default::default()
        },
    };
    Ok(TactileSequence {
        mask_force: mask(&["mask_force", "mano_force_valid"])?,
        mask_contact: mask(&["mask_contact", "mano_contact_valid"])?,
        familiarity: estimates("familiarity", &[])?,
        presence: estimates("presence", &[2])?,
        timestamps: row("timestamps")?,
        episode_ends: ends(row("episode_ends")?)?,
        force_kind,
        ..fields
    })
}

/// Writes a field file atomically. Frames that are not valid are masked out in it. Equal content gives equal bytes.
///
/// # Errors
/// If the arrays differ in length or the file can't be written.
pub fn write(path: &Path, sequence: &TactileSequence, mut metadata: BTreeMap<String, String>) -> Result<()> {
    let n_frames = sequence.n_frames();
    let field = [n_frames, N_FIELD];
    let bytes = |values: &[f32]| values.iter().flat_map(|x| x.to_le_bytes()).collect::<Vec<u8>>();
    let mut tensors = vec![
        ("force", Dtype::F32, field.to_vec(), bytes(&sequence.force)),
        ("contact", Dtype::F32, field.to_vec(), bytes(&sequence.contact)),
    ];
    for (name, mask) in [("mask_force", sequence.counted_force()), ("mask_contact", sequence.counted_contact())] {
        if !mask.is_empty() {
            tensors.push((name, Dtype::U8, field.to_vec(), mask.into_owned()));
        }
    }
    let estimates =
        [("familiarity", &sequence.familiarity, vec![n_frames]), ("presence", &sequence.presence, vec![n_frames, 2])];
    for (name, values, shape) in estimates {
        if !values.is_empty() {
            tensors.push((name, Dtype::F32, shape, bytes(values)));
        }
    }
    if !sequence.timestamps.is_empty() {
        let bytes = sequence.timestamps.iter().flat_map(|x| x.to_le_bytes()).collect();
        tensors.push(("timestamps", Dtype::F64, vec![n_frames], bytes));
    }
    if !sequence.episode_ends.is_empty() {
        let bytes = sequence.episode_ends.iter().flat_map(|x| (*x as i64).to_le_bytes()).collect();
        tensors.push(("episode_ends", Dtype::I64, vec![sequence.episode_ends.len()], bytes));
    }
    if let Some(topology) = sequence.topology {
        metadata.insert("topology".into(), topology.id().into());
    }
    if let Some(kind) = sequence.force_kind {
        metadata.insert(ForceKind::ATTRIBUTE.into(), kind.id().into());
    }
    let mut views = Vec::new();
    for (name, dtype, shape, data) in &tensors {
        let view = TensorView::new(*dtype, shape.clone(), data);
        views.push((*name, view.map_err(|e| Error::file(path, format!("{name}: {e}")))?));
    }
    file::write(path, &file::tensors::to_bytes(path, views, &metadata)?)
}

/// Converts episode ends to whole numbers.
fn ends(values: Vec<f64>) -> Result<Vec<usize>> {
    let whole = |end: f64| match end >= 0.0 && end.fract() == 0.0 {
        true => Ok(end as usize),
        false => Err(Error::value("episode_ends", "whole numbers from 0 on", end)),
    };
    values.into_iter().map(whole).collect()
}

/// Returns the numbers of a tensor of any dtype as f64.
pub(crate) fn numbers(name: &str, tensor: &TensorView, shape: &[usize]) -> Result<Vec<f64>> {
    if tensor.shape() != shape {
        return Err(Error::shape(name, format!("{shape:?}"), tensor.shape()));
    }
    fn each<const N: usize>(data: &[u8], number: impl Fn([u8; N]) -> f64) -> Vec<f64> {
        data.as_chunks::<N>().0.iter().map(|bytes| number(*bytes)).collect()
    }
    let data = tensor.data();
    Ok(match tensor.dtype() {
        Dtype::F64 => each(data, f64::from_le_bytes),
        Dtype::F32 => each(data, |b| f64::from(f32::from_le_bytes(b))),
        Dtype::F16 => each(data, |b| half::f16::from_le_bytes(b).to_f64()),
        Dtype::BF16 => each(data, |b| half::bf16::from_le_bytes(b).to_f64()),
        Dtype::I64 => each(data, |b| i64::from_le_bytes(b) as f64),
        Dtype::I32 => each(data, |b| f64::from(i32::from_le_bytes(b))),
        Dtype::I16 => each(data, |b| f64::from(i16::from_le_bytes(b))),
        Dtype::U64 => each(data, |b| u64::from_le_bytes(b) as f64),
        Dtype::U32 => each(data, |b| f64::from(u32::from_le_bytes(b))),
        Dtype::U16 => each(data, |b| f64::from(u16::from_le_bytes(b))),
        Dtype::I8 => each(data, |b: [u8; 1]| f64::from(b[0] as i8)),
        Dtype::U8 | Dtype::BOOL => each(data, |b: [u8; 1]| f64::from(b[0])),
        other => {
            return Err(Error::value(name, "dtype F16, BF16, F32, F64, an integer or BOOL", format!("{other:?}")));
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn equal_fields_give_equal_bytes() {
        let folder = tempfile::tempdir().unwrap();
        let sequence = TactileSequence::from_force(Some(Topology::Mano), vec![0.5; N_FIELD]);
        let write = |name: &str| {
            let path = folder.path().join(name);
            let metadata = ["d", "c", "b", "a"].map(|key| (key.to_string(), "1".to_string()));
            super::write(&path, &sequence, metadata.into()).unwrap();
            std::fs::read(path).unwrap()
        };
        let bytes = write("x");
        assert_eq!(bytes, write("y"));
        assert_eq!(read(&folder.path().join("x")).unwrap(), sequence);
    }
}
