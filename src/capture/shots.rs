//! What files tell of their exposures: times and sensitivities.

use super::exposure_times::SAME_TIME;

/// The exposure of a file, as far as it tells.
#[derive(Clone, Copy, Debug)]
pub(super) struct Shot {
    pub(super) seconds: Option<f64>,
    pub(super) iso: Option<f64>,
}

/// What brightness grows with: the times, multiplied by the sensitivities where every file says its own.
pub(super) fn exposures(shots: &[Shot]) -> Option<Vec<f64>> {
    let times: Option<Vec<f64>> = shots.iter().map(|shot| shot.seconds).collect();
    let isos: Option<Vec<f64>> = shots.iter().map(|shot| shot.iso).collect();
    Some(match isos {
        Some(isos) => times?.iter().zip(isos).map(|(time, iso)| time * iso).collect(),
        None => times?,
    })
}

/// The exposures of dark frames in the unit of the pictures'; those that do not say their sensitivity have that of the pictures,
/// where it is one.
pub(super) fn exposures_of_darks(shots: &[Shot], darks: &[Shot]) -> Option<Vec<f64>> {
    exposures(shots)?;
    let isos: Option<Vec<f64>> = shots.iter().map(|shot| shot.iso).collect();
    let Some(isos) = isos else { return darks.iter().map(|dark| dark.seconds).collect() };
    let of_all = (!differ(&isos)).then_some(isos[0]);
    darks.iter().map(|dark| Some(dark.seconds? * dark.iso.or(of_all)?)).collect()
}

/// Whether only some files tell their sensitivities, and tell different ones, so that times alone are not exposures.
pub(super) fn is_in_doubt(shots: &[Shot]) -> bool {
    let told: Vec<f64> = shots.iter().filter_map(|shot| shot.iso).collect();
    told.len() < shots.len() && differ(&told)
}

/// Whether any value differs from the first as two settings do.
pub(super) fn differ(values: &[f64]) -> bool {
    values.iter().any(|value| (value / values[0] - 1.0).abs() > SAME_TIME)
}

/// What to say of a picture that no dark frame was taken like, where there is one: `exposures` are those of the pictures and of the
/// dark frames, `of_bracket` the different ones as shares of the longest.
pub(super) fn without_dark(
    exposures: [&[f64]; 2],
    of_bracket: &[f64],
    [shots, darks]: [&[Shot]; 2],
) -> Option<String> {
    let [times, dark_times] = exposures;
    let longest = times.iter().copied().fold(0.0, f64::max);
    let has_dark = |time: f64| dark_times.iter().any(|dark| (dark / longest / time - 1.0).abs() <= SAME_TIME);
    let time = of_bracket.iter().copied().find(|time| !has_dark(*time))?;
    let distance = |index: &usize| (times[*index] / longest / time - 1.0).abs();
    let picture = (0..times.len()).min_by(|a, b| distance(a).total_cmp(&distance(b)))?;
    let mut found: Vec<String> = darks.iter().map(Shot::show).collect();
    found.sort();
    found.dedup();
    let wanted = shots[picture].show();
    Some(format!(
        "no dark frame fits picture {} of {wanted}: they have {}; take dark frames with the exposure time and ISO of each \
         picture",
        picture + 1,
        found.join(", ")
    ))
}

impl Shot {
    fn show(&self) -> String {
        let iso = self.iso.map_or(String::new(), |iso| format!(" at ISO {iso}"));
        let seconds = match self.seconds {
            None => return format!("an unknown time{iso}"),
            Some(seconds) => seconds,
        };
        let inverse = 1.0 / seconds;
        if seconds < 0.6 && (inverse - inverse.round()).abs() < SAME_TIME * inverse {
            format!("1/{} s{iso}", inverse.round())
        } else {
            format!("{seconds} s{iso}")
        }
    }
}
