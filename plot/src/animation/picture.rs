//! [`Picture`]: one frame of an animation, as pixels.

use super::below::{self, Below};
use super::{Animation, LEGEND_HEIGHT, Shape};
use kuva::backend::raster::RasterBackend;
use kuva::render::color::Color;
use kuva::render::render::{PathData, Primitive, Scene, TextAnchor};

/// Largest absolute value of a coordinate, in pixels. Farther ones are outside of every picture.
const FAR: f64 = 1e5;

/// Pixels of a picture, of which width and height are even, as encoders of films require.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Picture {
    /// Number of columns.
    pub width: usize,
    /// Number of rows.
    pub height: usize,
    /// Red, green and blue of every pixel, upper row first.
    pub rgb: Vec<u8>,
}

impl Animation {
    /// Draws `shapes`, for example those of one frame, before the static background, and the cursor
    /// at `time`. There is no title. Animations of one system have pictures of one size, in which
    /// the view is centered, with what is around it.
    ///
    /// # Panics
    /// Panics if there are more channels than fit into memory.
    pub fn picture(&self, shapes: &[Shape], time: f64) -> Picture {
        let below = Below::of(self);
        let [width, room] = self.largest();
        let top = if self.legend.is_empty() { 0.0 } else { LEGEND_HEIGHT };
        let area = if self.has_view() { room } else { 0.0 };
        let (total, world) = (top + area + below.height(), self.world());
        let scale = (width / world[0]).min(room / world[1]);
        let mut scene = Scene::new(width, total);
        if area > 0.0 {
            let [w, h] = world.map(|size| size * scale);
            let (x, y) = ((width - w) / 2.0, top + (area - h) / 2.0);
            let id = String::new();
            scene.add(Primitive::ClipStart { x: 0.0, y: top, width, height: area, id });
            let place = Place { corner: [self.view.0[0], self.view.1[1]], scale, at: [x, y] };
            place.draw(&mut scene, self.still.iter().chain(shapes));
            scene.add(Primitive::ClipEnd);
        }
        // Shapes around the view, in pixels from the lower left corner of the picture.
        let place = Place { corner: [0.0, total], scale: 1.0, at: [0.0; 2] };
        let mut around = below::legend(&self.legend, width, total - LEGEND_HEIGHT / 2.0 - 4.0);
        around.extend(below.still(width, scale));
        if self.time > 0.0 {
            around.extend(below.frame(width, time / self.time));
        }
        place.draw(&mut scene, &around);
        let png = RasterBackend::new()
            .with_scale(1.0)
            .render_scene(&scene)
            .expect("a picture of ordinary size");
        decoded(&png)
    }
}

fn decoded(png: &[u8]) -> Picture {
    let mut reader = png::Decoder::new(std::io::Cursor::new(png)).read_info().expect("a PNG");
    let mut rgba = vec![0; reader.output_buffer_size().expect("a picture of ordinary size")];
    let info = reader.next_frame(&mut rgba).expect("a picture");
    let rgb = rgba.chunks_exact(4).flat_map(|pixel| [pixel[0], pixel[1], pixel[2]]).collect();
    Picture { width: info.width as usize, height: info.height as usize, rgb }
}

/// Place of shapes in a picture.
struct Place {
    /// World coordinates of the upper left corner.
    corner: [f64; 2],
    /// Pixels per unit of length.
    scale: f64,
    /// Pixel of this corner.
    at: [f64; 2],
}

