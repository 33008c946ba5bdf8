//! Turns a described panel, lens and sensor into the PSF, by light propagation (the paper's Eq. 2).
//!
//! For each wavelength: the display's diffraction orders pass the gap, their field is evaluated over the pupil,
//! a zoom transform takes it to the sensor, and the light is integrated over the pixels. The derivation is in
//! [`optics`](super::optics), the demands on the grid are in [`sampling`](super::sampling).

use ndarray::{Array2, Array3, ArrayViewMut1, Axis};
use rayon::prelude::*;
use rustfft::num_complex::Complex64;
use serde::Serialize;

use crate::core::error::{Error, Result};
use crate::core::progress::Progress;
use crate::core::psf::Psf;

use super::chirp_z::{ChirpZ, Points};
use super::display::DisplayConfig;
use super::layout::UnitCell;
use super::optics::Optics;
use super::orders::{Field, Orders};
use super::pixel::PixelIntegral;
use super::pupil::Pupil;
use super::sampling::{Bandwidth, Grid};

/// A simulated PSF, and where its light went.
#[derive(Clone, Debug)]
pub struct SimulatedPsf {
    /// The PSF, each channel of unit sum within the window.
    pub psf: Psf,
    /// The light of each channel.
    pub light: [ChannelLight; 3],
    /// The resolved geometry.
    pub optics: Optics,
    /// The grid over the pupil.
    pub grid: Grid,
    /// The computation's largest arrays, in bytes.
    pub memory_bytes: usize,
}

/// Shares of one channel's light.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub struct ChannelLight {
    /// What passes the display, of what falls on it in front of the pupil.
    pub transmitted: f64,
    /// What lands outside of the PSF's window, of what passes.
    pub outside: f64,
}

/// The most samples of the light within a pixel, on each side: pixels of 100 µm at f/1 need some 600.
const MOST_SAMPLES_PER_PIXEL: f64 = 1000.0;

/// The most samples of the light across the window: the work grows with their square, to some minutes for each wavelength.
const MOST_SAMPLES: usize = 1 << 16;

/// More than this is refused before it is allocated.
const MEMORY_LIMIT_BYTES: usize = 2 << 30;

/// Simulates the PSF of a point source on the axis.
///
/// # Shapes
/// `size-px` squared, centre at N/2, turned as a camera shows its pictures.
///
/// # Accuracy
/// Computed in 64 bit. Pixel integration and interpolation err by about 1e-5 and 1e-7; the pupil's rim, drawn by
/// covered area, by less than 1 % of each pixel (tested by halving the grid pitch).
///
/// # Errors
/// [`Error::Config`] for values out of range, grids that alias and panels that pass no light; what reading a layout picture
/// meets; [`Error::Unsupported`] when the window sees no light or the work would not fit in memory, or would take hours;
/// [`Error::Interrupted`] after an interrupt.
pub fn simulate_psf(config: &DisplayConfig, progress: &Progress) -> Result<SimulatedPsf> {
    config.check()?;
    let bench = Bench::new(config)?;
    let lines = config.spectrum.lines();
    let bar = progress.bar(lines.len() as u64, "wavelengths");
    let size = config.sensor.size_px;
    let mut channels = [0, 1, 2].map(|_| ChannelSum::new(size));
    for (wavelength_nm, weights) in lines {
        let (image, through) = bench.image(wavelength_nm * 1e-9, progress)?;
        channels.iter_mut().zip(weights).for_each(|(channel, weight)| channel.add(weight, &image, through));
        bar.inc(1);
    }
    bar.finish_and_clear();
    let mut planes = Array3::zeros((3, size, size));
    for (mut plane, channel) in planes.outer_iter_mut().zip(&channels) {
        plane.assign(&channel.shares());
    }
    Ok(SimulatedPsf {
        psf: Psf::from_energy(planes)?,
        light: [0, 1, 2].map(|index| channels[index].light(bench.pupil_area_m2)),
        optics: bench.optics,
        grid: bench.grid,
        memory_bytes: bench.memory_bytes,
    })
}

