//! Reader of stores: single frames, or ranges of one array.

use std::collections::BTreeMap;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use ::image::RgbImage;
use zarrs::array::Array;
use zarrs::group::Group;
use zarrs::storage::ReadableStorageTraits;

use super::files::StoreFiles;
use super::place::StoreLocation;
use super::stored::{ArrayInfo, StoredArray};
use super::*;
use crate::dataset::source::LostBytes;
use crate::dataset::{Attributes, EpisodeReader, Frame};
use crate::error::{Error, Result};
use crate::file::limits;
use crate::hand::{HandParams, Topology};
use crate::image::check_size;
use crate::tactile::{ForceKind, N_FIELD, TactileField, Validity};

/// Number of frames up to which a store may leave out all chunks of its images, as if they were black.
const UNCHECKED: usize = 1024;

/// An open store. Reads Zarr v2 as written here or by zarr-python (any of its Blosc, zlib, gzip, zstd or no
/// compression), and v3.
///
/// Missing label arrays read as unknown (force and contact NaN, validity 0), missing validity arrays as valid, missing
/// hand poses as absent.
pub struct ZarrReader {
    path: PathBuf,
    files: Arc<StoreFiles>,
    attributes: Attributes,
    raw_attributes: serde_json::Map<String, serde_json::Value>,
    episode_ends: Vec<usize>,
    arrays: BTreeMap<String, StoredArray>,
    camera: Camera,
}

/// Array of the images.
#[derive(Debug, Clone)]
struct Camera {
    name: String,
    /// (H, W) pixels.
    size: (usize, usize),
    /// True for (T, 3, H, W) instead of (T, H, W, 3).
    planar: bool,
}

/// Opens all stores that `paths` name: stores, or folders of stores, as [`StoreLocation::find`] finds them.
///
/// # Errors
/// If a path holds no store, one can't be opened, or two differ in topology.
pub fn open_all(paths: &[PathBuf]) -> Result<Vec<ZarrReader>> {
    let mut stores = Vec::new();
    for path in paths {
        for place in StoreLocation::find(path)? {
            stores.push(ZarrReader::open_at(&place)?);
        }
    }
    for pair in stores.windows(2) {
        pair[0]
            .attributes
            .topology
            .must_match(pair[1].attributes.topology)
            .map_err(|error| Error::file(&pair[1].path, format!("beside {}: {error}", pair[0].path.display())))?;
    }
    Ok(stores)
}

impl ZarrReader {
    /// Opens the store at `path`, a folder or a zip file with one store in it.
    ///
    /// # Errors
    /// If it is not a store, a required array is missing, or an array has not the shape or dtype of its name.
    pub fn open(path: &Path) -> Result<Self> {
        Self::open_at(&StoreLocation::only(path)?)
    }

    /// Opens the store at `place`.
    ///
    /// # Errors
    /// As [`Self::open`].
    pub fn open_at(place: &StoreLocation) -> Result<Self> {
        let path = &PathBuf::from(place.to_string());
        let files = place.files()?;
        let storage: Arc<dyn ReadableStorageTraits> = files.clone();
        let group = Group::open(storage.clone(), "/").map_err(|e| Error::file(path, e))?;
        let raw_attributes = group.attributes().clone();

        let mut arrays = BTreeMap::new();
        for name in array_names(&files)? {
            let array = Array::open(storage.clone(), &format!("/{name}"))
                .map_err(|e| Error::file(path, format!("{name}: {e}")))?;
            arrays.insert(name.clone(), StoredArray::new(name, array));
        }
        let attributes = attributes(path, &raw_attributes, &arrays)?;
        let mut reader = Self {
            path: path.to_path_buf(),
            files,
            attributes,
            raw_attributes,
            episode_ends: Vec::new(),
            arrays,
            camera: Camera { name: String::new(), size: (0, 0), planar: false },
        };
        reader.episode_ends = reader.read_episode_ends()?;
        reader.check_shapes()?;
        let camera = [CAMERA_EGO_RGB, CAMERA_MAIN_RGB].into_iter().find(|name| reader.has(name));
        reader.camera = reader.find_camera(camera.unwrap_or(CAMERA_EGO_RGB))?;
        Ok(reader)
    }

