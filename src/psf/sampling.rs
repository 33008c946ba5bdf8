//! Turns optics and sensor into the grid over the pupil, and refuses one that would alias.
//!
//! # Equation
//! The sensor is the Fourier transform of the pupil: light of local spatial frequency ν in the lens plane lands
//! at u = λz₂ν. A window of half-width w sees frequencies up to `W = w/(λz₂)` on each axis; defocus ε over a pupil D adds
//! at most `|ε|D/2λ` to a wave's frequency. The display must therefore be described up to
//! `B = W + |ε|D/2λ + G`, where the guard `G = 8/D` keeps orders whose Airy rings still reach into the window. The transform of a grid of
//! pitch Δ repeats at 1/Δ; the repetition stays out of the window when
//!
//! `1/Δ ≥ W + B + |ε|D/2λ = 2W + |ε|D/λ + 8/D`.
//!
//! The quadratic phases of Eq. 2 need no more than this: those of source, lens and sensor cancel (see
//! [`optics`](super::optics)), the gap acts on the display's orders, and the transform to the sensor is a
//! zoom that does not wrap around.

use crate::core::error::{Error, Result};

use super::display::SamplingConfig;
use super::optics::Optics;

/// The grid over the pupil, in the lens plane, a point on the axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Grid {
    /// Δ: the distance of points, in metres.
    pub pitch_m: f64,
    /// The number of points on a side.
    pub size: usize,
}

/// What light of one wavelength demands of the grid, all in 1/m in the lens plane.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bandwidth {
    /// W: what the sensor's window sees.
    pub window: f64,
    /// |ε|D/2λ: what defocus adds.
    pub defocus: f64,
    /// G: orders beyond the window whose light still reaches into it.
    pub guard: f64,
}

/// Airy rings of orders outside of the window that are kept: beyond eight the amplitude is below 1 %.
const GUARD_RINGS: f64 = 8.0;
/// How much finer than needed the grid is by default: the pupil's rim is drawn by covered area, and more orders
/// beyond the window are kept.
const COMFORT: f64 = 1.5;
/// The fewest points across the pupil by default, for windows so small that any grid would do.
const FEWEST_ACROSS: f64 = 256.0;
/// The largest grid: 16384² complex numbers would be 4 GiB.
const LARGEST_GRID: usize = 8192;

impl Bandwidth {
    /// Finds the bandwidth for a window of half-width `window_m` on the sensor.
    pub fn new(optics: &Optics, wavelength_m: f64, window_m: f64) -> Self {
        Self {
            window: window_m / (wavelength_m * optics.sensor_distance_m),
            defocus: optics.defocus_per_m.abs() * optics.aperture_m / (2.0 * wavelength_m),
            guard: GUARD_RINGS / optics.aperture_m,
        }
    }

    /// 1/Δ of the coarsest grid that does not alias.
    pub fn required(&self) -> f64 {
        2.0 * (self.window + self.defocus) + self.guard
    }

    /// B: the highest frequency in the lens plane that a grid of pitch Δ has room for on each axis.
    pub fn display_band(&self, grid: &Grid) -> f64 {
        1.0 / grid.pitch_m - self.window - self.defocus
    }
}

