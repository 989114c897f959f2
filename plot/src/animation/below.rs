//! Parts of a picture around its view: legend, scale of lengths, channels and time axis.

use super::super::Channel;
use super::super::axes::{Axes, number, round_up, text, ticks};
use super::super::series::thinned;
use super::{Animation, Shape};

const INK: &str = "#4A4F57";
const CURSOR: &str = "#56B4E9";
const ZERO: &str = "#D5D8DC";

/// Mean width of a letter of a label, in pixels.
const LETTER: f64 = 7.2;
/// Height of the scale of lengths, in pixels.
const SCALE: f64 = 30.0;
/// Height of the time axis with its label, in pixels.
const TIME: f64 = 42.0;
/// Height of a band, in pixels: first with at most four channels, then with more.
const BANDS: [f64; 2] = [58.0, 44.0];
/// Reduction of the largest height of a view that has channels below it, in pixels.
pub const TAKEN: f64 = 180.0;
/// Left end of the bands, and space right of them, in pixels.
const SIDES: [f64; 2] = [150.0, 20.0];
/// Largest number of displayed letters of a channel's name.
const NAME: usize = 13;
/// Largest number of frames of the cursor and the dots.
const MAX_FRAMES: usize = 250;

/// Parts below the view, in pixels from the lower left corner of the picture.
pub struct Below<'a>(&'a Animation);

impl<'a> Below<'a> {
    pub fn of(animation: &'a Animation) -> Self {
        Self(animation)
    }

    pub fn height(&self) -> f64 {
        let scale = if self.0.unit.is_empty() { 0.0 } else { SCALE };
        scale + self.band() * self.0.channels.len() as f64 + self.bottom()
    }

    /// Height of the time axis.
    fn bottom(&self) -> f64 {
        if self.0.time > 0.0 { TIME } else { 0.0 }
    }

    fn band(&self) -> f64 {
        BANDS[usize::from(self.0.channels.len() > 4)]
    }

    /// Length of the axis of channels: the time, or 1 without a time axis.
    fn length(&self) -> f64 {
        if self.0.time > 0.0 { self.0.time } else { 1.0 }
    }

    /// Axes of the channel with this index, counted from the top, in a picture of this width.
    fn axes(&self, index: usize, width: f64) -> Axes {
        let base = self.bottom() + self.band() * (self.0.channels.len() - 1 - index) as f64;
        let [low, high] = self.0.channels[index].range();
        let half = (1e-3 * low.abs()).max(1.0);
        let y = if low < high { [low, high] } else { [low - half, high + half] };
        let (bottom, top) = (base + 8.0, base + self.band() - 8.0);
        Axes { left: SIDES[0], right: width - SIDES[1], bottom, top, x: [0.0, self.length()], y }
    }

    /// Axis of time, without height.
    fn time_axis(&self, width: f64) -> Axes {
        let left = if self.0.channels.is_empty() { SIDES[1] } else { SIDES[0] };
        let bottom = self.bottom();
        Axes {
            left,
            right: width - SIDES[1],
            bottom,
            top: bottom,
            x: [0.0, self.0.time],
            y: [0.0, 1.0],
        }
    }

    /// Static parts. `scale` is the number of pixels per unit of length.
    pub fn still(&self, width: f64, scale: f64) -> Vec<Shape> {
        let mut shapes = Vec::new();
        if !self.0.unit.is_empty() {
            shapes.extend(length(self.0.unit, scale, self.height() - 0.5 * SCALE));
        }
        for (i, channel) in self.0.channels.iter().enumerate() {
            shapes.extend(self.still_band(channel, &self.axes(i, width)));
        }
        if self.0.time > 0.0 {
            let axis = self.time_axis(width);
            let line = |color, to: f64| Shape::Line {
                from: axis.at(0.0, 0.0),
                to: axis.at(to, 0.0),
                width: 1.0,
                color,
            };
            shapes.push(line(INK, self.0.time));
            shapes.extend(axis.ticks_below(&ticks(0.0, self.0.time, 6.0)));
            shapes.push(text([(axis.left + axis.right) / 2.0, 6.0], "time (s)"));
        }
        shapes
    }

