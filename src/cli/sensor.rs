//! `egotac sensor`: maps of gloves' taxels on a hand, and conversion of forces by them.

use std::path::PathBuf;
use std::process::ExitCode;

use ::image::{Rgb, RgbImage, imageops};

use super::hands::Hands;
use crate::file;
use crate::hand::{HandModel, HandParams, Side};
use crate::render::{View, color, font, hand_picture, pixels};
use crate::sensor::{self, Layout, TaxelMap};
use crate::tactile::ForceKind;

/// Arguments of `egotac sensor`.
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, clap::Subcommand)]
enum Command {
    /// List the maps that come with egotac: taxels, coverage, and origin of the places.
    List,
    /// Draw a map: taxels on both hands, vertices in the colours of their pads.
    Show(Show),
    /// Build a map from pads outlined on the hand, and draw it.
    New(New),
    /// Turn the forces of a store or a field file from readings into spread forces, or back.
    Convert(Convert),
}

#[derive(Debug, clap::Args)]
struct Show {
    /// Name of a shipped map, or the YAML file of a map.
    sensor: String,
    /// PNG to write.
    #[arg(long, value_name = "FILE", default_value = "sensor.png")]
    out: PathBuf,
    #[command(flatten)]
    hands: Hands,
}

#[derive(Debug, clap::Args)]
#[command(
    after_help = "With --mano-left and --mano-right the same outlines are placed on MANO's hands, and the map is of MANO's \
    vertices."
)]
struct New {
    /// Layout, a YAML file (`egotac::sensor::Layout` lists its keys), or the YAML file or name of a map, whose layout is taken.
    layout: String,
    /// Map to write: a YAML file, and its weights beside it (.safetensors).
    #[arg(long, value_name = "FILE.yaml")]
    out: PathBuf,
    /// PNG to write with the picture of the map.
    #[arg(long, value_name = "FILE")]
    picture: Option<PathBuf>,
    #[command(flatten)]
    hands: Hands,
}

