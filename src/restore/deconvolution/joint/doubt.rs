//! What is left of a capture where flare that was taken from it is not known well enough.
//!
//! The flare of a sun is a hundred times as bright as the sky behind it, and no measured PSF is known to a hundredth. What is left there
//! are errors of the flare: dots, some brighter than the sky, some darker than darkness, in colours that the scene does not have. The
//! scene around is a better guess.
//!
//! # Method
//! 1. How large errors are is told by what is left below zero, where no scene is: `ε² = 2 G(max(−r, 0)²/B²)/G(F²/B²)`, at most 1, with the
//!    bell G, what is left r, the flare F and the capture's brightness B, half of the squares of errors being below zero. Of one whose
//!    PSF is exact it is 10⁻³ and less, of measured ones up to 4·10⁻².
//! 2. Not all of them are below zero. The fine detail of a scene is much the same in all colours, relative to its light, that of errors is
//!    not: what colours do not share beyond what they do not share elsewhere are errors too, up to 10 times the mean ε² of the squared
//!    flare.
//! 3. r becomes `c r + (1 − c) p` with `c = s²/(s² + V)`, the best estimate from a value with errors of variance V and a prior: p is
//!    the mean of what is believed around it, s the deviation from it that the scene has where there is no flare. Both follow from
//!    what is believed, c, and are found in a few passes.

use ndarray::{Array2, Zip};

use super::frame::{copy_of, row};
use super::smooth::smoothed;

/// Standard deviation of the bell over which errors of flare are alike, in pixels: some orders of a panel.
const ALIKE_PX: f32 = 12.0;

/// Standard deviation of the bell that fine detail is told from, in pixels.
const DETAIL_PX: f32 = 8.0;

/// Standard deviations of the bells over which the scene around is taken, and its contrast, in pixels, the widest first; and
/// the share of a bell that has to be believed for its mean to count half.
const AROUND_PX: [f32; 6] = [64.0, 32.0, 16.0, 8.0, 4.0, 2.0];
const CONTRAST_PX: [f32; 5] = [128.0, 64.0, 32.0, 16.0, 8.0];
const HALF_SHARE: f32 = 0.1;

/// The contrast of a scene of which nothing is without flare, and the least and the most that is believed.
const USUAL_CONTRAST: f32 = 0.3;
const CONTRASTS: [f32; 2] = [0.03, 0.5];

/// The flare beside the scene's light below which there is as good as none.
const NO_FLARE: f32 = 0.03;

/// The quantile of what colours do not share without flare that is not taken for errors, what that is where nothing is without flare, and
/// the least part of the pixels that tells it.
const SHARED: f32 = 0.75;
const USUALLY_APART: f32 = 0.1;
const LEAST_PART: f32 = 0.02;

/// The variance of an error over that of the part of it that three colours do not share.
const OF_APART: f32 = 1.5;

/// The mean of ε² beside which errors that are told by their colours are as large as this at most.
const MOST_BY_COLOR: f32 = 10.0;

const PASSES: usize = 3;

/// A channel of a capture from which flare was taken.
pub(super) struct Doubtful {
    /// What is left.
    pub(super) rest: Array2<f32>,
    pub(super) flare: Array2<f32>,
    /// 1 where the capture tells, 0 elsewhere.
    pub(super) known: Array2<f32>,
    /// The local brightness of the capture, and α.
    pub(super) brightness: Array2<f32>,
}

/// Replaces what errors of flare drown in the channels of a capture by the scene around.
pub(super) fn replace_doubtful(channels: Vec<Doubtful>, alpha: f32) -> Vec<Array2<f32>> {
    let mut channels: Vec<_> = channels.into_iter().map(|channel| Judged::new(channel, alpha)).collect();
    let told = Array2::from_shape_fn(channels[0].of.known.dim(), |at| {
        channels.iter().map(|channel| channel.of.known[at]).fold(1.0, f32::min)
    });
    for _ in 0..PASSES {
        channels.iter_mut().for_each(Judged::look_around);
        let details: Vec<_> = channels.iter().map(Judged::detail).collect();
        for (channel, detail) in channels.iter_mut().zip(&details) {
            channel.find_contrast(detail);
        }
        let mean = Array2::from_shape_fn(told.dim(), |at| {
            details.iter().map(|detail| detail[at]).sum::<f32>() / details.len() as f32
        });
        for (channel, detail) in channels.iter_mut().zip(details) {
            channel.find_errors(&(&told * (detail - &mean)), &told);
        }
    }
    channels.into_iter().map(Judged::finish).collect()
}

/// A channel, and what is thought of it.
struct Judged {
    of: Doubtful,
    alpha: f32,
    /// What is left below zero tells so much of V, and the most that colours may tell, each over F².
    below: Array2<f32>,
    most_by_color: f32,
    /// V.
    variance: Array2<f32>,
    /// p.
    around: Array2<f32>,
    /// s over p + α.
    contrast: Array2<f32>,
}

