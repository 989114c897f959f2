//! A chart on the page, with legend, caption and data for the script.

use maud::{Markup, PreEscaped, html};
use physgrad_plot::{Chart, Dash, Series};
use serde::Serialize;

/// A chart with its texts.
pub struct Figure {
    pub title: String,
    pub chart: Chart,
    pub keys: Vec<Key>,
    /// Explanation of the chart and hints for reading it.
    pub caption: String,
    /// Notes specific to the data.
    pub notes: Vec<String>,
}

/// Legend entry.
#[derive(PartialEq)]
pub struct Key {
    pub label: String,
    pub color: &'static str,
    pub dash: Dash,
    /// Indices of the series of the entry.
    pub series: Vec<usize>,
}

impl Figure {
    /// Creates a figure with one legend entry per series that is not thin.
    pub fn new(title: impl Into<String>, chart: Chart, caption: impl Into<String>) -> Self {
        let label = |s: &Series| match &*s.note {
            "" => s.label.clone(),
            note => format!("{} ({note})", s.label),
        };
        let series = || chart.series().iter().enumerate();
        // The entry of a summary also stands for its single seeds.
        let belongs = |s: &Series, other: &Series| {
            std::ptr::eq(s, other)
                || other.thin
                    && other
                        .label
                        .strip_prefix(&*s.label)
                        .is_some_and(|rest| rest.starts_with(", run "))
        };
        let members =
            |s: &Series| series().filter(|(_, other)| belongs(s, other)).map(|(i, _)| i).collect();
        let key =
            |s: &Series| Key { label: label(s), color: s.color, dash: s.dash, series: members(s) };
        let keys = series().filter(|(_, s)| !s.thin).map(|(_, s)| key(s)).collect();
        Self { title: title.into(), chart, keys, caption: caption.into(), notes: Vec::new() }
    }

    /// Replaces the legend. An entry stands for all series with its colour and dash.
    pub fn keys(self, mut keys: Vec<Key>) -> Self {
        for key in &mut keys {
            let series = self.chart.series().iter().enumerate();
            key.series = series
                .filter(|(_, s)| (s.color, s.dash) == (key.color, key.dash))
                .map(|(i, _)| i)
                .collect();
        }
        Self { keys, ..self }
    }

    pub fn notes(self, notes: Vec<String>) -> Self {
        Self { notes, ..self }
    }

    pub fn html(&self) -> Markup {
        let chart = &self.chart;
        let label =
            format!("{} against {}; arrow keys read values", chart.y_label(), chart.x_label());
        html! {
            figure {
                h3 { (self.title) }
                @if chart.series().is_empty() {
                    p.empty { "There are no finite values to draw." }
                } @else {
                    p.axis { (chart.y_label()) }
                    div.chart tabindex="0" role="group" aria-label=(label) {
                        (PreEscaped(chart.drawing().to_svg()))
                        output.readout hidden aria-live="polite" {}
                        script type="application/json" { (PreEscaped(self.data())) }
                    }
                    ul.legend {
                        @for key in &self.keys {
                            @let members: Vec<String> = key.series.iter().map(usize::to_string).collect();
                            li { button type="button" aria-pressed="true" data-series=(members.join(" ")) {
                                svg width="30" height="10" viewBox="0 0 30 10" aria-hidden="true" {
                                    line x1="1" x2="29" y1="5" y2="5" stroke=(key.color) stroke-width="3"
                                        stroke-dasharray=[key.dash.array()] {}
                                }
                                (key.label)
                            } }
                        }
                    }
                }
                figcaption {
                    p { (self.caption) }
                    @for note in &self.notes { p.note { (note) } }
                }
            }
        }
    }

    /// Chart data as JSON, escaped for a script element.
    fn data(&self) -> String {
        let frame = self.chart.frame();
        let data = Data {
            x_label: self.chart.x_label(),
            y_label: self.chart.y_label(),
            size: frame.size,
            across: frame.across,
            up: frame.up,
            x: frame.x,
            y: frame.y,
            log: frame.log,
            series: self.chart.series().iter().map(Line::of).collect(),
        };
        serde_json::to_string(&data).expect("plain numbers and names").replace('<', "\\u003c")
    }
}

#[derive(Serialize)]
struct Data<'a> {
    x_label: &'a str,
    y_label: &'a str,
    size: [f64; 2],
    across: [f64; 2],
    up: [f64; 2],
    x: [f64; 2],
    y: [f64; 2],
    log: bool,
    series: Vec<Line<'a>>,
}

#[derive(Serialize)]
struct Line<'a> {
    label: &'a str,
    color: &'a str,
    thin: bool,
    /// x and y of each point, followed by the limits of the band, if any.
    points: Vec<Vec<f64>>,
}

impl<'a> Line<'a> {
    fn of(series: &'a Series) -> Self {
        let point = |(i, &(x, y)): (usize, &(f64, f64))| {
            let band = series.band.get(i).map_or(Vec::new(), |&(low, high)| vec![low, high]);
            [x, y].into_iter().chain(band).map(rounded).collect()
        };
        Self {
            label: &series.label,
            color: series.color,
            thin: series.thin,
            points: series.line.iter().enumerate().map(point).collect(),
        }
    }
}

/// Rounds to five significant digits, which limits the size of the page.
fn rounded(x: f64) -> f64 {
    format!("{x:.4e}").parse().unwrap_or(x)
}
