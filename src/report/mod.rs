//! Pictures of runs: plain numbers in, SVG or PNG out. No scripts, no network, the same bytes every time.

mod animation;
mod axes;
mod cart_pole;
mod chart;
mod curves;
mod drawing;
mod guidance;
mod log_axis;
mod log_figure;
mod marks;
mod mechanics;
mod plane;
mod quantum;
mod raster;
mod series;
mod work_precision;

pub use animation::{Animation, Shape};
pub use cart_pole::{Rail, cart_pole, cart_pole_on};
pub use chart::{Chart, Frame};
pub use curves::{Case, Curve, Point, comparison, field_color, learning_curve, study};
pub use drawing::Drawing;
pub use guidance::{Field, guidance, guidance_in};
pub use mechanics::{Posture, Stage, mechanics};
pub use plane::{Map, Plane, maps};
pub use quantum::{Landscape, quantum, quantum_in};
pub use raster::Raster;
pub use series::Series;
pub use work_precision::{Work, work_precision};
