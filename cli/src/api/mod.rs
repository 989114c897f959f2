//! Scenes, policies and runs for other programs: several commands of `physgrad` as functions.
//!
//! The Python bindings call this module, `rows`, `optimize` and `identify`. Errors have the
//! messages that the program prints, or similar ones. An error that is a
//! [`Divergence`](physgrad::Divergence) or a [`TrainError`](physgrad::TrainError) can be downcast.
//! ```
//! use physgrad_cli::api::Scene;
//!
//! let scene = Scene::open("cart_pole", [("system.poles".into(), Some(2.into())), ("epochs".into(), Some(1.into()))])?;
//! assert_eq!((scene.name(), scene.state_names().len()), ("cart_pole", 6));
//! # Ok::<(), anyhow::Error>(())
//! ```

mod memory;
mod policy;
mod recordings;
mod run;
mod scene;

pub use crate::commands::accuracy::{Cheapest, Errors, Measured, Metric, Row, Setting};
pub use crate::commands::identify::data::TooLong;
pub use crate::commands::identify::remarks::Remarks;
pub use crate::commands::identify::table::{Cells, Columns, Kind, Reading};
pub use crate::platform::terminal::{did_you_mean, plain};
pub use crate::runs::run::{EpochEvent, Observer};
pub use crate::settings::Precision;
pub use memory::{TooLarge, fits};
pub use physgrad::engine::threads;
pub use physgrad::train::Trajectories;
pub use policy::{ClosedLoop, Policy};
pub use recordings::Recordings;
pub use run::Run;
pub use scene::{Change, Checked, Scene};

/// Names of all tasks, each of which is also the name of a preset.
pub fn task_names() -> Vec<&'static str> {
    crate::tasks::all().iter().map(|task| task.name()).collect()
}

/// Names of all presets, each with a line about it.
pub fn presets() -> Vec<(&'static str, &'static str)> {
    crate::scenes::presets::all().collect()
}

/// Contents of a file of up to `most` bytes. None if it has more.
///
/// # Errors
/// The file cannot be read.
pub fn read_file(path: &std::path::Path, most: usize) -> std::io::Result<Option<Vec<u8>>> {
    crate::platform::files::read(path, most)
}

/// Replaces the file at this path as a whole, by a temporary file beside it.
///
/// # Errors
/// There is no such folder, or the file cannot be written. The path is that of a link, a device or
/// another existing entry that is not a regular file.
pub fn write_file(path: &std::path::Path, bytes: &[u8]) -> anyhow::Result<()> {
    crate::platform::folder::Folder::write_at(path, bytes)
}
