//! Draws the repeating cell of a panel: sub-pixels, openings and wiring at their places, moved where it is irregular.

use ndarray::{Array2, Axis};
use rand::RngExt as _;
use rand_distr::StandardNormal;

use crate::core::rng::{Rng, stream};

use super::display::{Direction, IrregularityConfig, LayoutConfig, LayoutKind, RegionConfig, WiringConfig};
use super::layout::{UnitCell, rounded_up};
use super::shape::Outline;

/// Bounds of the raster of a drawn cell: fine enough for any shape, at most 128 MiB.
const RASTER_RANGE: (usize, usize) = (256, 4096);

/// How many raster squares the shortest period that matters spans. The raster's own aliases then stand at 1/16
/// of the true coefficients' size or less, and only at the highest orders.
const SQUARES_PER_PERIOD: f64 = 16.0;

/// Draws the cell, finely enough for spatial frequencies up to `band_per_m`.
pub(super) fn draw(layout: &LayoutConfig, band_per_m: f64) -> UnitCell {
    let panel = Panel::new(layout);
    let wanted = rounded_up(SQUARES_PER_PERIOD * band_per_m * panel.side_um() * 1e-6);
    // An even number keeps the symmetry of a cell of two pixels.
    let squares = wanted.clamp(RASTER_RANGE.0, RASTER_RANGE.1).next_multiple_of(2);
    let raster_um = panel.side_um() / squares as f64;
    let mut transmittance =
        Array2::from_elem((squares, squares), layout.background_transmittance.unwrap_or(1.0));
    for region in panel.regions() {
        region.draw(&mut transmittance, raster_um);
    }
    for (index, line) in layout.wiring.iter().enumerate() {
        draw_line(&mut transmittance, line, &panel.places_of_line(index, line), raster_um);
    }
    UnitCell { transmittance, raster_m: [raster_um * 1e-6; 2], centre_m: [0.0; 2] }
}

/// The panel's pixels within one cell.
struct Panel<'a> {
    layout: &'a LayoutConfig,
    pitch_um: f64,
    /// How many pixels wide and high the cell is.
    pixels: usize,
}

/// How the regions or lines of one kind leave their places and sizes, one after another.
struct Moves {
    irregularity: Option<(IrregularityConfig, Rng)>,
}

impl<'a> Panel<'a> {
    fn new(layout: &'a LayoutConfig) -> Self {
        let repeats_after = if layout.kind == LayoutKind::Pentile { 2 } else { 1 };
        Self {
            layout,
            pitch_um: layout.pitch_um.unwrap_or(1.0),
            pixels: layout.irregularity.as_ref().map_or(repeats_after, |irregularity| irregularity.pixels),
        }
    }

    fn side_um(&self) -> f64 {
        self.pitch_um * self.pixels as f64
    }

    /// The place of a pixel's centre, or with ½ added that of its far corner, from the cell's centre.
    fn place_um(&self, index: f64) -> f64 {
        (index + 0.5 - self.pixels as f64 / 2.0) * self.pitch_um
    }

    /// The row and column of each pixel.
    fn indices(&self) -> impl Iterator<Item = (usize, usize)> + use<> {
        let pixels = self.pixels;
        (0..pixels).flat_map(move |row| (0..pixels).map(move |column| (row, column)))
    }

    /// Whatever its neighbours are, each kind of region draws from a stream of its own.
    fn moves(&self, what: &str) -> Moves {
        let open = |config: &IrregularityConfig| {
            (*config, stream(config.seed, &format!("display/irregularity/{what}")))
        };
        Moves { irregularity: self.layout.irregularity.as_ref().map(open) }
    }

    /// Where the sub-pixels and openings lie, from the cell's centre.
    ///
    /// A stripe pixel holds red, green, blue at −⅓, 0, +⅓ of the pitch. In a PenTile panel red and blue alternate at the
    /// pixels' centres, the greens stand on the pixels' corners; a shift by one pixel in both directions leaves the
    /// pattern as it is.
    fn regions(&self) -> Vec<Placed> {
        let (red, green, blue) = (&self.layout.red, &self.layout.green, &self.layout.blue);
        let mut regions = Vec::new();
        if self.layout.kind == LayoutKind::Pentile {
            let centres = |odd: usize| self.places(0.0, 0.0, move |row, column| (row + column) % 2 == odd);
            self.place(&mut regions, ("red", red.as_ref()), centres(0));
            self.place(&mut regions, ("blue", blue.as_ref()), centres(1));
            self.place(&mut regions, ("green", green.as_ref()), self.places(0.5, 0.5, |_, _| true));
        } else {
            for (name, region, right) in
                [("red", red, -1.0 / 3.0), ("green", green, 0.0), ("blue", blue, 1.0 / 3.0)]
            {
                self.place(&mut regions, (name, region.as_ref()), self.places(0.0, right, |_, _| true));
            }
        }
        for (index, opening) in self.layout.openings.iter().enumerate() {
            let place = self.places(opening.y_um / self.pitch_um, opening.x_um / self.pitch_um, |_, _| true);
            self.place(&mut regions, (&format!("opening {index}"), Some(&opening.region())), place);
        }
        regions
    }

