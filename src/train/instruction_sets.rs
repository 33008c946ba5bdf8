//! The instruction sets of CPUs and the GPUs that a training computed with: its bits are theirs.

use std::fmt;

use crate::network::{Backends, Isa, Precision};

/// What stands between names in a training's state; a name may hold a comma.
const SEPARATOR: &str = " → ";

/// The names of instruction sets and GPUs, in the order in which a training used them.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct InstructionSets(Vec<String>);

impl InstructionSets {
    /// The one that this process computes with.
    pub(super) fn current(backends: &Backends, precision: Precision) -> Self {
        Self(vec![name_of(backends, precision)])
    }

    /// Reads what a state kept.
    pub(super) fn parse(text: &str) -> Self {
        Self(text.split(SEPARATOR).map(str::to_owned).collect())
    }

    /// Goes on with this process's set, and warns when it is another than the last.
    pub(super) fn followed(
        &self,
        (backends, precision): (&Backends, Precision),
        warn: &dyn Fn(&str),
    ) -> Self {
        self.followed_by(&name_of(backends, precision), |was, is| {
            let back = if Isa::named(was).is_some() {
                format!("; stop and resume with UDC_SIMD={was} in the environment, on the CPU, to keep them the same")
            } else {
                String::new()
            };
            warn(&format!(
                "the run computed with {was} and goes on with {is}: from here on its bits will differ from \
                 those of an uninterrupted one, by rounding{back}"
            ));
        })
    }

    fn followed_by(&self, is: &str, differs: impl Fn(&str, &str)) -> Self {
        let mut sets = self.0.clone();
        match sets.last() {
            Some(was) if was == is => {}
            Some(was) => {
                differs(was, is);
                sets.push(is.to_owned());
            }
            None => sets.push(is.to_owned()),
        }
        Self(sets)
    }
}

/// What stands for the arithmetic of backends.
fn name_of(backends: &Backends, precision: Precision) -> String {
    let is_cpu = backends.first().is_cpu();
    let name = if is_cpu { Isa::current().name().to_owned() } else { backends.to_string() };
    precision.name_of(&name)
}

impl fmt::Display for InstructionSets {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0.join(SEPARATOR))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::network::Backend;
    use std::cell::RefCell;

    #[test]
    fn another_set_than_the_last_is_told_and_remembered() {
        let kept = InstructionSets::parse("avx512 → avx2");
        let told = RefCell::new(Vec::new());
        let differs = |was: &str, is: &str| told.borrow_mut().push(format!("{was} to {is}"));
        assert_eq!(kept.followed_by("avx2", differs), kept);
        assert!(told.borrow().is_empty());
        let now = kept.followed_by("portable", differs);
        assert_eq!(now.to_string(), "avx512 → avx2 → portable");
        assert_eq!(InstructionSets::parse(&now.to_string()), now);
        assert_eq!(*told.borrow(), ["avx2 to portable"]);
    }

    #[test]
    fn the_same_set_is_gone_on_with_in_silence() {
        let (backends, precision) = (Backends::from(Backend::Flex), Precision::F32);
        let here = (&backends, precision);
        let current = InstructionSets::current(&backends, precision);
        assert_eq!(current.followed(here, &|text| panic!("{text}")), current);
    }

    #[test]
    fn bfloat16_is_another_arithmetic() {
        let [full, mixed] = [Precision::F32, Precision::Bf16]
            .map(|precision| InstructionSets::current(&Backends::as_devices(2), precision).to_string());
        assert_eq!(mixed, format!("{full}, bf16"));
    }
}
