//! Pictures of runs: plain numbers in, SVG or PNG out. No scripts, no network, the same bytes every time.

mod animation;
mod cart_pole;
mod chart;
mod curves;
mod drawing;
mod guidance;
mod log_axis;
mod log_figure;
mod marks;
mod quantum;
mod series;

pub use animation::{Animation, Shape};
pub use cart_pole::cart_pole;
pub use chart::{Chart, Frame};
pub use curves::{Curve, Point, comparison, field_color, learning_curve};
pub use drawing::Drawing;
pub use guidance::guidance;
pub use quantum::quantum;
pub use series::Series;