impl Place {
    fn draw<'a>(&self, scene: &mut Scene, shapes: impl IntoIterator<Item = &'a Shape>) {
        shapes.into_iter().for_each(|shape| scene.add(self.primitive(shape)));
    }

    fn point(&self, [x, y]: [f64; 2]) -> (f64, f64) {
        let [left, top] = self.corner;
        let [x, y] = [(x - left) * self.scale, (top - y) * self.scale];
        (pixels(x + self.at[0]), pixels(y + self.at[1]))
    }

    fn length(&self, length: f64) -> f64 {
        pixels(length.max(0.0) * self.scale)
    }

    fn upper_left(&self, center: [f64; 2], size: [f64; 2]) -> (f64, f64) {
        self.point([center[0] - size[0] / 2.0, center[1] + size[1] / 2.0])
    }

    fn primitive(&self, shape: &Shape) -> Primitive {
        let curve = |points: &[[f64; 2]], width: f64, color: &str| Primitive::PolyLine {
            points: points.iter().map(|&point| self.point(point)).collect(),
            stroke: Color::from(color),
            stroke_width: self.length(width),
            stroke_dasharray: None,
        };
        match shape {
            Shape::Line { from, to, width, color } => curve(&[*from, *to], *width, color),
            Shape::Curve { points, width, color } => curve(points, *width, color),
            Shape::Solid { points, width, color, .. } => match points[..] {
                [point] => curve(&[point; 2], *width, color),
                [_, _] => curve(points, *width, color),
                _ => self.polygon(points, *width, color),
            },
            Shape::Circle { center, radius, color } => {
                let ((cx, cy), r) = (self.point(*center), self.length(*radius));
                let fill = Color::from(*color);
                Primitive::Circle {
                    cx,
                    cy,
                    r,
                    fill,
                    fill_opacity: None,
                    stroke: None,
                    stroke_width: None,
                }
            }
            Shape::Rect { center, size, color } => {
                let (x, y) = self.upper_left(*center, *size);
                let [width, height] = size.map(|size| self.length(size));
                let (fill, opacity) = paint(color);
                Primitive::Rect {
                    x,
                    y,
                    width,
                    height,
                    fill,
                    stroke: None,
                    stroke_width: None,
                    opacity,
                }
            }
            Shape::Image { center, size, raster } => self.cells(*center, *size, raster.cells()),
            Shape::Text { at, size, text, color } => {
                let (x, y) = self.point(*at);
                Primitive::Text {
                    x,
                    y,
                    content: text.clone(),
                    size: self.length(*size).round() as u32,
                    anchor: TextAnchor::Middle,
                    rotate: None,
                    bold: false,
                    color: Some(Color::from(*color)),
                }
            }
        }
    }

    /// A filled polygon with an edge of this width.
    fn polygon(&self, points: &[[f64; 2]], width: f64, color: &str) -> Primitive {
        let corners: Vec<String> = points
            .iter()
            .map(|&point| self.point(point))
            .map(|(x, y)| format!("{x} {y}"))
            .collect();
        Primitive::Path(Box::new(PathData {
            d: if corners.is_empty() { String::new() } else { format!("M{}Z", corners.join("L")) },
            fill: Some(Color::from(color)),
            stroke: Color::from(color),
            stroke_width: self.length(width),
            opacity: None,
            stroke_dasharray: None,
        }))
    }

    /// The cells of a raster, in rows of `columns`, as rectangles.
    fn cells(&self, center: [f64; 2], size: [f64; 2], (columns, rgb): (usize, &[u8])) -> Primitive {
        let (left, top) = self.upper_left(center, size);
        let (count, [width, height]) = (rgb.len() / 3, size.map(|size| self.length(size)));
        let (w, h) = (width / columns as f64, height / (count / columns) as f64);
        Primitive::RectBatch {
            x: (0..count).map(|i| left + w * (i % columns) as f64).collect(),
            y: (0..count).map(|i| top + h * (i / columns) as f64).collect(),
            // Overlaps the next cells by half a pixel, so that no gap shows.
            w: (1..=count).map(|i| if i % columns == 0 { w } else { w + 0.5 }).collect(),
            h: (0..count).map(|i| if i + columns < count { h + 0.5 } else { h }).collect(),
            fills: rgb.chunks_exact(3).map(|cell| Color::Rgb(cell[0], cell[1], cell[2])).collect(),
        }
    }
}

fn pixels(value: f64) -> f64 {
    if value.is_finite() { value.clamp(-FAR, FAR) } else { 0.0 }
}

/// The colour without its opacity, which kuva takes as another number, and the opacity.
fn paint(color: &str) -> (Color, Option<f64>) {
    let parts = color.strip_prefix("rgba(").and_then(|rest| rest.strip_suffix(')'));
    match parts.and_then(|parts| parts.rsplit_once(',')) {
        Some((rgb, opacity)) => (Color::from(format!("rgb({rgb})")), opacity.trim().parse().ok()),
        None => (Color::from(color), None),
    }
}

#[cfg(test)]
mod tests {
    use super::super::super::{Channel, Raster};
    use super::*;

