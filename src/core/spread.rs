//! Chooses a few of many.

/// `count` of the numbers below `total`, all where there are fewer: from the first to the last, evenly spread.
///
/// What repeats in a fixed rhythm, as the kernels of a dataset do scene by scene, is met at different places: the last
/// number is one less than a multiple of the rhythm, so that steps are hardly ever multiples of it.
pub fn spread(count: usize, total: usize) -> impl Iterator<Item = usize> {
    let last = total.saturating_sub(1);
    let count = count.min(total);
    (0..count).map(move |k| k * last / count.saturating_sub(1).max(1))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_and_last_are_chosen_and_no_kernel_is_preferred() {
        assert_eq!(spread(3, 9).collect::<Vec<_>>(), [0, 4, 8]);
        assert_eq!(spread(1, 9).collect::<Vec<_>>(), [0]);
        assert_eq!(spread(7, 4).collect::<Vec<_>>(), [0, 1, 2, 3]);
        assert_eq!(spread(5, 0).count(), 0);
        let kernels: std::collections::BTreeSet<usize> = spread(6, 6 * 9).map(|index| index % 9).collect();
        assert!(kernels.len() >= 5, "{kernels:?}");
    }
}
