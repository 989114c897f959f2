//! [`Ranks`] of MPI (feature `mpi`).

use anyhow::{Context, Result, bail};
use mpi::Threading;
use mpi::datatype::{Partition, PartitionMut};
use mpi::environment::Universe;
use mpi::topology::SimpleCommunicator;
use mpi::traits::{Communicator, CommunicatorCollectives};
use physgrad::engine::Ranks;
use std::sync::{Arc, Mutex, PoisonError};

/// Handle of the running MPI library. None before [`start`] and after [`end`].
static UNIVERSE: Mutex<Option<Universe>> = Mutex::new(None);

/// Rank of this process, and number of all processes of the launcher.
#[derive(Debug)]
struct World {
    rank: usize,
    count: usize,
}

/// Starts MPI.
///
/// # Errors
/// MPI has already started. The MPI library has no thread level `MPI_THREAD_SERIALIZED`, which
/// admits calls from several threads, one at a time.
pub fn start() -> Result<Arc<dyn Ranks>> {
    let (universe, threading) =
        mpi::initialize_with_threading(Threading::Serialized).context("MPI has already started")?;
    if threading < Threading::Serialized {
        bail!(
            "this MPI library has thread level {threading:?}; use one with MPI_THREAD_SERIALIZED"
        );
    }
    let world = universe.world();
    let ranks = World { rank: world.rank() as usize, count: world.size() as usize };
    *UNIVERSE.lock().unwrap_or_else(PoisonError::into_inner) = Some(universe);
    Ok(Arc::new(ranks))
}

/// Ends MPI, if it runs. With an error status, ends the processes of all ranks.
pub fn end(status: Option<u8>) {
    let universe = UNIVERSE.lock().unwrap_or_else(PoisonError::into_inner).take();
    if let (Some(universe), Some(status)) = (&universe, status) {
        universe.world().abort(status.into());
    }
}

impl Ranks for World {
    fn rank(&self) -> usize {
        self.rank
    }

    fn count(&self) -> usize {
        self.count
    }

    fn exchange(&self, messages: &[&[u8]]) -> Vec<Vec<u8>> {
        let world = SimpleCommunicator::world();
        let length = |bytes: usize| {
            i32::try_from(bytes).expect(
                "the messages of a rank have 2 GiB or more; use a smaller policy or fewer samples",
            )
        };
        let sent: Vec<i32> = messages.iter().map(|message| length(message.len())).collect();
        let mut received = vec![0; self.count];
        world.all_to_all_into(&sent[..], &mut received[..]);
        let starts = |lengths: &[i32]| -> Vec<i32> {
            let ends = lengths.iter().scan(0, |end, &bytes| {
                *end += bytes as usize;
                Some(*end)
            });
            [0].into_iter().chain(ends).take(lengths.len()).map(length).collect()
        };
        // Adds an unused byte: the address of an empty vector of bytes is 1, which is MPI_IN_PLACE
        // in Open MPI.
        let bytes = [&messages.concat()[..], &[0]].concat();
        let mut buffer = vec![0u8; received.iter().map(|&bytes| bytes as usize).sum::<usize>() + 1];
        let (sent_starts, received_starts) = (starts(&sent), starts(&received));
        world.all_to_all_varcount_into(
            &Partition::new(&bytes[..], &sent[..], &sent_starts[..]),
            &mut PartitionMut::new(&mut buffer[..], &received[..], &received_starts[..]),
        );
        let message =
            |(&start, &bytes): (&i32, &i32)| buffer[start as usize..][..bytes as usize].to_vec();
        received_starts.iter().zip(&received).map(message).collect()
    }
}