/// Simulates the PSFs of a panel that is turned to each of `angles_deg` about the axis; see
/// [`DisplayConfig::turned`].
///
/// # Errors
/// Those of [`simulate_psf`].
pub fn simulate_turned(config: &DisplayConfig, angles_deg: &[f64], progress: &Progress) -> Result<Vec<Psf>> {
    let bar = progress.bar(angles_deg.len() as u64, "rotations");
    let turned = |angle_deg: &f64| {
        let simulated = simulate_psf(&config.turned(*angle_deg), progress)?;
        bar.inc(1);
        Ok(simulated.psf)
    };
    let psfs = angles_deg.iter().map(turned).collect();
    bar.finish_and_clear();
    psfs
}

/// The light of one channel, summed over its wavelengths.
struct ChannelSum {
    image: Array2<f64>,
    passed: f64,
    weight: f64,
}

impl ChannelSum {
    fn new(size: usize) -> Self {
        Self { image: Array2::zeros((size, size)), passed: 0.0, weight: 0.0 }
    }

    fn add(&mut self, weight: f64, image: &Array2<f64>, through: f64) {
        if weight > 0.0 {
            self.image.scaled_add(weight, image);
            self.passed += weight * through;
            self.weight += weight;
        }
    }

    /// Each pixel's share of what passes the panel.
    #[expect(clippy::cast_possible_truncation, reason = "PSFs are kept in 32 bit")]
    fn shares(&self) -> Array2<f32> {
        self.image.mapv(|light| (light / self.passed) as f32)
    }

    fn light(&self, pupil_area_m2: f64) -> ChannelLight {
        ChannelLight {
            transmitted: self.passed / self.weight / pupil_area_m2,
            outside: (1.0 - self.image.sum() / self.passed).max(0.0),
        }
    }
}

/// What all wavelengths share: geometry, grid, pupil and the display's orders.
struct Bench {
    optics: Optics,
    grid: Grid,
    pixel_pitch_m: f64,
    size_px: usize,
    angle: (f64, f64),
    integral: PixelIntegral,
    pupil: Pupil,
    pupil_area_m2: f64,
    orders: Orders,
    mean_power: f64,
    window_m: f64,
    memory_bytes: usize,
}

impl Bench {
    fn new(config: &DisplayConfig) -> Result<Self> {
        let optics = Optics::new(&config.optics)?;
        let shortest_m = config.spectrum.shortest_m();
        let pixel_pitch_m = config.sensor.pixel_pitch_um * 1e-6;
        let highest_per_m = optics.aperture_m / (shortest_m * optics.sensor_distance_m);
        check_pixels(config, PixelIntegral::samples_wanted(pixel_pitch_m, highest_per_m))?;
        let integral = PixelIntegral::new(pixel_pitch_m, highest_per_m);
        let size_px = config.sensor.size_px;
        check_samples(integral.samples(size_px))?;
        let margin_px = integral.reach() as f64 / integral.samples_per_pixel as f64;
        let window_m = (size_px as f64 / 2.0 + margin_px) * pixel_pitch_m;
        let grid = Grid::new(&config.sampling, &optics, &Bandwidth::new(&optics, shortest_m, window_m))?;
        let propagation_bytes = propagation_bytes(&grid, integral.samples(size_px), size_px);
        check_memory(propagation_bytes, || {
            format!(
                "{} samples and a grid of {} points on a side; reduce sensor.size-px, \
                 sensor.pixel-pitch-um, the defocus or the aperture",
                integral.samples(size_px),
                grid.size
            )
        })?;

        let (sin, cos) = config.display.angle_deg.to_radians().sin_cos();
        // Along the axes of a turned panel the corners of the band reach further.
        let longest_m = config.spectrum.longest_m();
        let widest = Bandwidth::new(&optics, longest_m, window_m).display_band(&grid);
        let band = optics.magnification * (sin.abs() + cos.abs()) * widest;
        let spread_m = longest_m * optics.reduced_gap_m * band;
        let cell = UnitCell::of(&config.display, band)?
            .within(optics.aperture_m / optics.magnification + 2.0 * spread_m);
        let mean_power = cell.mean_power();
        if mean_power <= 0.0 {
            let reason = "the panel passes no light: give a background-transmittance above 0, or an opening";
            return Err(Error::config("display", reason));
        }
        let orders_bytes = Orders::memory_bytes(&cell, band);
        check_memory(orders_bytes, || {
            let [height, width] = cell.period_m().map(|side| side * 1e3);
            format!(
                "the orders of a layout of {height:.2} × {width:.2} mm; reduce sensor.size-px, the aperture or, where \
                 it repeats, the picture"
            )
        })?;
        let pupil = Pupil::new(&grid, optics.aperture_m);
        Ok(Self {
            optics,
            grid,
            pixel_pitch_m,
            size_px,
            angle: (sin, cos),
            integral,
            pupil_area_m2: pupil.coverage.sum() * grid.pitch_m.powi(2),
            pupil,
            orders: Orders::of(&cell, band),
            mean_power,
            window_m,
            memory_bytes: propagation_bytes + orders_bytes,
        })
    }

