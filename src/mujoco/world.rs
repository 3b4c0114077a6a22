//! A simulated world: model and data owned together, names resolved once.

use std::path::Path;

use glam::{DMat3, DQuat, DVec3, Vec3};
use mujoco_rs::prelude::*;

pub use super::contact::Contact;
use super::fatal::refuse_what_ends_the_process;
pub use super::names::{Body, FreeJoint, Servo, Skin};
use super::options::{Integrator, PhysicsOptions};
use crate::error::{Error, Result};

/// A physics model with its state.
///
/// Positions are in the world frame, metres; quaternions are unit and rotate body to world.
#[derive(Debug)]
pub struct World {
    pub(super) data: MjData<Box<MjModel>>,
    options: PhysicsOptions,
    /// Body of each soft body's name.
    pub(super) flex_bodies: Vec<Body>,
}

impl World {
    /// Compiles MJCF and brings it to its initial state.
    ///
    /// Options in the text are replaced by `options`; automatic reset is off, so that a bad state stays visible.
    ///
    /// # Errors
    /// If the text does not compile, or the model holds what `options` would make the engine end the process for.
    pub fn from_mjcf(mjcf: &str, options: &PhysicsOptions) -> Result<Self> {
        keep_quiet();
        let model = MjModel::from_xml_string(mjcf).map_err(|e| Error::Engine(e.to_string()))?;
        Self::from_model(model, options)
    }

    /// Compiles an MJCF or URDF file, with the files it names, and brings it to its initial state; see [`Self::from_mjcf`].
    ///
    /// # Errors
    /// As [`Self::from_mjcf`]; the error names the file.
    pub fn from_file(path: &Path, options: &PhysicsOptions) -> Result<Self> {
        keep_quiet();
        if path.to_str().is_none_or(|path| path.contains('\0')) {
            return Err(Error::file(path, "expected a path in UTF-8 without NUL"));
        }
        let model = MjModel::from_xml(path).map_err(|error| Error::file(path, error))?;
        Self::from_model(model, options).map_err(|error| Error::file(path, error))
    }

