//! Finds exposures that end on a plateau below white: the white that was told, or that nobody told, is too high.

use ndarray::Array3;

use super::bracket::show_time;

/// An exposure whose values are cut off below white.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CutOff {
    /// The exposure, from 0 = longest.
    pub exposure: usize,
    /// The shorter exposure that shows more light there.
    pub shorter: usize,
    /// Where the values end, as a share of white above black.
    pub level: f64,
}

/// Values this close to the maximum, as a share, are on its plateau: some steps of 12 bits.
const PLATEAU: f64 = 0.002;
/// The values below it to compare it with: of six times the width, of which smooth light fills as much each.
const BELOW: f64 = 0.012;
/// So few equal values may be chance.
const FEWEST: usize = 16;
/// A plateau holds more than so many times what lies [below](BELOW), of smooth light a sixth of it.
const CLEARLY_MORE: usize = 2;
/// More light than the maximum lets expect, that no rounding of times makes.
const CLEARLY_BRIGHTER: f64 = 1.1;
/// The brightest tenth of the light on a plateau over the darkest: a flat surface has one brightness, but for noise.
const VARIES: f64 = 1.25;

impl CutOff {
    /// What the user is to do about it.
    pub(super) fn warning(&self, times: &[f64]) -> String {
        format!(
            "the values of exposure {} end at {:.4} of white, where {} shows more light: they are cut off there and taken for \
             light; tell the white of the sensor with --white",
            show_time(times[self.exposure]),
            self.level,
            show_time(times[self.shorter])
        )
    }
}

/// The exposures, longest first, whose values end below white although a shorter one shows more light there.
pub(super) fn cut_offs(frames: &[Array3<f32>], times: &[f64], saturation: f64) -> Vec<CutOff> {
    let cut_off = |exposure: usize| {
        let level = plateau(&frames[exposure]).filter(|level| *level < saturation)?;
        let is_brighter = |shorter: &usize| {
            shows_more([&frames[exposure], &frames[*shorter]], level, times[*shorter] / times[exposure])
        };
        let shorter = (exposure + 1..frames.len()).find(is_brighter)?;
        Some(CutOff { exposure, shorter, level })
    };
    (0..frames.len()).filter_map(cut_off).collect()
}

/// The shares of white from which on what values end at is taken for white, and is told of; what is darker is a capture of darkness.
const LEAST_WHITE: f64 = 0.8;
const LEAST_DOUBTED: f64 = 0.03;

/// Where the values of a mosaic end below white, as a share of that: a sensor may be full before its converter is. Far below, flat light
/// is more plausible.
pub(super) fn end_below_white(mosaic: &Array3<f32>, saturation: f64) -> Option<f64> {
    plateau(mosaic).filter(|level| (LEAST_WHITE..saturation).contains(level))
}

/// Where the values of a picture alone end far below white, as a share of that: flat light, or that of a sensor of fewer bits than told.
pub(super) fn end_far_below_white(frames: &[Array3<f32>]) -> Option<f64> {
    let [picture] = frames else { return None };
    // What most of a picture has is a wall.
    let (level, _) = counted_plateau(picture).filter(|(_, pixels)| 2 * pixels < picture.len())?;
    (LEAST_DOUBTED..LEAST_WHITE).contains(&level).then_some(level)
}

/// For each of so many exposures, the value from which on its light may be cut off.
pub(super) fn ceilings(cut_offs: &[CutOff], exposures: usize, saturation: f64) -> Vec<f64> {
    let mut ceilings = vec![saturation; exposures];
    cut_offs.iter().for_each(|cut_off| ceilings[cut_off.exposure] = cut_off.level * (1.0 - PLATEAU));
    ceilings
}

/// The maximum of a picture, where many more values are that bright than a little darker.
fn plateau(frame: &Array3<f32>) -> Option<f64> {
    counted_plateau(frame).map(|(level, _)| level)
}

/// The same, and how many values are that bright.
fn counted_plateau(frame: &Array3<f32>) -> Option<(f64, usize)> {
    let level = f64::from(frame.iter().copied().fold(0.0, f32::max));
    let [top, bottom] = [PLATEAU, PLATEAU + BELOW].map(|below| level * (1.0 - below));
    let (mut on, mut below) = (0, 0);
    for value in frame.iter().map(|value| f64::from(*value)).filter(|value| *value >= bottom) {
        if value >= top { on += 1 } else { below += 1 }
    }
    (level > 0.0 && on >= FEWEST && on > CLEARLY_MORE * below).then_some((level, on))
}

/// Whether a shorter exposure, of `share` of the time, shows more light on the longer one's plateau than its level is.
///
/// Wrong times show more light, too, but the same of a surface that is flat; of light that was cut off, they show
/// various amounts, or end at the same level.
fn shows_more([long, short]: [&Array3<f32>; 2], level: f64, share: f64) -> bool {
    let on_plateau = long.iter().zip(short).filter(|(long, _)| f64::from(**long) >= level * (1.0 - PLATEAU));
    let mut light: Vec<f64> = on_plateau.map(|(_, short)| f64::from(*short)).collect();
    let tenth = light.len() / 10;
    let mean = light.iter().sum::<f64>() / light.len() as f64;
    light.sort_unstable_by(f64::total_cmp);
    let (darkest, brightest) = (light[tenth], light[light.len() - 1 - tenth]);
    let ends_there = (brightest / level - 1.0).abs() <= PLATEAU;
    mean > CLEARLY_BRIGHTER * level * share && (brightest > VARIES * darkest || ends_there)
}

#[cfg(test)]
mod tests {
    use super::*;

    const TIMES: [f64; 3] = [1.0, 0.25, 1.0 / 16.0];

    /// A lamp's halo on a ground, and a flat wall beside it.
    fn scene() -> Array3<f32> {
        Array3::from_shape_fn((3, 48, 96), |(_, y, x)| {
            let squared = (y as f32 - 24.0).powi(2) + (x as f32 - 24.0).powi(2);
            if x > 60 { 0.15 } else { 0.05 + 0.001 * x as f32 + 40.0 / (1.0 + squared) }
        })
    }

    fn exposed(white: f32, times: [f64; 3]) -> Vec<Array3<f32>> {
        times.map(|time| scene().mapv(|light| (light * time as f32).min(white))).to_vec()
    }

    #[test]
    fn values_that_end_at_a_quarter_of_white_are_cut_off() {
        let found = cut_offs(&exposed(0.25, TIMES), &TIMES, 0.99);
        let places: Vec<[usize; 2]> =
            found.iter().map(|cut_off| [cut_off.exposure, cut_off.shorter]).collect();
        assert_eq!(places, [[0, 1], [1, 2]], "nothing is known of the shortest");
        assert!(found.iter().all(|cut_off| (cut_off.level - 0.25).abs() < 1e-6), "{found:?}");
        let said = found[0].warning(&TIMES);
        assert!(said.contains("end at 0.2500 of white") && said.contains("--white"), "{said}");
    }

    #[test]
    fn white_and_flat_surfaces_are_no_plateaus() {
        assert_eq!(cut_offs(&exposed(1.0, TIMES), &TIMES, 0.99), []);
        // The wall is the brightest there is.
        let flat: Vec<Array3<f32>> =
            TIMES.map(|time| scene().mapv(|light| light.min(0.15) * time as f32)).to_vec();
        assert_eq!(cut_offs(&flat, &[1.0, 0.2, 0.05], 0.99), [], "wrong times are no wrong white");
    }
}