#[derive(Debug, clap::Args)]
struct Convert {
    /// Name of a shipped map, or the YAML file of a map.
    sensor: String,
    /// Zarr store (folder or zip file) or safetensors file with fields.
    #[arg(long, value_name = "PATH")]
    field: PathBuf,
    /// Kind of the forces to write: `spread` sums to the contact force, `reading` is the sensor's value at the vertex.
    #[arg(long, value_enum)]
    to: Kind,
    /// The copy with converted forces.
    #[arg(long, value_name = "PATH")]
    out: PathBuf,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum Kind {
    Spread,
    Reading,
}

/// Runs the command.
pub fn run(args: Args) -> anyhow::Result<ExitCode> {
    match args.command {
        Command::List => list()?,
        Command::Show(args) => {
            let map = sensor::open(&args.sensor)?;
            println!("{}", described(&map));
            draw(&map, &hands_of(&map, &args.hands)?, &args.out)?;
        }
        Command::Convert(args) => {
            let map = sensor::open(&args.sensor)?;
            let to = if args.to == Kind::Spread { ForceKind::Spread } else { ForceKind::Reading };
            sensor::convert(&args.field, &args.out, &map, to)?;
            let error = 100.0 * map.conversion_error();
            println!("{} in {}: the sum of a taxel is kept to {error:.2} %", args.out.display(), to.id());
        }
        Command::New(args) => {
            anyhow::ensure!(
                args.out.extension().is_some_and(|extension| extension == "yaml"),
                "--out: expected a name that ends in .yaml, got {}",
                args.out.display()
            );
            let layout = Layout::read(&sensor::map_path(&args.layout)?)?;
            let hands = args.hands.files()?.unwrap_or_else(|| Side::BOTH.map(HandModel::builtin));
            let map = TaxelMap::build(&layout, &hands)?;
            map.write(&args.out)?;
            println!("{}\nwritten to {}", described(&map), args.out.display());
            if let Some(picture) = &args.picture {
                draw(&map, &hands, picture)?;
            }
        }
    }
    Ok(ExitCode::SUCCESS)
}

fn list() -> anyhow::Result<()> {
    for name in sensor::shipped_names() {
        println!("{}", described(&sensor::open(&name)?));
    }
    Ok(())
}

/// Describes a map in one line.
fn described(map: &TaxelMap) -> String {
    let [left, right] = map.counts();
    let covered = map.hands[1].covered().iter().filter(|covered| **covered).count();
    format!(
        "{}: {}; {left} and {right} taxels in {} channels of {}, {covered} of 778 vertices covered, places {}, {}",
        map.layout.name,
        map.layout.title,
        map.layout.channels,
        map.layout.unit,
        map.layout.placement.name(),
        map.topology.id()
    )
}

/// Returns hands of the map's topology.
fn hands_of(map: &TaxelMap, hands: &Hands) -> anyhow::Result<[HandModel; 2]> {
    let models = hands.files()?.unwrap_or_else(|| Side::BOTH.map(HandModel::builtin));
    map.topology.must_match(models[0].topology)?;
    Ok(models)
}

fn draw(map: &TaxelMap, hands: &[HandModel; 2], path: &std::path::Path) -> anyhow::Result<()> {
    file::write_png(path, &picture(map, hands))?;
    println!("drawn to {}", path.display());
    Ok(())
}

/// Draws both palms: vertices in the colours of their pads, a dot for each taxel, its first channels named.
fn picture(map: &TaxelMap, hands: &[HandModel; 2]) -> RgbImage {
    const PANEL: (u32, u32) = (620, 760);
    const TITLE: u32 = 44;
    let mut sheet = RgbImage::from_pixel(2 * PANEL.0, PANEL.1 + TITLE, color::PAPER);
    for (column, (hand, taxels)) in hands.iter().zip(&map.hands).enumerate() {
        let posed = hand.forward(&HandParams::default());
        let pad_of = |channel: u32| {
            let left = hand.side == Side::Left;
            let own = |pad: &sensor::Pad| pad.taxels(left).unwrap_or_default().contains(&Some(channel as usize));
            map.layout.pads.iter().position(own).unwrap_or(0)
        };
        let of_vertex = |list: &Vec<(u32, f32)>| list.first().map_or(color::SKIN, |entry| pad_color(pad_of(entry.0)));
        let colors: Vec<Rgb<u8>> = taxels.reading.iter().map(of_vertex).collect();
        let mut panel = hand_picture(hand, &posed, &colors, View::Palmar, PANEL);
        let places: Vec<_> = taxels.positions.iter().copied().filter(|place| !place.is_nan()).collect();
        let radius = if places.len() > 400 { 2 } else { 3 };
        for (x, y) in pixels(hand, &posed, &places, View::Palmar, PANEL) {
            disc(&mut panel, (x as i32, y as i32), radius);
        }
        for pad in &map.layout.pads {
            let first = pad.taxels(hand.side == Side::Left).unwrap_or_default().into_iter().flatten().next();
            let place = first.map(|channel| taxels.positions[channel]).filter(|place| !place.is_nan());
            for (x, y) in pixels(hand, &posed, place.as_slice(), View::Palmar, PANEL) {
                font::draw(&mut panel, &pad.name, (x as i32 + 5, y as i32 - 16), 13.0, color::INK, font::Align::Left);
            }
        }
        imageops::replace(&mut sheet, &panel, i64::from(column as u32 * PANEL.0), TITLE.into());
    }
    let title = format!("{}: {} ({})", map.layout.name, map.layout.title, map.layout.placement.name());
    font::draw(&mut sheet, &title, (16, 14), 19.0, color::INK, font::Align::Left);
    sheet
}

/// Returns one of twelve colours that neighbours in a list do not share.
fn pad_color(pad: usize) -> Rgb<u8> {
    let hue = (pad * 5 % 12) as f32 / 12.0 * std::f32::consts::TAU;
    let channel = |shift: f32| (185.0 + 45.0 * (hue + shift).cos()) as u8;
    Rgb([channel(0.0), channel(2.1), channel(4.2)])
}

fn disc(picture: &mut RgbImage, (x, y): (i32, i32), radius: i32) {
    for dx in -radius..=radius {
        for dy in -radius..=radius {
            let (x, y) = (x + dx, y + dy);
            let inside = x >= 0 && y >= 0 && (x as u32) < picture.width() && (y as u32) < picture.height();
            if inside && dx * dx + dy * dy <= radius * radius {
                picture.put_pixel(x as u32, y as u32, color::INK);
            }
        }
    }
}
