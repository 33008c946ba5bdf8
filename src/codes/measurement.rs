//! Gives a PSF the errors that a measurement of it has: turned, scaled, out of focus, cut off, noisy.

use ndarray::{Array2, Array3, ArrayView2, Axis, s};
use rand::RngExt as _;
use rand_distr::StandardNormal;
use serde::{Deserialize, Serialize};

use super::resample::Interpolation;
use crate::core::error::{Error, Result};
use crate::core::haze::without_noise;
use crate::core::psf::Psf;
use crate::core::rng::Rng;

/// By how much a measured PSF differs from that of the capture that it is to restore; all zero for a perfect one.
///
/// They act in the order of their names here: the panel has been mounted anew or warmed up, the focus is another, the
/// window is cut out, the sensor adds its noise.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields, rename_all = "kebab-case")]
pub struct MeasurementErrors {
    /// Turned about the centre by so many degrees, counter-clockwise as displayed.
    pub turn_deg: f64,
    /// Larger by this share: orders stand at 1 + this times their distance. Above −0.5, at most 1.
    pub scale: f64,
    /// Blurred to both sides by this standard deviation in pixels; a disc of defocus of radius r has r/2. 0 to 16.
    pub defocus_px: f64,
    /// Standard deviation σ of the noise where it is dark, as a share of the brightest pixel. Light of value v has the
    /// variance σ² + σv: the photon noise of a sensor that reads out with the noise of one electron. 0 to below 1.
    pub noise: f64,
    /// The side of the square that was measured, in pixels, where it is smaller than the PSF.
    pub reach_px: Option<usize>,
}

/// The widest blur: what is further out of focus is no camera's error.
const WIDEST_BLUR_PX: f64 = 16.0;

impl MeasurementErrors {
    /// Draws the errors of a careful measurement of a PSF of side `size_px`: a third of them none at all.
    ///
    /// The rest: turned by 0.2° and scaled by 0.3 % (standard deviations), a blur of up to 0.7 pixels, noise from 10⁻⁶ to
    /// 10⁻⁴ of the peak, and every other one cut off at half of its side or more.
    ///
    /// # Panics
    /// Never: the ranges are not empty.
    #[must_use]
    pub fn draw(rng: &mut Rng, size_px: usize) -> Self {
        if rng.random_ratio(1, 3) {
            return Self::default();
        }
        let mut normal = |deviation: f64| deviation * rng.sample::<f64, _>(StandardNormal);
        let (turn_deg, scale) = (normal(0.2), normal(0.003).clamp(-0.1, 0.1));
        Self {
            turn_deg,
            scale,
            defocus_px: rng.random_range(0.0..0.7),
            noise: 10f64.powf(rng.random_range(-6.0..-4.0)),
            reach_px: rng.random_bool(0.5).then(|| rng.random_range(size_px.div_ceil(2)..=size_px.max(1))),
        }
    }

    /// Whether nothing is wrong.
    #[must_use]
    pub fn is_none(&self) -> bool {
        *self == Self::default()
    }

    /// What such a measurement of `psf` hands over: its centre at N/2, each channel of unit sum, light below the noise
    /// averaged as [`measure_psf`](crate::psf::measure_psf) does.
    ///
    /// Turning and scaling are one resampling; light from beyond the border is zero.
    ///
    /// # Shapes
    /// `reach_px` squared, but no larger than `psf`.
    ///
    /// # Errors
    /// [`Error::Config`] naming a value out of range; [`Error::Unsupported`] when a channel turns dark.
    ///
    /// # Panics
    /// Never: all channels have one size.
    pub fn apply(&self, psf: &Psf, rng: &mut Rng) -> Result<Psf> {
        self.check()?;
        if self.is_none() {
            return Ok(psf.clone());
        }
        let mut channels = Vec::new();
        for channel in 0..psf.planes().len_of(Axis(0)) {
            let moved = self.moved(psf.channel(channel));
            let blurred = blurred(moved, &gaussian(self.defocus_px));
            let seen = self.within_reach(blurred);
            channels.push(self.noisy(seen, rng));
        }
        let views: Vec<_> = channels.iter().map(|channel| channel.view()).collect();
        let planes: Array3<f64> = ndarray::stack(Axis(0), &views).expect("channels have one size");
        #[expect(clippy::cast_possible_truncation, reason = "PSF values are f32")]
        Psf::from_energy(planes.mapv(|value| value as f32))
    }

