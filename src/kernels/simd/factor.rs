//! Numbers in the lanes of a product's factor, put there one by one, as weights are packed.

/// Puts number `index` of a column of factors into its lane, which holds `per_lane` of them and began as zero.
#[inline(always)]
pub(crate) fn put_factor(lane: &mut f32, per_lane: usize, index: usize, number: f32) {
    if per_lane == 1 {
        *lane = number;
    } else {
        // Half of what is cut off, and less by one where that would round a tie to an odd number.
        let bits = number.to_bits();
        let rounded = bits.wrapping_add(0x7fff + (bits >> 16 & 1)) >> 16;
        *lane = f32::from_bits(lane.to_bits() | rounded << (16 * (index % 2)));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kernels::simd::{Isa, Kernel, Simd};

    /// Dots of packed vectors, and of factors put one by one, with a vector of ones and minus ones.
    struct Dots<'a>(&'a [f32]);

    impl Kernel for Dots<'_> {
        type Output = [Vec<f32>; 2];
        #[inline(always)]
        fn run<S: Simd>(self, simd: S) -> [Vec<f32>; 2] {
            let mut results = [vec![0.0; S::LANES], vec![0.0; S::LANES]];
            let (mut one_by_one, mut signs) = (vec![0.0; S::LANES], vec![0.0; S::LANES]);
            for (index, number) in self.0[..S::LANES * S::PER_LANE].iter().enumerate() {
                put_factor(&mut one_by_one[index / S::PER_LANE], S::PER_LANE, index, *number);
                let sign = if index.is_multiple_of(3) { -1.0 } else { 1.0 };
                put_factor(&mut signs[index / S::PER_LANE], S::PER_LANE, index, sign);
            }
            // SAFETY: all slices hold whole vectors, the numbers two.
            unsafe {
                let packed = simd.pack(simd.load(self.0, 0), simd.load(self.0, S::LANES));
                let signs = simd.load(&signs, 0);
                simd.store(&mut results[0], 0, simd.dot(packed, signs, simd.splat(0.5)));
                let one_by_one = simd.load(&one_by_one, 0);
                simd.store(&mut results[1], 0, simd.dot(one_by_one, signs, simd.splat(0.5)));
            }
            results
        }
    }

    #[test]
    fn lanes_hold_as_many_numbers_as_they_say_rounded_to_nearest() {
        // Ties between two numbers of 8 bits, numbers beside ties, numbers of few bits, very large and small ones.
        let mut numbers =
            vec![1.0 + 1.0 / 256.0, 1.0 + 3.0 / 256.0, 1.003_906_4, 1.003_906_1, -2.5, 3e38, -1e-30, 0.1];
        numbers.extend((1..=24).map(|i| (i as f32 * 0.37).sin()));
        for isa in
            Isa::available().into_iter().flat_map(|isa| [Some(isa), isa.with_bf16_products()]).flatten()
        {
            let [packed, one_by_one] = isa.run_products(Dots(&numbers));
            assert_eq!(packed, one_by_one, "{}", isa.name());
            let per_lane = isa.per_lane();
            let rounded = |index: usize| {
                let (number, digit) = (f64::from(numbers[index]), 2f64.powi(-7));
                let unit = digit * 2f64.powf(number.abs().log2().floor());
                let rounded = if per_lane == 1 { number } else { (number / unit).round_ties_even() * unit };
                if index.is_multiple_of(3) { -rounded } else { rounded }
            };
            for (lane, found) in packed.iter().enumerate() {
                let expected = 0.5 + (lane * per_lane..(lane + 1) * per_lane).map(rounded).sum::<f64>();
                let error = (f64::from(*found) - expected).abs();
                assert!(
                    error <= 1e-6 * expected.abs(),
                    "{} lane {lane}: {found}, not {expected}",
                    isa.name()
                );
            }
        }
    }
}
