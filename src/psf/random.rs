//! Turns a seed into a plausible panel with lens, sensor and light: what a training set that must fit any panel needs.
//!
//! # Method
//! Three styles of panel: emitters of a PenTile or of a stripe layout on clear ground, and clear windows in dark ground.
//! Half of them are irregular. The ranges are those of published under-display panels and phones' front cameras, with room
//! beyond. What would be no panel to look through, or nearly none at all, is drawn anew: the share of the passing light that
//! keeps its direction, `(mean t)² / mean t²`, must lie between [`FAINTEST`] and [`CLEAREST`].

use std::f64::consts::LN_2;

use rand::RngExt as _;

use crate::core::rng::{Rng, stream};

use super::display::{
    Direction, DisplayConfig, IrregularityConfig, LayoutConfig, LayoutKind, OpeningConfig, OpticsConfig,
    PixelConfig, RegionConfig, SpectrumConfig, WiringConfig,
};
use super::panel;
use super::shape::ShapeKind;

/// The least and the largest share of the light that a drawn panel lets go straight on.
pub const FAINTEST: f64 = 0.35;
/// See [`FAINTEST`].
pub const CLEAREST: f64 = 0.95;

/// The side of the PSF in pixels: orders of a pitch of 60 µm reach the fifth or so.
const SIZE_PX: usize = 401;

/// Draws a panel with its lens, sensor and light: the same for the same seed, and [`check`](DisplayConfig::check)ed.
///
/// Numbers are rounded as a person would write them, so that a written display file is the same panel to the bit.
#[must_use]
pub fn random_display(seed: u64) -> DisplayConfig {
    let mut draw = Draw { rng: stream(seed, "psf/random") };
    DisplayConfig {
        optics: draw.optics(),
        sensor: PixelConfig { pixel_pitch_um: draw.between(0.8, 1.6, 3), size_px: SIZE_PX },
        spectrum: SpectrumConfig {
            red: draw.lines(595.0, 625.0),
            green: draw.lines(520.0, 545.0),
            blue: draw.lines(450.0, 475.0),
        },
        display: draw.plausible_panel(),
        ..DisplayConfig::default()
    }
}

/// The share of the passing light that no order or haze takes: that of order zero.
///
/// # Range
/// 0 to 1; 1 for a bare lens.
fn straight_share(layout: &LayoutConfig) -> f64 {
    // The coarsest raster is enough for areas.
    let cell = panel::draw(layout, 0.0);
    cell.transmittance.mean().unwrap_or_default().powi(2) / cell.mean_power()
}

/// Where all numbers come from.
struct Draw {
    rng: Rng,
}

impl Draw {
    /// A number between two bounds, of so many decimals.
    fn between(&mut self, low: f64, high: f64, decimals: i32) -> f64 {
        rounded(self.rng.random_range(low..high), decimals)
    }

    fn happens(&mut self, probability: f64) -> bool {
        self.rng.random_bool(probability)
    }

    fn one_of<T: Copy>(&mut self, choices: &[T]) -> T {
        choices[self.rng.random_range(0..choices.len())]
    }

    /// f/1.6 to f/2.8 at 2 to 5 mm, the source from 0.3 m away to a star, a part of them slightly out of focus.
    fn optics(&mut self) -> OpticsConfig {
        let source_distance_m = if self.happens(0.4) {
            f64::INFINITY
        } else {
            rounded(10f64.powf(self.between(-0.52, 1.5, 4)), 3)
        };
        let focal_length_mm = self.between(2.0, 5.0, 3);
        let f_number = self.between(1.6, 2.8, 4);
        let display_to_lens_mm = self.between(0.4, 2.5, 3);
        // The longest way that defocus ε makes over the pupil, W = εD²/8, moves the sensor by 8·W·(f/D)².
        let way_um =
            if self.happens(0.3) { self.between(0.03, 0.18, 4) * self.one_of(&[-1.0, 1.0]) } else { 0.0 };
        let vergence = 1.0 / (source_distance_m * 1e3 + display_to_lens_mm);
        let in_focus_mm = 1.0 / (1.0 / focal_length_mm - vergence);
        let moved_mm = 8.0 * way_um * f_number.powi(2) * 1e-3;
        OpticsConfig {
            source_distance_m,
            display_to_lens_mm,
            focal_length_mm,
            aperture_mm: rounded(focal_length_mm / f_number, 3),
            sensor_distance_mm: (way_um.abs() > 0.0).then(|| rounded(in_focus_mm + moved_mm, 6)),
        }
    }

