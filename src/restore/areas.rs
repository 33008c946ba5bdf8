//! Walks over the connected areas of a mask.

use ndarray::Array2;

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