    /// The light on each pixel for one wavelength, and all light that passes the pupil, in the same unit.
    fn image(&self, wavelength_m: f64, progress: &Progress) -> Result<(Array2<f64>, f64)> {
        progress.check()?;
        let band = Bandwidth::new(&self.optics, wavelength_m, self.window_m).display_band(&self.grid);
        let (sin, cos) = self.angle;
        let limit = band * self.optics.magnification;
        let orders = self.orders.clone().retain(|y, x| {
            let (on_lens_x, on_lens_y) = (x * cos + y * sin, y * cos - x * sin);
            on_lens_x.abs() <= limit && on_lens_y.abs() <= limit
        });
        let beyond = (self.mean_power - orders.power()).max(0.0) * self.pupil_area_m2;
        let field = orders.propagate(wavelength_m, self.optics.reduced_gap_m).field();
        progress.check()?;
        let (pupil_field, through) = self.pupil_field(&field, wavelength_m);
        drop(field);
        progress.check()?;
        let light = self.to_sensor(&pupil_field, wavelength_m, progress);
        // What was interrupted is not whole.
        progress.check()?;
        Ok((light, through + beyond))
    }

    /// P(x) · V(x/M) · exp(iπεx²/λ) on the grid, and the light it carries: ∫ P |V|² dx.
    fn pupil_field(&self, field: &Field, wavelength_m: f64) -> (Array2<Complex64>, f64) {
        let (sin, cos) = self.angle;
        let centre = (self.grid.size / 2) as f64;
        let place = |index: usize| (index as f64 - centre) * self.grid.pitch_m;
        let curvature = std::f64::consts::PI * self.optics.defocus_per_m / wavelength_m;
        let mut pupil_field = Array2::zeros(self.pupil.amplitude.dim());
        let fill = |(row, mut line): (usize, ArrayViewMut1<'_, Complex64>)| {
            let y = place(row);
            let mut light = 0.0;
            for (column, value) in line.iter_mut().enumerate() {
                let amplitude = self.pupil.amplitude[[row, column]];
                if amplitude.abs() > 0.0 {
                    let x = place(column);
                    // Back to the display, then along the turned panel's axes.
                    let (eta, xi) = (y / self.optics.magnification, x / self.optics.magnification);
                    let on_panel = field.at(xi * sin + eta * cos, xi * cos - eta * sin);
                    *value = on_panel * Complex64::cis(curvature * (y * y + x * x)) * amplitude;
                    light += on_panel.norm_sqr() * self.pupil.coverage[[row, column]];
                }
            }
            light
        };
        let light: Vec<f64> =
            pupil_field.axis_iter_mut(Axis(0)).into_par_iter().enumerate().map(fill).collect();
        (pupil_field, light.iter().sum::<f64>() * self.grid.pitch_m.powi(2))
    }

