//! `egotac sim trial`, the child process of [`crate::trial`].

use super::Trial;
use crate::mujoco::object::Shapes;
use crate::retarget::Robot;
use crate::{sim, trial};

/// Does the load of a request within limits, and answers on standard output.
///
/// # Errors
/// If the request can't be read or answered.
pub fn serve(args: &Trial) -> anyhow::Result<()> {
    trial::serve(&args.request, args.parent, |request| match request {
        trial::Trial::Robot { robot, model } => Robot::load(&robot, model.as_deref()).map(drop),
        trial::Trial::Object(file) => Shapes::read(&file).map(drop),
        trial::Trial::Mesh { file, scale } => sim::try_mesh(&file, scale),
    })?;
    Ok(())
}
