//! Says what the user should look at in a fused bracket, and which corrections a raw file lacks.

use super::bracket::show_time;
use super::frames::Uneven;
use super::fuse::Fused;
use super::point_source::NARROW;
use crate::io::RawMetadata;

/// So many saturated values of a whole image are no lamps.
const MUCH: f64 = 0.1;

/// A brightness that differs by more is no rounding of an exposure time.
const CLEAR_RATIO: f64 = 0.1;

impl Fused {
    /// What is doubtful of levels, exposure times and mosaic.
    pub fn warnings(&self) -> Vec<String> {
        let mut warnings: Vec<String> =
            self.cut_off.iter().map(|cut_off| cut_off.warning(&self.times)).collect();
        warnings.extend(self.white_found.map(|level| {
            format!(
                "its values end at {level:.3} of the white that the file says, as of a sensor that is full before its converter, and that \
                 is taken for white; to take another, tell --white"
            )
        }));
        warnings.extend(self.white_doubted.map(|level| {
            format!(
                "its values end at {level:.4} of white, many of them at one, as of a sensor that is full there, and are taken for light: if it is, \
                 tell its white with --white"
            )
        }));
        warnings.extend(self.pedestal.map(|level| {
            format!(
                "all of its exposures have about {level:.4} of white alike, which no light is, as that grows with time: a black level was left \
                 in; tell it with --black"
            )
        }));
        warnings.extend(self.doubtful_times());
        let compared = |uneven: &Uneven| {
            let [first, other] = uneven.pictures;
            let ratio = uneven.ratio?;
            Some(format!(
                "picture {other} is {ratio:.2} times as bright as picture {first} of the same exposure time; check the times"
            ))
        };
        warnings.extend(self.uneven.iter().filter_map(compared));
        let unknown = self.uneven.iter().filter(|uneven| uneven.ratio.is_none());
        let unknown: Vec<String> = unknown.map(|uneven| uneven.pictures[1].to_string()).collect();
        if !unknown.is_empty() {
            warnings.push(format!(
                "whether pictures of the same exposure time are as bright as each other could not be checked of {}: too \
                 little light in common with the first is well above black and unsaturated",
                unknown.join(", ")
            ));
        }
        if self.looks_hot > 0 {
            warnings.push(format!(
                "{} of its values stand alone in one colour, as those of hot pixels do and a lens's light does not: in a PSF they make \
                 ghosts of every lamp; take dark frames, which fill such pixels (--dark), or discard them (--mask)",
                self.looks_hot
            ));
        }
        if self.greens_look_swapped {
            warnings.push("the mosaic's greens look as if on the other diagonal; check --bayer".to_owned());
        }
        warnings
    }

    /// The exposure times that contradict the pictures, and those of exposures that were used and that nothing confirms.
    fn doubtful_times(&self) -> Vec<String> {
        let shortest_used = self.source.iter().max().map_or(0, |source| usize::from(*source));
        let pairs = self.ratio_found.iter().zip(self.times.windows(2)).enumerate();
        let doubt = |(index, (found, times)): (usize, (&Option<f64>, &[f64]))| {
            let [long, short] = [0, 1].map(|k| show_time(times[k]));
            match found {
                Some(found) => ((found - 1.0).abs() > CLEAR_RATIO).then(|| {
                    format!(
                        "exposure {short} is {found:.2} times as bright as {long} lets expect; check the times, or pass \
                         --estimate-exposures"
                    )
                }),
                None => (index < shortest_used).then(|| {
                    format!(
                        "the times of {long} and {short} could not be checked: too little light in common is well above \
                         black and unsaturated in both"
                    )
                }),
            }
        };
        pairs.filter_map(doubt).collect()
    }

    /// What is to be said of a point source whose core the photosites of a mosaic do not sample.
    pub fn core_is_narrow(&self) -> Option<String> {
        let share = self.core_share.filter(|share| *share > NARROW)?;
        Some(format!(
            "the core is too narrow for a mosaic: one photosite has {:.0} % of the light that those of its colour see around it, and what \
             lies between them is guessed, so that a good part of the PSF may be wrong. Take the same bracket with the source \
             moved by one pixel right, down, and both, and give the four folders with --positions; or measure with the lens \
             slightly out of focus, if it will be so in use",
            100.0 * share
        ))
    }

    /// What is to be said of an image of which much is brighter than its values are.
    pub fn much_is_saturated(&self) -> Option<String> {
        let share = self.saturated.iter().sum::<usize>() as f64 / self.source.len() as f64;
        let (of_what, advice) = match self.times.len() {
            1 => ("saturated", "check --white, or take a shorter exposure with it (--exposures)"),
            _ => ("saturated in every exposure", "add a shorter exposure, or check --white"),
        };
        let percent = 100.0 * share;
        (share >= MUCH).then(|| {
            format!("{percent:.0} % of the values are {of_what} and brighter than written; {advice}")
        })
    }
}

/// Names the corrections that a raw file asks for and that were not made.
pub fn uncorrected(raw: &RawMetadata) -> Option<String> {
    let names = |optional: bool| {
        let names = raw.ignored.iter().filter(|opcode| opcode.optional == optional);
        names.map(|opcode| opcode.name.as_str()).collect::<Vec<_>>().join(", ")
    };
    // Opcodes that have no name yet may be skipped silently where the file allows it.
    let (needed, optional) = (names(false), names(true));
    let is_known = raw.ignored.iter().any(|opcode| opcode.optional && !opcode.name.starts_with("opcode"));
    match (needed.is_empty(), is_known) {
        (true, false) => None,
        (true, true) => {
            Some(format!("restored without the correction of {optional}, which the file makes optional"))
        }
        (false, _) => {
            let also = if is_known { format!(", and of {optional}") } else { String::new() };
            Some(format!(
                "restored without the correction of {needed}{also}; the file requires {needed}: positions or values may \
                 be off, so convert it with these corrections made, if they matter"
            ))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::io::IgnoredOpcode;

    #[test]
    fn corrections_that_a_file_requires_are_told_apart_from_those_that_it_does_not() {
        let raw = |opcodes: &[(&str, bool)]| RawMetadata {
            ignored: opcodes
                .iter()
                .map(|(name, optional)| IgnoredOpcode { name: (*name).to_owned(), optional: *optional })
                .collect(),
            ..RawMetadata::default()
        };
        assert_eq!(uncorrected(&raw(&[])), None);
        assert_eq!(uncorrected(&raw(&[("opcode 99", true)])), None, "it has no name to warn of");
        let optional = uncorrected(&raw(&[("WarpRectilinear", true)])).unwrap();
        assert!(optional.contains("makes optional"), "{optional}");
        let both = uncorrected(&raw(&[("MapTable", false), ("WarpRectilinear", true)])).unwrap();
        assert!(both.contains("requires MapTable") && both.contains("and of WarpRectilinear"), "{both}");
    }
}
