//! `egotac hand map`: registers the built-in hand on MANO files and carries fields over.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use anyhow::bail;
use safetensors::tensor::Dtype;

use super::{SideArg, write_tensors};
use crate::cli::hands::Hands;
use crate::dataset;
use crate::hand::{FieldMap, HandMap, HandModel, Side, Topology};

/// Arguments of `egotac hand map`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// MANO file (the published pickle or an .npz) of one hand; the map of the other hand is the mirror image.
    #[arg(long, value_name = "FILE", required_unless_present = "mano_left", conflicts_with_all = ["mano_left", "mano_right"])]
    mano: Option<PathBuf>,
    /// Side of the hand in the file of --mano.
    #[arg(long, value_enum, default_value = "right")]
    side: SideArg,
    #[command(flatten)]
    hands: Hands,
    /// Fields to carry over: a safetensors file with `force` and/or `contact` (T, 1556), a Zarr store (folder or zip file), or a
    /// LeRobot data set that `egotac label` labelled; needs --to.
    #[arg(long, value_name = "PATH", requires = "to")]
    field: Option<PathBuf>,
    /// Target hand of the transfer.
    #[arg(long, value_enum, requires = "field")]
    to: Option<To>,
    /// The copy of --field with the fields carried over; without --field, a safetensors file with the sparse weights of the map.
    #[arg(long, value_name = "PATH")]
    out: PathBuf,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum To {
    Mano,
    Builtin,
}

/// Runs the command.
pub fn run(args: &Args) -> anyhow::Result<()> {
    let (map, sides): (_, Vec<Side>) = match (&args.mano, args.hands.map()?) {
        (Some(path), _) => (FieldMap::mirrored(path, args.side.into())?.into(), vec![args.side.into()]),
        (None, Some(map)) => (map, Side::BOTH.to_vec()),
        (None, None) => bail!("give --mano, or --mano-left and --mano-right"),
    };
    for side in &sides {
        let registered = &map.maps()[*side as usize];
        println!(
            "built-in {} hand on MANO's: keypoints {:.2} mm, surface {:.2} mm mean, {:.2} mm max, scale {:.3}",
            side.name(),
            1e3 * registered.fit.residual,
            1e3 * registered.mean_distance,
            1e3 * registered.max_distance,
            registered.fit.scale
        );
    }
    match (&args.field, args.to, sides.as_slice()) {
        (Some(field), Some(to), _) => {
            dataset::carry(field, &args.out, &map, to.into())?;
            println!(
                "{} transferred to {}, written to {}",
                field.display(),
                Topology::from(to).id(),
                args.out.display()
            );
        }
        (_, _, [side]) => {
            let side = *side as usize;
            write_map(&args.out, &map.maps()[side], &map.mano()[side])?;
            println!("weights written to {}", args.out.display());
        }
        _ => bail!("the weights of one hand are written: give its file with --mano and --side, or --field and --to"),
    }
    Ok(())
}

impl From<To> for Topology {
    fn from(to: To) -> Self {
        match to {
            To::Mano => Self::Mano,
            To::Builtin => Self::EgotacHand1,
        }
    }
}

/// Writes the weights as sparse triplets: `{to_mano,to_builtin}.{contact,force}.{target,source}` u32 and `.weight` f32.
fn write_map(path: &Path, map: &HandMap, mano: &HandModel) -> anyhow::Result<()> {
    let mut tensors = Vec::new();
    for (name, transfer) in [("to_mano", &map.to_mano), ("to_builtin", &map.to_builtin)] {
        let contact = transfer.contact.iter().enumerate();
        let contact = contact.flat_map(|(target, row)| row.iter().map(move |&(source, w)| (target as u32, source, w)));
        let force = transfer.force.iter().enumerate();
        let force = force.flat_map(|(source, row)| row.iter().map(move |&(target, w)| (target, source as u32, w)));
        for (kind, triplets) in [("contact", contact.collect::<Vec<_>>()), ("force", force.collect())] {
            let words = |get: fn(&(u32, u32, f32)) -> [u8; 4]| triplets.iter().flat_map(get).collect::<Vec<u8>>();
            let shape = vec![triplets.len()];
            let name = |part: &str| format!("{name}.{kind}.{part}");
            tensors.push((name("target"), Dtype::U32, shape.clone(), words(|t| t.0.to_le_bytes())));
            tensors.push((name("source"), Dtype::U32, shape.clone(), words(|t| t.1.to_le_bytes())));
            tensors.push((name("weight"), Dtype::F32, shape, words(|t| t.2.to_le_bytes())));
        }
    }
    let metadata = BTreeMap::from([
        ("side".to_string(), mano.side.name().to_string()),
        ("builtin".into(), Topology::EgotacHand1.id().into()),
        ("mano".into(), Topology::Mano.id().into()),
    ]);
    write_tensors(path, &tensors, metadata)
}
