//! `egotac hand`: pose a hand, draw it, transfer fields between the built-in hand and MANO, rebuild the built-in hand.

mod map;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use ::image::{RgbImage, imageops};
use anyhow::{Context, bail, ensure};
use candle_core::{DType, Device, Tensor};
use clap::ValueEnum;
use glam::Vec3;
use safetensors::tensor::{Dtype, TensorView};

use crate::file::{self, input, limits};
use crate::hand::{self, HandModel, HandParams, N_BETAS, N_JOINTS, N_VERTICES, Region, Side};
use crate::render::{View, color, font, hand_picture, region_colors};

/// Arguments of `egotac hand`.
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, clap::Subcommand)]
enum Command {
    /// Pose a hand: MANO parameters to vertices and joints.
    Forward(Forward),
    /// Draw a hand and its regions, palmar and dorsal.
    Show(Show),
    /// Register the built-in hand on MANO files, and carry over a field file, a store or a data set.
    Map(map::Args),
    /// Regenerate the built-in hand from its anatomy (for developers; vertex indices may change).
    Build(Build),
}

#[derive(Debug, clap::Args)]
struct Forward {
    #[command(flatten)]
    model: ModelArgs,
    /// Safetensors with `betas` (B, 10), `global_orient` (B, 3) rad, `hand_pose` (B, 45) rad (full pose, flat hand
    /// mean), `transl` (B, 3) m.
    #[arg(long, value_name = "FILE")]
    params: PathBuf,
    /// Safetensors to write: `vertices` (B, 778, 3) and `joints` (B, 16, 3), f32, m.
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
}

#[derive(Debug, clap::Args)]
struct Show {
    #[command(flatten)]
    model: ModelArgs,
    /// Safetensors with the parameters of `hand forward`; the first row is drawn. Default: the flat hand.
    #[arg(long, value_name = "FILE")]
    pose: Option<PathBuf>,
    /// PNG to write.
    #[arg(long, value_name = "FILE", default_value = "hand.png")]
    out: PathBuf,
}

#[derive(Debug, clap::Args)]
struct Build {
    /// Safetensors to write (the committed one is src/hand/builtin.safetensors).
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
}

