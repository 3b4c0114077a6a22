//! Rejects models and options with which the engine would end the process during a step.
//!
//! The engine handles a runtime error by calling `exit`. Its model compiler reports most faults as ordinary errors; the
//! cases here pass the compiler, or become possible once the options in the model text are replaced.

use mujoco_rs::prelude::*;

use super::options::{Integrator, PhysicsOptions, Solver};
use crate::error::{Error, Result};

/// Minimum arena (memory for contacts and scratch), bytes. With less, the engine drops all contacts at some sizes and
/// ends the process at others.
const MIN_ARENA: i64 = 256 << 10;
/// Additional minimum arena per degree of freedom, bytes.
const ARENA_PER_DOF: i64 = 1 << 10;

/// Checks that no step of `model` under `options` ends the process.
///
/// # Errors
/// If a step would; the error names the option or element to change.
pub(super) fn check_fatal(model: &MjModel, options: &PhysicsOptions) -> Result<()> {
    let ffi = model.ffi();
    let refuse = |name: &str, expected: &str, got: String| Err(Error::value(name, expected, got));
    if ffi.nflex > 0 {
        if options.integrator != Integrator::Discrete {
            return refuse("integrator", "discrete, which a soft body needs", spelled(&options.integrator));
        }
        if options.solver == Solver::Pgs {
            return refuse("solver", "newton or cg, which a soft body needs", spelled(&options.solver));
        }
        if options.noslip_iterations > 0 {
            let got = options.noslip_iterations.to_string();
            return refuse("noslip_iterations", "0 with a soft body", got);
        }
    }
    let enabled = |bit: MjtEnableBit| model.opt().enableflags & bit as i32 != 0;
    if enabled(MjtEnableBit::mjENBL_IPC) && (options.integrator, options.solver) != (Integrator::Discrete, Solver::Cg) {
        let got = format!("{} and {}", spelled(&options.integrator), spelled(&options.solver));
        return refuse("integrator and solver", "discrete and cg, which the flag ipc needs", got);
    }
    if enabled(MjtEnableBit::mjENBL_FWDINV)
        && enabled(MjtEnableBit::mjENBL_INVDISCRETE)
        && options.integrator == Integrator::Rk4
    {
        let expected = "any but rk4 beside the flags fwdinv and invdiscrete";
        return refuse("integrator", expected, spelled(&options.integrator));
    }
    let has_tactile = model.sensor_type().contains(&MjtSensor::mjSENS_TACTILE);
    let bare_sdf = model
        .geom_type()
        .iter()
        .zip(model.geom_plugin())
        .position(|(kind, plugin)| *kind == MjtGeomBase::mjGEOM_SDF && *plugin < 0);
    if let Some(geom) = bare_sdf.filter(|_| has_tactile) {
        let name = model.id_to_name(MjtObjBase::mjOBJ_GEOM, geom).unwrap_or_default();
        let expected = "a plugin, which a tactile sensor in the same model needs";
        return refuse(&format!("sdf geom {geom} {name:?}"), expected, "none".into());
    }
    let least = MIN_ARENA + ARENA_PER_DOF * ffi.nv;
    if ffi.narena < least {
        return refuse("size memory", &format!("at least {least} bytes"), format!("{} bytes", ffi.narena));
    }
    Ok(())
}

/// Returns an option as a file spells it.
fn spelled(option: &impl serde::Serialize) -> String {
    serde_json::to_value(option).ok().and_then(|v| v.as_str().map(str::to_owned)).unwrap_or_default()
}