    /// Transforms the field over the pupil to the sensor, and integrates its light over the pixels; of what is left to do at
    /// an interrupt nothing is done.
    fn to_sensor(
        &self,
        pupil_field: &Array2<Complex64>,
        wavelength_m: f64,
        progress: &Progress,
    ) -> Array2<f64> {
        let scale = wavelength_m * self.optics.sensor_distance_m;
        let per_pixel = self.integral.samples_per_pixel;
        let sample_m = self.pixel_pitch_m / per_pixel as f64;
        let over_pupil = Points { count: self.grid.size, zero: self.grid.size / 2 };
        let on_sensor = Points {
            count: self.integral.samples(self.size_px),
            zero: self.integral.reach() + self.size_px / 2 * per_pixel,
        };
        let zoom = ChirpZ::new(over_pupil, on_sensor, sample_m * self.grid.pitch_m / scale);
        let across = zoom_rows(pupil_field, &zoom, progress);
        // |1/(λz₂) · Δ² · Σ|², times the pixel's area: the light per pixel.
        let unit = (self.grid.pitch_m.powi(2) / scale * self.pixel_pitch_m).powi(2);
        let mut down = Array2::<f64>::zeros((on_sensor.count, self.size_px));
        let lines = down.axis_iter_mut(Axis(0)).into_par_iter().zip(across.axis_iter(Axis(1)));
        lines.for_each_init(
            || (zoom.workspace(), vec![0.0; on_sensor.count]),
            |(workspace, light), (mut pixels, column)| {
                if progress.check().is_err() {
                    return;
                }
                let spectrum = zoom.process(column.iter().copied(), workspace);
                light.iter_mut().zip(spectrum).for_each(|(light, field)| *light = field.norm_sqr() * unit);
                self.integral.apply(light, pixels.as_slice_mut().expect("rows are contiguous"));
            },
        );
        self.integrate_across(&down)
    }

    /// Integrates columns of samples, each already integrated downwards, over the pixels' widths.
    fn integrate_across(&self, samples: &Array2<f64>) -> Array2<f64> {
        let mut pixels = Array2::<f64>::zeros((self.size_px, self.size_px));
        pixels.axis_iter_mut(Axis(0)).into_par_iter().enumerate().for_each(|(index, mut column)| {
            let first = index * self.integral.samples_per_pixel;
            for (offset, &weight) in self.integral.weights().iter().enumerate() {
                column.scaled_add(weight, &samples.row(first + offset));
            }
        });
        pixels.reversed_axes().as_standard_layout().into_owned()
    }
}

/// Zooms into each row of the field, until an interrupt.
fn zoom_rows(field: &Array2<Complex64>, zoom: &ChirpZ, progress: &Progress) -> Array2<Complex64> {
    let mut rows = Array2::<Complex64>::zeros((field.nrows(), zoom.frequencies()));
    rows.axis_iter_mut(Axis(0)).into_par_iter().zip(field.axis_iter(Axis(0))).for_each_init(
        || zoom.workspace(),
        |workspace, (mut row, line)| {
            if progress.check().is_err() {
                return;
            }
            let spectrum = zoom.process(line.iter().copied(), workspace);
            row.as_slice_mut().expect("rows are contiguous").copy_from_slice(spectrum);
        },
    );
    rows
}

/// Refuses pixels that are so wide, or an aperture that is so large, that light has next to endless detail within a pixel.
fn check_pixels(config: &DisplayConfig, samples_per_pixel: f64) -> Result<()> {
    if samples_per_pixel <= MOST_SAMPLES_PER_PIXEL {
        return Ok(());
    }
    Err(Error::Unsupported(format!(
        "light that passes an aperture of {} mm has detail that takes {samples_per_pixel:.0} samples across a pixel of {} µm, more \
         than {MOST_SAMPLES_PER_PIXEL}; look at the units of optics.aperture-mm, sensor.pixel-pitch-um and the distances of \
         [optics]",
        config.optics.aperture_mm, config.sensor.pixel_pitch_um
    )))
}

