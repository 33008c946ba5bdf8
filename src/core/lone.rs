//! Tells pixels that stand alone, as hot ones of a sensor do, from diffraction orders.

use ndarray::ArrayView2;

/// The most light that the neighbours of a lone pixel, and what lies opposite of it across the centre, may have as a share of its own: a
/// diffraction order is spread over some pixels, or has a counterpart.
const MOST_BESIDE: f32 = 0.1;

/// Whether neither the neighbours of a pixel within `reach`, nor the pixels opposite of them across the `centre` of a PSF, have
/// more than a small share of its light.
///
/// The core does not stand alone, nor what has its opposite outside of the plane, of which nothing is known.
pub(crate) fn stands_alone(
    plane: ArrayView2<'_, f32>,
    at: (usize, usize),
    [centre_y, centre_x]: [usize; 2],
    reach: usize,
) -> bool {
    let (height, width) = plane.dim();
    let (y, x) = at;
    let is_core = y.abs_diff(centre_y).max(x.abs_diff(centre_x)) <= reach;
    // Of an even side, the first pixel's opposite is one beyond the last.
    let opposite = |place: usize, centre: usize, side: usize| {
        (2 * centre).checked_sub(place).filter(|other| *other <= side).map(|other| other.min(side - 1))
    };
    let (Some(opposite_y), Some(opposite_x)) = (opposite(y, centre_y, height), opposite(x, centre_x, width))
    else {
        return false;
    };
    let limit = MOST_BESIDE * plane[at];
    !is_core
        && around(plane.dim(), at, reach).all(|place| place == at || plane[place] <= limit)
        && around(plane.dim(), (opposite_y, opposite_x), reach).all(|place| plane[place] <= limit)
}

/// Whether a pixel and its neighbours have at most a small share of `light`, which is another colour's there.
pub(crate) fn is_faint_beside(plane: ArrayView2<'_, f32>, at: (usize, usize), light: f32) -> bool {
    around(plane.dim(), at, 1).all(|place| plane[place] <= MOST_BESIDE * light)
}

/// The pixels of the square around one that lie in the plane.
fn around(
    (height, width): (usize, usize),
    (y, x): (usize, usize),
    reach: usize,
) -> impl Iterator<Item = (usize, usize)> {
    let columns = x.saturating_sub(reach)..(x + reach + 1).min(width);
    (y.saturating_sub(reach)..(y + reach + 1).min(height))
        .flat_map(move |row| columns.clone().map(move |column| (row, column)))
}
