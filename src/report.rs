//! Pictures of runs: plain numbers in, SVG or PNG out. No scripts, no network, the same bytes every time.

mod animation;
mod cart_pole;
mod curves;
mod drawing;
mod guidance;
mod log_figure;
mod panel;
mod plane;
mod quantum;
mod raster;

pub use animation::{Animation, Shape};
pub use cart_pole::cart_pole;
pub use curves::{Case, Curve, Point, comparison, field_color, learning_curve, study};
pub use drawing::Drawing;
pub use guidance::guidance;
pub use plane::{Map, Plane, maps};
pub use quantum::quantum;
pub use raster::Raster;
