//! Chooses kernels of a set by their names: all of them, or those of a list.

use serde::de::Error as _;
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use super::Dataset;
use crate::core::error::{Error, Result};
use crate::core::nearest::nearest;

/// Which kernels of a set are used: `"all"`, or a list of their names.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub enum KernelChoice {
    /// Every kernel.
    #[default]
    All,
    /// The kernels of these names.
    Only(Vec<String>),
}

/// What a file says instead of a list.
const ALL: &str = "all";

impl KernelChoice {
    /// Refuses a list that chooses nothing, or a kernel twice.
    ///
    /// # Errors
    /// [`Error::Config`] under `key`.
    pub fn check(&self, key: &str) -> Result<()> {
        let Self::Only(names) = self else { return Ok(()) };
        if names.is_empty() {
            let reason = "names no kernel; name one or more, such as [\"r+00\"], or \"all\"";
            return Err(Error::config(key, reason));
        }
        match names.iter().enumerate().find(|(i, name)| names[..*i].contains(name)) {
            Some((_, twice)) => Err(Error::config(key, format!("names {twice} twice"))),
            None => Ok(()),
        }
    }

    /// The indices of the chosen kernels among those of the names `known`, in the order of these.
    ///
    /// # Errors
    /// [`Error::Config`] under `key` for a name that is not known, with those that are.
    pub fn indices(&self, key: &str, known: &[String]) -> Result<Vec<usize>> {
        self.find(key, known, |_| None)
    }

    /// As [`Self::indices`], where `other` may know a kernel by another name than its own.
    fn find(&self, key: &str, known: &[String], other: impl Fn(&str) -> Option<usize>) -> Result<Vec<usize>> {
        self.check(key)?;
        let Self::Only(names) = self else { return Ok((0..known.len()).collect()) };
        let find = |name: &String| {
            let index = known.iter().position(|known| known == name).or_else(|| other(name));
            index.ok_or_else(|| Error::config(key, unknown(name, known)))
        };
        let mut indices = names.iter().map(find).collect::<Result<Vec<_>>>()?;
        indices.sort_unstable();
        indices.dedup();
        Ok(indices)
    }
}

fn unknown(name: &str, known: &[String]) -> String {
    // The letters of an angle say nothing of how near it is to others.
    let near = match angle_of(name.strip_prefix('r').unwrap_or(name)) {
        Some(angle_deg) => beside(angle_deg, known),
        None => nearest(name, known),
    };
    let near = near.map(|near| format!("; did you mean {near}?")).unwrap_or_default();
    format!("there is no kernel {name}: there are {}{near}", known.join(", "))
}

/// Angles that differ by more are none that somebody took for each other.
const BESIDE_DEG: f64 = 2.0;

/// The kernel whose rotation is nearest to an angle, if it is near.
fn beside(angle_deg: f64, known: &[String]) -> Option<&str> {
    let distance = |name: &str| Some((angle_of(name.strip_prefix('r')?)? - angle_deg).abs());
    let distances = known.iter().filter_map(|name| Some((distance(name)?, name.as_str())));
    let near = distances.filter(|(distance, _)| *distance <= BESIDE_DEG);
    near.min_by(|(a, _), (b, _)| a.total_cmp(b)).map(|(_, name)| name)
}

/// The angle in degrees that a text is; none where it is no number.
fn angle_of(text: &str) -> Option<f64> {
    text.parse().ok().filter(|angle: &f64| angle.is_finite())
}

impl Dataset {
    /// The indices in the bank of the chosen kernels. A kernel that has a name of its own in a published set also goes
    /// by that of its rotation, `r+00`.
    ///
    /// # Errors
    /// [`Error::Config`] under `key` for a name that is not known, with those that are.
    pub fn kernel_indices(&self, choice: &KernelChoice, key: &str) -> Result<Vec<usize>> {
        choice.find(key, &self.kernels, |name| {
            let angle_deg: f64 = name.strip_prefix('r')?.parse().ok()?;
            let is_turned = |turned: f64| (turned - angle_deg).abs() < 1e-9;
            let triplet = self.triplets.iter().find(|triplet| triplet.angle_deg.is_some_and(is_turned))?;
            self.kernels.iter().position(|kernel| *kernel == triplet.kernel)
        })
    }
}

impl Serialize for KernelChoice {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self {
            Self::All => serializer.serialize_str(ALL),
            Self::Only(names) => names.serialize(serializer),
        }
    }
}

impl<'de> Deserialize<'de> for KernelChoice {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        /// Either way to write it.
        #[derive(Deserialize)]
        #[serde(untagged)]
        enum Written {
            One(String),
            Several(Vec<String>),
        }
        match Written::deserialize(deserializer) {
            Ok(Written::One(name)) if name == ALL => Ok(Self::All),
            Ok(Written::One(name)) => Ok(Self::Only(vec![name])),
            Ok(Written::Several(names)) => Ok(Self::Only(names)),
            Err(_) => Err(D::Error::custom("expected \"all\", or a list of names such as [\"r+00\"]")),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn known() -> Vec<String> {
        ["r-03", "r+00", "r+03"].map(str::to_owned).to_vec()
    }

    fn only(names: &[&str]) -> KernelChoice {
        KernelChoice::Only(names.iter().map(|&name| name.to_owned()).collect())
    }

    #[test]
    fn chooses_in_the_order_of_the_set() {
        assert_eq!(KernelChoice::All.indices("kernels", &known()).unwrap(), [0, 1, 2]);
        assert_eq!(only(&["r+03", "r-03"]).indices("kernels", &known()).unwrap(), [0, 2]);
    }

    #[test]
    fn names_the_kernels_there_are_when_one_is_unknown() {
        let message = only(&["r00"]).indices("data.kernels", &known()).unwrap_err().to_string();
        assert_eq!(
            message,
            "data.kernels: there is no kernel r00: there are r-03, r+00, r+03; did you mean r+00?"
        );
        for (name, meant) in [("0", "r+00"), ("-3", "r-03"), ("r+02", "r+03"), ("7", ""), ("r90", "")] {
            let message = only(&[name]).indices("kernels", &known()).unwrap_err().to_string();
            let meant = if meant.is_empty() {
                "r-03, r+00, r+03".to_owned()
            } else {
                format!("did you mean {meant}?")
            };
            assert!(message.ends_with(&meant), "{message}");
        }
        assert!(only(&[]).check("kernels").unwrap_err().to_string().contains("names no kernel"));
        assert!(only(&["a", "b", "a"]).check("kernels").unwrap_err().to_string().contains("a twice"));
    }

    #[test]
    fn is_written_as_a_word_or_a_list() {
        for (choice, text) in [(KernelChoice::All, "\"all\""), (only(&["r+00"]), "[\"r+00\"]")] {
            assert_eq!(serde_json::to_string(&choice).unwrap(), text);
            assert_eq!(serde_json::from_str::<KernelChoice>(text).unwrap(), choice);
        }
        assert_eq!(serde_json::from_str::<KernelChoice>("\"r+00\"").unwrap(), only(&["r+00"]));
        assert!(serde_json::from_str::<KernelChoice>("3").unwrap_err().to_string().contains("\"all\""));
    }
}
