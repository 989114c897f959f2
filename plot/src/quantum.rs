//! Animation of a quantum particle in a box with a tilted floor.

mod landscape;
#[cfg(test)]
mod tests;

pub use landscape::Landscape;

use super::Raster;
use super::animation::{Animation, Shape};
use super::axes::{Axes, number, text, ticks};

const DENSITY: &str = "#CF4446";
const TARGET: &str = "#0072B2";
const CONTROL: &str = "#D55E00";
const FIDELITY: &str = "#0072B2";
const ZERO: &str = "#D5D8DC";
const CURSOR: &str = "#56B4E9";

/// Largest number of frames. Longer trajectories are thinned.
const MAX_FRAMES: usize = 200;
/// Number of states, or of steps of the control, beyond which map columns and curve vertices are
/// averages over neighbours.
const MAX_COLUMNS: usize = 256;
/// Number of grid points beyond which map rows and bars are averages over grid points.
const MAX_ROWS: usize = 64;

/// Animates a trajectory in an empty box.
///
/// A state holds the real and imaginary part of ψ at every grid point between the walls, initially
/// with `Σ |ψ_j|² = 1`. States are `dt` units of time apart. `controls` holds the control of each
/// step. `target` is the real target state φ at the grid points. `length` is the length of the box.
///
/// The large map shows the probability density over time and position. Below the map are the
/// control and the fidelity `|⟨φ, ψ⟩|²`. A cursor moves through all three. The panel at the right
/// shows the density at the time of the cursor as bars, and the density of the target as a line.
///
/// A unit of time takes 1 s, but the whole trajectory takes at least 4 s and at most 12 s. The
/// animation ends before the first state that is non-finite or of a different length.
pub fn quantum(
    states: &[Vec<f64>],
    controls: &[f64],
    target: &[f64],
    length: f64,
    dt: f64,
) -> Animation {
    quantum_in(&Landscape::default(), states, controls, target, length, dt)
}

/// Animates a trajectory as [`quantum`] does, with a potential and absorbing edges.
///
/// The right panel shows the potential behind the density. Absorbing edges are shaded in that panel
/// and on the map. Densities and fidelities are not renormalized, so they include absorption
/// losses.
pub fn quantum_in(
    landscape: &Landscape,
    states: &[Vec<f64>],
    controls: &[f64],
    target: &[f64],
    length: f64,
    dt: f64,
) -> Animation {
    let layout = Layout::new(landscape, states, controls, target, positive(length), positive(dt));
    let count = layout.densities.len();
    let shown = count.min(MAX_FRAMES);
    let frames = (0..shown).map(|frame| layout.frame(frame * (count - 1) / (shown - 1).max(1)));
    let time = count.saturating_sub(1) as f64 * layout.dt;
    let of = if layout.landscape.tilted() { " of the empty box" } else { "" };
    Animation {
        title: format!(
            "Particle in a box, steered to an eigenstate{of}: {} units of time",
            number(time)
        ),
        seconds: time.clamp(4.0, 12.0),
        view: ([0.0, 0.0], [720.0, 480.0]),
        still: layout.background(),
        frames: frames.collect(),
        ..Animation::default()
    }
}

fn positive(value: f64) -> f64 {
    if value.is_normal() && value > 0.0 { value } else { 1.0 }
}

/// Returns the values, or averages over neighbours if there are more than `most`.
fn averaged(values: &[f64], most: usize) -> Vec<f64> {
    groups(values, most).map(|group| group.iter().sum::<f64>() / group.len() as f64).collect()
}

/// Splits into at most `most` groups of nearly equal length.
fn groups<T>(values: &[T], most: usize) -> impl Iterator<Item = &[T]> {
    let count = values.len().min(most);
    (0..count).map(move |i| &values[i * values.len() / count..(i + 1) * values.len() / count])
}

/// Data shared by all frames.
struct Layout {
    /// Density |ψ|² per unit length, by state and position.
    densities: Vec<Vec<f64>>,
    /// Density |φ|² of the target per unit length, by position.
    target: Vec<f64>,
    /// Fidelity by state.
    fidelities: Vec<f64>,
    /// Final Σ |ψ_j|².
    norm: f64,
    landscape: Landscape,
    /// Time at the right edge of the last state's column.
    end: f64,
    /// Control by step.
    controls: Vec<f64>,
    /// Half the spacing of the map rows; the walls are one spacing beyond the outermost rows.
    half_row: f64,
    dt: f64,
    map: Axes,
    profile: Axes,
    /// Colour scale of the map, along the x axis of the profile.
    scale: Axes,
    control: Axes,
    fidelity: Axes,
}