    /// Sets the array of the images, (T, H, W, 3) or (T, 3, H, W) u8. The default is `data/camera_ego_rgb`, or else
    /// `data/camera_main_rgb`.
    ///
    /// # Errors
    /// If there is no such array, or it holds no images.
    pub fn with_camera(mut self, name: &str) -> Result<Self> {
        self.camera = self.find_camera(name)?;
        Ok(self)
    }

    /// Returns the name of the array of the images.
    pub fn camera(&self) -> &str {
        &self.camera.name
    }

    /// Returns the path of the store.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Returns all attributes of the root group.
    pub fn raw_attributes(&self) -> &serde_json::Map<String, serde_json::Value> {
        &self.raw_attributes
    }

    /// Returns the number of frames over all episodes.
    pub fn len(&self) -> usize {
        self.episode_ends.last().copied().unwrap_or(0)
    }

    /// True if there is no frame, which an open store never has.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Returns height and width of the images, pixels.
    pub fn image_size(&self) -> (usize, usize) {
        self.camera.size
    }

    /// Reads the image of one frame, and keeps its chunk for the next frames.
    ///
    /// # Errors
    /// As [`Self::read`].
    pub fn image(&self, index: usize) -> Result<RgbImage> {
        let name = &self.camera.name;
        self.picture(self.bytes(name, self.read_frame(name, index)?)?, index)
    }

    /// Reads the images of frames `range`, decoding each chunk once.
    ///
    /// # Errors
    /// As [`Self::read`].
    pub fn images(&self, range: Range<usize>) -> Result<Vec<RgbImage>> {
        let Camera { name, size: (height, width), .. } = &self.camera;
        let pixels = self.read_u8(name, range.clone())?;
        let images = pixels.chunks_exact(height * width * 3).zip(range);
        images.map(|(pixels, index)| self.picture(pixels.to_vec(), index)).collect()
    }

    /// Returns the image of the stored bytes, by the layout of the camera.
    fn picture(&self, mut pixels: Vec<u8>, index: usize) -> Result<RgbImage> {
        let Camera { name, size: (height, width), planar } = &self.camera;
        let plane = height * width;
        if pixels.len() != 3 * plane {
            return Err(Error::file(&self.path, format!("{name}: frame {index} is too short")));
        }
        if *planar {
            pixels = (0..plane).flat_map(|i| [pixels[i], pixels[plane + i], pixels[2 * plane + i]]).collect();
        }
        RgbImage::from_raw(*width as u32, *height as u32, pixels)
            .ok_or_else(|| Error::file(&self.path, format!("{name}: frame {index} is too short")))
    }

    /// Decodes the chunks of all arrays but `except`, and returns those that can't be read, by the name of their file.
    ///
    /// # Errors
    /// If the medium fails.
    pub(super) fn damaged_chunks(&self, except: &str) -> Result<Vec<LostBytes>> {
        let mut damaged = Vec::new();
        for array in self.arrays.values().filter(|array| array.name != except) {
            for (name, bytes) in self.files.entries_in(&array.name)? {
                match array.check_file(&name, &self.path) {
                    Ok(()) => {}
                    Err(error) if error.is_of_medium() => return Err(error),
                    Err(error) => damaged.push(LostBytes {
                        file: format!("{}: {}/{name}", self.path.display(), array.name),
                        offset: 0,
                        bytes,
                        reason: error.to_string(),
                    }),
                }
            }
        }
        Ok(damaged)
    }

    /// True if the store has an array of this name.
    pub fn has(&self, name: &str) -> bool {
        self.arrays.contains_key(name)
    }

