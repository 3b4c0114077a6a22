//! Concatenation of several stores into one.

use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use rayon::prelude::*;
use serde_json::{Map, Value};
use zarrs::array::{Array, ArrayBytes, ArraySubset, CodecOptions};
use zarrs::filesystem::FilesystemStore;

use super::files::StoreFiles;
use super::folder::{StoreFolder, create_array, write_metadata};
use super::{ArraySpec, Compression, StoreLocation, ZarrReader};
use crate::dataset::{Attributes, EpisodeReader};
use crate::error::{Error, Result};
use crate::tactile::ForceKind;

/// Writes the frames of `parts`, one after another, into one store at `out`, with `threads` threads. Calls `progress` with
/// (done, all) after each chunk.
///
/// The parts must hold the same arrays in `data/`; their compression may differ. Memory: a few chunks per thread.
///
/// # Errors
/// If there is no part, `out` exists, the parts differ in topology or in an array's shape or dtype, or reading or writing
/// fails.
pub fn concatenate(
    parts: &[PathBuf],
    out: &Path,
    attributes: &Attributes,
    mut more_attributes: Map<String, Value>,
    threads: usize,
    progress: impl Fn(usize, usize) + Sync,
) -> Result<()> {
    let (sources, specs, episode_ends) = survey(parts, attributes)?;
    let kind = force_kind(parts)?.map_or(Value::Null, |kind| kind.id().into());
    more_attributes.entry(ForceKind::ATTRIBUTE).or_insert(kind);
    let n_frames = sources.last().map_or(0, |source| source.frames.end);
    let folder = StoreFolder::create(out)?;
    let mut outputs = Vec::new();
    for spec in &specs {
        // A short array gets a short chunk instead of padding.
        let chunk_len = spec.chunk_len().min(n_frames);
        let array = create_array(folder.root(), spec, n_frames, chunk_len, Compression::Keep)?;
        outputs.push(OutputArray { spec, array, chunk_len });
    }
    let chunks: Vec<(&OutputArray, usize)> =
        outputs.iter().flat_map(|output| (0..n_frames.div_ceil(output.chunk_len)).map(move |n| (output, n))).collect();
    let done = AtomicUsize::new(0);
    let write = |(output, n): &(&OutputArray, usize)| -> Result<()> {
        output.write(*n, &sources, n_frames, out)?;
        progress(done.fetch_add(1, Ordering::Relaxed) + 1, chunks.len());
        Ok(())
    };
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads.max(1)).build();
    let pool = pool.map_err(|error| Error::file(out, error))?;
    pool.install(|| chunks.par_iter().with_max_len(1).try_for_each(write))?;
    for output in &outputs {
        write_metadata(folder.root(), output.spec, n_frames, output.chunk_len, Compression::Keep)?;
    }
    folder.finish(attributes, more_attributes, &episode_ends)
}

/// A part and its frames in the whole.
struct StorePart {
    path: PathBuf,
    store: Arc<StoreFiles>,
    frames: Range<usize>,
}

/// Returns the meaning of the forces of the parts that know some.
fn force_kind(parts: &[PathBuf]) -> Result<Option<ForceKind>> {
    let mut found: Option<ForceKind> = None;
    for path in parts {
        if let Some(kind) = ZarrReader::open(path)?.force_kind()? {
            found.get_or_insert(kind).must_match(kind).map_err(|error| Error::file(path, error))?;
        }
    }
    Ok(found)
}