impl Layout {
    fn new(
        landscape: &Landscape,
        states: &[Vec<f64>],
        controls: &[f64],
        target: &[f64],
        length: f64,
        dt: f64,
    ) -> Self {
        let width = states.first().map_or(0, Vec::len);
        let valid = |s: &&Vec<f64>| s.len() == width && s.iter().all(|v| v.is_finite());
        let states: Vec<&Vec<f64>> = states.iter().take_while(valid).collect();
        // Divides by the grid spacing to obtain a density.
        let per_point = (width / 2 + 1) as f64 / length;
        let density = |squares: Vec<f64>| {
            averaged(&squares, MAX_ROWS).into_iter().map(|d| d * per_point).collect::<Vec<_>>()
        };
        let of_state = |s: &&Vec<f64>| {
            density(s.chunks_exact(2).map(|psi| psi[0] * psi[0] + psi[1] * psi[1]).collect())
        };
        let densities: Vec<Vec<f64>> = states.iter().map(of_state).collect();
        let target_density = density(target.iter().map(|phi| phi * phi).collect());
        let fidelity = |s: &&Vec<f64>| {
            let overlap = |part: usize| {
                s.chunks_exact(2).zip(target).map(|(psi, phi)| psi[part] * phi).sum::<f64>()
            };
            overlap(0).powi(2) + overlap(1).powi(2)
        };
        let finite = |c: &f64| if c.is_finite() { *c } else { 0.0 };
        let controls: Vec<f64> =
            controls.iter().take(states.len().saturating_sub(1)).map(finite).collect();

        let highest = 1.04
            * positive(
                densities.iter().flatten().chain(&target_density).copied().fold(0.0, f64::max),
            );
        let (least, most) =
            controls.iter().fold((0.0f64, 0.0f64), |(least, most), &c| (least.min(c), most.max(c)));
        let (room, middle) = (0.55 * positive(most - least), 0.5 * (least + most));
        // Each column of the map is centered at the time of its state.
        let end = |states: usize| (states.max(1) as f64 - 0.5) * dt;
        let time = [-0.5 * dt, end(states.len().max(landscape.steps + 1))];
        let panel = |left, right, bottom, top, x, y| Axes { left, right, bottom, top, x, y };
        Self {
            fidelities: states.iter().map(fidelity).collect(),
            norm: states.last().map_or(0.0, |s| s.iter().map(|part| part * part).sum()),
            landscape: landscape.drawn(length),
            end: end(states.len()),
            half_row: 0.5 * length / (densities.first().map_or(0, Vec::len) + 1) as f64,
            dt,
            map: panel(100.0, 530.0, 236.0, 452.0, time, [0.0, length]),
            profile: panel(548.0, 704.0, 236.0, 452.0, [0.0, highest], [0.0, length]),
            scale: panel(548.0, 704.0, 226.0, 236.0, [0.0, highest], [0.0, 1.0]),
            control: panel(100.0, 530.0, 138.0, 218.0, time, [middle - room, middle + room]),
            fidelity: panel(100.0, 530.0, 44.0, 120.0, time, [-0.05, 1.05]),
            densities,
            target: target_density,
            controls,
        }
    }

    /// Static shapes: map, curves and axes.
    fn background(&self) -> Vec<Shape> {
        let Self { map, profile, scale, control, fidelity, landscape, .. } = self;
        let [from, to] = map.x;
        let length = map.y[1];
        let mut shapes = self.colors();
        shapes.extend(landscape.floor(profile));
        shapes.extend(landscape.edges(&[map, profile]));
        let zero = |panel: &Axes| panel.curve([[from, 0.0], [to, 0.0]], 1.0, ZERO);
        shapes.push(zero(control));
        shapes.push(control.curve(self.steps(), 1.6, CONTROL));
        shapes.extend([0.0, 1.0].map(|y| fidelity.curve([[from, y], [to, y]], 1.0, ZERO)));
        let means = averaged(&self.fidelities, MAX_COLUMNS);
        shapes.push(fidelity.curve(
            (0..).zip(&means).map(|(i, &f)| [self.time(i, means.len()), f]),
            2.0,
            FIDELITY,
        ));
        shapes.extend([map, profile, scale, control, fidelity].map(Axes::frame));

        let positions = [0.0, length / 2.0, length];
        shapes.extend(map.ticks_left(&positions));
        shapes.extend(control.ticks_left(&ticks(control.y[0], control.y[1], 4.0)));
        shapes.extend(fidelity.ticks_left(&[0.0, 0.5, 1.0]));
        shapes.extend(fidelity.ticks_below(&ticks(from, to, 5.0)));
        shapes.extend(scale.ticks_below(&ticks(0.0, scale.x[1], 4.0)));
        let middle =
            |panel: &Axes| ((panel.left + panel.right) / 2.0, (panel.bottom + panel.top) / 2.0);
        let sum = if landscape.tilted() { "in V + c x" } else { "in V = c x" };
        let names = [
            (map, "position", "x"),
            (control, "control c", sum),
            (fidelity, "fidelity", "|⟨φ, ψ⟩|²"),
        ];
        for (panel, first, second) in names {
            let (x, y) = (34.0, middle(panel).1);
            shapes.extend([text([x, y + 2.0], first), text([x, y - 14.0], second)]);
        }
        // Raises the captions above the scale of the potential, if there is one.
        let top = if landscape.tilted() { 470.0 } else { 460.0 };
        shapes.push(text([middle(map).0, top], "probability density |ψ(x, t)|²"));
        shapes.push(text([middle(profile).0, top], "density at time t"));
        shapes.push(text([middle(fidelity).0, 8.0], "time t (units: ħ = 1, m = ½)"));
        shapes.extend(self.legend());
        shapes.extend(landscape.legend(self));
        shapes
    }