    /// Places in the pixels for which `is_there` holds, `down` and `right` of their centres by such shares of a pitch.
    fn places(&self, down: f64, right: f64, is_there: impl Fn(usize, usize) -> bool) -> Vec<[f64; 2]> {
        self.indices()
            .filter(|(row, column)| is_there(*row, *column))
            .map(|(row, column)| [self.place_um(row as f64 + down), self.place_um(column as f64 + right)])
            .collect()
    }

    fn place(&self, to: &mut Vec<Placed>, (name, region): (&str, Option<&RegionConfig>), at: Vec<[f64; 2]>) {
        let Some(region) = region else { return };
        let mut moves = self.moves(name);
        to.extend(at.into_iter().map(|[y_um, x_um]| {
            let ([dy_um, dx_um], size) = ([moves.shift_um(), moves.shift_um()], moves.size());
            let sides_um = [region.height_um, region.width_um].map(|side| side * size);
            Placed {
                outline: Outline::new(region.shape, sides_um, region.corner_um * size),
                reach_um: sides_um.map(|side| side / 2.0),
                centre_um: [y_um + dy_um, x_um + dx_um],
                transmittance: region.transmittance,
            }
        }));
    }

    /// Where a line runs in each row or column of pixels, from the cell's centre.
    fn places_of_line(&self, index: usize, line: &WiringConfig) -> Vec<f64> {
        let mut moves = self.moves(&format!("line {index}"));
        let place = |pixel: usize| self.place_um(pixel as f64) + line.position_um + moves.shift_um();
        (0..self.pixels).map(place).collect()
    }
}

impl Moves {
    /// A displacement along one axis.
    fn shift_um(&mut self) -> f64 {
        let of = |(config, rng): &mut (IrregularityConfig, Rng)| {
            config.jitter_um * rng.sample::<f64, _>(StandardNormal)
        };
        self.irregularity.as_mut().map_or(0.0, of)
    }

    /// A factor on the extents.
    fn size(&mut self) -> f64 {
        let of = |(config, rng): &mut (IrregularityConfig, Rng)| {
            1.0 + config.size_spread * rng.random_range(-1.0..=1.0)
        };
        self.irregularity.as_mut().map_or(1.0, of)
    }
}

/// A region at its place, repeated with the cell.
struct Placed {
    outline: Outline,
    /// Half of its height and width.
    reach_um: [f64; 2],
    /// Down and right of the cell's centre.
    centre_um: [f64; 2],
    transmittance: f64,
}

impl Placed {
    fn draw(&self, transmittance: &mut Array2<f64>, raster_um: f64) {
        let rows = self.near(0, transmittance.nrows(), raster_um);
        let columns = self.near(1, transmittance.ncols(), raster_um);
        for &(row, dy) in &rows {
            for &(column, dx) in &columns {
                let covered = self.outline.coverage(dy, dx, raster_um);
                let t = &mut transmittance[[row, column]];
                *t += covered * (self.transmittance - *t);
            }
        }
    }

    /// The lanes of squares that the region can cover, with their distances from its middle.
    fn near(&self, axis: usize, squares: usize, raster_um: f64) -> Vec<(usize, f64)> {
        let side_um = squares as f64 * raster_um;
        let distance = |index: usize| {
            let place = (index as f64 + 0.5) * raster_um - side_um / 2.0;
            (index, wrapped(place - self.centre_um[axis], side_um))
        };
        let reach_um = self.reach_um[axis] + raster_um;
        (0..squares).map(distance).filter(|(_, distance)| distance.abs() <= reach_um).collect()
    }
}

/// Multiplies the transmittance of lines that run through the cell, their middles at `middles_um` from its centre.
fn draw_line(transmittance: &mut Array2<f64>, line: &WiringConfig, middles_um: &[f64], raster_um: f64) {
    let axis = match line.direction {
        Direction::Horizontal => Axis(0),
        Direction::Vertical => Axis(1),
    };
    let side_um = transmittance.len_of(axis) as f64 * raster_um;
    for (index, mut lane) in transmittance.axis_iter_mut(axis).enumerate() {
        let square_um = (index as f64 + 0.5) * raster_um - side_um / 2.0;
        let distance_to = |middle_um: &f64| wrapped(square_um - middle_um, side_um).abs();
        let distance = middles_um.iter().map(distance_to).fold(f64::INFINITY, f64::min);
        let covered = ((line.width_um / 2.0 - distance) / raster_um + 0.5).clamp(0.0, 1.0);
        let covered = covered.min(line.width_um / raster_um);
        lane.mapv_inplace(|t| t * (1.0 - covered * (1.0 - line.transmittance)));
    }
}

/// The distance to the nearest repetition.
fn wrapped(distance: f64, period: f64) -> f64 {
    distance - period * (distance / period).round()
}