    fn still_band(&self, channel: &Channel, axes: &Axes) -> Vec<Shape> {
        let mut name: String = channel.name.chars().take(NAME).collect();
        if channel.name.chars().count() > NAME {
            name.push('…');
        }
        let mut shapes = vec![text([52.0, (axes.bottom + axes.top) / 2.0 - 4.0], name)];
        if axes.y[0] < 0.0 && axes.y[1] > 0.0 {
            shapes.push(axes.curve([[0.0, 0.0], [axes.x[1], 0.0]], 1.0, ZERO));
        }
        let frame = [[axes.left, axes.bottom], [axes.left, axes.top]];
        shapes.push(Shape::Line { from: frame[0], to: frame[1], width: 1.0, color: INK });
        let [low, high] = channel.range();
        let ends = [low, high];
        shapes.extend(axes.ticks_left(&ends[..if low < high { 2 } else { 1 }]));
        let values = channel.finite();
        if values.len() > 1 {
            let at = |i: usize| self.length() * i as f64 / (channel.values.len() - 1) as f64;
            let points = values.iter().enumerate().map(|(i, &y)| [at(i), y]).collect();
            shapes.push(axes.curve(thinned(points, |point| point[1]), 1.8, channel.color));
        }
        shapes
    }

    /// Cursor, and a dot on every channel, by frame.
    pub fn frames(&self, width: f64) -> Vec<Vec<Shape>> {
        if self.0.time <= 0.0 {
            return Vec::new();
        }
        let channels = &self.0.channels;
        let steps =
            channels.iter().map(|channel| channel.values.len()).max().unwrap_or(2).max(2) - 1;
        let count = if channels.is_empty() { 2 } else { (steps + 1).min(MAX_FRAMES) };
        (0..count).map(|i| self.frame(width, i as f64 / (count - 1) as f64)).collect()
    }

    /// Cursor and dots at a share of the time, from 0 to 1.
    pub fn frame(&self, width: f64, share: f64) -> Vec<Shape> {
        let (channels, axis) = (&self.0.channels, self.time_axis(width));
        let top = self.bottom() + self.band() * channels.len() as f64 + 4.0;
        let [x, y] = axis.at(share * self.0.time, 0.0);
        let cursor = Shape::Line { from: [x, y], to: [x, top], width: 2.0, color: CURSOR };
        let dot = |(i, channel): (usize, &Channel)| {
            let values = channel.finite();
            let at = (share * (channel.values.len().max(1) - 1) as f64).round() as usize;
            let [_, y] = self
                .axes(i, width)
                .at(0.0, values.get(at.min(values.len().max(1) - 1)).copied().unwrap_or(0.0));
            Shape::Circle {
                center: [x, y],
                radius: if values.is_empty() { 0.0 } else { 4.0 },
                color: channel.color,
            }
        };
        std::iter::once(cursor).chain(channels.iter().enumerate().map(dot)).collect()
    }
}

/// Bar of a round length, 30 to 75 pixels wide, with its length as label.
fn length(unit: &str, scale: f64, y: f64) -> [Shape; 4] {
    let length = round_up(60.0 / scale / 2.0);
    let (left, right) = (SIDES[1], SIDES[1] + length * scale);
    let line = |from, to| Shape::Line { from, to, width: 1.5, color: INK };
    let label = format!("{} {unit}", number(length));
    let middle = right + 8.0 + 0.5 * LETTER * label.chars().count() as f64;
    let end = |x: f64| line([x, y - 4.0], [x, y + 4.0]);
    [line([left, y], [right, y]), end(left), end(right), text([middle, y - 4.0], label)]
}

/// Centered row of dots and names.
pub fn legend(entries: &[(String, &'static str)], width: f64, y: f64) -> Vec<Shape> {
    let widths: Vec<f64> =
        entries.iter().map(|(name, _)| 34.0 + LETTER * name.chars().count() as f64).collect();
    let mut x = (width - widths.iter().sum::<f64>()) / 2.0 + 17.0;
    let mut shapes = Vec::new();
    for ((name, color), width) in entries.iter().zip(widths) {
        shapes.push(Shape::Circle { center: [x, y + 4.0], radius: 5.0, color });
        shapes.push(text([x + (width - 34.0) / 2.0 + 10.0, y], name.clone()));
        x += width;
    }
    shapes
}
