//! Turns a panel's description into its repeating cell, drawn on a raster.

use std::path::Path;

use ndarray::{Array2, Array3, Axis, s};

use crate::core::error::{Error, Result};
use crate::io::{Pixels, read_pixels};

use super::display::{Grey, LayoutConfig, LayoutKind};
use super::panel;

/// One period of a display: the factor t on the field, constant over each raster square.
///
/// Its centre lies on the optical axis but for the layout's offset; rows run down and columns to the right as
/// the camera sees the panel.
#[derive(Clone, Debug)]
pub struct UnitCell {
    /// The transmittance of each raster square.
    pub transmittance: Array2<f64>,
    /// The side of a raster square, in metres.
    pub raster_m: [f64; 2],
    /// Where the cell's centre lies, before the panel is turned: down and right of the axis, in metres.
    pub centre_m: [f64; 2],
}

impl UnitCell {
    /// Draws the cell of a layout, finely enough for spatial frequencies up to `band_per_m`.
    ///
    /// # Errors
    /// What reading the picture of an `image` layout meets.
    pub fn of(layout: &LayoutConfig, band_per_m: f64) -> Result<Self> {
        let mut cell = match layout.kind {
            LayoutKind::None => Self::uniform(),
            LayoutKind::Pentile | LayoutKind::Stripe => panel::draw(layout, band_per_m),
            LayoutKind::Image => read_layout(layout)?,
        };
        cell.centre_m = unturned_offset_m(layout);
        Ok(cell)
    }

    /// Nothing in the way. Its period may be any; one nanometre has no orders but the zeroth.
    fn uniform() -> Self {
        Self { transmittance: Array2::ones((1, 1)), raster_m: [1e-9; 2], centre_m: [0.0; 2] }
    }

    /// The cell's height and width, in metres.
    pub fn period_m(&self) -> [f64; 2] {
        let (rows, columns) = self.transmittance.dim();
        [rows as f64 * self.raster_m[0], columns as f64 * self.raster_m[1]]
    }

    /// The mean of t² over the cell: the share of the light that passes.
    pub fn mean_power(&self) -> f64 {
        self.transmittance.iter().map(|t| t * t).sum::<f64>() / self.transmittance.len() as f64
    }

    /// Keeps of a cell that is larger than the square of side `extent_m` around the axis only that square.
    ///
    /// Light from outside of it cannot reach the pupil when the extent allows for the spread over the gap.
    pub fn within(self, extent_m: f64) -> Self {
        let mut cell = self;
        for axis in 0..2 {
            let wanted = rounded_up(extent_m / cell.raster_m[axis]);
            cell = cell.keep_along(axis, wanted);
        }
        cell
    }

    fn keep_along(self, axis: usize, wanted: usize) -> Self {
        let length = self.transmittance.len_of(Axis(axis));
        if wanted >= length {
            return self;
        }
        // The square that holds the axis, counted from the cell's first square and wrapped by the period.
        let on_axis = length as f64 / 2.0 - self.centre_m[axis] / self.raster_m[axis];
        let first = (on_axis - wanted as f64 / 2.0).round();
        let mut centre_m = self.centre_m;
        centre_m[axis] += (first + wanted as f64 / 2.0 - length as f64 / 2.0) * self.raster_m[axis];
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "in 0..length by rem_euclid"
        )]
        let start = first.rem_euclid(length as f64) as usize;
        let indices: Vec<usize> = (0..wanted).map(|index| (start + index) % length).collect();
        Self { transmittance: self.transmittance.select(Axis(axis), &indices), centre_m, ..self }
    }
}

/// The offset as seen along the panel's own axes: the panel is moved after it was turned.
fn unturned_offset_m(layout: &LayoutConfig) -> [f64; 2] {
    let [right, down] = layout.offset_um.map(|offset| offset * 1e-6);
    let (sin, cos) = layout.angle_deg.to_radians().sin_cos();
    [right * sin + down * cos, right * cos - down * sin]
}

