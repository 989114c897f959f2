//! [`Drawing`]: a static picture, as SVG or PNG.

use kuva::backend::png::PngBackend;
use kuva::prelude::SvgBackend;
use kuva::render::color::Color;
use kuva::render::render::{Primitive, Scene};

/// Static picture. Output is reproducible byte for byte. It depends neither on installed fonts,
/// because fonts are built in, nor on earlier pictures of the process.
pub struct Drawing(Scene);

impl Drawing {
    pub(super) fn of(mut scene: Scene) -> Self {
        scene.elements.iter_mut().for_each(join_cells);
        number_clips(&mut scene);
        Self(scene)
    }

    /// Renders to SVG, with searchable text.
    pub fn to_svg(&self) -> String {
        // kuva writes no viewBox; without one, a page that sets a width crops the picture.
        let view_box = format!("<svg viewBox=\"0 0 {} {}\" ", self.0.width, self.0.height);
        valid(SvgBackend::new().render_scene(&self.0).replacen("<svg ", &view_box, 1))
    }

    /// Renders to PNG, two pixels per SVG unit.
    ///
    /// # Panics
    /// Panics if the picture has no pixels or cannot be encoded.
    pub fn to_png(&self) -> Vec<u8> {
        PngBackend::new().render_scene(&self.0).expect("a picture of ordinary size")
    }
}

/// The document with a replacement character in place of each character that XML forbids, even in
/// escaped form. Titles and labels of users may contain such characters.
pub(super) fn valid(xml: String) -> String {
    let is_forbidden = |c: char| {
        (c.is_control() && !matches!(c, '\t' | '\n' | '\r')) || matches!(c, '\u{fffe}' | '\u{ffff}')
    };
    if xml.contains(is_forbidden) { xml.replace(is_forbidden, "\u{fffd}") } else { xml }
}

/// Merges horizontally adjacent cells of the same colour, which shrinks the file.
///
/// Rectangles then overlap their right and lower neighbours by one unit. With kuva's overlap of
/// half a unit, browsers show gaps.
fn join_cells(element: &mut Primitive) {
    let Primitive::RectBatch { x, y, w, h, fills } = element else { return };
    let end = |from: &[f64], size: &[f64]| {
        from.iter().zip(size).map(|(from, size)| from + size).fold(0.0, f64::max)
    };
    let (right, bottom) = (end(x, w), end(y, h));
    let mut kept = 0;
    for i in 0..x.len() {
        let last = kept.max(1) - 1;
        let touches = |i: usize| {
            y[last] == y[i] && h[last] == h[i] && x[last] < x[i] && x[i] <= x[last] + w[last]
        };
        if i > 0
            && touches(i)
            && rgb(&fills[last]).is_some_and(|color| rgb(&fills[i]) == Some(color))
        {
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

/// Numbers the clip paths of a picture from 0. kuva counts through all pictures of a process.
fn number_clips(scene: &mut Scene) {
    let clips = scene.elements.iter_mut().filter_map(|element| match element {
        Primitive::ClipStart { id, .. } => Some(id),
        _ => None,
    });
    for (number, id) in clips.enumerate() {
        let old = std::mem::replace(id, format!("clip-{number}"));
        // Renames the clip path in its definition too.
        for definition in &mut scene.defs {
            *definition = definition.replace(&format!("id=\"{old}\""), &format!("id=\"{id}\""));
        }
    }
}

fn rgb(color: &Color) -> Option<[u8; 3]> {
    match *color {
        Color::Rgb(r, g, b) => Some([r, g, b]),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::super::{Animation, learning_curve};

    #[test]
    fn pictures_with_forbidden_characters_in_their_titles_are_xml() {
        let every: String = ('\0'..='\u{a0}').chain(['\u{fffe}', '\u{ffff}', 'é']).collect();
        let animation = Animation { title: every.clone(), ..Animation::default() };
        for svg in [learning_curve(&every, &[(0.0, 1.0)], &[]).to_svg(), animation.to_svg()] {
            let document = roxmltree::Document::parse(&svg).expect("an SVG is XML");
            let text: String = document.descendants().filter_map(|node| node.text()).collect();
            assert!(text.contains("az\u{7b}") || text.contains("é"), "{text}");
        }
    }

    #[test]
    fn a_picture_does_not_depend_on_earlier_pictures_of_the_process() {
        let picture = |loss: f64| learning_curve("title", &[(0.0, loss), (1.0, 2.0)], &[]).to_svg();
        let first = picture(1.0);
        assert!(picture(3.0) != first);
        assert!(picture(1.0) == first);
        assert!(
            first.contains("<clipPath id=\"clip-0\">") && first.contains("url(#clip-0)"),
            "{first}"
        );
    }
}
