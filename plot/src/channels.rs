//! Numbers over time, for animations.

use super::animation::Animation;

/// One number over time.
#[derive(Clone, Debug, PartialEq)]
pub struct Channel {
    /// Name, at the left of its band.
    pub name: String,
    /// Values, evenly spaced from the first frame of the animation to the last. The curve ends
    /// before the first non-finite value.
    pub values: Vec<f64>,
    /// CSS colour.
    pub color: &'static str,
    /// Lowest and highest value of the band. `None` for the extremes of the values before the first
    /// non-finite value.
    pub range: Option<[f64; 2]>,
}

impl Channel {
    /// Creates one channel per name. Channel i holds column i of the rows.
    ///
    /// # Panics
    /// Panics if a row has fewer values than there are names.
    pub fn columns(names: Vec<String>, rows: &[Vec<f64>], color: &'static str) -> Vec<Self> {
        let values = |i: usize| rows.iter().map(|row| row[i]).collect();
        names
            .into_iter()
            .enumerate()
            .map(|(i, name)| Self { name, values: values(i), color, range: None })
            .collect()
    }

    /// Values before the first non-finite value.
    pub(super) fn finite(&self) -> &[f64] {
        &self.values[..self.values.iter().take_while(|value| value.is_finite()).count()]
    }

    /// Lowest and highest value of the band. Both are 0 if `range` is `None` and the first value is
    /// missing or non-finite.
    pub fn range(&self) -> [f64; 2] {
        let ends = |values: &[f64]| {
            values.iter().fold([f64::MAX, f64::MIN], |[low, high], &y| [low.min(y), high.max(y)])
        };
        self.range.unwrap_or_else(|| {
            if self.finite().is_empty() { [0.0, 0.0] } else { ends(self.finite()) }
        })
    }
}

/// Animates numbers over time, one band per channel, each with its own range. Values are `dt`
/// seconds apart. All channels have the same number of values, except that channels of controls may
/// have one value less. The animation ends where the longest curve ends. A cursor crosses the bands
/// in real time, or in 1 s if the values span less time.
pub fn channels_over_time(title: &str, channels: &[Channel], dt: f64) -> Animation {
    let steps =
        channels.iter().map(|channel| channel.finite().len()).max().unwrap_or(0).saturating_sub(1);
    let time = steps as f64 * dt;
    let shown = |channel: &Channel| {
        // Controls have no value at the final time. Repeats the last value, which holds until that
        // time.
        let mut values = channel.values[..channel.values.len().min(steps + 1)].to_vec();
        if let (true, Some(&last)) = (values.len() == steps, values.last()) {
            values.push(last);
        }
        Channel { values, ..channel.clone() }
    };
    let channels = channels.iter().map(shown).collect();
    Animation {
        title: title.to_owned(),
        seconds: time.max(1.0),
        time,
        channels,
        ..Animation::default()
    }
}
