//! Import of checkpoints of other programs, by a table that maps tensor names.
//!
//! ```yaml
//! config: { vision_width: 384, vision_depth: 12, vision_heads: 6, width: 384, depth: 12, heads: 6, image: 224,
//!           patch: 14, pretrain_image: 518, horizon: 4, predict: 1 }
//! sidecar:
//!   name: theirs
//!   topology: mano            # or egotac-hand-1
//!   force_scale: 1.7          # N per unit of the force head; leave out where it was never trained
//!   hand_order: right_left    # of the heads' outputs; the order of egotac is left_right
//!   mean: [0.485, 0.456, 0.406]
//!   std: [0.229, 0.224, 0.225]
//!   resize: crop
//!   filter: bicubic
//!   fps: 30                   # frames per second of the training data
//!   frame_stride: 4           # every fourth frame is an observation step
//! tensors:                    # name in egotac: name in the file; {i} stands for a number
//!   queries: decoder.tactile_queries
//!   encoder.encoder.layer.{i}.norm1.weight: backbone.blocks.{i}.norm1.weight
//!   encoder.encoder.layer.{i}.attention.attention.query.weight: { from: backbone.blocks.{i}.attn.qkv.weight, part: [0, 3] }
//!   temporal.proj.weight: { from: fuse.proj, transpose: true }
//! same: true                  # tensors that the table lacks have the same name in the file
//! ignore: [optimizer.]        # prefixes of names in the file that are not needed
//! ```
//!
//! Dimensions of 1 need not agree. Errors name tensors that are missing, left over or of a wrong shape.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use candle_core::Tensor;
use serde::Deserialize;

use super::config::Config;
use super::metadata::Metadata;
use super::{shapes, weights};
use crate::error::{Error, Result};
use crate::file::{input, limits};
use crate::hand::{N_VERTICES, Topology};
use crate::image::{Filter, IMAGENET_MEAN, IMAGENET_STD, Resize};
use crate::text::parse_yaml;

/// The table as written.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Mapping {
    config: Config,
    sidecar: Sidecar,
    #[serde(default)]
    tensors: BTreeMap<String, TensorSource>,
    #[serde(default)]
    same: bool,
    #[serde(default)]
    ignore: Vec<String>,
}

/// Metadata that the weights lack.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct Sidecar {
    name: String,
    topology: String,
    force_scale: Option<f32>,
    #[serde(default)]
    hand_order: HandOrder,
    #[serde(default = "imagenet_mean")]
    mean: [f32; 3],
    #[serde(default = "imagenet_std")]
    std: [f32; 3],
    #[serde(default)]
    resize: Resize,
    #[serde(default)]
    filter: Filter,
    fps: f64,
    #[serde(default = "one")]
    frame_stride: u32,
}

fn imagenet_mean() -> [f32; 3] {
    IMAGENET_MEAN
}

fn imagenet_std() -> [f32; 3] {
    IMAGENET_STD
}

fn one() -> u32 {
    1
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize)]
#[serde(rename_all = "snake_case")]
enum HandOrder {
    #[default]
    LeftRight,
    RightLeft,
}

/// Source of a tensor.
#[derive(Debug, Clone, Deserialize)]
#[serde(untagged)]
enum TensorSource {
    Name(String),
    Part(TensorPart),
}

#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct TensorPart {
    from: String,
    /// Index of the part, and number of equal parts along the first dimension.
    part: Option<(usize, usize)>,
    #[serde(default)]
    transpose: bool,
}

impl Mapping {
    /// Reads the table.
    ///
    /// # Errors
    /// If it can't be read, a key is unknown or missing, or a value is out of range.
    pub fn read(path: &Path) -> Result<Self> {
        let text = input::read_text(path, limits::TEXT)?;
        let mapping: Self = parse_yaml(&text).map_err(|error| Error::file(path, error))?;
        mapping.config.check().map_err(|error| Error::file(path, error))?;
        mapping.metadata().map_err(|error| Error::file(path, error))?;
        for source in mapping.tensors.values() {
            if let TensorSource::Part(TensorPart { part: Some((index, of)), .. }) = source
                && index >= of
            {
                return Err(Error::file(
                    path,
                    Error::value("part", "an index below the count", format!("[{index}, {of}]")),
                ));
            }
        }
        Ok(mapping)
    }

    fn metadata(&self) -> Result<Metadata> {
        let Sidecar { name, topology, force_scale, mean, std, resize, filter, fps, frame_stride, .. } = &self.sidecar;
        let metadata = Metadata {
            topology: Topology::from_id(topology)?,
            has_force: force_scale.is_some(),
            mean: *mean,
            std: *std,
            resize: *resize,
            filter: *filter,
            training: "imported".into(),
            ..Metadata::new(name, force_scale.unwrap_or(1.0), f64::from(*frame_stride) / fps)
        };
        metadata.check()?;
        Ok(metadata)
    }

