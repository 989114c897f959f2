//! [`Raster`]: an image of coloured cells, embedded as one PNG instead of thousands of rectangles.

use base64::prelude::{BASE64_STANDARD, Engine};
use std::fmt;

/// Grid of cells, each a number between 0 and 1 on the perceptually uniform Inferno colour scale.
#[derive(Clone, PartialEq, Eq)]
pub struct Raster {
    columns: usize,
    /// Red, green and blue of every cell, upper row first.
    rgb: Vec<u8>,
}

impl Raster {
    /// Creates a raster from rows of equal length, upper row first. Clamps values to `[0, 1]`; NaN
    /// becomes 0.
    ///
    /// # Panics
    /// Panics without cells, or if the rows differ in length.
    pub fn new(rows: &[Vec<f64>]) -> Self {
        let columns = rows.first().map_or(0, Vec::len);
        assert!(
            columns > 0 && rows.iter().all(|row| row.len() == columns),
            "a raster needs rows of equal, nonzero length"
        );
        // False for NaN.
        let shown = |value: f64| if value > 0.0 { value.min(1.0) } else { 0.0 };
        let color = |&value: &f64| colorous::INFERNO.eval_continuous(shown(value)).as_array();
        Self { columns, rgb: rows.iter().flatten().flat_map(color).collect() }
    }

    /// Number of columns, and red, green and blue of every cell, upper row first.
    pub(super) fn cells(&self) -> (usize, &[u8]) {
        (self.columns, &self.rgb)
    }

    /// Encodes as PNG, one pixel per cell.
    fn png(&self) -> Vec<u8> {
        let mut file = Vec::new();
        let mut encoder = png::Encoder::new(
            &mut file,
            self.columns as u32,
            (self.rgb.len() / 3 / self.columns) as u32,
        );
        encoder.set_color(png::ColorType::Rgb);
        encoder
            .write_header()
            .and_then(|mut writer| writer.write_image_data(&self.rgb))
            .expect("a vector takes every byte");
        file
    }

    /// Data URI of the PNG.
    pub(super) fn data_uri(&self) -> String {
        format!("data:image/png;base64,{}", BASE64_STANDARD.encode(self.png()))
    }
}

impl fmt::Debug for Raster {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Raster({} × {})", self.columns, self.rgb.len() / 3 / self.columns)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_png_decodes_to_the_colours_of_the_cells() {
        let raster = Raster::new(&[vec![0.0, 0.5, 1.0], vec![f64::NAN, -1.0, f64::INFINITY]]);
        let file = raster.png();
        let mut reader = png::Decoder::new(std::io::Cursor::new(&file)).read_info().expect("a PNG");
        let mut pixels = vec![0; 18];
        let info = reader.next_frame(&mut pixels).expect("a picture");
        assert_eq!((info.width, info.height, &pixels), (3, 2, &raster.rgb));
        // Low values are dark; values beyond the scale are clamped.
        assert!(pixels[..3].iter().all(|&c| c < 10) && pixels[6] > 240);
        assert_eq!(pixels[9..15], [&pixels[..3], &pixels[..3]].concat());
        assert_eq!(pixels[15..], pixels[6..9]);
    }
}
