//! The fastest that one core can multiply and add: what operations' speeds are compared with.

use std::hint::black_box;
use std::time::Instant;

use super::simd::{Isa, Kernel, Simd};

/// Independent chains of multiply-adds: enough to hide a latency of four cycles at two a cycle.
const CHAINS: usize = 12;

struct Chains {
    steps: usize,
}

impl Kernel for Chains {
    type Output = f32;

    #[inline(always)]
    fn run<S: Simd>(self, simd: S) -> f32 {
        let (factor, term) = (simd.splat(black_box(0.999)), simd.splat(black_box(0.001)));
        let mut sums = [simd.splat(1.0); CHAINS];
        for _ in 0..self.steps {
            for sum in &mut sums {
                *sum = simd.mul_add(*sum, factor, term);
            }
        }
        let mut total = sums[0];
        for sum in &sums[1..] {
            total = simd.add(total, *sum);
        }
        let mut floats = [0.0; 16];
        // SAFETY: sixteen floats hold any vector.
        unsafe { simd.store(&mut floats, 0, total) };
        floats[0]
    }
}

/// Measures one core's multiply-adds, in floating-point operations per second, counting two each.
pub fn measure(isa: Isa) -> f64 {
    const STEPS: usize = 2_000_000;
    let operations = (STEPS * CHAINS * isa.lanes() * 2) as f64;
    let once = || {
        let start = Instant::now();
        black_box(isa.run(Chains { steps: STEPS }));
        operations / start.elapsed().as_secs_f64()
    };
    (0..5).map(|_| once()).fold(0.0, f64::max)
}
