//! Upper limits on what a file, message or option from outside may make this program use.
//!
//! Each limit has a default and an environment variable that replaces it. Readers check a number from a header twice before
//! they allocate: against its limit, and against the bytes that are there.

use std::fmt::Write;
use std::path::Path;

use crate::error::{Error, Result};

/// Prefix of the environment variables that replace defaults.
const PREFIX: &str = "EGOTAC_LIMIT_";
const MIB: u64 = 1 << 20;
const GIB: u64 = 1 << 30;

/// One upper limit.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Limit {
    /// Name in capitals, the end of the environment variable's name.
    pub name: &'static str,
    /// Bounded quantity, as the table and error texts call it.
    pub bounds: &'static str,
    /// Value without the environment variable.
    pub default: u64,
    /// Unit of the value, plural.
    pub unit: &'static str,
}

/// Size of a JSON, YAML, XML or text file.
pub const TEXT: Limit = limit("TEXT_BYTES", "a JSON, YAML, XML, CSV or text file", 64 * MIB, "bytes");
/// Size of a checkpoint, pretrained network or other file of weights.
pub const WEIGHTS: Limit = limit("WEIGHTS_BYTES", "a file of network weights", 8 * GIB, "bytes");
/// Size of a file that is read whole: image, hand model, mesh, tensor file of labels.
pub const FILE: Limit =
    limit("FILE_BYTES", "an image, mesh, hand model or tensor file that is read whole", GIB, "bytes");
/// Pixels of one image. 8K video has 33 million.
pub const IMAGE: Limit = limit("IMAGE_PIXELS", "one image", 36_000_000, "pixels");
/// Size of one record of a bag before decompression.
pub const RECORD: Limit = limit("RECORD_BYTES", "one record of a bag", 256 * MIB, "bytes");
/// Decompressed size of one chunk.
pub const CHUNK: Limit = limit("CHUNK_BYTES", "one decompressed chunk", 256 * MIB, "bytes");
/// Decompressed size of a page or a cell of a Parquet file. Five times that are in memory while a row is copied.
pub const PAGE: Limit = limit("PAGE_BYTES", "one decompressed page or cell of a Parquet file", 128 * MIB, "bytes");
/// Size of the part of an array that is read at once. Force on both hands in 690,000 frames has 4 GiB.
pub const ARRAY: Limit = limit("ARRAY_BYTES", "one array of a recording that is read whole", 4 * GIB, "bytes");
/// Number of chunks that the values of one frame of an array may lie in.
pub const FRAME_CHUNKS: Limit = limit("FRAME_CHUNKS", "one frame of an array", 4096, "chunks");
/// Number of chunks of an array whose chunks are parts of a frame: each costs a look into the file system, also where it is
/// absent.
pub const PART_CHUNKS: Limit =
    limit("PART_CHUNKS", "all frames of an array whose frames lie in several chunks each", 1 << 22, "chunks");
/// Number of images or rows of one recording. At 30 Hz, 16 million are 148 hours.
pub const FRAMES: Limit = limit("FRAMES", "one recording", 1 << 24, "frames");
/// Number of episodes of one data set: each has a journal of its own while it is labelled.
pub const EPISODES: Limit = limit("EPISODES", "one data set", 1 << 20, "episodes");
/// Number of parameters of a network; DINOv2 giant has 1.1 thousand million.
pub const PARAMETERS: Limit = limit("PARAMETERS", "a network", 2_000_000_000, "parameters");
/// Memory of a child process that reads a model of others (MJCF, URDF, meshes).
pub const MODEL_MEMORY: Limit = limit("MODEL_BYTES", "the memory to compile a scene or robot model", 2 * GIB, "bytes");
/// Processor time of a child process that reads a model of others.
pub const MODEL_SECONDS: Limit =
    limit("MODEL_SECONDS", "the processor time to compile a scene or robot model", 10, "seconds");

/// All limits, in the order of the table.
pub const ALL: [Limit; 15] = [
    TEXT,
    FILE,
    WEIGHTS,
    PARAMETERS,
    IMAGE,
    RECORD,
    CHUNK,
    PAGE,
    ARRAY,
    FRAME_CHUNKS,
    PART_CHUNKS,
    FRAMES,
    EPISODES,
    MODEL_MEMORY,
    MODEL_SECONDS,
];

const fn limit(name: &'static str, bounds: &'static str, default: u64, unit: &'static str) -> Limit {
    Limit { name, bounds, default, unit }
}

impl Limit {
    /// Name of the environment variable that replaces the default.
    pub fn variable(&self) -> String {
        format!("{PREFIX}{}", self.name)
    }

    /// Value that holds in this process.
    pub fn value(&self) -> u64 {
        // `check_environment` has refused a value that is not a number.
        std::env::var(self.variable()).ok().and_then(|text| text.parse().ok()).unwrap_or(self.default)
    }

    /// Checks a quantity of the file at `path` against the limit. `quantity` names it, e.g. `chunk 3 of images`.
    ///
    /// # Errors
    /// If `got` exceeds the limit; the error names the variable that raises it.
    pub fn check(&self, path: &Path, quantity: &str, got: u64) -> Result<()> {
        let most = self.value();
        if got <= most {
            return Ok(());
        }
        let (unit, variable) = (self.unit, self.variable());
        Err(Error::file(
            path,
            format!("{quantity}: expected at most {most} {unit}, got {got}; {variable} raises the limit"),
        ))
    }
}

/// Checks the environment variables of all limits; programs call it at their start.
///
/// # Errors
/// If a variable with the prefix names no limit, or its value is not a whole number above 0.
pub fn check_environment() -> Result<()> {
    for (name, value) in std::env::vars_os() {
        let (Some(name), value) = (name.to_str(), value.to_string_lossy()) else { continue };
        let Some(limit) = name.strip_prefix(PREFIX) else { continue };
        if !ALL.iter().any(|known| known.name == limit) {
            return Err(Error::unknown("limit", limit, ALL.iter().map(|known| known.name)));
        }
        if !value.parse().is_ok_and(|number: u64| number > 0) {
            return Err(Error::value(name, "a whole number above 0", value));
        }
    }
    Ok(())
}

/// Formats the table of all limits in Markdown.
pub fn table() -> String {
    let mut text = String::from("| bounded | at most | variable that replaces it |\n|---|---|---|\n");
    for limit in ALL {
        // Writing to a String cannot fail.
        let _ = writeln!(text, "| {} | {} {} | `{}` |", limit.bounds, limit.default, limit.unit, limit.variable());
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_quantity_above_its_limit_is_refused_with_the_variable_that_raises_it() {
        let path = Path::new("a.zarr");
        assert!(IMAGE.check(path, "camera_ego_rgb", IMAGE.default).is_ok());
        let error = IMAGE.check(path, "camera_ego_rgb", IMAGE.default + 1).unwrap_err().to_string();
        assert_eq!(
            error,
            "a.zarr: camera_ego_rgb: expected at most 36000000 pixels, got 36000001; EGOTAC_LIMIT_IMAGE_PIXELS raises the limit"
        );
    }

    #[test]
    fn names_of_limits_differ() {
        let mut names: Vec<_> = ALL.iter().map(|limit| limit.name).collect();
        names.sort_unstable();
        names.dedup();
        assert_eq!(names.len(), ALL.len());
    }
}