    /// Map and colour scale.
    fn colors(&self) -> Vec<Shape> {
        let Self { map, scale, half_row, .. } = self;
        let image = |(center, size), rows: &[Vec<f64>]| Shape::Image {
            center,
            size,
            raster: Raster::new(rows),
        };
        let whole = |panel: &Axes| panel.area([panel.x[0], panel.y[0]], [panel.x[1], panel.y[1]]);
        let all = (0..128).map(|i| f64::from(i) / 127.0).collect();
        let mut shapes = vec![image(whole(scale), &[all]), image(whole(map), &[vec![0.0]])];
        let columns: Vec<&[Vec<f64>]> = groups(&self.densities, MAX_COLUMNS).collect();
        let cell = |row: usize, states: &[Vec<f64>]| {
            states.iter().map(|s| s[row]).sum::<f64>() / states.len() as f64
        };
        let row =
            |row: usize| columns.iter().map(|states| cell(row, states) / scale.x[1]).collect();
        // Reverses the rows: a raster starts with the upper row, which is the last position.
        let rows: Vec<Vec<f64>> =
            (0..self.densities.first().map_or(0, Vec::len)).rev().map(row).collect();
        if !rows.is_empty() {
            shapes.push(image(
                map.area([map.x[0], *half_row], [self.end, map.y[1] - half_row]),
                &rows,
            ));
        }
        shapes
    }

    /// Control over time, piecewise constant.
    fn steps(&self) -> Vec<[f64; 2]> {
        let means = averaged(&self.controls, MAX_COLUMNS);
        let step = self.dt * self.controls.len() as f64 / means.len().max(1) as f64;
        (0..)
            .zip(&means)
            .flat_map(|(i, &c)| [[step * f64::from(i), c], [step * f64::from(i + 1), c]])
            .collect()
    }

    /// Time at the middle of a column.
    fn time(&self, column: usize, columns: usize) -> f64 {
        let (from, to) = (self.map.x[0], self.end);
        from + (to - from) * (column as f64 + 0.5) / columns as f64
    }

    /// Legend of the profile, with the initial and final fidelity.
    fn legend(&self) -> Vec<Shape> {
        let (x, middle) =
            (self.profile.left + 14.0, (self.profile.left + self.profile.right) / 2.0);
        let end = if self.landscape.steps > 0 { "now" } else { "at the end" };
        let ends =
            [self.fidelities.first(), self.fidelities.last()].map(|f| f.copied().unwrap_or(0.0));
        vec![
            text([middle, 190.0], "probability per length"),
            Shape::Rect { center: [x, 162.0], size: [28.0, 8.0], color: DENSITY },
            text([x + 52.0, 158.0], "|ψ|² now"),
            Shape::Line {
                from: [x - 13.0, 142.0],
                to: [x + 13.0, 142.0],
                width: 2.0,
                color: TARGET,
            },
            text([x + 56.0, 138.0], "|φ|² target"),
            text([middle, 84.0], format!("fidelity {:.3} at the start", ends[0])),
            text([middle, 66.0], format!("{:.3} {end}", ends[1])),
        ]
    }

    /// Moving shapes of one frame.
    fn frame(&self, state: usize) -> Vec<Shape> {
        let Self { map, profile, fidelity, half_row, .. } = self;
        let density = &self.densities[state];
        let position = |j: usize| 2.0 * half_row * (j + 1) as f64;
        let bar = |(j, &density): (usize, &f64)| {
            let margin = 0.8 * half_row;
            let (center, size) =
                profile.area([0.0, position(j) - margin], [density, position(j) + margin]);
            Shape::Rect { center, size, color: DENSITY }
        };
        let mut shapes: Vec<Shape> = density.iter().enumerate().map(bar).collect();
        let walls = [[0.0, 0.0], [0.0, profile.y[1]]];
        let inside = self.target.iter().enumerate().map(|(j, &density)| [density, position(j)]);
        shapes.push(profile.curve(
            [walls[0]].into_iter().chain(inside).chain([walls[1]]),
            2.0,
            TARGET,
        ));
        let time = state as f64 * self.dt;
        let x = map.at(time, 0.0)[0];
        shapes.push(Shape::Line {
            from: [x, map.top],
            to: [x, fidelity.bottom],
            width: 1.6,
            color: CURSOR,
        });
        shapes.push(Shape::Circle {
            center: fidelity.at(time, self.fidelities[state]),
            radius: 4.0,
            color: FIDELITY,
        });
        shapes
    }
}