#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "saturates, and is bounded after"
)]
pub(super) fn rounded_up(count: f64) -> usize {
    count.ceil() as usize
}

fn read_layout(layout: &LayoutConfig) -> Result<UnitCell> {
    let file = layout.file.as_deref().unwrap_or(Path::new(""));
    // Shares of light that pass, not light: 8-bit values are taken as they are, whatever curve the file speaks of.
    let Pixels { planes, capture, is_integer, .. } = read_pixels(file)?;
    let orientation = capture.and_then(|capture| capture.orientation).unwrap_or_default();
    let mut planes = orientation.upright(planes);
    if is_integer {
        open_ones(&mut planes);
    }
    let (channels, rows, columns) = planes.dim();
    if planes.iter().any(|t| !(0.0..=1.0).contains(t)) {
        return Err(Error::format(file, "a layout picture needs values from 0 (opaque) to 1 (open)"));
    }
    // Colour pictures are accepted when they are grey: a layout has one transmittance for all light.
    let grey = planes.slice(s![0, .., ..]);
    if planes.outer_iter().any(|plane| plane != grey) {
        let reason = format!("its {channels} channels differ; a layout picture must be grey");
        return Err(Error::format(file, reason));
    }
    let amplitude = match layout.grey.unwrap_or_default() {
        Grey::Amplitude => grey.mapv(f64::from),
        Grey::Power => grey.mapv(|power| f64::from(power).sqrt()),
    };
    if amplitude.iter().all(|t| *t <= 0.0) {
        let reason = format!("all {rows} × {columns} pixels are black: no light would pass");
        return Err(Error::format(file, reason));
    }
    let raster_m = [layout.pixel_size_um.unwrap_or(1.0) * 1e-6; 2];
    Ok(UnitCell { transmittance: amplitude, raster_m, centre_m: [0.0; 2] })
}

