//! Command `egotac model`.

mod attention;
mod calibrate;
mod convert;
mod doubt;
mod familiarity;
mod get;
mod presence;

use std::collections::{BTreeMap, HashMap};
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::Context;
use candle_core::{DType, Device, Tensor};

use super::options::Json;
use crate::file::{input, limits};
use crate::model::{Checkpoint, Config, Precision, checkpoint};

/// Arguments of `egotac model`.
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, clap::Subcommand)]
enum Command {
    /// Run the network on prepared images and write the output of each stage.
    Forward(Forward),
    /// Draw the network's attention over its input images.
    Attention(attention::Args),
    /// Convert another program's checkpoint, by a table of tensor names.
    Import(convert::Import),
    /// Get a published network, from its name, an address or a file; without one, list them with their licences.
    Get(get::Args),
    /// Create a network to train from a published DINOv2 encoder.
    #[command(alias = "start")]
    Init(convert::Init),
    /// Make a trained network wider and deeper without changing its function, to continue its training.
    Grow(convert::Grow),
    /// Store the weights of a checkpoint in f16: half the size.
    Half(convert::Half),
    /// Measure the features of training images, so that a checkpoint tells images unlike them.
    Familiarity(familiarity::Args),
    /// Fit the estimate of presence and keypoints of the hands, so that a checkpoint tells images without hands.
    Presence(presence::Args),
    /// Fit the temperature of contact probabilities and the intervals of forces on frames with truth.
    Calibrate(calibrate::Args),
    /// Show what a network knows and does not know of recordings, and of pictures that hold no hand.
    Doubt(doubt::Args),
    /// Print geometry, parameter count, metadata and hash of a checkpoint.
    Info(Info),
}

#[derive(Debug, clap::Args)]
struct Forward {
    /// Checkpoint to run.
    #[arg(long, value_name = "FILE|shipped", value_parser = super::options::checkpoint())]
    checkpoint: PathBuf,
    /// Safetensors with key `images`: (B, T, 3, H, W) f32, ImageNet-normalised, oldest frame first.
    #[arg(long, value_name = "FILE")]
    input: PathBuf,
    /// Safetensors to write: `tokens` (B T, P, dv), `z` (B, d), `force` and `contact_logits` (B, K, 1556).
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
    /// Geometry (JSON) that replaces the one in the metadata of the weights.
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Number format: f32, bf16 or int8.
    #[arg(long, default_value = "f32")]
    precision: Precision,
}

#[derive(Debug, clap::Args)]
struct Info {
    /// Checkpoint to describe.
    #[arg(long, value_name = "FILE|shipped", value_parser = super::options::checkpoint())]
    checkpoint: PathBuf,
    #[command(flatten)]
    json: Json,
}

/// Runs the command.
pub fn run(args: Args) -> anyhow::Result<ExitCode> {
    match args.command {
        Command::Forward(args) => forward(&args)?,
        Command::Attention(args) => attention::run(&args)?,
        Command::Import(args) => convert::import(&args)?,
        Command::Get(args) => get::run(&args)?,
        Command::Init(args) => convert::init(&args)?,
        Command::Grow(args) => convert::grow(&args)?,
        Command::Half(args) => convert::half(&args)?,
        Command::Familiarity(args) => familiarity::run(&args)?,
        Command::Presence(args) => presence::run(&args)?,
        Command::Calibrate(args) => calibrate::run(&args)?,
        Command::Doubt(args) => doubt::run(&args)?,
        Command::Info(args) => info(&args)?,
    }
    Ok(ExitCode::SUCCESS)
}

fn forward(args: &Forward) -> anyhow::Result<()> {
    let config = match &args.config {
        Some(path) => {
            let json = input::read_text(path, limits::TEXT)?;
            Some(Config::from_json(&json).with_context(|| path.display().to_string())?)
        }
        None => None,
    };
    let device = Device::Cpu;
    let model = checkpoint::load_model(&args.checkpoint, config.as_ref(), &device)?.compile(args.precision)?;
    let images = images(&args.input, &device)?;
    let stages = model.stages(&images).with_context(|| args.input.display().to_string())?;
    let stages = BTreeMap::from([
        ("tokens".to_string(), stages.tokens),
        ("z".into(), stages.z),
        ("force".into(), stages.force),
        ("contact_logits".into(), stages.contact_logits),
    ]);
    for (name, tensor) in &stages {
        println!("{name}: {:?}", tensor.dims());
    }
    checkpoint::save_tensors(&args.out, &stages)?;
    println!("written to {}", args.out.display());
    Ok(())
}

/// Reads the tensor `images` of a file as f32.
fn images(path: &Path, device: &Device) -> anyhow::Result<Tensor> {
    let mut tensors: HashMap<String, Tensor> =
        candle_core::safetensors::load_buffer(&input::read(path, limits::FILE)?, device)
            .with_context(|| path.display().to_string())?;
    let Some(images) = tensors.remove("images") else {
        let mut keys: Vec<_> = tensors.into_keys().collect();
        keys.sort();
        anyhow::bail!("{}: key `images` is missing; there: {}", path.display(), keys.join(", "));
    };
    Ok(images.to_dtype(DType::F32)?)
}

fn info(args: &Info) -> anyhow::Result<()> {
    let Checkpoint { model, metadata, familiarity, presence, spread, sha256 } =
        Checkpoint::load(&args.checkpoint, &Device::Cpu)?;
    let config = model.config();
    let parameters = checkpoint::parameter_count(config)?;
    let facts = serde_json::json!({
        "file": args.checkpoint, "sha256": sha256, "parameters": parameters, "config": config,
        "metadata": metadata.to_map(), "familiarity": familiarity.is_some(), "presence": presence.is_some(),
        "spread": spread.is_some(),
    });
    if args.json.take(&facts)? {
        return Ok(());
    }
    println!("{}", metadata.name);
    println!("  sha256      {sha256}");
    println!("  parameters  {:.2} M", parameters as f64 / 1e6);
    println!(
        "  encoder     {} x {} wide, {} heads; image {} px, patch {} px: {} tokens a frame",
        config.vision_depth,
        config.vision_width,
        config.vision_heads,
        config.image,
        config.patch,
        config.tokens()
    );
    println!("  decoder     {} x {} wide, {} heads", config.depth, config.width, config.heads);
    println!("  window      {} frames, {} s apart; {} predicted", config.horizon, metadata.frame_dt, config.predict);
    match familiarity {
        Some(_) => println!("  familiarity estimated; touch is unknown below {}", metadata.doubt.familiarity),
        None => println!("  familiarity not estimated: `egotac model familiarity` adds it"),
    }
    match presence {
        Some(_) => println!("  presence    estimated; touch of a hand is unknown below {}", metadata.doubt.presence),
        None => println!("  presence    not estimated: `egotac model presence` adds it"),
    }
    match spread {
        Some(_) => println!("  spread      {:.0} % intervals of forces", 100.0 * crate::model::spread::LEVEL),
        None => println!("  spread      not measured: `egotac model calibrate` adds it"),
    }
    for (key, value) in metadata.to_map() {
        if !["name", "frame_dt"].contains(&key.as_str()) {
            println!("  {key:<11} {value}");
        }
    }
    Ok(())
}
