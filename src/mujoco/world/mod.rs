//! A simulated world: model and state owned together, elements resolved by name once.

mod contacts;
mod energy;
mod facts;
mod flex;
mod motion;
mod names;
mod pose;
mod state;
mod step;

use std::path::Path;

use glam::Vec3;
use mujoco_rs::prelude::*;
use mujoco_rs::wrappers::MjVfs;

use super::fatal::check_fatal;
use super::named_files::check_named_files;
use super::options::{Cone, Integrator, PhysicsOptions, Solver};
use crate::error::{Error, Result};

pub use contacts::{Contact, Grip};
pub use facts::Facts;
pub use flex::Flex;
pub use names::{Body, FreeJoint, Servo, Skin};

/// Name of a model among files in memory.
const MODEL_FILE: &str = "model.xml";

/// A physics model with its state.
///
/// Positions are in the world frame, metres; quaternions are unit and rotate body to world.
#[derive(Debug)]
pub struct World {
    data: MjData<Box<MjModel>>,
    options: PhysicsOptions,
    /// Body that carries each soft body's name, by flex index.
    flex_bodies: Vec<Body>,
}

impl World {
    /// Compiles MJCF text and computes the initial state.
    ///
    /// `options` replace those in the text. Automatic reset is off, so that an invalid state stays visible.
    ///
    /// # Errors
    /// If the text does not compile, or a step of the model under `options` would end the process.
    pub fn from_mjcf(mjcf: &str, options: &PhysicsOptions) -> Result<Self> {
        disable_log_file();
        let model = MjModel::from_xml_string(mjcf).map_err(|e| Error::Engine(e.to_string()))?;
        Self::from_model(model, options)
    }

    /// Compiles MJCF text that names files which lie in memory: name and content; see [`Self::from_mjcf`].
    ///
    /// # Errors
    /// As [`Self::from_mjcf`], and if two files have the same name.
    pub fn from_mjcf_with_files(mjcf: &str, files: &[(String, Vec<u8>)], options: &PhysicsOptions) -> Result<Self> {
        if files.is_empty() {
            return Self::from_mjcf(mjcf, options);
        }
        disable_log_file();
        let engine = |error: &dyn std::fmt::Display| Error::Engine(error.to_string());
        let mut folder = MjVfs::new();
        folder.add_from_buffer(MODEL_FILE, mjcf.as_bytes()).map_err(|e| engine(&e))?;
        for (name, content) in files {
            folder.add_from_buffer(name, content).map_err(|e| engine(&e))?;
        }
        let model = MjModel::from_xml_vfs(MODEL_FILE, &folder).map_err(|e| engine(&e))?;
        Self::from_model(model, options)
    }

    /// Compiles an MJCF or URDF file with the files that it names; see [`Self::from_mjcf`]. Of a file by somebody else, a
    /// [`crate::trial::Trial`] comes first.
    ///
    /// # Errors
    /// As [`Self::from_mjcf`]; the error names the file.
    pub fn from_file(path: &Path, options: &PhysicsOptions) -> Result<Self> {
        disable_log_file();
        if path.to_str().is_none_or(|path| path.contains('\0')) {
            return Err(Error::file(path, "expected a path in UTF-8 without NUL"));
        }
        check_named_files(path)?;
        let model = MjModel::from_xml(path).map_err(|error| Error::file(path, error))?;
        Self::from_model(model, options).map_err(|error| Error::file(path, error))
    }

    pub(super) fn from_model(mut model: MjModel, options: &PhysicsOptions) -> Result<Self> {
        check_fatal(&model, options)?;
        apply(options, &mut model);
        let data = MjData::try_new(Box::new(model)).map_err(|e| Error::Engine(e.to_string()))?;
        let mut world = Self { data, options: options.clone(), flex_bodies: Vec::new() };
        world.flex_bodies = world.find_flex_bodies();
        world.forward();
        Ok(world)
    }

    /// Returns the options in force.
    pub fn options(&self) -> &PhysicsOptions {
        &self.options
    }

    /// Replaces a skin's vertices in the bind pose of its bones, m; the next picture shows them.
    ///
    /// # Errors
    /// If the number of vertices differs from the skin's.
    pub fn set_skin(&mut self, skin: Skin, vertices: &[Vec3]) -> Result<()> {
        if vertices.len() != skin.count {
            return Err(Error::shape("skin vertices", format!("[{}, 3]", skin.count), [vertices.len(), 3]));
        }
        let all = &mut self.skin_vertices_mut()[skin.first..skin.first + skin.count];
        all.iter_mut().zip(vertices).for_each(|(old, new)| *old = new.to_array());
        Ok(())
    }

    /// Vertices of all skins in their bind poses, m.
    fn skin_vertices_mut(&mut self) -> &mut [[f32; 3]] {
        // SAFETY: `model_mut` requires that the model is not swapped and that its sizes, indices and addresses stay as
        // the data was allocated for. This function upholds that: the reference to the model ends here, and the slice
        // that leaves holds coordinates only, which the engine reads for drawing and never as an index.
        #[allow(unsafe_code)]
        let model = unsafe { self.data.model_mut() };
        model.skin_vert_mut()
    }

    pub(super) fn data_mut(&mut self) -> &mut MjData<Box<MjModel>> {
        &mut self.data
    }

    pub(super) fn model(&self) -> &MjModel {
        self.data.model()
    }
}