/// Takes the ones of integers that are all zero or one for open: masks of programs are written so.
fn open_ones(planes: &mut Array3<f32>) {
    let highest = planes.iter().copied().fold(0.0, f32::max);
    let is_one = [u8::MAX.into(), u16::MAX.into()]
        .into_iter()
        .any(|largest: f32| (highest * largest - 1.0).abs() < 1e-3);
    if is_one {
        planes.mapv_inplace(|t| t / highest);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::psf::display::{Direction, OpeningConfig, RegionConfig, WiringConfig};
    use crate::psf::shape::ShapeKind;

    fn square(side: f64, transmittance: f64) -> RegionConfig {
        RegionConfig {
            shape: ShapeKind::Rectangle,
            width_um: side,
            height_um: side,
            corner_um: 0.0,
            transmittance,
        }
    }

    /// Edges lie at 1/16 of a raster square at worst: 4 sides of 20 µm placed to 0.016 µm are 0.03 % of the
    /// cell.
    #[test]
    fn a_stripe_pixel_has_the_transmittance_of_its_areas() {
        let layout = LayoutConfig {
            kind: LayoutKind::Stripe,
            pitch_um: Some(60.0),
            background_transmittance: Some(0.5),
            green: Some(square(20.0, 1.0)),
            wiring: vec![WiringConfig {
                direction: Direction::Vertical,
                position_um: 25.0,
                width_um: 3.0,
                transmittance: 0.0,
            }],
            ..LayoutConfig::default()
        };
        let cell = UnitCell::of(&layout, 250e3).unwrap();
        let mean = cell.transmittance.mean().unwrap();
        let expected = 0.5 + 0.5 * (400.0 / 3600.0) - 0.5 * 3.0 / 60.0;
        assert!((mean - expected).abs() < 5e-4, "{mean} instead of {expected}");
    }

    #[test]
    fn a_pentile_cell_repeats_after_one_pixel_in_both_directions() {
        let layout = LayoutConfig {
            kind: LayoutKind::Pentile,
            pitch_um: Some(60.0),
            red: Some(square(11.0, 0.1)),
            green: Some(square(8.0, 0.3)),
            blue: Some(square(17.0, 0.2)),
            openings: vec![OpeningConfig {
                x_um: 20.0,
                y_um: 4.0,
                width_um: 5.0,
                height_um: 9.0,
                ..OpeningConfig::default()
            }],
            ..LayoutConfig::default()
        };
        let t = UnitCell::of(&layout, 250e3).unwrap().transmittance;
        let n = t.nrows() / 2;
        let shifted = |y, x| t[[(y + n) % (2 * n), (x + n) % (2 * n)]];
        assert!(t.indexed_iter().all(|((y, x), v)| (v - shifted(y, x)).abs() < 1e-12));
        assert!(t.indexed_iter().any(|((y, x), v)| (v - t[[y, (x + n) % (2 * n)]]).abs() > 0.05));
    }

    #[test]
    fn keeps_the_part_of_a_large_cell_around_the_axis() {
        let cell = UnitCell {
            transmittance: Array2::from_shape_fn((100, 80), |(y, x)| (y * 100 + x) as f64),
            raster_m: [1e-6; 2],
            centre_m: [10e-6, -30e-6],
        };
        let kept = cell.clone().within(19.5e-6);
        assert_eq!(kept.transmittance.dim(), (20, 20));
        // The axis meets row 100/2 − 10 and column 80/2 + 30 of the cell.
        assert_eq!(kept.transmittance[[10, 10]], cell.transmittance[[40, 70]]);
        assert!(kept.centre_m.iter().all(|c| c.abs() < 1e-12));
        assert_eq!(cell.clone().within(1.0).transmittance, cell.transmittance);
    }

    /// What is read of a layout file.
    fn drawn(name: &str, bytes: &[u8]) -> Array2<f64> {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join(name);
        std::fs::write(&file, bytes).unwrap();
        let layout = LayoutConfig { kind: LayoutKind::Image, file: Some(file), ..LayoutConfig::default() };
        UnitCell::of(&layout, 250e3).unwrap().transmittance
    }

    #[test]
    fn integers_that_are_zero_or_one_are_opaque_or_open() {
        let array = |values: [u8; 4]| {
            let header = "{'descr': '|u1', 'fortran_order': False, 'shape': (2, 2), }\n";
            let length = u16::try_from(header.len()).unwrap().to_le_bytes();
            [&b"\x93NUMPY\x01\x00"[..], &length, header.as_bytes(), &values].concat()
        };
        let found = drawn("mask.npy", &array([0, 1, 1, 0]));
        assert_eq!(found, ndarray::array![[0.0, 1.0], [1.0, 0.0]]);
        let found = drawn("grey.npy", &array([0, 51, 255, 0]));
        assert!((found[[0, 1]] - 0.2).abs() < 1e-7 && found[[1, 0]] == 1.0, "{found}");
    }

    /// Three columns of one row, the first open, to be turned right when it is shown: three rows of one column.
    #[test]
    fn a_layout_lies_as_its_file_says() {
        let short = |tag: u16, value: u16| {
            [&tag.to_le_bytes()[..], &[3, 0, 1, 0, 0, 0], &value.to_le_bytes(), &[0, 0]].concat()
        };
        let fields = [
            (256, 3),
            (257, 1),
            (258, 8),
            (259, 1),
            (262, 1),
            (273, 8),
            (274, 6),
            (277, 1),
            (278, 1),
            (279, 3),
        ];
        let directory: Vec<u8> = fields.into_iter().flat_map(|(tag, value)| short(tag, value)).collect();
        let head = [&b"II*\0\x0c\0\0\0"[..], &[255, 0, 0, 0], &[10, 0]].concat();
        let found = drawn("turned.tif", &[&head[..], &directory, &[0; 4]].concat());
        assert_eq!(found, ndarray::array![[1.0], [0.0], [0.0]]);
    }
}