impl Judged {
    fn new(of: Doubtful, alpha: f32) -> Self {
        let relative = |plane: &Array2<f32>| plane * &of.known / &of.brightness;
        let mut below = local_power(&relative(&of.rest.mapv(|rest| (-rest).max(0.0))));
        let whole = local_power(&relative(&of.flare));
        let most_by_color = MOST_BY_COLOR * 2.0 * below.sum() / whole.sum().max(f32::MIN_POSITIVE);
        Zip::from(&mut below).and(&whole).par_for_each(|below, whole| {
            *below = (2.0 * *below / whole.max(f32::MIN_POSITIVE)).min(1.0);
        });
        let variance = &of.flare * &of.flare * &below;
        let around = Array2::zeros(of.rest.dim());
        let contrast = Array2::from_elem(of.rest.dim(), USUAL_CONTRAST);
        Self { of, alpha, below, most_by_color: most_by_color.min(1.0), variance, around, contrast }
    }

    /// c.
    fn belief(&self) -> Array2<f32> {
        let Self { alpha, variance, around, contrast, .. } = self;
        Zip::from(around).and(contrast).and(variance).par_map_collect(|around, contrast, variance| {
            let scene = (contrast * (around + alpha)).powi(2);
            scene / (scene + variance)
        })
    }

    fn look_around(&mut self) {
        let belief = self.belief() * &self.of.known;
        self.around = believed_mean((&self.of.rest, &belief), &AROUND_PX, 0.0);
        self.around.par_mapv_inplace(|around| around.max(0.0));
    }

    /// The fine detail of what is left, over the light around.
    fn detail(&self) -> Array2<f32> {
        let Doubtful { rest, known, .. } = &self.of;
        let [light, share] = believed_sums((rest, known), DETAIL_PX);
        let mut detail = rest.clone();
        Zip::from(&mut detail).and(&light).and(&share).par_for_each(|detail, light, share| {
            *detail -= light / share.max(f32::MIN_POSITIVE);
        });
        Zip::from(&mut detail).and(known).and(&self.around).par_for_each(|detail, known, around| {
            *detail *= known / (around + self.alpha);
        });
        detail
    }

    /// Takes the contrast of the scene from its detail where there is no flare.
    fn find_contrast(&mut self, detail: &Array2<f32>) {
        let mut belief = self.belief() * &self.of.known;
        Zip::from(&mut belief).and(&self.of.flare).and(&self.around).par_for_each(|belief, flare, around| {
            *belief /= 1.0 + (flare / (NO_FLARE * (around + self.alpha))).powi(2);
        });
        let squares = detail.mapv(|detail| detail * detail);
        self.contrast = believed_mean((&squares, &belief), &CONTRAST_PX, USUAL_CONTRAST.powi(2));
        self.contrast.par_mapv_inplace(|square| square.max(0.0).sqrt().clamp(CONTRASTS[0], CONTRASTS[1]));
    }

    /// Takes the errors of flare from what is left below zero and from the detail that colours do not share, where all are told.
    fn find_errors(&mut self, apart: &Array2<f32>, told: &Array2<f32>) {
        let mut power = local_power(apart);
        let share = smoothed(told.dim(), ALIKE_PX, copy_of(told));
        Zip::from(&mut power).and(&share).par_for_each(|power, share| {
            *power = if *share > LEAST_PART { *power / share } else { 0.0 };
        });
        let usual = self.usually_apart(&power);
        let Self { of, alpha, below, most_by_color, around, .. } = &*self;
        let mut variance = &of.flare * &of.flare;
        Zip::from(&mut variance).and(below).and(around).and(&power).par_for_each(
            |variance, below, around, power| {
                let by_color = OF_APART * (power - usual).max(0.0) * (around + alpha).powi(2);
                *variance = (*variance * below).max(by_color.min(*variance * most_by_color));
            },
        );
        self.variance = variance;
    }

    /// What colours do not share where there is no flare.
    fn usually_apart(&self, power: &Array2<f32>) -> f32 {
        let mut without_flare = Vec::new();
        Zip::from(power).and(&self.of.flare).and(&self.around).for_each(|power, flare, around| {
            if *flare < NO_FLARE * (around + self.alpha) {
                without_flare.push(*power);
            }
        });
        if (without_flare.len() as f32) < LEAST_PART * power.len() as f32 {
            return USUALLY_APART;
        }
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a part of a length")]
        let rank = (SHARED * (without_flare.len() - 1) as f32) as usize;
        *without_flare.select_nth_unstable_by(rank, f32::total_cmp).1
    }

    fn finish(self) -> Array2<f32> {
        let belief = self.belief();
        let mut rest = self.of.rest;
        Zip::from(&mut rest).and(&self.around).and(&belief).and(&self.of.known).par_for_each(
            |rest, around, belief, known| {
                if *known > 0.0 {
                    *rest = around + belief * (*rest - around);
                }
            },
        );
        rest
    }
}