/// Writes `options` into a model.
fn apply(options: &PhysicsOptions, model: &mut MjModel) {
    let opt = model.opt_mut();
    opt.timestep = options.timestep;
    opt.cone = match options.cone {
        Cone::Pyramidal => MjtCone::mjCONE_PYRAMIDAL,
        Cone::Elliptic => MjtCone::mjCONE_ELLIPTIC,
    } as i32;
    opt.impratio = options.impratio;
    opt.solver = match options.solver {
        Solver::Pgs => MjtSolver::mjSOL_PGS,
        Solver::Cg => MjtSolver::mjSOL_CG,
        Solver::Newton => MjtSolver::mjSOL_NEWTON,
    } as i32;
    opt.iterations = options.iterations as i32;
    opt.tolerance = options.tolerance;
    opt.noslip_iterations = options.noslip_iterations as i32;
    opt.integrator = match options.integrator {
        Integrator::Euler => MjtIntegrator::mjINT_EULER,
        Integrator::Rk4 => MjtIntegrator::mjINT_RK4,
        Integrator::Implicit => MjtIntegrator::mjINT_IMPLICIT,
        Integrator::ImplicitFast => MjtIntegrator::mjINT_IMPLICITFAST,
        Integrator::Discrete => MjtIntegrator::mjINT_DISCRETE,
    } as i32;
    opt.gravity = options.gravity;
    opt.disableflags |= MjtDisableBit::mjDSBL_AUTORESET as i32;
    let gap = options.preset.near_contact_gap();
    if gap > 0.0 {
        // The engine adds the gaps of a pair's two geoms.
        model.geom_gap_mut().fill(0.5 * gap);
    }
}

/// Stops the engine from writing MUJOCO_LOG.TXT into the working directory; [`World::warnings`] counts its warnings.
pub(super) fn disable_log_file() {
    static ONCE: std::sync::Once = std::sync::Once::new();
    ONCE.call_once(|| {
        // SAFETY: `set_log_config` requires that no other thread uses the engine during the call. All entry points of
        // this module (`from_mjcf`, `from_file`, `with_object`) call this function before anything else of the engine,
        // and `Once` blocks them until the call has returned.
        #[allow(unsafe_code)]
        unsafe {
            set_log_config(log_config().with_logto_file(false));
        }
    });
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;

    const BOX_ON_FLOOR: &str = r#"<mujoco><worldbody><geom name="floor" type="plane" size="1 1 .1"/>
        <body name="box" pos="0 0 .0499"><freejoint name="box"/>
        <geom type="box" size=".05 .05 .05" mass=".2" condim="4"/></body></worldbody></mujoco>"#;

    #[test]
    fn contact_forces_on_a_resting_box_equal_its_weight() {
        let mut world = World::from_mjcf(BOX_ON_FLOOR, &PhysicsOptions::default()).unwrap();
        for _ in 0..1000 {
            world.step();
        }
        world.forward();
        let lift: DVec3 = world.contacts().map(|c| c.force).sum();
        assert!((lift - DVec3::new(0.0, 0.0, 0.2 * 9.81)).length() < 1e-3, "{lift}");
        let normal: f64 = world.contacts().map(|c| c.normal_force).sum();
        assert!((normal - 0.2 * 9.81).abs() < 1e-3, "{normal}");
        assert_eq!(world.warnings(), 0);
        assert!((world.time() - 2.0).abs() < 1e-9);
    }

    #[test]
    fn an_unknown_name_lists_the_known_ones() {
        let world = World::from_mjcf(BOX_ON_FLOOR, &PhysicsOptions::default()).unwrap();
        let error = world.body("bux").unwrap_err().to_string();
        assert!(error.contains("bux") && error.contains("box"), "{error}");
    }

    #[test]
    fn replay_reports_contacts_within_a_centimetre_without_force() {
        let options = PhysicsOptions::preset(crate::mujoco::Preset::Replay);
        let mut world = World::from_mjcf(BOX_ON_FLOOR, &options).unwrap();
        let mut qpos = world.qpos().to_vec();
        for (height, touching, near) in [(0.0495, 4, 4), (0.0599, 0, 4), (0.0601, 0, 0)] {
            qpos[2] = height;
            world.set_qpos(&qpos).unwrap();
            world.detect(0.0);
            let contacts: Vec<Contact> = world.contacts().collect();
            assert_eq!((contacts.iter().filter(|c| c.distance < 0.0).count(), contacts.len()), (touching, near));
            for contact in contacts {
                assert!(
                    (contact.distance - (height - 0.05)).abs() < 1e-9 && contact.normal_force == 0.0,
                    "{contact:?}"
                );
            }
        }
        assert_eq!(world.time(), 0.0);
        assert!(world.set_qpos(&qpos[1..]).is_err() && world.set_qpos(&[f64::NAN; 7]).is_err());
    }

    #[test]
    fn an_invalid_state_is_not_reset() {
        let mut world = World::from_mjcf(BOX_ON_FLOOR, &PhysicsOptions::default()).unwrap();
        let joint = world.free_joint("box").unwrap();
        for _ in 0..10 {
            world.step();
        }
        world.qpos_mut()[joint.qpos] = f64::NAN;
        world.step();
        assert!(world.warnings() > 0);
        assert!(!world.is_finite());
        assert!(world.time() > 0.019);
    }

    #[test]
    fn a_model_that_does_not_compile_is_an_error() {
        let error = World::from_mjcf("<mujoco><worldbody><geom/></worldbody>", &PhysicsOptions::default());
        assert!(matches!(error, Err(Error::Engine(_))));
    }
}