/// Refuses a window of so many samples on a side that they would take hours.
fn check_samples(samples: usize) -> Result<()> {
    if samples <= MOST_SAMPLES {
        return Ok(());
    }
    Err(Error::Unsupported(format!(
        "the window takes {samples} samples of the light on a side, more than {MOST_SAMPLES}; reduce sensor.size-px, \
         sensor.pixel-pitch-um or optics.aperture-mm"
    )))
}

/// The arrays that exist at once at the peak: pupil and field, one zoom, and the light on its way to pixels.
fn propagation_bytes(grid: &Grid, samples: usize, size_px: usize) -> usize {
    let over_pupil = grid.size * grid.size * (2 * 8 + 16);
    let half_way = grid.size * samples * 16;
    let light = samples * size_px * 8 + 4 * size_px * size_px * 8;
    over_pupil + half_way + light
}

fn check_memory(needed: usize, what: impl FnOnce() -> String) -> Result<()> {
    if needed <= MEMORY_LIMIT_BYTES {
        return Ok(());
    }
    let gibibytes = needed as f64 / f64::from(1 << 30);
    Err(Error::Unsupported(format!("the propagation needs {gibibytes:.1} GiB for {}", what())))
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;
    use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};

    use super::*;

    /// Each takes years, or more memory than there is, where it is not refused.
    #[test]
    fn absurd_sizes_are_refused_before_the_work() {
        let refusal = |change: fn(&mut DisplayConfig)| {
            let mut config = DisplayConfig::default();
            change(&mut config);
            simulate_psf(&config, &Progress::default()).unwrap_err().to_string()
        };
        let said = refusal(|config| config.optics.aperture_mm = 1e6);
        assert!(said.contains("aperture of 1000000 mm") && said.contains("look at the units"), "{said}");
        let said = refusal(|config| config.sensor.pixel_pitch_um = 1e9);
        assert!(said.contains("a pixel of 1000000000 µm"), "{said}");
        let said = refusal(|config| config.sensor.pixel_pitch_um = 100.0);
        assert!(said.contains("samples of the light on a side, more than 65536"), "{said}");
    }

    /// Sets the flag at the first wavelength that is done.
    #[derive(Clone, Debug, Default)]
    struct StopAtFirst(Arc<AtomicBool>, Arc<AtomicU32>);

    impl crate::core::progress::Reporter for StopAtFirst {
        fn bar(&self, _: u64, _: &'static str) -> Box<dyn crate::core::progress::Bar> {
            Box::new(self.clone())
        }

        fn task(&self, _: String) -> Box<dyn crate::core::progress::Task> {
            Box::new(self.clone())
        }
    }

    impl crate::core::progress::Task for StopAtFirst {}

    impl crate::core::progress::Bar for StopAtFirst {
        fn inc(&self, _: u64) {
            self.0.store(true, Ordering::Relaxed);
            self.1.fetch_add(1, Ordering::Relaxed);
        }

        fn start_at(&self, _: u64) {}

        fn show(&self, _: crate::core::progress::Status) {}

        fn finish_and_clear(&self) {}
    }

    #[test]
    fn an_interrupt_ends_the_work_and_gives_nothing_half_done() {
        let mut config = DisplayConfig::default();
        config.sensor.size_px = 15;
        let stop = StopAtFirst::default();
        let progress = Progress::new(Some(Arc::new(stop.clone())), Arc::clone(&stop.0));
        assert!(simulate_psf(&config, &progress).unwrap_err().is_interrupt());
        assert_eq!(stop.1.load(Ordering::Relaxed), 1);
    }
}
