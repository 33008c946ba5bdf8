//! Makes the light that is measured: of one bracket, or of brackets of one source at several positions.

use std::path::PathBuf;

use anyhow::{Context as _, Result, bail};
use serde_json::{Value, json};

use udc::capture::{CaptureGroups, Developed, Pictures, SAME_TIME, Told, interleave, names_of};

use super::summary::doubts_of;
use crate::commands::Session;

/// What is to be written or measured.
pub(super) struct Light {
    /// The files that it is made of.
    pub(super) inputs: Vec<PathBuf>,
    /// The first bracket, with the image of all.
    pub(super) developed: Developed,
    /// Where the source was taken; empty for one bracket.
    pub(super) positions: Vec<Position>,
}

/// One of several positions of a source.
pub(super) struct Position {
    name: String,
    displacement_px: [f64; 2],
}

impl Position {
    pub(super) fn describe(&self) -> String {
        let [down, right] = self.displacement_px;
        format!("position {}: {down:+.2} down, {right:+.2} right of the first", self.name)
    }

    pub(super) fn json(&self) -> Value {
        json!({ "name": self.name, "displacement-px": self.displacement_px })
    }
}

impl Light {
    pub(super) fn of_bracket(inputs: Vec<PathBuf>, told: &Told, session: &Session) -> Result<Self> {
        let developed = develop(&inputs, told, session)?;
        Ok(Self { inputs, developed, positions: Vec::new() })
    }

    pub(super) fn of_positions(inputs: &[PathBuf], told: &Told, session: &Session) -> Result<Self> {
        let groups = CaptureGroups::of_brackets(inputs)?;
        groups.warnings.iter().for_each(|warning| session.warn(warning));
        let names: Vec<String> = groups.captures.iter().map(|capture| capture.name.clone()).collect();
        let (mut brackets, mut inputs) = (Vec::new(), Vec::new());
        for capture in groups.captures {
            brackets.push(develop(&capture.files, told, session)?);
            inputs.extend(capture.files);
        }
        check_equal(&brackets, &names)?;
        let doing = || format!("joining the positions {}", names.join(" "));
        let Some(pattern) = brackets[0].config.bayer else {
            bail!(
                "--positions are of mosaics: these pictures have every colour at every pixel, so that one is enough"
            );
        };
        let images: Vec<_> = brackets.iter().map(|bracket| bracket.fused.image.clone()).collect();
        let joined =
            session.timed("joining the positions", || interleave(&images, pattern)).with_context(doing)?;
        joined.warnings(&names).iter().for_each(|warning| session.warn(warning));
        for (bracket, name) in brackets.iter().zip(&names).skip(1) {
            doubts_of(&bracket.fused).iter().for_each(|doubt| session.warn(format_args!("{name}: {doubt}")));
        }
        let mut developed = brackets.swap_remove(0);
        developed.fused.image = joined.image;
        let positions = names.into_iter().zip(joined.displacements_px);
        let positions = positions.map(|(name, displacement_px)| Position { name, displacement_px }).collect();
        Ok(Self { inputs, developed, positions })
    }
}

fn develop(files: &[PathBuf], told: &Told, session: &Session) -> Result<Developed> {
    let doing = || format!("fusing bracket {}", names_of(files));
    let read = || Pictures::read(files, told, &session.progress);
    let pictures = session.timed(format_args!("reading {}", names_of(files)), read).with_context(doing)?;
    pictures.warnings.iter().for_each(|warning| session.warn(warning));
    session.progress.check()?;
    session.timed("fusing", || pictures.develop()).with_context(doing)
}

/// Refuses brackets whose values have another unit than those of the first: white of its longest exposure.
fn check_equal(brackets: &[Developed], names: &[String]) -> Result<()> {
    for (bracket, name) in brackets.iter().zip(names) {
        let is_same = |a: f64, b: f64| (a / b - 1.0).abs() <= SAME_TIME;
        if !is_same(bracket.longest_exposure, brackets[0].longest_exposure) {
            bail!(
                "{name}: its longest exposure is another than that of {}; take each position with the same times",
                names[0]
            );
        }
        if bracket.config != brackets[0].config {
            bail!("{name}: it says other levels, colours or gains than {}; give them by flags", names[0]);
        }
    }
    Ok(())
}