    /// Returns the meaning of the forces; `None` = the store says that it knows no force. Stores that do not say anything hold
    /// spread forces.
    ///
    /// # Errors
    /// If the attribute is unknown.
    pub fn force_kind(&self) -> Result<Option<ForceKind>> {
        match self.raw_attributes().get(ForceKind::ATTRIBUTE) {
            None => Ok(Some(ForceKind::default())),
            Some(serde_json::Value::Null) => Ok(None),
            Some(id) => {
                let kind = ForceKind::from_id(id.as_str().unwrap_or_default());
                kind.map(Some).map_err(|error| self.named(error))
            }
        }
    }

    /// Returns all arrays of the store, by name.
    pub fn arrays(&self) -> Vec<ArrayInfo> {
        self.arrays.values().map(StoredArray::info).collect()
    }

    /// Returns the declarations of the arrays in `data/`, by name.
    ///
    /// # Errors
    /// If one has a dtype that [`Dtype`] does not have.
    pub fn specs(&self) -> Result<Vec<ArraySpec>> {
        let of_frames = self.arrays.values().filter(|column| column.name.starts_with("data/"));
        of_frames
            .map(|column| {
                let info = column.info();
                let unknown = || self.named(Error::value(&column.name, "dtype u8, f32, f64 or i64", &info.dtype));
                let dtype = column.dtype().ok_or_else(unknown)?;
                Ok(ArraySpec::new(&column.name, &info.shape[1..], dtype))
            })
            .collect()
    }

    /// Reads one frame of array `name` and keeps its chunk for the next frames.
    ///
    /// # Errors
    /// As [`Self::read`].
    pub fn read_frame(&self, name: &str, index: usize) -> Result<Values> {
        self.column(name)?.read_frame(index, &self.path)
    }

    /// Reads frames `range` of array `name`, row-major, decoding each chunk once.
    ///
    /// # Errors
    /// If there is no such array, the range exceeds it, its dtype is not supported, or a chunk can't be decoded.
    pub fn read(&self, name: &str, range: Range<usize>) -> Result<Values> {
        self.column(name)?.read(range, &self.path)
    }

    /// As [`Self::read`], converted to f32.
    ///
    /// # Errors
    /// As [`Self::read`].
    pub fn read_f32(&self, name: &str, range: Range<usize>) -> Result<Vec<f32>> {
        Ok(self.read(name, range)?.into_f32())
    }

    /// As [`Self::read`], for an array of bytes.
    ///
    /// # Errors
    /// As [`Self::read`], or if the array holds other numbers.
    pub fn read_u8(&self, name: &str, range: Range<usize>) -> Result<Vec<u8>> {
        self.bytes(name, self.read(name, range)?)
    }

    /// Reads the contact of frames `range`, (n, 1556): truth as 0 and 1, or else the predicted score; NaN without either.
    ///
    /// # Errors
    /// As [`Self::read`].
    pub fn read_contact(&self, range: Range<usize>) -> Result<Vec<f32>> {
        match self.contact_name() {
            Some(name) => self.read_f32(name, range),
            None => Ok(vec![f32::NAN; range.len() * N_FIELD]),
        }
    }

