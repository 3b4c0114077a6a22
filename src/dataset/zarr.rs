//! OXT-style Zarr v2 stores.
//!
//! | array | shape | dtype | unit |
//! |---|---|---|---|
//! | `data/camera_ego_rgb` | (T, H, W, 3) | u8 | RGB |
//! | `data/timestamps` | (T) | f64 | s |
//! | `data/mano_force` | (T, 1556) | f32 | N, NaN = unknown |
//! | `data/mano_contact` (truth) | (T, 1556) | u8 | 0 or 1 |
//! | `data/mano_contact_score` (prediction) | (T, 1556) | f32 | probability |
//! | `data/mano_force_valid`, `data/mano_contact_valid` | (T, 1556) | u8 | 1 = supervised |
//! | `data/mano_proximity` (by distance; optional) | (T, 1556) | u8 | 1 = an object within 1 cm |
//! | `data/frame_validity` | (T) | u8 | 0 = valid, else the guard's code |
//! | `data/left_hand_pose`, `data/right_hand_pose` | (T, 61) | f32 | transl 3 m, global_orient 3 rad, hand_pose 45 rad, betas 10; zeros = absent |
//! | `meta/episode_ends` | (E) | i64 | exclusive cumulative ends |
//!
//! Images may also be (T, 3, H, W). A producer may declare further arrays when it creates the store. Chunks split the time axis alone and hold about 2 MB.
//! Chunks equal to the fill value are not written, so a missing chunk reads as zeros.

mod added;
mod bounded;
mod carry;
mod column;
mod concatenate;
mod convert;
mod files;
mod folder;
mod images;
mod labels;
mod place;
mod read_labels;
mod reader;
mod rewrite;
mod stored;
mod writer;

use std::fmt;

use serde_json::{Value, json};

pub use added::AddedArrays;
pub(crate) use carry::carry;
pub use concatenate::concatenate;
pub(crate) use convert::{StoreOutput, fitted, image_size, scaled};
pub(crate) use images::Store;
pub(crate) use labels::{copy as copy_store, predicted, read_info};
pub use place::StoreLocation;
pub(crate) use read_labels::read_labelled;
pub use read_labels::{read_fields, read_labels, read_proximity, read_truth};
pub use reader::{ZarrReader, open_all};
pub(crate) use rewrite::{Block, rewrite};
pub use stored::ArrayInfo;
pub use writer::{Contact, ZarrWriter};

/// Egocentric image, (T, H, W, 3) u8.
pub const CAMERA_EGO_RGB: &str = "data/camera_ego_rgb";
/// Image of the task's main camera, in stores by other programs, (T, H, W, 3) u8.
pub const CAMERA_MAIN_RGB: &str = "data/camera_main_rgb";
/// Time of each frame, (T) f64, s.
pub const TIMESTAMPS: &str = "data/timestamps";
/// Normal force, (T, 1556) f32, N.
pub const MANO_FORCE: &str = "data/mano_force";
/// Contact truth, (T, 1556) u8.
pub const MANO_CONTACT: &str = "data/mano_contact";
/// Predicted contact probability, (T, 1556) f32.
pub const MANO_CONTACT_SCORE: &str = "data/mano_contact_score";
/// 1 where the force is supervised, (T, 1556) u8.
pub const MANO_FORCE_VALID: &str = "data/mano_force_valid";
/// Standard deviation of the force, N, (T, 1556) f32; of forces estimated from motion.
pub const MANO_FORCE_STD: &str = "data/mano_force_std";
/// Likeness of each image to the training's, (T).
pub const FAMILIARITY: &str = "data/familiarity";
/// Presence of left and right hand, (T, 2).
pub const PRESENCE: &str = "data/presence";
/// Predicted keypoints of both hands, (T, 2, 21, 3) f32: x and y in pixels of the image, confidence; NaN = unknown.
pub const PREDICTED_KEYPOINTS: &str = "data/predicted_keypoints";
/// 1 where the contact is supervised, (T, 1556) u8.
pub const MANO_CONTACT_VALID: &str = "data/mano_contact_valid";
/// Contact by distance: 1 where the surface of an object is within 1 cm, (T, 1556) u8.
pub const MANO_PROXIMITY: &str = "data/mano_proximity";
/// 0 for a valid frame, else the code of the guard that refused it, (T) u8.
pub const FRAME_VALIDITY: &str = "data/frame_validity";
/// Left hand's MANO parameters, (T, 61) f32.
pub const LEFT_HAND_POSE: &str = "data/left_hand_pose";
/// Right hand's MANO parameters, (T, 61) f32.
pub const RIGHT_HAND_POSE: &str = "data/right_hand_pose";
/// (T, objects, 7) f32: position in m and quaternion (w, x, y, z) of each object in the world; NaN = no such object.
pub const OBJECT_POSE: &str = "data/object_pose";
/// (T, 7) f32: position in m and quaternion (w, x, y, z) of the camera's optical frame in the world.
pub const CAMERA_POSE: &str = "data/camera_pose";
/// Exclusive cumulative ends of the episodes, (E) i64.
pub const EPISODE_ENDS: &str = "meta/episode_ends";

/// Minimum size of an uncompressed chunk, bytes; a chunk has the fewest frames that reach it.
const CHUNK_BYTES: usize = 2_000_000;

/// Compression of chunks.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Compression {
    /// For storage, as in OXT's own stores: Blosc with zstd, level 5, bit shuffle.
    #[default]
    Keep,
    /// For predicted forces and contacts: Blosc with zstd, level 1, byte shuffle, which is smaller and faster on such
    /// values than [`Compression::Keep`].
    Labels,
    /// For temporary stores: Blosc with lz4, level 1.
    Pass,
    /// None.
    None,
}

