//! The ranks that a launcher such as `mpirun` has started.

use super::{Communicator, Single};
#[cfg(not(feature = "mpi"))]
use crate::error::Error;
use crate::error::Result;

/// Variables in which Open MPI and the launchers of MPICH give the number of processes to each of them.
const SIZES: [&str; 2] = ["OMPI_COMM_WORLD_SIZE", "PMI_SIZE"];
/// Variables of `srun --mpi=pmix`: rank, which only processes of a step have, and number of processes.
const PMIX: [&str; 2] = ["PMIX_RANK", "SLURM_STEP_NUM_TASKS"];

/// Returns the communicator of the processes that a launcher has started together with this one; [`Single`] if none has.
///
/// Call it once, on the thread that trains.
///
/// # Errors
/// If a launcher has started several processes and this program is built without the feature `mpi`, or MPI can't be initialised.
pub fn launched() -> Result<Box<dyn Communicator>> {
    let ranks = started(|name| std::env::var(name).ok());
    match ranks > 1 {
        false => Ok(Box::new(Single)),
        true => communicator(ranks),
    }
}

#[cfg(feature = "mpi")]
fn communicator(_: usize) -> Result<Box<dyn Communicator>> {
    Ok(Box::new(super::mpi::Mpi::new()?))
}

#[cfg(not(feature = "mpi"))]
fn communicator(ranks: usize) -> Result<Box<dyn Communicator>> {
    let expected =
        "one process, since this program is built without the feature `mpi` (`cargo build --release --features mpi`)";
    Err(Error::value("launcher", expected, format!("{ranks} processes")))
}

/// Returns the number of processes that the environment tells; 1 without a launcher.
fn started(variable: impl Fn(&str) -> Option<String>) -> usize {
    let number = |name: &str| variable(name).and_then(|text| text.parse::<usize>().ok());
    let by_pmix = || number(PMIX[0]).and_then(|_| number(PMIX[1]));
    SIZES.into_iter().find_map(number).or_else(by_pmix).unwrap_or(1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_launcher_tells_the_number_of_processes() {
        let of = |variables: &[(&str, &str)]| {
            started(|name| variables.iter().find(|(key, _)| *key == name).map(|(_, value)| value.to_string()))
        };
        assert_eq!(of(&[]), 1);
        assert_eq!(of(&[("OMPI_COMM_WORLD_SIZE", "4")]), 4);
        assert_eq!(of(&[("PMI_SIZE", "3"), ("PMI_RANK", "0")]), 3);
        assert_eq!(of(&[("PMIX_RANK", "0"), ("SLURM_STEP_NUM_TASKS", "8")]), 8);
        // A shell inside an allocation is not a rank.
        assert_eq!(of(&[("SLURM_STEP_NUM_TASKS", "8")]), 1);
    }
}
