//! Puts what is painted so far out of focus.

use super::film::Film;
use super::light::Rgb;
use crate::core::image::CHANNELS;

/// Passes of a running mean: two make a tent, as smooth as a defocused background needs to be.
const PASSES: usize = 2;

/// Blurs the film by running means of `2·radius + 1` samples along both axes; edges repeat.
pub(super) fn defocus(film: &mut Film, radius: usize) {
    let [rows, columns] = film.grid();
    let mut line = Vec::with_capacity(rows.max(columns));
    for _ in 0..PASSES {
        for row in film.samples.chunks_exact_mut(columns.max(1)) {
            line.clear();
            line.extend_from_slice(row);
            mean(&line, radius, |i, value| row[i] = value);
        }
        for column in 0..columns {
            line.clear();
            line.extend(film.samples.iter().skip(column).step_by(columns));
            mean(&line, radius, |i, value| film.samples[i * columns + column] = value);
        }
    }
}

fn mean(line: &[Rgb], radius: usize, mut store: impl FnMut(usize, Rgb)) {
    let at = |i: usize| line[i.saturating_sub(radius).min(line.len() - 1)];
    let mut sum = [0f64; CHANNELS];
    let mut add = |value: Rgb, sign: f64| {
        (0..CHANNELS).for_each(|c| sum[c] += sign * f64::from(value[c]));
        sum
    };
    (0..2 * radius).for_each(|i| {
        add(at(i), 1.0);
    });
    let share = 1.0 / (2 * radius + 1) as f64;
    for i in 0..line.len() {
        let sum = add(at(i + 2 * radius), 1.0);
        #[expect(clippy::cast_possible_truncation, reason = "films are f32")]
        store(i, sum.map(|value| (value * share).max(0.0) as f32));
        add(at(i), -1.0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn spreads_light_and_keeps_it() {
        let mut film = Film::new([20, 20]);
        film.within([10.0, 10.0, 10.5, 10.5], |_, sample| *sample = [8.0, 4.0, 2.0]);
        defocus(&mut film, 3);
        let sum: f32 = film.samples.iter().map(|sample| sample[1]).sum();
        let peak = film.samples.iter().fold(0.0f32, |a, b| b[1].max(a));
        // Two running means over 7 leave 1/7 of a line's peak, on both axes.
        assert!((sum - 4.0).abs() < 1e-4 && (peak - 4.0 / 49.0).abs() < 1e-5, "{sum} {peak}");
    }
}
