//! Decides which item every sample of a training is drawn from, by its position alone: a training that is
//! resumed draws on as if it had never stopped.

use rand::seq::SliceRandom;

use crate::core::rng::{self, Rng};

/// The order of samples: pass after pass over all items, each in an order of its own when shuffled.
#[derive(Clone, Debug)]
pub struct Sampler {
    seed: u64,
    items: usize,
    shuffle: bool,
    /// The pass whose order is at hand, with that order.
    pass: Option<(u64, Vec<usize>)>,
}

impl Sampler {
    /// Makes the order of samples over `items` items.
    ///
    /// # Panics
    /// When there are no items.
    pub fn new(seed: u64, items: usize, shuffle: bool) -> Self {
        assert!(items > 0, "there must be items to sample");
        Self { seed, items, shuffle, pass: None }
    }

    /// The item of the sample at `position`, counted from the training's start.
    pub fn item(&mut self, position: u64) -> usize {
        let items = self.items as u64;
        let pass = position / items;
        #[expect(clippy::cast_possible_truncation, reason = "a remainder is below the number of items")]
        let index = (position % items) as usize;
        if !self.shuffle {
            return index;
        }
        if self.pass.as_ref().is_none_or(|(current, _)| *current != pass) {
            let mut order: Vec<usize> = (0..self.items).collect();
            order.shuffle(&mut rng::stream(self.seed, &format!("pass/{pass}")));
            self.pass = Some((pass, order));
        }
        self.pass.as_ref().map_or(index, |(_, order)| order[index])
    }

    /// The random stream that the sample at `position` is cut and degraded with.
    pub fn stream(&self, position: u64) -> Rng {
        rng::stream(self.seed, &format!("sample/{position}"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_pass_visits_every_item_once_in_another_order() {
        let mut sampler = Sampler::new(3, 20, true);
        let mut pass = |n: u64| (20 * n..20 * (n + 1)).map(|p| sampler.item(p)).collect::<Vec<_>>();
        let (first, second) = (pass(0), pass(1));
        assert_ne!(first, second);
        for mut order in [first, second] {
            order.sort_unstable();
            assert_eq!(order, (0..20).collect::<Vec<_>>());
        }
    }

    #[test]
    fn an_item_depends_on_its_position_only() {
        let mut forward = Sampler::new(1, 7, true);
        let expected: Vec<usize> = (0..30).map(|p| forward.item(p)).collect();
        let mut backward = Sampler::new(1, 7, true);
        let found: Vec<usize> = (0..30).rev().map(|p| backward.item(p)).collect();
        assert_eq!(found.into_iter().rev().collect::<Vec<_>>(), expected);
    }

    #[test]
    fn unshuffled_items_come_in_their_own_order() {
        let mut sampler = Sampler::new(1, 3, false);
        assert_eq!([0, 1, 2, 3, 4].map(|p| sampler.item(p)), [0, 1, 2, 0, 1]);
    }
}
