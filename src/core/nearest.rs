//! Finds the known names that are nearest to a misspelt one, to be suggested in its place.

/// The least number of insertions, deletions and replacements that turn `a` into `b`.
pub fn edits(a: &str, b: &str) -> usize {
    let b: Vec<char> = b.chars().collect();
    let mut row: Vec<usize> = (0..=b.len()).collect();
    for (i, x) in a.chars().enumerate() {
        let mut diagonal = std::mem::replace(&mut row[0], i + 1);
        for (j, y) in b.iter().enumerate() {
            let replaced = diagonal + usize::from(x != *y);
            diagonal = row[j + 1];
            row[j + 1] = replaced.min(diagonal + 1).min(row[j] + 1);
        }
    }
    row[b.len()]
}

/// The known name that takes the fewest edits, the earliest of equals; none among none.
pub fn nearest<'a>(name: &str, known: &'a [String]) -> Option<&'a str> {
    known.iter().min_by_key(|known| edits(name, known)).map(String::as_str)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn edits_are_counted() {
        assert_eq!((edits("crop", "corp"), edits("", "abc"), edits("beta1", "beta2")), (2, 3, 1));
    }

    #[test]
    fn the_name_of_the_fewest_edits_is_nearest() {
        let known = ["r-03", "r+00", "r+03"].map(str::to_owned);
        assert_eq!((nearest("r00", &known), nearest("r3", &known)), (Some("r+00"), Some("r-03")));
        assert_eq!(nearest("r00", &[]), None);
    }
}