    fn check(&self) -> Result<()> {
        let require = |key: &str, is_right: bool, range: &str, found: f64| {
            if is_right { Ok(()) } else { Err(Error::config(key, format!("must be {range}, found {found}"))) }
        };
        let Self { turn_deg, scale, defocus_px, noise, reach_px } = *self;
        require("turn", turn_deg.is_finite(), "a number of degrees", turn_deg)?;
        require("scale", scale > -0.5 && scale <= 1.0, "above -0.5 and at most 1", scale)?;
        let blur = "a number of pixels from 0 to 16";
        require("defocus", (0.0..=WIDEST_BLUR_PX).contains(&defocus_px), blur, defocus_px)?;
        require("noise", (0.0..1.0).contains(&noise), "a share of the peak from 0 to below 1", noise)?;
        require("reach", reach_px != Some(0), "at least 1 pixel", 0.0)
    }

    /// Turns and scales a channel about its centre.
    ///
    /// # Equation
    /// As in [`rotate`](super::rotate), but that the pixel takes its light from 1/(1 + s) of the distance.
    fn moved(&self, channel: ArrayView2<'_, f32>) -> Array2<f64> {
        if self.turn_deg.abs() + self.scale.abs() <= 0.0 {
            return channel.mapv(f64::from);
        }
        let (sin, cos) = self.turn_deg.to_radians().sin_cos();
        let (sin, cos) = (sin / (1.0 + self.scale), cos / (1.0 + self.scale));
        let (height, width) = channel.dim();
        let (centre_y, centre_x) = ((height / 2) as f64, (width / 2) as f64);
        let moved = Interpolation::new(channel).sample((height, width), |y, x| {
            let (dy, dx) = (y as f64 - centre_y, x as f64 - centre_x);
            (centre_y + dy * cos + dx * sin, centre_x + dx * cos - dy * sin)
        });
        moved.mapv(f64::from)
    }

    /// The window of the measurement around the centre.
    fn within_reach(&self, light: Array2<f64>) -> Array2<f64> {
        let (height, width) = light.dim();
        let part = |length: usize| {
            let kept = self.reach_px.unwrap_or(length).min(length);
            let first = length / 2 - kept / 2;
            first..first + kept
        };
        light.slice(s![part(height), part(width)]).to_owned()
    }

    fn noisy(&self, mut light: Array2<f64>, rng: &mut Rng) -> Array2<f64> {
        if self.noise <= 0.0 {
            return light;
        }
        let deviation = self.noise * light.iter().copied().fold(0.0, f64::max);
        light.mapv_inplace(|value| {
            let variance = deviation * (deviation + value.max(0.0));
            value + variance.sqrt() * rng.sample::<f64, _>(StandardNormal)
        });
        without_noise(light.view(), deviation)
    }
}

/// The weights of a blur from its middle on.
///
/// # Equation
/// The discrete Gaussian `e^(−t) I_n(t)` with t = σ², the blur whose variance is σ² on a lattice, however narrow it is
/// (Lindeberg, "Scale-space for discrete signals", 1990). `I_n(t) = Σ (t/2)^(2k+n) / (k! (k+n)!)`.
///
/// # Accuracy
/// What is cut off beyond 6 σ + 4 is below 1e-9.
fn gaussian(deviation_px: f64) -> Vec<f64> {
    let half = deviation_px.powi(2) / 2.0;
    let mut first = (-2.0 * half).exp();
    let mut weights = Vec::new();
    for n in 0..=rounded_up(6.0 * deviation_px) + if half > 0.0 { 4 } else { 0 } {
        let (mut term, mut sum, mut k) = (first, first, 0.0);
        while term > 1e-17 * sum {
            k += 1.0;
            term *= half * half / (k * (k + n as f64));
            sum += term;
        }
        weights.push(sum);
        first *= half / (n as f64 + 1.0);
    }
    weights
}

#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a few pixels")]
fn rounded_up(count: f64) -> usize {
    count.ceil() as usize
}

