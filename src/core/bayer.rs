//! Names the colour filter mosaics of sensors.

use serde::{Deserialize, Serialize};

const RED: usize = 0;
const GREEN: usize = 1;
const BLUE: usize = 2;

/// The colours of a sensor's first two rows, left to right, top to bottom.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum BayerPattern {
    /// Red, green / green, blue.
    Rggb,
    /// Blue, green / green, red.
    Bggr,
    /// Green, red / blue, green.
    Grbg,
    /// Green, blue / red, green.
    Gbrg,
}

impl BayerPattern {
    const ALL: [Self; 4] = [Self::Rggb, Self::Bggr, Self::Grbg, Self::Gbrg];

    /// The channels of the first two rows' photosites, in reading order.
    pub fn sites(self) -> [usize; 4] {
        match self {
            Self::Rggb => [RED, GREEN, GREEN, BLUE],
            Self::Bggr => [BLUE, GREEN, GREEN, RED],
            Self::Grbg => [GREEN, RED, BLUE, GREEN],
            Self::Gbrg => [GREEN, BLUE, RED, GREEN],
        }
    }

    /// The pattern of these channels in reading order; none for channels that are no Bayer pattern.
    pub fn of_sites(sites: [usize; 4]) -> Option<Self> {
        Self::ALL.into_iter().find(|pattern| pattern.sites() == sites)
    }

    /// The channel that the photosite at (y, x) sees.
    pub fn channel(self, y: usize, x: usize) -> usize {
        self.sites()[(y % 2) * 2 + x % 2]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn patterns_are_found_by_their_sites() {
        for pattern in BayerPattern::ALL {
            assert_eq!(BayerPattern::of_sites(pattern.sites()), Some(pattern));
        }
        assert_eq!(BayerPattern::of_sites([0, 1, 2, 1]), None);
    }
}