    fn contact_name(&self) -> Option<&'static str> {
        [MANO_CONTACT, MANO_CONTACT_SCORE].into_iter().find(|name| self.has(name))
    }

    fn column(&self, name: &str) -> Result<&StoredArray> {
        self.arrays.get(name).ok_or_else(|| Error::Missing {
            name: name.to_string(),
            place: self.path.display().to_string(),
            present: self.arrays.keys().cloned().collect::<Vec<_>>().join(", "),
        })
    }

    fn bytes(&self, name: &str, values: Values) -> Result<Vec<u8>> {
        match values {
            Values::U8(values) => Ok(values),
            Values::I64(values) if values.iter().all(|value| (0..=255).contains(value)) => {
                Ok(values.into_iter().map(|value| value as u8).collect())
            }
            other => Err(Error::file(&self.path, format!("{name}: expected dtype u8, got {}", other.dtype()))),
        }
    }

    fn read_episode_ends(&self) -> Result<Vec<usize>> {
        let column = self.column(EPISODE_ENDS)?;
        let [_] = column.info().shape[..] else {
            return Err(self.named(Error::shape(EPISODE_ENDS, "(E)", column.info().shape)));
        };
        let fail = |message: String| Error::file(&self.path, format!("{EPISODE_ENDS}: {message}"));
        let episodes = column.info().shape.first().copied().unwrap_or(0);
        limits::EPISODES.check(&self.path, EPISODE_ENDS, episodes as u64)?;
        let values = self.read(EPISODE_ENDS, 0..episodes)?;
        let Values::I64(ends) = values else {
            return Err(fail(format!("expected integers, got {}", values.dtype())));
        };
        let mut before = 0;
        for end in &ends {
            if *end <= before {
                return Err(fail(format!("expected ends that grow from above 0, got {end} after {before}")));
            }
            before = *end;
        }
        if ends.is_empty() {
            return Err(fail("the store has no episode".into()));
        }
        limits::FRAMES.check(&self.path, EPISODE_ENDS, before as u64)?;
        Ok(ends.into_iter().map(|end| end as usize).collect())
    }

    /// Checks the number of frames of all arrays, and the shapes of known arrays.
    fn check_shapes(&self) -> Result<()> {
        let n_frames = self.len();
        for column in self.arrays.values().filter(|column| column.name.starts_with("data/")) {
            let shape = column.info().shape;
            if shape.first() != Some(&n_frames) {
                let expected = format!("({n_frames}, ..), the last of {EPISODE_ENDS}");
                return Err(self.named(Error::shape(&column.name, expected, shape)));
            }
        }
        let fields = [MANO_FORCE, MANO_CONTACT, MANO_CONTACT_SCORE, MANO_FORCE_VALID, MANO_CONTACT_VALID];
        let known = fields.into_iter().map(|name| (name, vec![n_frames, N_FIELD])).chain([
            (FRAME_VALIDITY, vec![n_frames]),
            (TIMESTAMPS, vec![n_frames]),
            (LEFT_HAND_POSE, vec![n_frames, 61]),
            (RIGHT_HAND_POSE, vec![n_frames, 61]),
        ]);
        for (name, expected) in known {
            if let Some(column) = self.arrays.get(name)
                && column.info().shape != expected
            {
                return Err(self.named(Error::shape(name, format!("{expected:?}"), column.info().shape)));
            }
        }
        self.column(TIMESTAMPS)?;
        Ok(())
    }

    fn find_camera(&self, name: &str) -> Result<Camera> {
        let info = self.column(name)?.info();
        let (height, width, planar) = match info.shape[..] {
            [_, height, width, 3] => (height, width, false),
            [_, 3, height, width] => (height, width, true),
            _ => (0, 0, false),
        };
        if height == 0 || width == 0 {
            return Err(self.named(Error::shape(name, "(T, H, W, 3)", info.shape)));
        }
        check_size(width as u64, height as u64).map_err(|error| self.named(error))?;
        // An intact image takes at least a byte; a shape by itself is no recording.
        let frames = self.len();
        if frames > UNCHECKED && self.files.bytes_below(name, frames as u64)? < frames as u64 {
            let message =
                format!("{name}: expected {frames} images, as {EPISODE_ENDS} states, got fewer bytes than that");
            return Err(Error::file(&self.path, message));
        }
        Ok(Camera { name: name.to_string(), size: (height, width), planar })
    }

    fn named(&self, error: Error) -> Error {
        Error::file(&self.path, error)
    }

    fn hand_pose(&self, name: &str, index: usize) -> Result<Option<HandParams>> {
        let Some(column) = self.arrays.get(name) else { return Ok(None) };
        let row = column.read_frame(index, &self.path)?.into_f32();
        let array: [f32; 61] = row.try_into().map_err(|row: Vec<f32>| Error::shape(name, "[61]", [row.len()]))?;
        Ok(array.iter().any(|x| *x != 0.0).then(|| HandParams::from_array(&array)))
    }

    /// Reads one frame of a (T, 1556) array; `missing` everywhere without such an array.
    fn field(&self, name: Option<&str>, index: usize, missing: f32) -> Result<Vec<f32>> {
        match name.and_then(|name| self.arrays.get(name)) {
            Some(column) => Ok(column.read_frame(index, &self.path)?.into_f32()),
            None => Ok(vec![missing; N_FIELD]),
        }
    }

    fn mask(&self, name: &str, label: Option<&str>, index: usize) -> Result<Vec<u8>> {
        match self.arrays.get(name) {
            Some(column) => self.bytes(name, column.read_frame(index, &self.path)?),
            None => Ok(vec![u8::from(label.is_some_and(|label| self.has(label))); N_FIELD]),
        }
    }
}

