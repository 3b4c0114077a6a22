//! Command `egotac model doubt`.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::Context;
use serde_json::json;

use crate::cli::doubt::Doubt;
use crate::cli::options::Json;
use crate::dataset::format::open_images;
use crate::dataset::image_folder::ImageFolder;
use crate::dataset::video::VideoFile;
use crate::dataset::{CONTACT_THRESHOLD, Format, ImageSource};
use crate::hand::Side;
use crate::image::procedural::Picture;
use crate::model::predictor::{Options, Prediction};
use crate::model::{Precision, Predictor, Unknown, shipped};
use crate::score::metrics::contact::auroc;
use crate::statistics::median;

/// Width and height of the procedural pictures, pixels.
const SIZE: (u32, u32) = (320, 240);

/// Arguments of `egotac model doubt`.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "One row per recording, and one per kind of procedural picture: images; frames with touch on some vertex by \
    the network's guess, and by what it knows; hands whose touch is unknown because the image is unfamiliar, or the hand \
    absent; median familiarity; and the area under the ROC curve of familiarity, all images of the recordings of --data \
    against those of the row."
)]
pub struct Args {
    /// Checkpoint [default: the one shipped with egotac].
    #[arg(long, value_name = "FILE|shipped", value_parser = crate::cli::options::checkpoint())]
    checkpoint: Option<PathBuf>,
    /// Recordings of the training's kind that it was not trained on: stores, bags, data sets, videos, folders of images.
    #[arg(long, value_name = "PATH", num_args = 1.., required = true)]
    data: Vec<PathBuf>,
    /// Recordings of another kind.
    #[arg(long, value_name = "PATH", num_args = 1..)]
    others: Vec<PathBuf>,
    /// Number of procedural pictures of each kind.
    #[arg(long, default_value_t = 100)]
    pictures: u64,
    /// Seed of the procedural pictures.
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Number format of the network: f32, bf16 or int8.
    #[arg(long, default_value = "f32")]
    precision: Precision,
    #[command(flatten)]
    json: Json,
    #[command(flatten)]
    doubt: Doubt,
}

/// Counts of one recording or kind of picture.
struct Row {
    name: String,
    is_data: bool,
    /// Familiarity of each image; NaN = not estimated.
    familiarity: Vec<f32>,
    guessed: u64,
    known: u64,
    unfamiliar: u64,
    absent: [u64; 2],
}

impl Row {
    fn new(name: String, is_data: bool) -> Self {
        Self { name, is_data, familiarity: Vec::new(), guessed: 0, known: 0, unfamiliar: 0, absent: [0; 2] }
    }

    /// Counts a prediction whose field is the network's guess.
    fn push(&mut self, Prediction { field, certainty, .. }: &Prediction) {
        let touches =
            |side: Side| field.contact[side.range()].iter().any(|contact| f64::from(*contact) > CONTACT_THRESHOLD);
        let is_known = |side: Side| certainty.doubt[side as usize].is_none();
        self.familiarity.push(certainty.familiarity.unwrap_or(f32::NAN));
        self.guessed += u64::from(Side::BOTH.into_iter().any(touches));
        self.known += u64::from(Side::BOTH.into_iter().any(|side| is_known(side) && touches(side)));
        self.unfamiliar += u64::from(certainty.is_unfamiliar());
        if !certainty.is_unfamiliar() {
            for side in Side::BOTH {
                self.absent[side as usize] += u64::from(!is_known(side));
            }
        }
    }

    fn share(&self, count: u64) -> f64 {
        count as f64 / self.familiarity.len().max(1) as f64
    }
}

/// Runs the command.
pub fn run(args: &Args) -> anyhow::Result<()> {
    let path = args.checkpoint.clone().map_or_else(shipped::path, Ok)?;
    let options = Options { precision: args.precision, max_gap_secs: Some(f64::MAX), ..Options::default() };
    let options = Options { unknown: Unknown::Guess, ..args.doubt.apply(options) };
    let mut predictor = Predictor::load(&path, options)?;
    let mut rows = Vec::new();
    for (paths, is_data) in [(&args.data, true), (&args.others, false)] {
        for path in paths {
            rows.push(of_recording(&mut predictor, path, is_data)?);
        }
    }
    for kind in Picture::ALL {
        let mut row = Row::new(kind.name().into(), false);
        for index in 0..args.pictures {
            predictor.reset();
            row.push(&predictor.push(&kind.draw(SIZE.0, SIZE.1, args.seed + index), 0.0)?);
        }
        rows.push(row);
    }
    print(&rows, &args.json)
}

fn of_recording(predictor: &mut Predictor, path: &Path, is_data: bool) -> anyhow::Result<Row> {
    let source: Arc<dyn ImageSource> = match Format::of(path) {
        Some(Format::Images) => Arc::new(ImageFolder::open(path, predictor.metadata().frame_dt)?),
        Some(Format::Video) => Arc::new(VideoFile::open(path)?),
        _ => open_images(path, None).with_context(|| format!("{}: holds no images", path.display()))?,
    };
    let mut row = Row::new(path.display().to_string(), is_data);
    for unit in 0..source.units().len() {
        predictor.reset();
        for frame in source.frames(unit, 0)? {
            let frame = frame?;
            let named = || format!("{}: image {}", path.display(), row.familiarity.len());
            let image = frame.image.map_err(anyhow::Error::msg).with_context(named)?.decode().with_context(named)?;
            row.push(&predictor.push(&image, frame.stamp_secs)?);
        }
    }
    Ok(row)
}

fn print(rows: &[Row], option: &Json) -> anyhow::Result<()> {
    let familiar: Vec<(f32, bool)> =
        rows.iter().filter(|row| row.is_data).flat_map(|row| &row.familiarity).map(|f| (*f, true)).collect();
    let area = |row: &Row| {
        let others = row.familiarity.iter().map(|f| (*f, false));
        (!row.is_data).then(|| auroc(familiar.iter().copied().chain(others).collect())).flatten()
    };
    let middle = |row: &Row| median(row.familiarity.iter().map(|f| f64::from(*f)));
    let of = |row: &Row| {
        json!({
            "name": row.name, "in_domain": row.is_data, "images": row.familiarity.len(),
            "touch_guessed": row.share(row.guessed), "touch_known": row.share(row.known),
            "unfamiliar": row.share(row.unfamiliar), "absent": row.absent.map(|n| row.share(n)),
            "median_familiarity": middle(row), "auroc": area(row),
        })
    };
    if option.take(&serde_json::Value::Array(rows.iter().map(of).collect()))? {
        return Ok(());
    }
    println!(
        "| images | number | touch guessed | touch known | unfamiliar | no left hand | no right hand | median familiarity | AUROC |"
    );
    println!("|---|---|---|---|---|---|---|---|---|");
    for row in rows {
        let percent = |count| format!("{:.2} %", 100.0 * row.share(count));
        let area = area(row).map_or(String::new(), |area| format!("{area:.4}"));
        println!(
            "| {} | {} | {} | {} | {} | {} | {} | {:.2e} | {area} |",
            row.name,
            row.familiarity.len(),
            percent(row.guessed),
            percent(row.known),
            percent(row.unfamiliar),
            percent(row.absent[0]),
            percent(row.absent[1]),
            middle(row)
        );
    }
    Ok(())
}
