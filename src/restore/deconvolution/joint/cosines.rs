//! Cosines of blocks that are worked on side by side, one in each lane of a vector.

/// Side of a block: 16 restores 0.1 dB worse.
pub(super) const SIDE: usize = 8;

/// Pixels from one block to the next: with 4 it is 0.2 dB worse.
pub(super) const STEP: usize = 2;

/// Blocks that are worked on side by side; steps of two columns make them neighbours among the even and among the odd ones.
pub(super) const LANES: usize = 16;

/// A number of each of those blocks.
pub(super) type Lanes = [f32; LANES];

/// A number of each lane, from a place on.
#[inline(always)]
pub(super) fn lane(from: &[f32], at: usize) -> Lanes {
    from[at..at + LANES].try_into().expect("lanes have one length")
}

/// Lanes that lie so far apart, from the first on.
#[inline(always)]
pub(super) fn lanes(from: &[f32], first: usize, stride: usize) -> [Lanes; SIDE] {
    let mut lanes = [[0.0; LANES]; SIDE];
    for (index, to) in lanes.iter_mut().enumerate() {
        *to = lane(from, first + index * stride);
    }
    lanes
}

/// Adds values times a factor.
#[inline(always)]
pub(super) fn add_times(sum: &mut Lanes, factor: f32, values: &Lanes) {
    for (sum, value) in sum.iter_mut().zip(values) {
        *sum += factor * value;
    }
}

/// The same, to what stands from a place on.
#[inline(always)]
pub(super) fn add_at(sums: &mut [f32], at: usize, factor: f32, values: &Lanes) {
    for (sum, value) in sums[at..at + LANES].iter_mut().zip(values) {
        *sum += factor * value;
    }
}

/// The cosines of a block's side, and the window under which blocks are averaged.
pub(super) struct Cosines {
    /// The first half of each cosine, by frequency: the second is the same, of the opposite sign where the frequency is odd.
    halves: [[f32; SIDE / 2]; SIDE],
    pub(super) window: [f32; SIDE],
}

impl Cosines {
    #[expect(clippy::cast_precision_loss, reason = "indices of a block")]
    pub(super) fn new() -> Self {
        let cosine = |u: usize, x: usize| {
            let scale = if u == 0 { 1.0 } else { std::f32::consts::SQRT_2 };
            scale * (std::f32::consts::PI * u as f32 * (x as f32 + 0.5) / SIDE as f32).cos()
                / (SIDE as f32).sqrt()
        };
        // Von Hann's, without the zeros at its ends; blocks two pixels apart add up to the same everywhere.
        let bell = |x: usize| (std::f32::consts::PI * (x as f32 + 1.0) / (SIDE as f32 + 1.0)).sin().powi(2);
        let sum: f32 = (0..SIDE).step_by(STEP).map(bell).sum();
        Self {
            halves: std::array::from_fn(|u| std::array::from_fn(|x| cosine(u, x))),
            window: std::array::from_fn(|x| bell(x) / sum),
        }
    }

    /// The coefficients of the samples of a side.
    #[inline(always)]
    pub(super) fn forward(&self, samples: &[Lanes; SIDE]) -> [Lanes; SIDE] {
        let mut out = [[0.0; LANES]; SIDE];
        for x in 0..SIDE / 2 {
            let [mut sum, mut difference] = [samples[x]; 2];
            add_times(&mut sum, 1.0, &samples[SIDE - 1 - x]);
            add_times(&mut difference, -1.0, &samples[SIDE - 1 - x]);
            for (u, (out, halves)) in out.iter_mut().zip(&self.halves).enumerate() {
                add_times(out, halves[x], if u % 2 == 0 { &sum } else { &difference });
            }
        }
        out
    }

    /// The samples of a side of its coefficients.
    #[inline(always)]
    pub(super) fn inverse(&self, coefficients: &[Lanes; SIDE]) -> [Lanes; SIDE] {
        let mut out = [[0.0; LANES]; SIDE];
        for x in 0..SIDE / 2 {
            let [mut even, mut odd] = [[0.0; LANES]; 2];
            for (u, (values, halves)) in coefficients.iter().zip(&self.halves).enumerate() {
                add_times(if u % 2 == 0 { &mut even } else { &mut odd }, halves[x], values);
            }
            out[x] = even;
            out[SIDE - 1 - x] = even;
            add_times(&mut out[x], 1.0, &odd);
            add_times(&mut out[SIDE - 1 - x], -1.0, &odd);
        }
        out
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Other numbers in each lane.
    fn samples() -> [Lanes; SIDE] {
        std::array::from_fn(|x| std::array::from_fn(|lane| ((x * 31 + lane * 17) % 23) as f32 / 23.0))
    }

    #[test]
    fn cosines_return_and_keep_the_power() {
        let (cosines, samples) = (Cosines::new(), samples());
        let coefficients = cosines.forward(&samples);
        let back = cosines.inverse(&coefficients);
        for lane in 0..LANES {
            let power = |values: &[Lanes; SIDE]| values.iter().map(|v| v[lane] * v[lane]).sum::<f32>();
            assert!((power(&coefficients) / power(&samples) - 1.0).abs() < 1e-5);
            let mean = samples.iter().map(|v| v[lane]).sum::<f32>() / 8f32.sqrt();
            assert!((coefficients[0][lane] - mean).abs() < 1e-5, "{} {mean}", coefficients[0][lane]);
        }
        assert!(back.iter().flatten().zip(samples.iter().flatten()).all(|(a, b)| (a - b).abs() < 1e-6));
    }

    #[test]
    fn a_cosine_is_one_coefficient() {
        let cosines = Cosines::new();
        let wave = |x: usize| (std::f32::consts::PI * 3.0 * (x as f32 + 0.5) / 8.0).cos() / 2.0;
        let coefficients = cosines.forward(&std::array::from_fn(|x| [wave(x); LANES]));
        for (u, values) in coefficients.iter().enumerate() {
            let expected = if u == 3 { 1.0 } else { 0.0 };
            assert!(values.iter().all(|value| (value - expected).abs() < 1e-5), "{u}: {values:?}");
        }
    }
}
