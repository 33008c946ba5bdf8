//! The saturated pixels of a capture, and the connected areas of a mask.

use ndarray::{Array2, Zip};

use crate::core::image::{CHANNELS, LinearImage};
use crate::core::saturation::saturated_from;

/// The pixels of a capture that are saturated in some colour.
pub(super) fn saturated_in_some(capture: &LinearImage, saturation: [f32; CHANNELS]) -> Array2<bool> {
    let from = saturation.map(saturated_from);
    let [red, green, blue] = [0, 1, 2].map(|channel| capture.channel(channel));
    let is_saturated =
        |red: &f32, green: &f32, blue: &f32| *red >= from[0] || *green >= from[1] || *blue >= from[2];
    Zip::from(red).and(green).and(blue).par_map_collect(is_saturated)
}

/// Calls `visit` with the rows and columns of each connected area of a mask's true pixels, those at corners included, in the order of their
/// first pixels.
pub(super) fn visit_areas(mut todo: Array2<bool>, mut visit: impl FnMut(&[(usize, usize)])) {
    let (height, width) = todo.dim();
    let mut area = Vec::new();
    let mut start = 0;
    loop {
        let rest = &todo.as_slice().expect("masks are contiguous")[start..];
        let Some(next) = rest.iter().position(|is_todo| *is_todo) else { break };
        start += next;
        let first = (start / width, start % width);
        todo[first] = false;
        area.clear();
        area.push(first);
        let mut next = 0;
        while let Some(&(y, x)) = area.get(next) {
            next += 1;
            for y in y.saturating_sub(1)..=(y + 1).min(height - 1) {
                for x in x.saturating_sub(1)..=(x + 1).min(width - 1) {
                    if std::mem::take(&mut todo[[y, x]]) {
                        area.push((y, x));
                    }
                }
            }
        }
        visit(&area);
    }
}