impl EpisodeReader for ZarrReader {
    fn attributes(&self) -> &Attributes {
        &self.attributes
    }

    fn episode_ends(&self) -> &[usize] {
        &self.episode_ends
    }

    fn frame(&self, index: usize) -> Result<Frame> {
        let one = |name: &str| self.column(name)?.read_frame(index, &self.path);
        let code = match self.has(FRAME_VALIDITY) {
            true => self.bytes(FRAME_VALIDITY, one(FRAME_VALIDITY)?)?.first().copied().unwrap_or(0),
            false => 0,
        };
        let validity = Validity::ALL.get(usize::from(code)).copied().ok_or_else(|| {
            let known = format!("a code below {}", Validity::ALL.len());
            self.named(Error::value(format!("{FRAME_VALIDITY}[{index}]"), known, code))
        })?;
        Ok(Frame {
            timestamp: one(TIMESTAMPS)?.into_f64().first().copied().unwrap_or(f64::NAN),
            camera_ego_rgb: self.image(index)?,
            field: TactileField {
                topology: self.attributes.topology,
                force: self.field(Some(MANO_FORCE), index, f32::NAN)?,
                contact: self.field(self.contact_name(), index, f32::NAN)?,
            },
            force_valid: self.mask(MANO_FORCE_VALID, Some(MANO_FORCE), index)?,
            contact_valid: self.mask(MANO_CONTACT_VALID, self.contact_name(), index)?,
            validity,
            left_hand_pose: self.hand_pose(LEFT_HAND_POSE, index)?,
            right_hand_pose: self.hand_pose(RIGHT_HAND_POSE, index)?,
        })
    }
}

impl std::fmt::Debug for ZarrReader {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "ZarrReader({}, {} frames)", self.path.display(), self.len())
    }
}

/// Returns the names of the arrays in `data/` and `meta/`.
fn array_names(files: &StoreFiles) -> Result<Vec<String>> {
    let mut names = Vec::new();
    for group in ["data/", "meta/"] {
        for array in files.folders_in(group)? {
            let name = format!("{group}{array}");
            let has = |file: &str| files.has(&format!("{name}/{file}"));
            if has(".zarray")? || (has("zarr.json")? && !has(".zgroup")?) {
                names.push(name);
            }
        }
    }
    Ok(names)
}

/// Returns the fixed attributes; a store without labels needs none of them.
fn attributes(
    path: &Path,
    raw: &serde_json::Map<String, serde_json::Value>,
    arrays: &BTreeMap<String, StoredArray>,
) -> Result<Attributes> {
    let mut map = raw.clone();
    // Stores by other programs may hold values of other types under these descriptive names: ignore them.
    map.retain(|name, value| match name.as_str() {
        "scene" | "producer" | "version" => value.is_string(),
        "seed" => value.is_u64(),
        "sigma" => value.is_number(),
        "thresholds" => value.get("contact_force").is_none_or(serde_json::Value::is_number) && value.is_object(),
        _ => true,
    });
    if !map.contains_key("topology") {
        let labels: Vec<&str> =
            arrays.keys().filter(|name| name.starts_with("data/mano_")).map(String::as_str).collect();
        if !labels.is_empty() {
            let labels = labels.join(", ");
            return Err(Error::file(
                path,
                format!("attribute topology is missing: it states the vertex numbering of {labels}"),
            ));
        }
        map.insert("topology".into(), Topology::default().id().into());
    }
    serde_json::from_value(map.into()).map_err(|e| Error::file(path, format!("attributes: {e}")))
}
