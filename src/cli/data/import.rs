//! `egotac data import`.

use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::Context;

use crate::cli::labelling::{Work, shard};
use crate::cli::options::{Json, Length};
use crate::import::glove::CONTACT_SHARE;
use crate::import::{ContactRule, HandModels, ImportTasks, Options, Settings, kind, table};
use crate::label::Shard;
use crate::tactile::ForceKind;

/// Arguments of `egotac data import`.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "The source is only read. A run that was stopped, even by a kill, resumes when the same command is given \
    again. A store appears when it is complete.\n\
    Exit status: 0 = everything is imported, 3 = everything readable is imported and the rest is listed, 1 = error."
)]
pub struct Args {
    /// Kind of the data set; --list names all.
    #[arg(required_unless_present = "list")]
    kind: Option<String>,
    /// Folder of the data set, laid out as its authors distribute it, or one of its recordings.
    #[arg(required_unless_present = "list")]
    source: Option<PathBuf>,
    /// The store of a single recording; of several ones, a folder for their stores and a manifest.json.
    #[arg(long, required_unless_present = "list", value_name = "STORE")]
    out: Option<PathBuf>,
    /// Print the table of all kinds.
    #[arg(long)]
    list: bool,
    /// Left hand of MANO, the published pickle or an .npz variant; without MANO files the built-in hand approximates.
    #[arg(long, value_name = "FILE", requires = "mano_right")]
    mano_left: Option<PathBuf>,
    /// Right hand of MANO.
    #[arg(long, value_name = "FILE", requires = "mano_left")]
    mano_right: Option<PathBuf>,
    /// Folder of the objects' meshes; by default where the data set has it.
    #[arg(long, value_name = "FOLDER")]
    objects: Option<PathBuf>,
    /// Taxel map of the gloves, of kinds with gloves: a name of `egotac sensor list`, or a YAML file of `egotac sensor new`; by
    /// default that of the data set's glove.
    #[arg(long, value_name = "NAME|FILE")]
    sensor: Option<String>,
    /// Share of the range of a glove without a calibration above which a vertex counts as touched.
    #[arg(long, value_name = "SHARE", value_parser = share, default_value_t = CONTACT_SHARE)]
    contact_reading: f32,
    /// Meaning of the forces of gloves: `reading` (the value at the vertex, as the EgoTac paper has it) or `spread` (sums to the
    /// force on the hand, as simulated stores have it).
    #[arg(long, value_name = "KIND", value_parser = force_kind, default_value = "reading")]
    force_kind: ForceKind,
    /// Vertices touch an object whose surface is at most so far, such as 2mm, negative inside; by default vertices touch an object
    /// that has a point within 1 cm, the paper's rule.
    #[arg(long, value_name = "LENGTH", value_parser = contact_distance, allow_negative_numbers = true)]
    contact_distance: Option<Length>,
    /// Upper limit of the images' shorter side, pixels; 0 = original size.
    #[arg(long, value_name = "PIXELS", default_value_t = 224)]
    size: u32,
    /// Shard: import only every N-th recording from the I-th (from 0) on.
    #[arg(long, value_name = "I/N", value_parser = shard, default_value = "0/1")]
    shard: Shard,
    #[command(flatten)]
    json: Json,
}

/// Runs the command.
pub fn run(args: Args) -> anyhow::Result<ExitCode> {
    if args.list {
        print!("{}", table());
        return Ok(ExitCode::SUCCESS);
    }
    let (name, source, out) = args
        .kind
        .zip(args.source)
        .zip(args.out)
        .map(|((name, source), out)| (name, source, out))
        .context("expected KIND, SOURCE and --out")?;
    let settings = Settings {
        kind: kind(&name)?,
        hands: HandModels::load(args.mano_left.as_deref(), args.mano_right.as_deref())?,
        rule: args
            .contact_distance
            .map_or(ContactRule::Proximity, |distance| ContactRule::SignedDistance(distance.0 as f32)),
        side: (args.size > 0).then_some(args.size),
        options: Options {
            objects: args.objects,
            sensor: args.sensor,
            contact_share: Some(args.contact_reading),
            force_kind: Some(args.force_kind),
        },
    };
    let import = ImportTasks::find(&source, &out, settings)?;
    let jobs = import.jobs();
    let work = Work { input: &source, out: &out, tasks: &import.tasks, jobs: &jobs, unreadable: &import.unreadable };
    work.run(&args.json, |index, number, timing, progress| {
        jobs[index].run_with(&mut import.labeller(index), args.shard, number, timing, progress)
    })
}

fn force_kind(text: &str) -> Result<ForceKind, String> {
    ForceKind::from_id(text).map_err(|error| error.to_string())
}

fn share(text: &str) -> Result<f32, String> {
    match text.parse::<f32>() {
        Ok(value) if (0.0..1.0).contains(&value) => Ok(value),
        _ => Err("expected a number from 0 to below 1".into()),
    }
}

/// Largest distance of contact, m: distances are known up to 5 cm.
const MOST: f64 = 0.05;

fn contact_distance(text: &str) -> Result<Length, String> {
    let distance: Length = text.parse()?;
    match distance.0.abs() < MOST {
        true => Ok(distance),
        false => Err(format!("expected a length between -{0} and {0}", Length(MOST))),
    }
}