/// Blurs along both axes with weights from the middle on; beyond the border it is dark.
fn blurred(light: Array2<f64>, weights: &[f64]) -> Array2<f64> {
    if weights.len() == 1 {
        return light;
    }
    let along = |light: &Array2<f64>, axis: Axis| {
        let length = light.len_of(axis);
        let mut blurred = light.mapv(|value| value * weights[0]);
        for (distance, &weight) in weights.iter().enumerate().skip(1).take_while(|(n, _)| *n < length) {
            let (near, far) = (length - distance, distance);
            for (to, from) in [(0..near, far..length), (far..length, 0..near)] {
                blurred
                    .slice_axis_mut(axis, to.into())
                    .scaled_add(weight, &light.slice_axis(axis, from.into()));
            }
        }
        blurred
    };
    along(&along(&light, Axis(0)), Axis(1))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::progress::Progress;
    use crate::core::rng::stream;
    use crate::psf::random::random_display;
    use crate::psf::simulate_psf;

    const SIDE: usize = 241;
    const CENTRE: f64 = 120.0;

    /// A core, and an order 100 pixels right of it.
    fn spots() -> Psf {
        let spot = |y: usize, x: usize, right: f64| {
            (-((y as f64 - CENTRE).powi(2) + (x as f64 - CENTRE - right).powi(2)) / 8.0).exp()
        };
        Psf::from_energy(Array3::from_shape_fn((3, SIDE, SIDE), |(_, y, x)| {
            (spot(y, x, 0.0) + 0.1 * spot(y, x, 100.0)) as f32
        }))
        .unwrap()
    }

    fn apply(errors: MeasurementErrors, psf: &Psf) -> Psf {
        errors.apply(psf, &mut stream(5, "errors")).unwrap()
    }

    /// Sum, centroid and variance along x of the light within 12 pixels of a place, all from the centre.
    fn moments(psf: &Psf, down: f64, right: f64) -> (f64, [f64; 2], f64) {
        let (centre_y, centre_x) = psf.centre();
        let (mut sum, mut first, mut second) = (0.0, [0.0; 2], 0.0);
        for ((y, x), &value) in psf.channel(1).indexed_iter() {
            let place = [y as f64 - centre_y as f64, x as f64 - centre_x as f64];
            if (place[0] - down).abs().max((place[1] - right).abs()) <= 12.0 {
                sum += f64::from(value);
                (0..2).for_each(|axis| first[axis] += f64::from(value) * place[axis]);
                second += f64::from(value) * place[1].powi(2);
            }
        }
        let mean = first.map(|moment| moment / sum);
        (sum, mean, second / sum - mean[1].powi(2))
    }

    #[test]
    fn turning_and_scaling_move_an_order_to_its_place() {
        for (turn_deg, scale) in [(0.3, 0.0), (0.0, 0.005), (-0.7, -0.004), (2.0, 0.01)] {
            let moved =
                apply(MeasurementErrors { turn_deg, scale, ..MeasurementErrors::default() }, &spots());
            let (sin, cos) = f64::to_radians(turn_deg).sin_cos();
            let distance = 100.0 * (1.0 + scale);
            // Counter-clockwise as displayed: what is on the right goes up.
            let expected = [-distance * sin, distance * cos];
            let (_, found, _) = moments(&moved, expected[0], expected[1]);
            for (found, expected) in found.iter().zip(expected) {
                // Resampling moves light by a hundredth of a pixel where the PSF is resolved.
                assert!(
                    (found - expected).abs() < 0.01,
                    "{turn_deg}°, {scale}: {found} instead of {expected}"
                );
            }
            let (_, core, _) = moments(&moved, 0.0, 0.0);
            assert!(core.iter().all(|place| place.abs() < 0.01), "the centre stays: {core:?}");
        }
    }

    #[test]
    fn a_turn_of_a_panel_and_back_agrees_to_what_resampling_achieves() {
        let mut config = random_display(1);
        config.sensor.size_px = SIDE;
        let psf = simulate_psf(&config, &Progress::default()).unwrap().psf;
        let turned =
            |psf, turn_deg| apply(MeasurementErrors { turn_deg, ..MeasurementErrors::default() }, psf);
        let there = turned(&psf, 0.3);
        let back = turned(&there, -0.3);
        let difference = |a: &Psf, b: &Psf| -> f64 {
            a.channel(1).iter().zip(b.channel(1)).map(|(a, b)| f64::from((a - b).abs())).sum()
        };
        // The head of resample.rs: 5.7 and 7.3 % for the shipped panels.
        assert!(difference(&back, &psf) < 0.06, "{}", difference(&back, &psf));
        assert!(difference(&there, &psf) > difference(&back, &psf));
    }

    #[test]
    fn a_blur_adds_its_variance_and_keeps_the_light() {
        for defocus_px in [0.05, 0.3, 0.7, 1.0] {
            let (sum, _, before) = moments(&spots(), 0.0, 0.0);
            let blurred = apply(MeasurementErrors { defocus_px, ..MeasurementErrors::default() }, &spots());
            let (kept, _, after) = moments(&blurred, 0.0, 0.0);
            assert!((kept - sum).abs() < 1e-5);
            // Of a core of σ = √5 at most, 1e-7 lie beyond 12 pixels, where they count 144 times.
            assert!(
                (after - before - defocus_px.powi(2)).abs() < 1e-4,
                "{defocus_px}: {before}, then {after}"
            );
        }
        let weights = gaussian(16.0);
        let sum = weights[0] + 2.0 * weights[1..].iter().sum::<f64>();
        assert!((sum - 1.0).abs() < 1e-9, "{sum}");
    }

    /// Clipped pixel by pixel, noise of 10⁻⁴ would make a haze of 241² · 10⁻⁴/√(2π) = 2.3 peaks: 8 % of this light.
    #[test]
    fn noise_lifts_no_haze() {
        let noise = 1e-4;
        let noisy = apply(MeasurementErrors { noise, ..MeasurementErrors::default() }, &spots());
        let (sum, ..) = moments(&spots(), 0.0, 0.0);
        let (found, ..) = moments(&noisy, 0.0, 0.0);
        assert!((found / sum - 1.0).abs() < 0.01, "{found} instead of {sum}");
        assert_ne!(noisy, spots());
        assert_ne!(noisy.channel(0), noisy.channel(1), "colours have noise of their own");
    }

    #[test]
    fn the_window_is_cut_out_around_the_centre_and_sums_to_one() {
        for reach in [100, 101, 240, 241, 500] {
            let cut = MeasurementErrors { reach_px: Some(reach), ..MeasurementErrors::default() };
            let cut = apply(cut, &spots());
            assert_eq!([cut.height(), cut.width()], [reach.min(SIDE); 2]);
            let brightest = cut.channel(0).indexed_iter().max_by(|a, b| a.1.total_cmp(b.1)).unwrap().0;
            assert_eq!(brightest, cut.centre());
            assert!((cut.channel(2).iter().map(|&v| f64::from(v)).sum::<f64>() - 1.0).abs() < 1e-6);
        }
    }

    #[test]
    fn draws_repeat_and_a_third_of_them_is_perfect() {
        let draw = |seed| MeasurementErrors::draw(&mut stream(seed, "draw"), 401);
        let errors: Vec<_> = (0..300).map(draw).collect();
        assert_eq!(errors[7], draw(7));
        let perfect = errors.iter().filter(|errors| errors.is_none()).count();
        // 100 ± 8.2: four standard deviations.
        assert!((67..=133).contains(&perfect), "{perfect}");
        for errors in errors.iter().filter(|errors| !errors.is_none()) {
            errors.check().unwrap();
            assert!(errors.reach_px.is_none_or(|reach| (201..=401).contains(&reach)));
        }
        assert_eq!(MeasurementErrors::default().apply(&spots(), &mut stream(0, "")).unwrap(), spots());
    }

    #[test]
    fn refuses_errors_out_of_range_by_name() {
        let refused =
            |errors: MeasurementErrors| errors.apply(&spots(), &mut stream(0, "")).unwrap_err().to_string();
        let none = MeasurementErrors::default();
        assert!(refused(MeasurementErrors { turn_deg: f64::NAN, ..none }).contains("turn"));
        assert!(refused(MeasurementErrors { scale: -0.5, ..none }).contains("scale"));
        assert!(refused(MeasurementErrors { defocus_px: -1.0, ..none }).contains("defocus"));
        assert!(refused(MeasurementErrors { noise: 1.0, ..none }).contains("noise"));
        assert!(refused(MeasurementErrors { reach_px: Some(0), ..none }).contains("reach"));
    }
}