/// Returns the parts, the arrays that they have in common, and the ends of all episodes.
fn survey(parts: &[PathBuf], attributes: &Attributes) -> Result<(Vec<StorePart>, Vec<ArraySpec>, Vec<i64>)> {
    let (mut sources, mut specs, mut ends) = (Vec::new(), Vec::new(), Vec::new());
    let mut n_frames = 0;
    for path in parts {
        let reader = ZarrReader::open(path)?;
        let topology = attributes.topology.must_match(reader.attributes().topology);
        topology.map_err(|error| Error::file(path, error))?;
        let own = reader.specs()?;
        if sources.is_empty() {
            specs = own;
        } else if specs != own {
            let named = |specs: &[ArraySpec]| {
                specs.iter().map(|s| format!("{} {:?} {}", s.name, s.item, s.dtype)).collect::<Vec<_>>().join(", ")
            };
            let what = format!("expected the arrays of {}: {}; got {}", parts[0].display(), named(&specs), named(&own));
            return Err(Error::file(path, what));
        }
        ends.extend(reader.episode_ends().iter().map(|end| (n_frames + end) as i64));
        let store = StoreLocation::folder(path).files()?;
        sources.push(StorePart { path: path.clone(), store, frames: n_frames..n_frames + reader.len() });
        n_frames += reader.len();
    }
    match n_frames {
        0 => Err(Error::value("parts", "at least one store", "none")),
        _ => Ok((sources, specs, ends)),
    }
}

/// One array of the output.
struct OutputArray<'a> {
    spec: &'a ArraySpec,
    array: Array<FilesystemStore>,
    chunk_len: usize,
}

impl OutputArray<'_> {
    /// Gathers and writes the `n`-th chunk.
    fn write(&self, n: usize, sources: &[StorePart], n_frames: usize, out: &Path) -> Result<()> {
        let wanted = n * self.chunk_len..((n + 1) * self.chunk_len).min(n_frames);
        let mut bytes = Vec::with_capacity(self.chunk_len * self.spec.frame_bytes());
        let first = sources.partition_point(|source| source.frames.end <= wanted.start);
        for source in sources[first..].iter().take_while(|source| source.frames.start < wanted.end) {
            let from = wanted.start.max(source.frames.start) - source.frames.start;
            let to = wanted.end.min(source.frames.end) - source.frames.start;
            bytes.extend_from_slice(&source.read(self.spec, from..to)?);
        }
        // Zarr v2 pads the last chunk to full length.
        bytes.resize(self.chunk_len * self.spec.frame_bytes(), 0);
        let written = self.array.store_chunk_opt(&self.spec.chunk_index(n), ArrayBytes::new_flen(bytes), &one_thread());
        written.map_err(|error| Error::file(out, format!("{}: {error}", self.spec.name)))
    }
}

impl StorePart {
    fn read(&self, spec: &ArraySpec, frames: Range<usize>) -> Result<Vec<u8>> {
        let fail = |error: &dyn std::fmt::Display| Error::file(&self.path, format!("{}: {error}", spec.name));
        let array = Array::open(self.store.clone(), &format!("/{}", spec.name)).map_err(|e| fail(&e))?;
        let time = frames.start as u64..frames.end as u64;
        let subset = ArraySubset::from(std::iter::once(time).chain(spec.item.iter().map(|n| 0..*n as u64)));
        let read: ArrayBytes = array.retrieve_array_subset_opt(&subset, &one_thread()).map_err(|e| fail(&e))?;
        Ok(read.into_fixed().map_err(|e| fail(&e))?.into_owned())
    }
}

/// Options without concurrency inside a chunk, since chunks are written concurrently.
fn one_thread() -> CodecOptions {
    CodecOptions::default().with_concurrent_target(1)
}

#[cfg(test)]
mod tests {
    use ::image::RgbImage;

    use super::super::{Contact, Dtype, TIMESTAMPS, Values, ZarrWriter};
    use super::*;
    use crate::dataset::{EpisodeWriter, Frame};
    use crate::hand::Topology;
    use crate::tactile::{N_FIELD, TactileField, Validity};

    fn attributes(topology: Topology) -> Attributes {
        serde_json::from_value(serde_json::json!({ "topology": topology })).unwrap()
    }

