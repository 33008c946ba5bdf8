//! How surely the flare of a light is seen, by the parts of a frame that it falls on.
//!
//! What is left of a capture without a light is regressed on the light's flare in blocks of the frame. Where the light is there, blocks
//! agree on how much of it there is, however busy the scene is; what a scene's own glow makes look like flare is seen near the light alone,
//! or in some blocks more and in others less than nothing.

use ndarray::{Array2, ArrayView2, Axis};
use rayon::prelude::*;

/// Blocks along the shorter side, and the least side of one.
const BLOCKS: usize = 8;
const LEAST_BLOCK_PX: usize = 8;

/// Light over its standard deviation, as blocks disagree on it, from which on it is taken for seen; beyond the blocks that tell half of
/// it, half of that.
const SURE: f64 = 6.0;

/// Standard deviations by which light that is not sure is taken for less than what is told of it: one is 0.3 dB better on average, and
/// up to 1 dB worse where the sky is clipped in blue alone.
const LIKELY: f64 = 2.0;

/// The part of the light that those blocks tell at least.
const LEAST_FAR: f64 = 0.5;

/// What a block tells: how much the flare is like what is left, and like itself.
#[derive(Clone, Copy, Default)]
struct Block {
    alike: f64,
    power: f64,
}

/// How much there is of a light for what it is, and over its standard deviation.
struct Amount {
    times: f64,
    over_deviation: f64,
}

impl Amount {
    /// The amount less some of its standard deviations, or none.
    fn at_least(&self) -> f64 {
        (self.times * (1.0 - LIKELY / self.over_deviation)).max(0.0)
    }
}

/// How many times a `flare` is in what is `left` without it, at the least that is likely.
pub(super) fn times_likely_seen(flare: &Array2<f32>, left: &Array2<f32>) -> f64 {
    amount(&blocks_of(flare, left)).at_least()
}

/// How much of a `flare` is in what is `left` without it, all of it at most, where some surely is.
pub(super) fn part_surely_seen(flare: &Array2<f32>, left: &Array2<f32>) -> Option<f64> {
    let mut blocks = blocks_of(flare, left);
    blocks.sort_by(|a, b| b.power.total_cmp(&a.power));
    let half: f64 = 0.5 * blocks.iter().map(|block| block.power).sum::<f64>();
    let mut sum = 0.0;
    let near = blocks.iter().take_while(|block| {
        sum += block.power;
        sum < half
    });
    let far = (near.count() + 1).min(blocks.len());
    let [all, beyond] = [amount(&blocks), amount(&blocks[far..])];
    let is_sure = all.over_deviation > SURE && beyond.over_deviation > SURE / 2.0 && beyond.times > LEAST_FAR;
    is_sure.then_some(all.times.min(1.0))
}

fn blocks_of(flare: &Array2<f32>, left: &Array2<f32>) -> Vec<Block> {
    let side = (flare.nrows().min(flare.ncols()) / BLOCKS).max(LEAST_BLOCK_PX);
    let columns = flare.ncols().div_ceil(side);
    let of_row_of_blocks = |(flare, left): (ArrayView2<'_, f32>, ArrayView2<'_, f32>)| {
        let mut blocks = vec![Block::default(); columns];
        for (flare, left) in flare.rows().into_iter().zip(left.rows()) {
            for (x, (flare, left)) in flare.iter().zip(left).enumerate() {
                let block = &mut blocks[x / side];
                block.alike += f64::from(flare * left);
                block.power += f64::from(flare * flare);
            }
        }
        blocks
    };
    let rows = flare.axis_chunks_iter(Axis(0), side).into_par_iter();
    rows.zip(left.axis_chunks_iter(Axis(0), side)).flat_map_iter(of_row_of_blocks).collect()
}

/// What blocks tell together.
///
/// # Equation
/// `a = Σ⟨p, r⟩/Σ⟨p, p⟩` of flare p and rest r, with the deviation `√Σ(⟨p, r⟩ − a⟨p, p⟩)²/Σ⟨p, p⟩` of sums over blocks (Liang and Zeger,
/// Biometrika 73, 1986).
fn amount(blocks: &[Block]) -> Amount {
    let [alike, power] = [|block: &Block| block.alike, |block: &Block| block.power]
        .map(|of| blocks.iter().map(of).sum::<f64>());
    let times = alike / power.max(f64::MIN_POSITIVE);
    let squares: f64 = blocks.iter().map(|block| (block.alike - times * block.power).powi(2)).sum();
    Amount { times, over_deviation: alike / squares.sqrt().max(f64::MIN_POSITIVE) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::rng::stream;
    use rand::RngExt as _;

    /// The arms of a lamp, and a scene of blocks that is ten times as strong.
    fn arms_and_scene() -> [Array2<f32>; 2] {
        let arms = Array2::from_shape_fn((128, 128), |(y, x)| {
            let (dy, dx) = (y.abs_diff(60) as f32, x.abs_diff(70) as f32);
            (dy.min(dx) % 4.0 - 1.5) * (-dy.min(dx) / 6.0).exp() / (1.0 + (dy + dx) / 30.0)
        });
        let mut rng = stream(5, "scene");
        let scene = Array2::from_shape_simple_fn((128, 128), || 20.0 * (rng.random::<f32>() - 0.5));
        [arms, scene]
    }

    #[test]
    fn flare_is_seen_in_a_scene_that_drowns_it_and_not_where_it_is_not() {
        let [arms, scene] = arms_and_scene();
        let part =
            part_surely_seen(&arms.mapv(|flare| 4.0 * flare), &(&scene + &arms.mapv(|flare| 3.0 * flare)));
        assert!((part.unwrap() - 0.75).abs() < 0.1, "{part:?}");
        assert_eq!(part_surely_seen(&arms, &scene), None);
        assert_eq!(part_surely_seen(&arms, &(&scene - &arms)), None);
    }

    #[test]
    fn flare_is_likely_seen_as_often_as_it_is_there_or_less() {
        let [arms, scene] = arms_and_scene();
        let with = |times: f32| times_likely_seen(&arms, &(&scene + &arms.mapv(|flare| times * flare)));
        assert!(with(0.0) < 0.2 && with(-2.0) == 0.0 && (2.0..3.1).contains(&with(3.0)), "{}", with(3.0));
        assert_eq!(times_likely_seen(&arms, &Array2::zeros(arms.dim())), 0.0);
    }

    #[test]
    fn what_is_like_flare_near_the_light_alone_is_none() {
        let [arms, scene] = arms_and_scene();
        let glow = Array2::from_shape_fn(arms.dim(), |(y, x)| {
            let near = y.abs_diff(60) < 16 && x.abs_diff(70) < 16;
            if near { 9.0 * arms[[y, x]] } else { 0.0 }
        });
        assert_eq!(part_surely_seen(&arms, &(&scene + &glow)), None);
    }
}
