//! Turns a seed and a name into an independent stream of random numbers.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use sha2::{Digest, Sha256};

/// The generator behind every random number of the project: counter-based, portable, of fixed output.
pub type Rng = ChaCha8Rng;

/// Opens the stream that belongs to `label` under `seed`.
///
/// Work items that draw from streams of their own give the same numbers in any order and on any number of
/// threads.
pub fn stream(seed: u64, label: &str) -> Rng {
    let mut hash = Sha256::new();
    hash.update(seed.to_le_bytes());
    hash.update(label.as_bytes());
    Rng::from_seed(hash.finalize().into())
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::Rng as _;

    #[test]
    fn streams_repeat_and_differ_by_label_and_seed() {
        let first = |seed, label| stream(seed, label).next_u64();
        assert_eq!(first(1, "noise/a"), first(1, "noise/a"));
        assert_ne!(first(1, "noise/a"), first(1, "noise/b"));
        assert_ne!(first(1, "noise/a"), first(2, "noise/a"));
    }
}
