//! Ranks of a launcher such as `mpirun`. Only `mpi.rs` calls MPI (feature `mpi`).

#[cfg(feature = "mpi")]
use crate::platform::mpi;
use anyhow::{Result, bail};
use physgrad::engine::Ranks;
use std::sync::Arc;

/// Environment variables with the number of ranks. Open MPI sets the first, MPICH and Slurm set the
/// second.
const SIZES: [&str; 2] = ["OMPI_COMM_WORLD_SIZE", "PMI_SIZE"];

/// The ranks, if a launcher started this process with at least one other.
///
/// # Errors
/// The program has no feature `mpi`, or MPI cannot start. MPI connects more or fewer processes than
/// the launcher started.
pub fn launched() -> Result<Option<Arc<dyn Ranks>>> {
    let size = |name: &&str| std::env::var(name).ok()?.parse::<usize>().ok();
    match SIZES.iter().find_map(size) {
        Some(size) if size > 1 => {
            let ranks = start()?;
            if ranks.count() != size {
                bail!(
                    "the launcher started {size} processes, but MPI connects {} of them; use the launcher of the MPI library \
                     with which this program was built",
                    ranks.count()
                );
            }
            Ok(Some(ranks))
        }
        _ => Ok(None),
    }
}

#[cfg(feature = "mpi")]
fn start() -> Result<Arc<dyn Ranks>> {
    mpi::start()
}

#[cfg(not(feature = "mpi"))]
fn start() -> Result<Arc<dyn Ranks>> {
    bail!(
        "the launcher started several processes of this program, which was built without MPI; build it with --features mpi, or \
         start one process"
    )
}

/// Ends MPI, if it runs. With an error status, ends the processes of all ranks.
pub fn end(status: Option<u8>) {
    #[cfg(feature = "mpi")]
    mpi::end(status);
    #[cfg(not(feature = "mpi"))]
    let _ = status;
}