    /// A bell of wavelengths that falls to one half 5 to 25 nm from its middle, cut off there.
    fn lines(&mut self, low_nm: f64, high_nm: f64) -> Vec<(f64, f64)> {
        let (centre_nm, half_nm) = (self.between(low_nm, high_nm, 1), self.between(5.0, 25.0, 1));
        // At most 9 nm apart: far orders of neighbouring lines then overlap.
        let on_each_side: i32 = if half_nm < 9.0 {
            1
        } else if half_nm < 18.0 {
            2
        } else {
            3
        };
        (-on_each_side..=on_each_side)
            .map(|index| {
                let place = f64::from(index) / f64::from(on_each_side);
                (rounded(centre_nm + place * half_nm, 1), rounded((-LN_2 * place * place).exp(), 3))
            })
            .collect()
    }

    fn plausible_panel(&mut self) -> LayoutConfig {
        loop {
            let layout = self.panel();
            if (FAINTEST..=CLEAREST).contains(&straight_share(&layout)) {
                return layout;
            }
        }
    }

    fn panel(&mut self) -> LayoutConfig {
        let pitch_um = self.between(45.0, 100.0, 2);
        let mut layout = match self.rng.random_range(0..5) {
            0 | 1 => self.pentile(pitch_um),
            2 | 3 => self.stripe(pitch_um),
            _ => self.windows(pitch_um),
        };
        layout.pitch_um = Some(pitch_um);
        layout.angle_deg = self.between(-1.0, 1.0, 2);
        layout.offset_um = [0, 1].map(|_| self.between(-pitch_um, pitch_um, 1));
        let lines = self.rng.random_range(0..=3);
        layout.wiring = (0..lines).map(|_| self.line(pitch_um)).collect();
        layout.irregularity = self.happens(0.5).then(|| self.irregularity(pitch_um));
        layout
    }

    fn pentile(&mut self, pitch_um: f64) -> LayoutConfig {
        let side_um = pitch_um * self.between(0.15, 0.5, 3);
        let (shape, transmittance) = (self.shape(), self.between(0.0, 0.3, 3));
        let blue = self.between(1.1, 1.5, 3);
        let green = self.between(0.8, 1.25, 3);
        let mut emitter = |shape, [height, width]: [f64; 2]| {
            Some(self.region(shape, [height * side_um, width * side_um], transmittance))
        };
        LayoutConfig {
            kind: LayoutKind::Pentile,
            red: emitter(shape, [1.1, 1.1]),
            green: emitter(ShapeKind::Ellipse, [0.8 * green, 0.8]),
            blue: emitter(shape, [blue, blue]),
            background_transmittance: Some(self.between(0.7, 0.98, 3)),
            ..LayoutConfig::default()
        }
    }

    fn stripe(&mut self, pitch_um: f64) -> LayoutConfig {
        let height_um = pitch_um * self.between(0.25, 0.85, 3);
        let transmittance = self.between(0.0, 0.3, 3);
        let mut emitter = || {
            let width_um = pitch_um * self.between(0.08, 0.28, 3);
            Some(self.region(ShapeKind::Rectangle, [height_um, width_um], transmittance))
        };
        LayoutConfig {
            kind: LayoutKind::Stripe,
            red: emitter(),
            green: emitter(),
            blue: emitter(),
            background_transmittance: Some(self.between(0.7, 0.98, 3)),
            ..LayoutConfig::default()
        }
    }

    /// A dark panel with one clear window in each pixel.
    fn windows(&mut self, pitch_um: f64) -> LayoutConfig {
        let (shape, transmittance) = (self.shape(), self.between(0.7, 0.98, 3));
        let sides_um = [0, 1].map(|_| pitch_um * self.between(0.6, 0.95, 3));
        let window = self.region(shape, sides_um, transmittance);
        let opening = OpeningConfig {
            x_um: 0.0,
            y_um: 0.0,
            shape: window.shape,
            width_um: window.width_um,
            height_um: window.height_um,
            corner_um: window.corner_um,
            transmittance: window.transmittance,
        };
        LayoutConfig {
            kind: LayoutKind::Stripe,
            openings: vec![opening],
            background_transmittance: Some(self.between(0.0, 0.25, 3)),
            ..LayoutConfig::default()
        }
    }

    fn shape(&mut self) -> ShapeKind {
        self.one_of(&[ShapeKind::Rectangle, ShapeKind::Ellipse, ShapeKind::Diamond])
    }

