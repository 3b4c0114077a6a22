//! `egotac label --physics`: forces from motion in place of a network.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::bail;
use glam::DVec3;

use super::hands::Hands;
use super::options::Json;
use crate::dataset::EpisodeReader;
use crate::dataset::zarr::ZarrReader;
use crate::hand::{HandModel, Side, Topology};
use crate::label::physics::{BodyOptions, FrameCounts, Label, label};
use crate::physics::body::DENSITY_CLASSES;
use crate::physics::{DensityClass, Settings};

/// Arguments about the bodies of a store.
#[derive(Debug, clap::Args)]
#[command(next_help_heading = "Bodies")]
pub struct Bodies {
    /// Mass of an object, kg; once per object.
    #[arg(long, value_name = "OBJECT=KG", value_parser = mass)]
    mass: Vec<(String, f64)>,
    /// Class of the density of objects without --mass: household, filled, wood, plastic, ceramic, glass or metal. By default
    /// the masses of the simulator, and household for recordings.
    #[arg(long, value_name = "CLASS", value_parser = density)]
    density: Option<DensityClass>,
    /// Coefficient of friction between hands and objects; by default the simulator's, and 0.8 for recordings.
    #[arg(long, value_name = "F", value_parser = super::positive)]
    friction: Option<f64>,
    /// Folder with a mesh OBJECT.obj, .ply, .glb or .stl of each object, in place of the files that the import read.
    #[arg(long, value_name = "FOLDER")]
    meshes: Option<PathBuf>,
    /// Direction of gravity in the store's world frame, such as 0,0,-1; by default found from objects at rest.
    #[arg(long, value_name = "X,Y,Z", value_parser = direction, allow_hyphen_values = true)]
    gravity: Option<DVec3>,
}

impl Bodies {
    /// Returns the options that the arguments give.
    pub fn options(&self) -> BodyOptions {
        BodyOptions {
            masses: self.mass.iter().cloned().collect(),
            density: self.density,
            friction: self.friction,
            meshes: self.meshes.clone(),
            gravity: self.gravity,
        }
    }

    /// Returns the name of an option that is given; None if none is.
    pub fn given(&self) -> Option<&'static str> {
        let Self { mass, density, friction, meshes, gravity } = self;
        let given = [
            ("--mass", !mass.is_empty()),
            ("--density", density.is_some()),
            ("--friction", friction.is_some()),
            ("--meshes", meshes.is_some()),
            ("--gravity", gravity.is_some()),
        ];
        given.into_iter().find_map(|(name, given)| given.then_some(name))
    }
}

/// Arguments of forces from motion.
#[derive(Debug, clap::Args)]
#[command(next_help_heading = "Forces from motion")]
pub struct Physics {
    /// Estimate forces from the motion of objects, in a store with poses of hands and objects; no network runs, and no image
    /// is read.
    #[arg(long)]
    pub physics: bool,
    #[command(flatten)]
    pub bodies: Bodies,
    /// Bandwidth of the smoothed motion, 1/s; by default the largest at which noise of the poses stays small.
    #[arg(long, value_name = "HZ", value_parser = super::positive, requires = "physics")]
    bandwidth: Option<f64>,
    /// Move hands, within the noise of their poses, to where contact is possible.
    #[arg(long, requires = "physics")]
    refine: bool,
}

impl Physics {
    /// Writes a copy of the store `input` with forces to `out`.
    pub fn run(&self, input: &Path, out: &Path, hands: &Hands, json: &Json) -> anyhow::Result<ExitCode> {
        let store = ZarrReader::open(input)?;
        let models = models(&store, hands)?;
        let bodies = self.bodies.options();
        let settings = Settings { bandwidth: self.bandwidth, refine: self.refine, ..Settings::default() };
        let bar = super::progress::bar("images");
        bar.set_length(store.len() as u64);
        let run = Label { models: &models, bodies, settings };
        let counts = label(input, out, &run, |done, _| bar.set_position(done as u64))?;
        bar.finish_and_clear();
        json.show(&serde_json::to_value(&counts)?, || summary(&counts, out))?;
        Ok(ExitCode::SUCCESS)
    }
}

/// Returns the left and right hand on the topology of a store.
///
/// # Errors
/// If the store is on MANO's vertices and no MANO files are given, or the other way round.
pub fn models(store: &ZarrReader, hands: &Hands) -> anyhow::Result<[HandModel; 2]> {
    let mut models = match (store.attributes().topology, hands.files()?) {
        (Topology::Mano, Some(models)) => models,
        (Topology::Mano, None) => bail!(
            "{}: is on MANO's vertices; expected --mano-left FILE and --mano-right FILE to pose them",
            store.path().display()
        ),
        (Topology::EgotacHand1, None) => Side::BOTH.map(HandModel::builtin),
        (Topology::EgotacHand1, Some(_)) => bail!(
            "{}: is on the built-in hand's vertices; expected no MANO files, or a store that was imported with them",
            store.path().display()
        ),
    };
    let import = store.raw_attributes().get("import");
    if import.and_then(|import| import.get("left_shapedirs_fixed")).is_some_and(|fixed| fixed == true) {
        models[0].fix_left_shapedirs();
    }
    Ok(models)
}

fn summary(counts: &FrameCounts, out: &Path) -> String {
    let FrameCounts { frames, touching, undetermined, unknown } = counts;
    let mut text = format!(
        "{}: {frames} frames; {touching} hands touch, {undetermined} of them with a squeeze that motion does not tell\n",
        out.display()
    );
    for (reason, hands) in unknown {
        text += &format!("  {hands} hands unknown: {reason}\n");
    }
    text
}

fn mass(text: &str) -> Result<(String, f64), String> {
    let (name, kilograms) = text.split_once('=').ok_or("expected OBJECT=KG, such as mug=0.3")?;
    Ok((name.to_string(), super::positive(kilograms)?))
}

fn density(text: &str) -> Result<DensityClass, String> {
    let known = || DENSITY_CLASSES.map(|class| class.name).join(", ");
    DensityClass::by_name(text).map_err(|_| format!("expected one of {}", known()))
}

fn direction(text: &str) -> Result<DVec3, String> {
    let parts: Option<Vec<f64>> = text.split(',').map(|part| part.trim().parse().ok()).collect();
    let vector = parts.and_then(|parts| <[f64; 3]>::try_from(parts).ok()).map(DVec3::from_array);
    let vector = vector.filter(|v| v.is_finite() && v.length() > 1e-6);
    vector.ok_or_else(|| "expected three numbers, such as 0,0,-1".into())
}