/// The sums of squares under a bell.
fn local_power(values: &Array2<f32>) -> Array2<f32> {
    smoothed(values.dim(), ALIKE_PX, |y, out| {
        out.iter_mut().zip(row(values, y)).for_each(|(out, value)| *out = value * value);
    })
}

/// The sums under a bell of a plane times what of it is believed, and of the latter.
fn believed_sums((plane, belief): (&Array2<f32>, &Array2<f32>), sigma_px: f32) -> [Array2<f32>; 2] {
    let light = smoothed(plane.dim(), sigma_px, |y, out| {
        let values = out.iter_mut().zip(row(plane, y)).zip(row(belief, y));
        values.for_each(|((out, value), belief)| *out = value * belief);
    });
    [light, smoothed(plane.dim(), sigma_px, copy_of(belief))]
}

/// The mean of what is believed around each pixel, over the finest bells that hold enough of it; `otherwise` where none does.
fn believed_mean(of: (&Array2<f32>, &Array2<f32>), bells_px: &[f32], otherwise: f32) -> Array2<f32> {
    let mut mean = Array2::from_elem(of.0.dim(), otherwise);
    for sigma_px in bells_px {
        let [light, share] = believed_sums(of, *sigma_px);
        Zip::from(&mut mean).and(&light).and(&share).par_for_each(|mean, light, share| {
            if *share > f32::MIN_POSITIVE {
                *mean += share / (share + HALF_SHARE) * (light / share - *mean);
            }
        });
    }
    mean
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIDE: usize = 160;
    const ALPHA: f32 = 0.25;

    /// A sky with a tree, in three colours.
    fn scene(channel: usize) -> Array2<f32> {
        Array2::from_shape_fn((SIDE, SIDE), |(y, x)| {
            let sky = 0.4 + 0.1 * channel as f32 + 1e-3 * y as f32;
            if x > 120 && (x * y / 40) % 3 == 0 { 0.2 * sky } else { sky }
        })
    }

    /// Orders of a sun beyond the upper border, displaced by so many pixels.
    fn flare(channel: usize, moved_px: f32) -> Array2<f32> {
        let pitch = 9.0 + channel as f32;
        Array2::from_shape_fn((SIDE, SIDE), |(y, x)| {
            let phase = |at: usize| ((at as f32 + moved_px) * std::f32::consts::PI / pitch).cos().powi(8);
            20.0 * phase(y) * phase(x) * (-(y as f32) / 25.0).exp()
        })
    }

    /// What is left of three colours of a sky whose flare is believed to be `moved_px` from where it is, and with doubts.
    fn left(moved_px: f32) -> (Vec<Array2<f32>>, Vec<Array2<f32>>) {
        let of = |channel: usize| {
            let capture = scene(channel) + flare(channel, 0.0);
            let flare = flare(channel, moved_px);
            let brightness = super::super::smooth::local_mean(&capture, 4.0) + ALPHA;
            Doubtful { rest: capture - &flare, flare, known: Array2::ones((SIDE, SIDE)), brightness }
        };
        let rests = (0..3).map(|channel| of(channel).rest).collect();
        (rests, replace_doubtful((0..3).map(of).collect(), ALPHA))
    }

    /// The mean square of what is wrong in tone-mapped light.
    fn error(found: &[Array2<f32>]) -> f32 {
        let tone = |light: f32| light.max(0.0) / (light.max(0.0) + ALPHA);
        let of = |(channel, found): (usize, &Array2<f32>)| {
            Zip::from(found)
                .and(&scene(channel))
                .map_collect(|a, b| (tone(*a) - tone(*b)).powi(2))
                .mean()
                .unwrap()
        };
        found.iter().enumerate().map(of).sum::<f32>() / 3.0
    }

    #[test]
    fn dots_that_a_wrong_flare_leaves_become_sky() {
        for moved_px in [0.5, 1.0] {
            let (rest, found) = left(moved_px);
            let [before, after] = [&rest, &found].map(|planes| error(planes));
            assert!(after < before / 4.0, "{moved_px}: {before}, then {after}");
        }
    }

    #[test]
    fn a_flare_that_is_known_leaves_the_scene_alone() {
        let (rest, found) = left(0.0);
        for (rest, found) in rest.iter().zip(&found) {
            assert!(rest.iter().zip(found).all(|(a, b)| (a - b).abs() < 1e-3));
        }
    }

    #[test]
    fn what_no_pixel_tells_stays() {
        let plane = || Array2::from_shape_fn((20, 30), |(y, x)| (y * 30 + x) as f32);
        let of = || Doubtful {
            rest: plane(),
            flare: plane(),
            known: Array2::zeros((20, 30)),
            brightness: plane() + 1.0,
        };
        let found = replace_doubtful(vec![of(), of(), of()], ALPHA);
        assert!(found.iter().all(|found| *found == plane()));
    }
}