    pub(super) fn from_model(mut model: MjModel, options: &PhysicsOptions) -> Result<Self> {
        refuse_what_ends_the_process(&model, options)?;
        let opt = model.opt_mut();
        opt.timestep = options.timestep;
        opt.cone = match options.cone {
            super::Cone::Pyramidal => MjtCone::mjCONE_PYRAMIDAL,
            super::Cone::Elliptic => MjtCone::mjCONE_ELLIPTIC,
        } as i32;
        opt.impratio = options.impratio;
        opt.solver = match options.solver {
            super::Solver::Pgs => MjtSolver::mjSOL_PGS,
            super::Solver::Cg => MjtSolver::mjSOL_CG,
            super::Solver::Newton => MjtSolver::mjSOL_NEWTON,
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
        let gap = options.preset.near_contact_gap();
        opt.disableflags |= MjtDisableBit::mjDSBL_AUTORESET as i32;
        if gap > 0.0 {
            // The gap of a pair is the sum of its two geoms'.
            model.geom_gap_mut().fill(0.5 * gap);
        }
        let data = MjData::try_new(Box::new(model)).map_err(|e| Error::Engine(e.to_string()))?;
        let mut world = Self { data, options: options.clone(), flex_bodies: Vec::new() };
        world.flex_bodies = world.find_flex_bodies();
        world.forward();
        Ok(world)
    }

    /// The options in force.
    pub fn options(&self) -> &PhysicsOptions {
        &self.options
    }

    /// Replaces a skin's vertices in the pose in which its bones were bound, m; the next picture shows them.
    ///
    /// # Errors
    /// If their number is another.
    pub fn set_skin(&mut self, skin: Skin, vertices: &[Vec3]) -> Result<()> {
        if vertices.len() != skin.count {
            return Err(Error::shape("skin vertices", format!("[{}, 3]", skin.count), [vertices.len(), 3]));
        }
        // SAFETY: the model itself stays, with every size, index and address; only coordinates that nothing but the
        // drawing of skins reads get other values.
        #[allow(unsafe_code)]
        let model = unsafe { self.data.model_mut() };
        let all = &mut model.skin_vert_mut()[skin.first..skin.first + skin.count];
        all.iter_mut().zip(vertices).for_each(|(old, new)| *old = new.to_array());
        Ok(())
    }

    /// Advances by one timestep.
    pub fn step(&mut self) {
        self.data.step();
    }

    /// Gives access to the engine's own data, which holds the model too.
    ///
    /// For the benchmarks, which measure [`Self::step`] against the engine's C function.
    #[doc(hidden)]
    pub fn engine_data_mut(&mut self) -> &mut MjData<Box<MjModel>> {
        &mut self.data
    }

    /// Computes everything that follows from the state: poses, contacts, forces, accelerations.
    pub fn forward(&mut self) {
        self.data.forward();
    }

    /// Computes poses only, as [`Self::jacobian`] needs them.
    pub fn kinematics(&mut self) {
        self.data.kinematics();
        self.data.com_pos();
    }

    /// Back to the initial state, time 0.
    pub fn reset(&mut self) {
        self.data.reset();
    }

    /// Everything that decides how the simulation goes on, to come back to with [`Self::set_state`].
    pub fn state(&self) -> Vec<f64> {
        self.data.state(MjtState::mjSTATE_INTEGRATION as u32).into_vec()
    }

    /// Goes back to a state.
    ///
    /// # Errors
    /// If it is of another model.
    pub fn set_state(&mut self, state: &[f64]) -> Result<()> {
        self.data.set_state(state, MjtState::mjSTATE_INTEGRATION as u32).map_err(|e| Error::Engine(e.to_string()))
    }

    /// Simulated seconds.
    pub fn time(&self) -> f64 {
        self.data.time()
    }

    /// Whether every position, velocity and acceleration is finite.
    pub fn is_finite(&self) -> bool {
        [self.data.qpos(), self.data.qvel(), self.data.qacc()].iter().all(|array| array.iter().all(|x| x.is_finite()))
    }

    /// Positions of all joints, metres, radians or quaternions, in the engine's order.
    pub fn qpos(&self) -> &[f64] {
        self.data.qpos()
    }

    /// Sets the positions of all joints, as [`Self::qpos`] gave them.
    ///
    /// # Errors
    /// If their number is another, or one is not finite.
    pub fn set_qpos(&mut self, qpos: &[f64]) -> Result<()> {
        assign("qpos", self.data.qpos_mut(), qpos)
    }

    /// Targets of all servos, in the engine's order.
    pub fn ctrl(&self) -> &[f64] {
        self.data.ctrl()
    }

    /// Sets the targets of all servos, as [`Self::ctrl`] gave them.
    ///
    /// # Errors
    /// As [`Self::set_qpos`].
    pub fn set_ctrl(&mut self, ctrl: &[f64]) -> Result<()> {
        assign("ctrl", self.data.ctrl_mut(), ctrl)
    }

    /// Velocities of all degrees of freedom, m/s or rad/s.
    pub fn qvel(&self) -> &[f64] {
        self.data.qvel()
    }

    /// Engine warnings since the start (bad state, full memory, ...).
    pub fn warnings(&self) -> usize {
        self.data.warning().iter().map(|warning| warning.number.max(0) as usize).sum()
    }

    /// Whether the solver used all its iterations in the last step.
    pub fn hit_iteration_cap(&self) -> bool {
        let islands = (self.data.nisland().max(1) as usize).min(self.data.solver_niter().len());
        self.data.solver_niter()[..islands].iter().any(|n| *n >= self.options.iterations as i32)
    }

    /// Origin of a body.
    pub fn position(&self, Body(body): Body) -> DVec3 {
        DVec3::from_array(self.data.xpos()[body])
    }

    /// Orientation of a body.
    pub fn orientation(&self, Body(body): Body) -> DQuat {
        let [w, x, y, z] = self.data.xquat()[body];
        DQuat::from_xyzw(x, y, z, w).normalize()
    }

    /// Name of a body; empty if it has none.
    pub fn body_name(&self, Body(body): Body) -> &str {
        self.data.model().id_to_name(MjtObjBase::mjOBJ_BODY, body).unwrap_or_default()
    }

    /// Mass of a body without its children, kg.
    pub fn mass(&self, Body(body): Body) -> f64 {
        self.data.model().body_mass()[body]
    }

    /// Position and orientation of a camera; it looks along -z, +y is up.
    pub fn camera_pose(&self, camera: usize) -> (DVec3, DMat3) {
        let m = &self.data.cam_xmat()[camera];
        (DVec3::from_array(self.data.cam_xpos()[camera]), DMat3::from_cols_array(m).transpose())
    }

    /// Angle of a servo's joint, rad, or its displacement, m.
    pub fn joint_position(&self, servo: Servo) -> f64 {
        self.data.qpos()[servo.qpos]
    }

    /// Sets a servo's joint; call [`Self::forward`] or [`Self::kinematics`] afterwards.
    pub fn set_joint_position(&mut self, servo: Servo, position: f64) {
        self.data.qpos_mut()[servo.qpos] = position;
    }

    /// Sets a servo's target.
    pub fn set_target(&mut self, servo: Servo, target: f64) {
        self.data.ctrl_mut()[servo.ctrl] = target;
    }

    /// Places a free body.
    ///
    /// # Errors
    /// If the position is not finite or the orientation is no rotation: the engine would take a zero quaternion for "not
    /// turned" and keep one of another length as it is.
    pub fn set_pose(&mut self, joint: FreeJoint, position: DVec3, orientation: DQuat) -> Result<()> {
        if !position.is_finite() {
            return Err(Error::value("position", "finite metres", position));
        }
        let length = orientation.length();
        if !length.is_finite() || (length - 1.0).abs() > 1e-3 {
            return Err(Error::value("orientation", "a unit quaternion", format!("length {length}")));
        }
        let orientation = orientation.normalize();
        let qpos = &mut self.data.qpos_mut()[joint.qpos..joint.qpos + 7];
        qpos[..3].copy_from_slice(&position.to_array());
        qpos[3..].copy_from_slice(&[orientation.w, orientation.x, orientation.y, orientation.z]);
        Ok(())
    }

    /// Positions to overwrite, as [`Self::qpos`] has them. Nothing is checked here; a guard sees what becomes of it.
    pub fn qpos_mut(&mut self) -> &mut [f64] {
        self.data.qpos_mut()
    }

    /// Velocities to overwrite, as [`Self::qvel`] has them. Nothing is checked here; a guard sees what becomes of it.
    pub fn qvel_mut(&mut self) -> &mut [f64] {
        self.data.qvel_mut()
    }

    /// Pulls at a body's centre of mass in every step from now on: force, N, and torque, N m, in the world frame. Nothing
    /// is checked here; a guard sees what becomes of it.
    pub fn apply_force(&mut self, Body(body): Body, force: DVec3, torque: DVec3) {
        let [fx, fy, fz] = force.to_array();
        let [tx, ty, tz] = torque.to_array();
        self.data.xfrc_applied_mut()[body] = [fx, fy, fz, tx, ty, tz];
    }

    /// Places a mocap body.
    pub fn set_mocap(&mut self, mocap: usize, position: DVec3, orientation: DQuat) {
        self.data.mocap_pos_mut()[mocap] = position.to_array();
        self.data.mocap_quat_mut()[mocap] = [orientation.w, orientation.x, orientation.y, orientation.z];
    }

    /// Linear velocity of a free body's origin, m/s.
    pub fn velocity(&self, joint: FreeJoint) -> DVec3 {
        DVec3::from_slice(&self.data.qvel()[joint.dof..joint.dof + 3])
    }

    /// Acceleration of a free body's centre of mass, m/s²; valid after [`Self::forward`].
    pub fn acceleration(&self, joint: FreeJoint) -> DVec3 {
        let rotation = self.orientation(joint.body);
        let arm = DVec3::from_array(self.data.xipos()[joint.body.0]) - self.position(joint.body);
        let omega = rotation * DVec3::from_slice(&self.data.qvel()[joint.dof + 3..joint.dof + 6]);
        let alpha = rotation * DVec3::from_slice(&self.data.qacc()[joint.dof + 3..joint.dof + 6]);
        let origin = DVec3::from_slice(&self.data.qacc()[joint.dof..joint.dof + 3]);
        origin + alpha.cross(arm) + omega.cross(omega.cross(arm))
    }

    /// The body of a free joint.
    pub fn body_of(&self, joint: FreeJoint) -> Body {
        joint.body
    }

    /// Velocity of a world point fixed to `body`, per unit velocity of each servo: one column per servo.
    ///
    /// Valid after [`Self::kinematics`] or [`Self::forward`].
    pub fn jacobian(&self, Body(body): Body, point: DVec3, servos: &[Servo]) -> Vec<DVec3> {
        let (jacp, _) = self.data.jac(true, false, &point.to_array(), body);
        let nv = jacp.len() / 3;
        servos.iter().map(|s| DVec3::new(jacp[s.dof], jacp[nv + s.dof], jacp[2 * nv + s.dof])).collect()
    }

    /// Angular velocity of `body` per unit velocity of each servo; validity as for [`Self::jacobian`].
    pub fn angular_jacobian(&self, Body(body): Body, servos: &[Servo]) -> Vec<DVec3> {
        let (_, jacr) = self.data.jac(false, true, &[0.0; 3], body);
        let nv = jacr.len() / 3;
        servos.iter().map(|s| DVec3::new(jacr[s.dof], jacr[nv + s.dof], jacr[2 * nv + s.dof])).collect()
    }

    pub(super) fn data(&self) -> &MjData<Box<MjModel>> {
        &self.data
    }

    pub(super) fn data_mut(&mut self) -> &mut MjData<Box<MjModel>> {
        &mut self.data
    }

    pub(super) fn model(&self) -> &MjModel {
        self.data.model()
    }
}

fn assign(name: &str, to: &mut [f64], from: &[f64]) -> Result<()> {
    if to.len() != from.len() {
        return Err(Error::shape(name, format!("[{}]", to.len()), [from.len()]));
    }
    if let Some(bad) = from.iter().position(|value| !value.is_finite()) {
        return Err(Error::value(format!("{name}[{bad}]"), "a finite number", from[bad]));
    }
    to.copy_from_slice(from);
    Ok(())
}

/// Keeps the engine from leaving a MUJOCO_LOG.TXT in the working directory; its warnings are counted in the world.
pub(super) fn keep_quiet() {
    static ONCE: std::sync::Once = std::sync::Once::new();
    ONCE.call_once(|| {
        // SAFETY: every use of the engine begins with World::from_mjcf, and its callers wait here until this is done,
        // so no other thread uses the engine now.
        #[allow(unsafe_code)]
        unsafe {
            set_log_config(log_config().with_logto_file(false));
        }
    });
}

#[cfg(test)]
mod tests {
    use super::*;

    const BOX_ON_FLOOR: &str = r#"<mujoco><worldbody><geom name="floor" type="plane" size="1 1 .1"/>
        <body name="box" pos="0 0 .0499"><freejoint name="box"/>
        <geom type="box" size=".05 .05 .05" mass=".2" condim="4"/></body></worldbody></mujoco>"#;

    #[test]
    fn a_resting_box_is_carried_by_its_weight() {
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
    fn replay_sees_what_is_within_a_centimetre_without_a_force() {
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
    fn a_bad_state_stays_visible_instead_of_being_reset() {
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