    /// A view of 2 by 1 with a red square of side 0.5 around this center.
    fn square(center: [f64; 2]) -> (Animation, Shape) {
        let animation = Animation { view: ([0.0, 0.0], [2.0, 1.0]), ..Animation::default() };
        (animation, Shape::Rect { center, size: [0.5; 2], color: "#ff0000" })
    }

    fn pixel(picture: &Picture, x: usize, y: usize) -> [u8; 3] {
        let at = 3 * (y * picture.width + x);
        [picture.rgb[at], picture.rgb[at + 1], picture.rgb[at + 2]]
    }

    #[test]
    fn a_picture_has_the_shapes_at_their_places() {
        let (animation, shape) = square([0.5, 0.25]);
        let picture = animation.picture(&[shape], 0.0);
        assert_eq!((picture.width, picture.height), (720, 480));
        // 360 pixels per unit; the view is 360 pixels high, with 60 pixels above.
        let red = |x, y| pixel(&picture, x, y) == [255, 0, 0];
        assert!(red(91, 421 - 91) && red(268, 418 - 90) && !red(88, 330) && !red(272, 330));
        assert!(red(180, 241) && !red(180, 238), "y is upwards");
    }

    #[test]
    fn a_picture_contains_every_kind_of_shape_and_clips_it() {
        let (red, at) = ("#ff0000", [1.0, 0.5]);
        let raster = Raster::new(&[vec![0.0, 1.0]]);
        let solid = |points: &[[f64; 2]]| Shape::Solid {
            id: 0,
            points: points.to_vec(),
            width: 0.1,
            color: red.into(),
        };
        let shapes = [
            Shape::Line { from: at, to: at, width: 0.2, color: red },
            Shape::Circle { center: at, radius: 0.2, color: red },
            Shape::Rect { center: at, size: [0.2; 2], color: "rgba(255, 0, 0, 0.5)" },
            Shape::Curve { points: vec![[0.0, 0.5], [2.0, 0.5]], width: 0.2, color: red },
            solid(&[at]),
            solid(&[at, [1.5, 0.5]]),
            solid(&[[0.5, 0.2], [1.5, 0.2], [1.0, 0.8]]),
            Shape::Image { center: at, size: [0.2; 2], raster },
            Shape::Text { at, size: 0.2, text: "M".into(), color: red },
        ];
        let (mut animation, _) = square(at);
        for shape in shapes {
            let picture = animation.picture(std::slice::from_ref(&shape), 0.0);
            assert!(picture.rgb.iter().any(|&byte| byte != 255), "{shape:?}");
        }
        animation.unit = "m";
        let scale = animation.picture(&[], 0.0);
        let below = &scale.rgb[3 * 480 * scale.width..];
        assert!(below.iter().any(|&byte| byte != 255), "the scale is below the view");
        let (_, outside) = square([1.0, -0.45]);
        assert!(animation.picture(&[outside], 0.0) == scale, "shapes end at the scale");
    }

    #[test]
    fn sizes_are_even_and_independent_of_the_view() {
        let channel = |values: &[f64]| Channel {
            name: "u".into(),
            values: values.to_vec(),
            color: "red",
            range: None,
        };
        for count in [0, 1, 4, 5] {
            for (unit, time) in [("", 0.0), ("m", 2.0)] {
                let (mut animation, shape) = square([0.5, 0.5]);
                animation.legend = vec![("a".into(), "red")];
                animation.unit = unit;
                animation.time = time;
                animation.channels = vec![channel(&[0.0, 1.0, f64::NAN]); count];
                let size = |animation: &Animation| {
                    let picture = animation.picture(std::slice::from_ref(&shape), time);
                    assert_eq!(picture.rgb.len(), 3 * picture.width * picture.height);
                    [picture.width, picture.height]
                };
                let wide = size(&animation);
                assert_eq!(wide.map(|side| side % 2), [0, 0], "{count} channels: {wide:?}");
                animation.view.1 = [1.0, 5.0];
                assert_eq!(size(&animation), wide);
            }
        }
    }

    #[test]
    fn numbers_that_are_not_finite_give_a_picture() {
        for x in [f64::NAN, f64::INFINITY, 1e300] {
            let (mut animation, shape) = square([x, 0.5]);
            animation.picture(std::slice::from_ref(&shape), x);
            animation.view.1[0] = x;
            animation.time = 1.0;
            animation.picture(&[shape], x);
        }
    }
}