    /// Writes a store whose frames count on from `first`, in episodes of the given lengths.
    fn part(path: &Path, first: usize, episodes: &[usize], compression: Compression, item: usize) {
        let extra = vec![ArraySpec::new("data/own", [item], Dtype::F32)];
        let writer = ZarrWriter::create(path, attributes(Topology::Mano), Contact::Truth, extra).unwrap();
        let mut writer = writer.with_compression(compression);
        let mut at = first;
        for length in episodes {
            for _ in 0..*length {
                let frame = Frame {
                    timestamp: at as f64,
                    // 300 kB per image: chunks of 2 MB end within parts.
                    camera_ego_rgb: RgbImage::from_fn(320, 313, |x, y| [at as u8, x as u8, (x * y) as u8].into()),
                    field: TactileField::zeros(Topology::Mano),
                    force_valid: vec![1; N_FIELD],
                    contact_valid: vec![1; N_FIELD],
                    validity: Validity::Valid,
                    left_hand_pose: None,
                    right_hand_pose: None,
                };
                let own = Values::F32(vec![f32::NAN; item]);
                writer.push_with(frame, vec![("data/own", own)]).unwrap();
                at += 1;
            }
            writer.end_episode().unwrap();
        }
        writer.finish().unwrap();
    }

    #[test]
    fn parts_of_any_length_and_compression_are_concatenated() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        let all = [[3, 1], [8, 1], [1, 9], [2, 2]];
        let compressions = [Compression::Pass, Compression::Keep, Compression::None, Compression::Pass];
        let (mut parts, mut first) = (Vec::new(), 0);
        for (at, (episodes, compression)) in all.iter().zip(compressions).enumerate() {
            parts.push(path(&at.to_string()));
            part(&parts[at], first, episodes, compression, 2);
            first += episodes.iter().sum::<usize>();
        }
        // The same frames as one store.
        part(&path("whole"), 0, all.as_flattened(), Compression::Keep, 2);
        let whole = ZarrReader::open(&path("whole")).unwrap();
        for threads in [1, 3] {
            let out = path(&format!("out{threads}"));
            let more = [("note".to_string(), Value::from("kept"))].into_iter().collect();
            concatenate(&parts, &out, &attributes(Topology::Mano), more, threads, |_, _| ()).unwrap();
            let read = ZarrReader::open(&out).unwrap();
            assert_eq!(read.episode_ends(), whole.episode_ends());
            assert_eq!(read.arrays(), whole.arrays());
            assert_eq!(read.raw_attributes()["note"], "kept");
            for spec in whole.specs().unwrap() {
                let [got, expected] = [&read, &whole].map(|store| store.read(&spec.name, 0..first).unwrap().into_f64());
                let bits = |values: &[f64]| values.iter().map(|x| x.to_bits()).collect::<Vec<_>>();
                assert!(bits(&got) == bits(&expected), "{}", spec.name);
            }
            assert_eq!(read.read(TIMESTAMPS, 0..first).unwrap().into_f64()[first - 1], (first - 1) as f64);
        }
    }

    #[test]
    fn parts_that_differ_are_refused_by_name_and_leave_no_output() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        part(&path("a"), 0, &[2], Compression::Pass, 2);
        part(&path("b"), 0, &[2], Compression::Pass, 3);
        let join = |parts: &[&str], topology: Topology| {
            let parts: Vec<_> = parts.iter().map(|name| path(name)).collect();
            let joined = concatenate(&parts, &path("out"), &attributes(topology), Map::new(), 1, |_, _| ());
            assert!(!path("out").exists());
            joined.unwrap_err().to_string()
        };
        let error = join(&["a", "b"], Topology::Mano);
        assert!(error.contains("data/own [2] f32") && error.contains("data/own [3] f32"), "{error}");
        assert!(join(&["a"], Topology::EgotacHand1).contains("egotac-hand-1"));
        assert!(join(&["a", "none"], Topology::Mano).contains("none"));
        assert!(join(&[], Topology::Mano).contains("at least one store"));
    }
}
