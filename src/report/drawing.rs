//! [`Drawing`]: a picture that stands still, as SVG or PNG.

use kuva::backend::png::PngBackend;
use kuva::prelude::SvgBackend;
use kuva::render::render::Scene;

/// A finished picture. The same numbers give the same bytes, on every machine: fonts are built in.
pub struct Drawing(Scene);

impl Drawing {
    pub(super) fn of(scene: Scene) -> Self {
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