    fn region(&mut self, shape: ShapeKind, [height, width]: [f64; 2], transmittance: f64) -> RegionConfig {
        let (width_um, height_um) = (rounded(width, 2), rounded(height, 2));
        let radius = self.between(0.0, 0.49, 3) * width_um.min(height_um);
        let corner_um = if shape == ShapeKind::Rectangle { rounded(radius, 2) } else { 0.0 };
        RegionConfig { shape, width_um, height_um, corner_um, transmittance }
    }

    fn line(&mut self, pitch_um: f64) -> WiringConfig {
        WiringConfig {
            direction: self.one_of(&[Direction::Horizontal, Direction::Vertical]),
            position_um: self.between(-pitch_um / 2.0, pitch_um / 2.0, 2),
            width_um: self.between(2.0, 7.0, 2),
            transmittance: self.between(0.0, 0.3, 3),
        }
    }

    fn irregularity(&mut self, pitch_um: f64) -> IrregularityConfig {
        IrregularityConfig {
            pixels: self.one_of(&[4, 6, 8, 10, 12]),
            seed: self.rng.random_range(0..1_000_000),
            jitter_um: rounded(pitch_um * self.between(0.02, 0.2, 4), 2),
            size_spread: if self.happens(0.5) { self.between(0.05, 0.35, 3) } else { 0.0 },
        }
    }
}

fn rounded(value: f64, decimals: i32) -> f64 {
    let unit = 10f64.powi(decimals);
    (value * unit).round() / unit
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;
    use crate::core::progress::Progress;
    use crate::psf::{assess_psf, simulate_psf};

    /// Small enough for a test, large enough for the first orders.
    fn small(seed: u64) -> DisplayConfig {
        let mut config = random_display(seed);
        config.sensor.size_px = 81;
        config
    }

    #[test]
    fn the_same_seed_is_the_same_panel_and_another_is_another() {
        for seed in 0..40 {
            let config = random_display(seed);
            config.check().unwrap();
            assert_eq!(config, random_display(seed));
            assert_ne!(config.display, random_display(seed + 1).display);
            let share = straight_share(&config.display);
            assert!((FAINTEST..=CLEAREST).contains(&share), "seed {seed}: {share}");
        }
    }

    #[test]
    fn all_styles_are_drawn() {
        let panels: Vec<_> = (0..40).map(|seed| random_display(seed).display).collect();
        let some = |test: fn(&LayoutConfig) -> bool| panels.iter().filter(|panel| test(panel)).count() >= 4;
        assert!(some(|panel| panel.kind == LayoutKind::Pentile));
        assert!(some(|panel| panel.red.is_some() && panel.kind == LayoutKind::Stripe));
        assert!(some(|panel| !panel.openings.is_empty()));
        assert!(some(|panel| panel.irregularity.is_some()));
        assert!(some(|panel| panel.irregularity.is_none()));
        assert!(some(|panel| panel.wiring.is_empty()) && some(|panel| panel.wiring.len() == 3));
    }

    #[test]
    fn panels_simulate_to_psfs_whose_peak_is_in_the_centre() {
        for seed in 0..8 {
            let simulated = simulate_psf(&small(seed), &Progress::default()).unwrap();
            for channel in 0..3 {
                let plane = simulated.psf.channel(channel);
                let brightest = plane.indexed_iter().max_by(|a, b| a.1.total_cmp(b.1)).unwrap().0;
                assert_eq!(brightest, simulated.psf.centre(), "seed {seed}, channel {channel}");
            }
            assert!(assess_psf(&simulated.psf).channels.iter().all(|channel| channel.peak_share > 0.02));
        }
    }

    /// Rounded decimals read back to the bit, so that nothing of the PSF may differ.
    #[test]
    fn a_written_panel_reads_back_and_simulates_to_the_same_psf() {
        let irregular = (0..).find(|&seed| random_display(seed).display.irregularity.is_some()).unwrap();
        for seed in [irregular, irregular + 1] {
            let config = small(seed);
            let text = toml::to_string(&config).unwrap();
            let again = DisplayConfig::parse(&text, Path::new("panel.toml")).unwrap();
            assert_eq!(again, config, "{text}");
            let psf = |config| simulate_psf(config, &Progress::default()).unwrap().psf;
            assert_eq!(psf(&again), psf(&config));
        }
    }

    /// The origin in a PSF's file is JSON, which has no infinity.
    #[test]
    fn the_display_in_a_files_origin_is_the_whole_panel() {
        for seed in 0..10 {
            let config = random_display(seed);
            let json = serde_json::to_string(&config).unwrap();
            assert_eq!(serde_json::from_str::<DisplayConfig>(&json).unwrap(), config, "{json}");
        }
    }
}
