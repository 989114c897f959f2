//! Commands of the program, one module each. `print` contains `scene` and `schema`.
//!
//! Imports all other parts of the program except `api`. Start reading with `train`.

pub mod accuracy;
pub mod animate;
pub mod check;
pub mod compare;
pub mod completions;
pub mod effects;
pub mod eval;
pub mod explain;
pub mod export;
pub mod identify;
pub mod merge;
pub mod new;
pub mod optimize;
pub mod paper;
pub mod print;
pub mod report;
pub mod robust;
pub mod runs;
pub mod study;
pub mod tasks;
pub mod train;