    /// Converts a checkpoint. Returns geometry, metadata and tensors.
    ///
    /// # Errors
    /// If the file can't be read, or tensors are missing, left over or of a wrong shape; names them.
    pub fn apply(&self, path: &Path) -> Result<(Config, Metadata, BTreeMap<String, Tensor>)> {
        let theirs = weights::read_tensors(path)?;
        let (mut tensors, mut used, mut problems) = (BTreeMap::new(), BTreeSet::new(), Vec::new());
        for (name, dims) in shapes::of_network(&self.config) {
            let Some(source) = self.source(&name) else {
                problems.push(format!("{name}: the table does not name it"));
                continue;
            };
            match theirs.get(&source.from) {
                None => problems.push(format!("{name}: expected {dims:?} in {}, found none", source.from)),
                Some(tensor) => {
                    used.insert(source.from.clone());
                    match take(tensor, &source, &dims)? {
                        Some(tensor) => drop(tensors.insert(name.clone(), self.left_hand_first(&name, tensor)?)),
                        None => {
                            let found = tensor.dims();
                            problems.push(format!("{name}: expected {dims:?} from {}, found {found:?}", source.from));
                        }
                    }
                }
            }
        }
        let is_ignored = |name: &str| self.ignore.iter().any(|beginning| name.starts_with(beginning.as_str()));
        let left = theirs.iter().filter(|(name, _)| !used.contains(*name) && !is_ignored(name));
        problems.extend(left.map(|(name, tensor)| format!("{name} {:?}: left over", tensor.dims())));
        if !problems.is_empty() {
            let message = format!("{} tensors do not fit: {}", problems.len(), shapes::first(&problems));
            return Err(Error::file(path, message));
        }
        Ok((self.config.clone(), self.metadata()?, tensors))
    }

    /// Finds the source of the tensor of this name.
    fn source(&self, name: &str) -> Option<TensorPart> {
        let plain = |from: String| TensorPart { from, part: None, transpose: false };
        for (pattern, source) in &self.tensors {
            let Some(number) = matched(pattern, name) else { continue };
            let fill = |text: &str| text.replace("{i}", &number);
            return Some(match source {
                TensorSource::Name(from) => plain(fill(from)),
                TensorSource::Part(part) => TensorPart { from: fill(&part.from), ..part.clone() },
            });
        }
        self.same.then(|| plain(name.to_owned()))
    }

    /// Reorders the heads' outputs so that the left hand is first.
    fn left_hand_first(&self, name: &str, tensor: Tensor) -> Result<Tensor> {
        let is_head = name.starts_with("force_head.") || name.starts_with("contact_head.");
        if !is_head || self.sidecar.hand_order == HandOrder::LeftRight {
            return Ok(tensor);
        }
        let hand = |first| tensor.narrow(0, first, N_VERTICES);
        Ok(Tensor::cat(&[hand(N_VERTICES)?, hand(0)?], 0)?)
    }
}

/// Returns the number that `{i}` stands for if the name fits the pattern; empty for a pattern without `{i}`.
fn matched(pattern: &str, name: &str) -> Option<String> {
    let Some((before, after)) = pattern.split_once("{i}") else {
        return (pattern == name).then(String::new);
    };
    let number = name.strip_prefix(before)?.strip_suffix(after)?;
    (!number.is_empty() && number.bytes().all(|byte| byte.is_ascii_digit())).then(|| number.to_owned())
}

/// Takes the part that `source` names and gives it the shape `dims`; None if shapes differ in more than dimensions of 1.
fn take(tensor: &Tensor, source: &TensorPart, dims: &[usize]) -> Result<Option<Tensor>> {
    let mut tensor = tensor.clone();
    if let Some((index, of)) = source.part {
        match tensor.dims().first() {
            Some(rows) if rows % of == 0 => tensor = tensor.narrow(0, index * (rows / of), rows / of)?,
            _ => return Ok(None),
        }
    }
    if source.transpose {
        if tensor.rank() != 2 {
            return Ok(None);
        }
        tensor = tensor.t()?;
    }
    // For instance (d) in the file for (1, 1, d).
    let squeezed = |dims: &[usize]| dims.iter().copied().filter(|size| *size != 1).collect::<Vec<_>>();
    match squeezed(tensor.dims()) == squeezed(dims) {
        true => Ok(Some(tensor.contiguous()?.reshape(dims)?)),
        false => Ok(None),
    }
}
