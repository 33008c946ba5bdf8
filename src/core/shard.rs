//! One of several runs that do a piece of work together: which items are its own.
//!
//! An item is the same whichever run makes it: seeds and names follow the item, never the shard.

use std::fmt;
use std::ops::Range;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

use super::error::{Error, Result};

/// One of several runs that do a piece of work together; in files, as `2/8`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(into = "String", try_from = "String")]
pub struct Shard {
    /// Which one, from 0.
    pub index: usize,
    /// How many there are.
    pub count: usize,
}

impl Shard {
    /// The only run.
    pub const WHOLE: Self = Self { index: 0, count: 1 };

    /// Whether other runs do the rest.
    pub fn is_part(self) -> bool {
        self.count > 1
    }

    /// The items that this run is for: every `count`-th, so that sizes and sources are spread.
    pub fn choose<T>(self, items: Vec<T>) -> Vec<T> {
        items.into_iter().skip(self.index).step_by(self.count).collect()
    }

    /// The items that this run is for where neighbours belong together: a block of `total`; those of two shards differ in
    /// length by one at most, and one after the other they are all items in their order.
    ///
    /// # Panics
    /// Never: a share of the total is none of more.
    pub fn block(self, total: usize) -> Range<usize> {
        // In 128 bits, since the product may not fit into fewer.
        let cut = |index: usize| {
            let at = index as u128 * total as u128 / self.count as u128;
            usize::try_from(at).expect("a share of the total")
        };
        cut(self.index)..cut(self.index + 1)
    }

    /// Refuses more shards than there are items, of which some would have nothing to do; `items` names these.
    ///
    /// # Errors
    /// [`Error::Config`] with the largest number that makes sense.
    pub fn check(self, total: usize, items: &str) -> Result<()> {
        if self.count <= total.max(1) {
            return Ok(());
        }
        let reason =
            format!("{self} is one of more shards than there are {items}; use at most {}", total.max(1));
        Err(Error::config("shard", reason))
    }
}

impl Default for Shard {
    fn default() -> Self {
        Self::WHOLE
    }
}

impl fmt::Display for Shard {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}", self.index + 1, self.count)
    }
}

impl From<Shard> for String {
    fn from(shard: Shard) -> Self {
        shard.to_string()
    }
}

impl TryFrom<String> for Shard {
    type Error = Error;

    fn try_from(text: String) -> Result<Self> {
        text.parse()
    }
}

impl FromStr for Shard {
    type Err = Error;

    /// Reads `I/N`, with I from 1 to N.
    fn from_str(text: &str) -> Result<Self> {
        // Without the sign that numbers may begin with.
        let number = |digits: &str| -> Option<usize> {
            digits.bytes().all(|digit| digit.is_ascii_digit()).then(|| digits.parse().ok())?
        };
        let parse = || {
            let (index, count) = text.split_once('/')?;
            let (index, count) = (number(index)?, number(count)?);
            (1..=count).contains(&index).then(|| Self { index: index - 1, count })
        };
        let reason = || format!("expected I/N with I from 1 to N, such as 2/8, found `{text}`");
        parse().ok_or_else(|| Error::config("shard", reason()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shards_are_read_from_one() {
        assert_eq!("2/8".parse::<Shard>().unwrap(), Shard { index: 1, count: 8 });
        assert_eq!("8/8".parse::<Shard>().unwrap().to_string(), "8/8");
        for text in ["0/8", "9/8", "2", "a/b", "1/0", "0/0", "-1/8", "+1/8", "1/8/8", "1 / 8", "1/", "/8", ""]
        {
            let message = text.parse::<Shard>().unwrap_err().to_string();
            assert!(message.contains("from 1 to N") && message.contains(&format!("`{text}`")), "{message}");
        }
    }

    #[test]
    fn shards_share_all_items_out() {
        for (total, count) in [(0, 3), (2, 3), (15, 4), (16, 4), (1, 1)] {
            let shards = (0..count).map(|index| Shard { index, count });
            let mut dealt: Vec<usize> =
                shards.clone().flat_map(|shard| shard.choose((0..total).collect())).collect();
            dealt.sort_unstable();
            assert_eq!(dealt, (0..total).collect::<Vec<_>>());
            let blocks: Vec<usize> = shards.clone().flat_map(|shard| shard.block(total)).collect();
            assert_eq!(blocks, dealt, "in their order");
            let lengths: Vec<usize> = shards.map(|shard| shard.block(total).len()).collect();
            assert!(lengths.iter().max().unwrap() - lengths.iter().min().unwrap() <= 1, "{lengths:?}");
        }
        assert_eq!(Shard { index: usize::MAX - 1, count: usize::MAX }.block(usize::MAX).len(), 1);
    }

    #[test]
    fn more_shards_than_items_are_refused() {
        let shard = Shard { index: 0, count: 4 };
        shard.check(4, "views").unwrap();
        Shard::WHOLE.check(0, "views").unwrap();
        let message = shard.check(3, "views").unwrap_err().to_string();
        assert!(message.contains("1/4") && message.contains("at most 3"), "{message}");
    }
}