impl Compression {
    /// Returns the `compressor` entry of `.zarray`.
    fn zarr(self) -> Value {
        match self {
            Self::Keep => json!({"id": "blosc", "cname": "zstd", "clevel": 5, "shuffle": 2, "blocksize": 0}),
            Self::Labels => json!({"id": "blosc", "cname": "zstd", "clevel": 1, "shuffle": 1, "blocksize": 0}),
            Self::Pass => json!({"id": "blosc", "cname": "lz4", "clevel": 1, "shuffle": 0, "blocksize": 0}),
            Self::None => Value::Null,
        }
    }
}

/// Element type of an array.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Dtype {
    /// Unsigned byte.
    U8,
    /// 32-bit float.
    F32,
    /// 64-bit float.
    F64,
    /// 64-bit signed integer.
    I64,
}

impl Dtype {
    /// Returns the size of an element, bytes.
    pub fn size(self) -> usize {
        match self {
            Self::U8 => 1,
            Self::F32 => 4,
            Self::F64 | Self::I64 => 8,
        }
    }

    /// Returns the name in Zarr v2.
    fn zarr_name(self) -> &'static str {
        match self {
            Self::U8 => "|u1",
            Self::F32 => "<f4",
            Self::F64 => "<f8",
            Self::I64 => "<i8",
        }
    }
}

impl fmt::Display for Dtype {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::U8 => "u8",
            Self::F32 => "f32",
            Self::F64 => "f64",
            Self::I64 => "i64",
        })
    }
}

/// Declaration of an array beside the fixed ones.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ArraySpec {
    /// Name with its group, e.g. `data/object_pose`.
    pub name: String,
    /// Shape of one frame's values, e.g. `[n_objects, 7]`; empty = one number per frame.
    pub item: Vec<usize>,
    /// Element type.
    pub dtype: Dtype,
}

impl ArraySpec {
    /// Declares an array `name` with `item` values of `dtype` per frame.
    pub fn new(name: impl Into<String>, item: impl Into<Vec<usize>>, dtype: Dtype) -> Self {
        Self { name: name.into(), item: item.into(), dtype }
    }

    fn frame_bytes(&self) -> usize {
        self.dtype.size() * self.item.iter().product::<usize>()
    }

    /// Returns the number of frames in a chunk.
    fn chunk_len(&self) -> usize {
        CHUNK_BYTES.div_ceil(self.frame_bytes().max(1)).max(1)
    }

    /// Returns the index of the `n`-th chunk in time.
    fn chunk_index(&self, n: usize) -> Vec<u64> {
        std::iter::once(n as u64).chain(self.item.iter().map(|_| 0)).collect()
    }
}

/// Values of one array, row-major.
#[derive(Debug, Clone, PartialEq)]
pub enum Values {
    /// Unsigned bytes.
    U8(Vec<u8>),
    /// 32-bit floats.
    F32(Vec<f32>),
    /// 64-bit floats.
    F64(Vec<f64>),
    /// 64-bit signed integers.
    I64(Vec<i64>),
}

impl Values {
    /// Returns the element type.
    pub fn dtype(&self) -> Dtype {
        match self {
            Self::U8(_) => Dtype::U8,
            Self::F32(_) => Dtype::F32,
            Self::F64(_) => Dtype::F64,
            Self::I64(_) => Dtype::I64,
        }
    }

    /// Returns the number of elements.
    pub fn len(&self) -> usize {
        match self {
            Self::U8(v) => v.len(),
            Self::F32(v) => v.len(),
            Self::F64(v) => v.len(),
            Self::I64(v) => v.len(),
        }
    }

    /// True if there is no element.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Copies the elements `range`.
    fn slice(&self, range: std::ops::Range<usize>) -> Self {
        match self {
            Self::U8(v) => Self::U8(v[range].to_vec()),
            Self::F32(v) => Self::F32(v[range].to_vec()),
            Self::F64(v) => Self::F64(v[range].to_vec()),
            Self::I64(v) => Self::I64(v[range].to_vec()),
        }
    }

    /// Converts the values to f32; wider types are rounded.
    pub fn into_f32(self) -> Vec<f32> {
        match self {
            Self::U8(v) => v.into_iter().map(f32::from).collect(),
            Self::F32(v) => v,
            Self::F64(v) => v.into_iter().map(|x| x as f32).collect(),
            Self::I64(v) => v.into_iter().map(|x| x as f32).collect(),
        }
    }

    /// Converts the values to f64.
    pub fn into_f64(self) -> Vec<f64> {
        match self {
            Self::U8(v) => v.into_iter().map(f64::from).collect(),
            Self::F32(v) => v.into_iter().map(f64::from).collect(),
            Self::F64(v) => v,
            Self::I64(v) => v.into_iter().map(|x| x as f64).collect(),
        }
    }
}

impl From<Vec<u8>> for Values {
    fn from(values: Vec<u8>) -> Self {
        Self::U8(values)
    }
}

impl From<Vec<f32>> for Values {
    fn from(values: Vec<f32>) -> Self {
        Self::F32(values)
    }
}

impl From<Vec<f64>> for Values {
    fn from(values: Vec<f64>) -> Self {
        Self::F64(values)
    }
}

impl From<Vec<i64>> for Values {
    fn from(values: Vec<i64>) -> Self {
        Self::I64(values)
    }
}
