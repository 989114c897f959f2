//! [`Drawing`]: a picture that stands still, as SVG or PNG.

use kuva::backend::png::PngBackend;
use kuva::prelude::SvgBackend;
use kuva::render::color::Color;
use kuva::render::render::{Primitive, Scene};

/// A finished picture. The same numbers give the same bytes, on every machine: fonts are built in.
pub struct Drawing(Scene);

impl Drawing {
    pub(super) fn of(mut scene: Scene) -> Self {
        scene.elements.iter_mut().for_each(join_cells);
        Self(scene)
    }

    /// As SVG: sharp at any size, text that can be searched.
    pub fn to_svg(&self) -> String {
        // kuva writes no viewBox, without which a page that sets a width would crop the picture instead of scaling it.
        let view_box = format!("<svg viewBox=\"0 0 {} {}\" ", self.0.width, self.0.height);
        SvgBackend::new().render_scene(&self.0).replacen("<svg ", &view_box, 1)
    }

    /// As PNG, two pixels to a unit of the SVG.
    ///
    /// # Panics
    /// If the picture is too large to be held in memory.
    pub fn to_png(&self) -> Vec<u8> {
        PngBackend::new().render_scene(&self.0).expect("a picture of ordinary size")
    }
}

/// Makes one rectangle of neighbours in a row of cells that have the same colour, which is most of them in a map of few
/// colours: the file is a quarter of the size. And lets every rectangle reach a whole unit under the next, not half a one as
/// kuva does, through which browsers let the background shine.
fn join_cells(element: &mut Primitive) {
    let Primitive::RectBatch { x, y, w, h, fills } = element else { return };
    let end = |from: &[f64], size: &[f64]| from.iter().zip(size).map(|(from, size)| from + size).fold(0.0, f64::max);
    let (right, bottom) = (end(x, w), end(y, h));
    let mut kept = 0;
    for i in 0..x.len() {
        let last = kept.max(1) - 1;
        let touches = |i: usize| y[last] == y[i] && h[last] == h[i] && x[last] < x[i] && x[i] <= x[last] + w[last];
        if i > 0 && touches(i) && rgb(&fills[last]).is_some_and(|color| rgb(&fills[i]) == Some(color)) {
            w[last] = x[i] + w[i] - x[last];
            continue;
        }
        (x[kept], y[kept], w[kept], h[kept]) = (x[i], y[i], w[i], h[i]);
        fills.swap(kept, i);
        kept += 1;
    }
    [&mut *x, &mut *y, &mut *w, &mut *h].into_iter().for_each(|numbers| numbers.truncate(kept));
    fills.truncate(kept);
    for (from, size, end) in [(x, w, right), (y, h, bottom)] {
        for (from, size) in from.iter().zip(size) {
            *size = (*size + 0.5).min(end - from);
        }
    }
}

fn rgb(color: &Color) -> Option<[u8; 3]> {
    match *color {
        Color::Rgb(r, g, b) => Some([r, g, b]),
        _ => None,
    }
}
