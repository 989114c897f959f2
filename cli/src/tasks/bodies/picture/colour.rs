//! Colours of shapes, as CSS.

use physgrad_bodies::model::{Model, Shape};
use physgrad_plot::PALETTE;

/// Shadows on the floor.
pub const SHADOW: &str = "#E4E6EA";
/// Arrows of contact forces.
pub const FORCE: &str = "#CC3311";
/// Lines on the floor.
pub const GRID: &str = "#D5D8DC";
/// The floor from the side.
pub const FLOOR: &str = "#9AA0A8";
/// Shapes of the world without a colour.
const STILL: &str = "#C9CED6";
/// Colour of shapes whose file gives none.
const NONE: [f64; 4] = [0.5, 0.5, 0.5, 1.0];
/// Opacity below which a shape is invisible.
const INVISIBLE: f64 = 0.02;
/// Brightness of an edge relative to its shape.
const EDGE: f64 = 0.6;

/// Colours of a shape and of its edge, unless it is invisible. Without a colour in the file, bodies
/// have the colours of the palette in the order of the chain of bodies, so that the limbs of a pair
/// have the same.
pub fn of(model: &Model, shape: &Shape) -> Option<[String; 2]> {
    let [red, green, blue, opacity] = shape.colour;
    if opacity < INVISIBLE {
        return None;
    }
    let rgb = if shape.colour == NONE {
        default(model, shape.body)
    } else {
        // The background is white.
        [red, green, blue].map(|part| 255.0 * (1.0 - opacity * (1.0 - part.clamp(0.0, 1.0))))
    };
    Some([rgb, rgb.map(|part| EDGE * part)].map(css))
}

fn css(rgb: [f64; 3]) -> String {
    let [red, green, blue] = rgb.map(|part| part.round() as u8);
    format!("#{red:02X}{green:02X}{blue:02X}")
}

fn default(model: &Model, mut body: usize) -> [f64; 3] {
    let mut joints = 0;
    while body != 0 {
        joints += usize::from(model.joints.iter().any(|joint| joint.body == body));
        body = model.bodies[body].parent;
    }
    // The last colour of the palette is black, as text.
    let moving = &PALETTE[..PALETTE.len() - 1];
    let colour = if joints == 0 { STILL } else { moving[(joints - 1) % moving.len()] };
    let part = |i: usize| u8::from_str_radix(&colour[i..i + 2], 16).expect("six digits");
    [1, 3, 5].map(|i| f64::from(part(i)))
}
