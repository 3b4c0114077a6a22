//! Formats of recordings, found by their files.

use std::path::Path;
use std::sync::Arc;

use super::image_folder::image_files;
use super::label_info::LabelInfo;
use super::lerobot::LeRobotDataset;
use super::mcap::Bag;
use super::source::ImageSource;
use super::zarr::{Store, StoreLocation};
use super::{lerobot, mcap, tensors, video, zarr};

/// A format of recordings.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Format {
    /// A Zarr store in a folder, or stores in a zip file.
    Store,
    /// The folder of a bag, or an MCAP file.
    Bag,
    /// A LeRobot data set.
    LeRobot,
    /// A video file.
    Video,
    /// A folder of PNG and JPEG files.
    Images,
    /// A safetensors file with labels alone.
    Tensors,
}

impl Format {
    /// Returns the format of `path`; None if it is unknown.
    pub fn of(path: &Path) -> Option<Self> {
        if path.is_dir() {
            let has = |name: &str| path.join(name).is_file();
            return if has(".zgroup") || has("zarr.json") {
                Some(Self::Store)
            } else if has("metadata.yaml") {
                Some(Self::Bag)
            } else if has("meta/info.json") {
                Some(Self::LeRobot)
            } else {
                image_files(path).is_ok_and(|files| !files.is_empty()).then_some(Self::Images)
            };
        }
        let extension = path.extension()?.to_string_lossy().to_lowercase();
        match extension.as_str() {
            "zip" => Some(Self::Store),
            "mcap" => Some(Self::Bag),
            "safetensors" => Some(Self::Tensors),
            video if video::EXTENSIONS.contains(&video) => Some(Self::Video),
            _ => None,
        }
    }

    /// Reads the description of the labels at `path`; None without labels of ours.
    pub fn read_info(self, path: &Path) -> Option<LabelInfo> {
        match self {
            Self::Store => zarr::read_info(path),
            Self::Bag => mcap::read_info(path),
            Self::LeRobot => lerobot::read_info(path),
            Self::Tensors => tensors::read_info(path),
            Self::Video | Self::Images => None,
        }
    }
}

/// Opens the images of the labelled data set at `path`, in the order of its labels; None if it has none, or they can't be
/// opened. `info` tells which camera was labelled.
pub fn open_images(path: &Path, info: Option<&LabelInfo>) -> Option<Arc<dyn ImageSource>> {
    let noted = info.and_then(|info| info.provenance.source.iter().find_map(|line| line.strip_prefix("images ")));
    // A data set converted from another format keeps its images under that format's default name: try it second.
    let cameras = [noted, None];
    match Format::of(path)? {
        Format::Store => {
            let place = StoreLocation::only(path).ok()?;
            let store = cameras.iter().find_map(|camera| Store::open(&place, *camera, None).ok())?;
            Some(Arc::new(store))
        }
        Format::Bag => Some(Arc::new(cameras.iter().find_map(|topic| Bag::open(path, *topic, "").ok())?)),
        Format::LeRobot => {
            let open = |camera: &Option<&str>| LeRobotDataset::open(path, *camera, "images only").ok();
            Some(Arc::new(cameras.iter().find_map(open)?))
        }
        Format::Video | Format::Images | Format::Tensors => None,
    }
}
