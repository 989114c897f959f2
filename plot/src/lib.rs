//! Figures, as SVG or PNG, and animations, as SVG, from plain numbers.
//!
//! Contents:
//!
//! - Charts: [`learning_curve`], [`comparison`], [`study`], [`final_losses`], [`robustness`],
//!   [`distribution`], [`settings()`], [`fitted`] and [`work_precision`], and [`Chart`] for
//!   interactive pages.
//! - Maps of a plane: [`maps`].
//! - Animations: [`cart_pole()`], [`guidance()`], [`quantum()`], [`mechanics()`],
//!   [`channels_over_time`], or [`Animation`] for other systems.
//!
//! Start with [`learning_curve`]. Output contains no scripts, needs no network, and is reproducible
//! byte for byte.

mod animation;
mod axes;
mod cart_pole;
mod channels;
mod chart;
mod curves;
mod distribution;
mod drawing;
mod final_losses;
mod fitted;
mod guidance;
mod log_axis;
mod log_figure;
mod marks;
mod mechanics;
mod plane;
pub mod quantile;
mod quantum;
mod raster;
mod robustness;
mod series;
mod settings;
mod work_precision;
mod y_axis;

pub use animation::{Animation, Picture, Shape, View};
pub use cart_pole::{Rail, cart_pole, cart_pole_on};
pub use channels::{Channel, channels_over_time};
pub use chart::{Chart, Frame};
pub use curves::{
    Abscissa, Case, Curve, PALETTE, Point, comparison, field_color, learning_curve, line_style,
    statistic, study,
};
pub use distribution::distribution;
pub use drawing::Drawing;
pub use final_losses::{TaskLosses, final_losses};
pub use fitted::{FittedColumn, fitted};
pub use guidance::{Field, guidance, guidance_in};
pub use mechanics::{BOXES, Posture, Stage, mechanics};
pub use plane::{Map, Plane, maps};
pub use quantum::{Landscape, quantum, quantum_in};
pub use raster::Raster;
pub use robustness::robustness;
pub use series::{Dash, Series};
pub use settings::settings;
pub use work_precision::{Work, work_precision};
pub use y_axis::YScale;
