//! Reader of stores: single frames, or ranges of one array.

mod check;
mod frame;

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
use crate::dataset::Attributes;
use crate::dataset::source::LostBytes;
use crate::error::{Error, Result};
use crate::image::Framing;
use crate::tactile::{ForceKind, N_FIELD};
use check::{array_names, attributes};

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
    pub(in crate::dataset::zarr) fn damaged_chunks(&self, except: &str) -> Result<Vec<LostBytes>> {
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

    /// Returns what the pictures show; stores that do not say anything hold whole pictures.
    ///
    /// # Errors
    /// If the attribute is unknown.
    pub fn framing(&self) -> Result<Framing> {
        let Some(name) = self.raw_attributes().get(Framing::KEY) else { return Ok(Framing::default()) };
        let unknown = || Error::value(Framing::KEY, "frame or hands", name);
        serde_json::from_value(name.clone()).map_err(|_| self.named(unknown()))
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

    fn named(&self, error: Error) -> Error {
        Error::file(&self.path, error)
    }
}

impl std::fmt::Debug for ZarrReader {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "ZarrReader({}, {} frames)", self.path.display(), self.len())
    }
}
