//! Sums a quantity over pixels, so that parts of an image and several images add up.

use std::ops::AddAssign;

use serde::{Deserialize, Serialize};

/// The sum of a quantity over pixels and channels, and their number.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Pool {
    /// The sum.
    pub sum: f64,
    /// How many values were added.
    pub count: u64,
}

impl Pool {
    /// The mean of the values; none without any.
    pub fn mean(&self) -> Option<f64> {
        #[expect(clippy::cast_precision_loss, reason = "images have far fewer than 2⁵³ pixels")]
        let mean = self.sum / self.count as f64;
        (self.count > 0).then_some(mean)
    }

    /// The sum of values that come in any number.
    pub(super) fn of(values: impl Iterator<Item = f64>) -> Self {
        values.fold(Self::default(), |pool, value| Self { sum: pool.sum + value, count: pool.count + 1 })
    }

    /// Adds pools in their order: the same bits on any number of threads.
    pub(super) fn total(pools: &[Self]) -> Self {
        let mut total = Self::default();
        pools.iter().for_each(|pool| total += *pool);
        total
    }
}

impl AddAssign for Pool {
    fn add_assign(&mut self, other: Self) {
        self.sum += other.sum;
        self.count += other.count;
    }
}
