//! Models and options with which the engine would end the process in the middle of a step.
//!
//! An engine error is an exit by design. What the compiler of models refuses by itself is a plain error and not listed
//! here; this is what gets past it, or past it once the options of the text are replaced.

use mujoco_rs::prelude::*;

use super::options::{Integrator, PhysicsOptions, Solver};
use crate::error::{Error, Result};

/// Least memory for contacts and scratch, bytes. Where it is short, some sizes make the engine drop all contacts, and
/// others, a little larger or smaller, make it end the process.
const LEAST_ARENA: i64 = 256 << 10;
/// More of it for each degree of freedom, bytes.
const ARENA_PER_DOF: i64 = 1 << 10;

/// Refuses `model` under `options` where a step would end the process.
///
/// # Errors
/// If it would; the error names what to change.
pub(super) fn refuse_what_ends_the_process(model: &MjModel, options: &PhysicsOptions) -> Result<()> {
    let ffi = model.ffi();
    let refuse = |name: &str, expected: &str, got: String| Err(Error::value(name, expected, got));
    if ffi.nflex > 0 {
        if options.integrator != Integrator::Discrete {
            return refuse("integrator", "discrete, which a soft body needs", word(&options.integrator));
        }
        if options.solver == Solver::Pgs {
            return refuse("solver", "newton or cg, which a soft body needs", word(&options.solver));
        }
        if options.noslip_iterations > 0 {
            let got = options.noslip_iterations.to_string();
            return refuse("noslip_iterations", "0 beside a soft body", got);
        }
    }
    let enabled = |bit: MjtEnableBit| model.opt().enableflags & bit as i32 != 0;
    if enabled(MjtEnableBit::mjENBL_IPC) && (options.integrator, options.solver) != (Integrator::Discrete, Solver::Cg) {
        let got = format!("{} and {}", word(&options.integrator), word(&options.solver));
        return refuse("integrator and solver", "discrete and cg, which the flag ipc needs", got);
    }
    if enabled(MjtEnableBit::mjENBL_FWDINV)
        && enabled(MjtEnableBit::mjENBL_INVDISCRETE)
        && options.integrator == Integrator::Rk4
    {
        let expected = "any but rk4 beside the flags fwdinv and invdiscrete";
        return refuse("integrator", expected, word(&options.integrator));
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
    let least = LEAST_ARENA + ARENA_PER_DOF * ffi.nv;
    if ffi.narena < least {
        return refuse("size memory", &format!("at least {least} bytes"), format!("{} bytes", ffi.narena));
    }
    Ok(())
}

/// An option as it is written.
fn word(option: &impl serde::Serialize) -> String {
    serde_json::to_value(option).ok().and_then(|v| v.as_str().map(str::to_owned)).unwrap_or_default()
}