#[derive(Debug, clap::Args)]
struct ModelArgs {
    /// `builtin`, or a MANO file (the published pickle or an .npz).
    #[arg(long, value_name = "builtin|FILE", default_value = "builtin")]
    model: String,
    /// Side of the hand; it is not derived from the file name.
    #[arg(long, value_enum, default_value = "right")]
    side: SideArg,
    /// Negate x of a left MANO file's shapedirs, which has the wrong sign in the published file.
    #[arg(long)]
    fix_left_shapedirs: bool,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum SideArg {
    Left,
    Right,
}

/// Runs the command.
pub fn run(args: Args) -> anyhow::Result<ExitCode> {
    match args.command {
        Command::Forward(args) => forward(&args)?,
        Command::Show(args) => show(&args)?,
        Command::Map(args) => map::run(&args)?,
        Command::Build(args) => build(&args)?,
    }
    Ok(ExitCode::SUCCESS)
}

fn forward(args: &Forward) -> anyhow::Result<()> {
    let model = args.model.load()?;
    let batch = read_params(&args.params)?;
    let (mut vertices, mut joints) = (Vec::new(), Vec::new());
    for params in &batch {
        let posed = model.forward(params);
        vertices.extend(posed.vertices.iter().flat_map(|vertex| vertex.to_array()));
        joints.extend(posed.joints.iter().flat_map(|joint| joint.to_array()));
    }
    let tensors = [
        ("vertices".to_string(), Dtype::F32, vec![batch.len(), N_VERTICES, 3], floats(&vertices)),
        ("joints".to_string(), Dtype::F32, vec![batch.len(), N_JOINTS, 3], floats(&joints)),
    ];
    let metadata = BTreeMap::from([
        ("topology".to_string(), model.topology.id().to_string()),
        ("side".into(), model.side.name().into()),
    ]);
    write_tensors(&args.out, &tensors, metadata)?;
    println!("posed {} {} hands, written to {}", batch.len(), model.side.name(), args.out.display());
    Ok(())
}

fn show(args: &Show) -> anyhow::Result<()> {
    let model = args.model.load()?;
    let params = match &args.pose {
        Some(path) => {
            let mut batch = read_params(path)?;
            ensure!(!batch.is_empty(), "{}: no parameters, expected at least one row", path.display());
            batch.swap_remove(0)
        }
        None => HandParams::default(),
    };
    let picture = sheet(&model, &params);
    file::write_png(&args.out, &picture)?;
    println!("{} {} hand drawn to {}", model.side.name(), model.topology.id(), args.out.display());
    Ok(())
}

/// Draws the posed hand in skin colour and by region, each palmar and dorsal, with a legend of the regions.
fn sheet(model: &HandModel, params: &HandParams) -> RgbImage {
    const PANEL: (u32, u32) = (420, 520);
    const LEGEND: u32 = 210;
    const TITLE: u32 = 40;
    let posed = model.forward(params);
    let skin = vec![color::SKIN; posed.vertices.len()];
    let regions = region_colors(&model.regions());
    let mut sheet = RgbImage::from_pixel(2 * PANEL.0 + LEGEND, 2 * PANEL.1 + TITLE, color::PAPER);
    for (row, colors) in [&skin, &regions].into_iter().enumerate() {
        for (column, view) in [View::Palmar, View::Dorsal].into_iter().enumerate() {
            let panel = hand_picture(model, &posed, colors, view, PANEL);
            let (x, y) = (column as u32 * PANEL.0, TITLE + row as u32 * PANEL.1);
            imageops::replace(&mut sheet, &panel, x.into(), y.into());
        }
    }
    let title = format!("{} hand, {}", model.side.name(), model.topology.id());
    font::draw(&mut sheet, &title, (16, 12), 20.0, color::INK, font::Align::Left);
    let left = 2 * PANEL.0 as i32 + 8;
    for region in Region::ALL {
        let y = (TITLE + PANEL.1) as i32 + 24 + 27 * region.index() as i32;
        for (dx, dy) in (0..18).flat_map(|dx| (0..18).map(move |dy| (dx, dy))) {
            sheet.put_pixel((left + dx) as u32, (y + dy) as u32, color::region_color(region));
        }
        font::draw(&mut sheet, region.name(), (left + 28, y), 16.0, color::INK, font::Align::Left);
    }
    sheet
}

fn build(args: &Build) -> anyhow::Result<()> {
    let model = hand::build::build();
    file::write(&args.out, &hand::builtin_bytes(&model)?)?;
    println!("{} vertices, {} faces, written to {}", model.v_template.len(), model.faces.len(), args.out.display());
    Ok(())
}

impl ModelArgs {
    fn load(&self) -> anyhow::Result<HandModel> {
        let side = self.side.into();
        ensure!(
            !self.fix_left_shapedirs || (side == Side::Left && self.model != "builtin"),
            "--fix-left-shapedirs is for a left MANO file: add --side left and --model FILE"
        );
        if self.model == "builtin" {
            return Ok(HandModel::builtin(side));
        }
        let mut model = HandModel::load(Path::new(&self.model), side)?;
        if self.fix_left_shapedirs {
            model.fix_left_shapedirs();
        }
        Ok(model)
    }
}

impl From<SideArg> for Side {
    fn from(side: SideArg) -> Self {
        match side {
            SideArg::Left => Self::Left,
            SideArg::Right => Self::Right,
        }
    }
}

/// Reads a batch of MANO parameters; all four keys are required, with the same number of rows.
fn read_params(path: &Path) -> anyhow::Result<Vec<HandParams>> {
    let file = || path.display().to_string();
    let tensors =
        candle_core::safetensors::load_buffer(&input::read(path, limits::FILE)?, &Device::Cpu).with_context(file)?;
    let keys = [("betas", N_BETAS), ("global_orient", 3), ("hand_pose", 3 * (N_JOINTS - 1)), ("transl", 3)];
    let missing: Vec<&str> = keys.iter().map(|(key, _)| *key).filter(|key| !tensors.contains_key(*key)).collect();
    if !missing.is_empty() {
        let mut present: Vec<&str> = tensors.keys().map(String::as_str).collect();
        present.sort();
        bail!("{}: missing {}; there: {}", file(), missing.join(", "), present.join(", "));
    }
    let rows = tensors["betas"].dims().first().copied().unwrap_or(0);
    let [betas, global_orient, hand_pose, transl] = keys.map(|(key, width)| column(&tensors[key], key, rows, width));
    let (betas, global_orient) = (betas.with_context(file)?, global_orient.with_context(file)?);
    let (hand_pose, transl) = (hand_pose.with_context(file)?, transl.with_context(file)?);
    let row = |b: usize| HandParams {
        betas: std::array::from_fn(|i| betas[b * N_BETAS + i]),
        global_orient: Vec3::from_slice(&global_orient[3 * b..]),
        hand_pose: std::array::from_fn(|joint| Vec3::from_slice(&hand_pose[(b * (N_JOINTS - 1) + joint) * 3..])),
        transl: Vec3::from_slice(&transl[3 * b..]),
    };
    Ok((0..rows).map(row).collect())
}

/// Reads a tensor as f32 and checks that it has the expected shape and finite numbers.
fn column(tensor: &Tensor, key: &str, rows: usize, width: usize) -> anyhow::Result<Vec<f32>> {
    ensure!(tensor.dims() == [rows, width], "{key}: expected shape [{rows}, {width}], got {:?}", tensor.dims());
    let values = tensor.to_dtype(DType::F32)?.flatten_all()?.to_vec1::<f32>()?;
    if let Some(bad) = values.iter().position(|value| !value.is_finite()) {
        bail!("{key}: expected finite numbers, got {} in row {}", values[bad], bad / width);
    }
    Ok(values)
}

fn floats(values: &[f32]) -> Vec<u8> {
    values.iter().flat_map(|value| value.to_le_bytes()).collect()
}

/// Writes named tensors of little-endian bytes as safetensors; equal content gives equal bytes.
fn write_tensors(
    path: &Path,
    tensors: &[(String, Dtype, Vec<usize>, Vec<u8>)],
    metadata: BTreeMap<String, String>,
) -> anyhow::Result<()> {
    let views = tensors.iter().map(|(name, dtype, shape, data)| {
        Ok((name.as_str(), TensorView::new(*dtype, shape.clone(), data).with_context(|| name.clone())?))
    });
    let views = views.collect::<anyhow::Result<Vec<_>>>()?;
    file::write(path, &file::tensors::to_bytes(path, views, &metadata)?)?;
    Ok(())
}