impl Grid {
    /// Chooses the grid, or checks the one that was asked for.
    ///
    /// # Errors
    /// [`Error::Config`] naming a grid that would do, when the one asked for aliases or misses part of the
    /// pupil; also when no grid of reasonable size would do.
    pub fn new(config: &SamplingConfig, optics: &Optics, shortest: &Bandwidth) -> Result<Self> {
        let coarsest_m = 1.0 / shortest.required();
        let pitch_m = match (config.grid_pitch_um, config.grid_size) {
            (Some(pitch_um), _) if pitch_um.is_finite() && pitch_um > 0.0 => pitch_um * 1e-6,
            (Some(pitch_um), _) => {
                let reason = format!("must be a positive length, found {pitch_um}");
                return Err(Error::config("sampling.grid-pitch-um", reason));
            }
            (None, Some(size)) => optics.aperture_m / (size.max(5) - 4) as f64,
            (None, None) => (coarsest_m / COMFORT).min(optics.aperture_m / FEWEST_ACROSS),
        };
        let enough = points_across(optics, pitch_m);
        let grid = Self { pitch_m, size: config.grid_size.unwrap_or(enough) };
        let would_do = format!(
            "a grid pitch of at most {:.3} µm, {} points on a side, would do",
            coarsest_m * 1e6,
            points_across(optics, coarsest_m)
        );
        if grid.pitch_m > coarsest_m * (1.0 + 1e-9) {
            let key =
                if config.grid_pitch_um.is_some() { "sampling.grid-pitch-um" } else { "sampling.grid-size" };
            let pitch_um = grid.pitch_m * 1e6;
            let reason =
                format!("a grid pitch of {pitch_um:.3} µm aliases into the sensor's window; {would_do}");
            return Err(Error::config(key, reason));
        }
        if grid.size < enough {
            let span_mm = grid.size as f64 * grid.pitch_m * 1e3;
            let reason = format!("the grid spans {span_mm:.3} mm and misses part of the pupil; {would_do}");
            return Err(Error::config("sampling.grid-size", reason));
        }
        if grid.size > LARGEST_GRID {
            return Err(Error::Unsupported(format!(
                "the light needs a grid of {} points on a side, more than {LARGEST_GRID}; reduce sensor.size-px, \
                 sensor.pixel-pitch-um, the defocus or the aperture, or set a coarser [sampling] grid",
                grid.size
            )));
        }
        Ok(grid)
    }
}

/// The points that the pupil and a margin of two for its drawn rim need.
fn points_across(optics: &Optics, pitch_m: f64) -> usize {
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "saturates, and is bounded after"
    )]
    let across = (optics.aperture_m / pitch_m).ceil() as usize;
    across.saturating_add(4)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::psf::display::OpticsConfig;

    fn optics() -> Optics {
        Optics::new(&OpticsConfig::default()).unwrap()
    }

    fn bandwidth() -> Bandwidth {
        Bandwidth::new(&optics(), 465e-9, 450e-6)
    }

    #[test]
    fn the_grid_chosen_has_room_for_window_and_repetition() {
        let grid = Grid::new(&SamplingConfig::default(), &optics(), &bandwidth()).unwrap();
        let band = bandwidth();
        assert!(1.0 / grid.pitch_m - band.display_band(&grid) >= band.window);
        assert!(band.display_band(&grid) > band.window + band.guard);
        assert!(grid.size as f64 * grid.pitch_m > optics().aperture_m);
    }

    #[test]
    fn the_grid_that_a_refusal_names_is_accepted() {
        let coarse = SamplingConfig { grid_pitch_um: Some(4.0), grid_size: None };
        let message = Grid::new(&coarse, &optics(), &bandwidth()).unwrap_err().to_string();
        let named = message.split("at most ").nth(1).unwrap().split(' ').next().unwrap();
        let pitch: f64 = named.parse().unwrap();
        // The message rounds to a nanometre.
        let better = SamplingConfig { grid_pitch_um: Some(pitch - 0.0005), grid_size: None };
        assert!(Grid::new(&better, &optics(), &bandwidth()).is_ok(), "{message}");
    }

    #[test]
    fn refuses_a_grid_that_misses_part_of_the_pupil() {
        let small = SamplingConfig { grid_pitch_um: Some(0.5), grid_size: Some(1000) };
        let message = Grid::new(&small, &optics(), &bandwidth()).unwrap_err().to_string();
        assert!(message.contains("misses part of the pupil"), "{message}");
        let size_only = SamplingConfig { grid_pitch_um: None, grid_size: Some(300) };
        let message = Grid::new(&size_only, &optics(), &bandwidth()).unwrap_err().to_string();
        assert!(message.contains("sampling.grid-size") && message.contains("aliases"), "{message}");
    }
}
