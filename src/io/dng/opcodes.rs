//! Corrections of the lens that a digital negative asks for: lists of opcodes, of which those that change how bright
//! places of the frame are get applied, and the others named (DNG 1.7, chapter 7, "Opcode List Processing").

use ndarray::{Array3, Axis};
use rayon::prelude::*;

use super::gains::{Gain, GainMap, Vignette};
use super::reader::Reader;
use crate::core::bayer::BayerPattern;
use crate::core::saturation::saturated_from;
use crate::io::IgnoredOpcode;
use crate::io::directory::Directory;

/// Opcodes for the photosites as they are read, for linear light, and for interpolated colours.
const LISTS: [u16; 3] = [51008, 51009, 51022];

const FIX_VIGNETTE_RADIAL: u32 = 3;
const GAIN_MAP: u32 = 9;

/// Names of the opcodes from 1 on.
const NAMES: [&str; 14] = [
    "WarpRectilinear",
    "WarpFisheye",
    "FixVignetteRadial",
    "FixBadPixelsConstant",
    "FixBadPixelsList",
    "TrimBounds",
    "MapTable",
    "MapPolynomial",
    "GainMap",
    "DeltaPerRow",
    "DeltaPerColumn",
    "ScalePerRow",
    "ScalePerColumn",
    "WarpRectilinear2",
];

/// The flag of an opcode that may be left out.
const OPTIONAL: u32 = 1;

const DAMAGED: &str =
    "is damaged: its corrections of the lens (opcode lists) are cut off or hold impossible numbers";

/// What is done to a negative's light.
#[derive(Default)]
pub(super) struct Corrections {
    gains: Vec<Gain>,
    /// Names of what is applied.
    pub(super) applied: Vec<String>,
    /// What is left out.
    pub(super) ignored: Vec<IgnoredOpcode>,
}

impl Corrections {
    /// Reads all lists of a raw image.
    pub(super) fn of(raw: &Directory<'_>) -> Result<Self, String> {
        let mut corrections = Self::default();
        for tag in LISTS {
            if let Some(list) = raw.bytes_of(tag) {
                corrections.read(&mut Reader(list), tag == LISTS[0], tag == LISTS[2]).ok_or(DAMAGED)?;
            }
        }
        Ok(corrections)
    }

    /// None where the list ends within an opcode, or one holds impossible numbers.
    fn read(&mut self, list: &mut Reader<'_>, is_of_photosites: bool, is_of_colors: bool) -> Option<()> {
        for _ in 0..list.u32()? {
            let (id, _version, flags) = (list.u32()?, list.u32()?, list.u32()?);
            let length = usize::try_from(list.u32()?).ok()?;
            let mut parameters = Reader(list.take(length)?);
            let name = usize::try_from(id).ok().and_then(|id| NAMES.get(id.checked_sub(1)?));
            let gain = match id {
                // The photosites as they are read are not linear, nor cut to the active area.
                _ if is_of_photosites => None,
                GAIN_MAP => Some(Gain::Map { map: GainMap::read(&mut parameters)?, is_of_colors }),
                FIX_VIGNETTE_RADIAL => Some(Gain::Vignette(Vignette::read(&mut parameters)?)),
                _ => None,
            };
            let name = name.map_or_else(|| format!("opcode {id}"), |name| (*name).to_owned());
            match gain {
                Some(gain) => {
                    self.gains.push(gain);
                    self.applied.push(name);
                }
                None => self.ignored.push(IgnoredOpcode { name, optional: flags & OPTIONAL != 0 }),
            }
        }
        Some(())
    }

    /// Multiplies the light above black; what was saturated stays at least as bright as it was.
    pub(super) fn apply(
        &self,
        planes: &mut Array3<f32>,
        [black, white]: [f64; 2],
        bayer: Option<BayerPattern>,
    ) {
        if self.gains.is_empty() {
            return;
        }
        #[expect(clippy::cast_possible_truncation, reason = "images are kept in 32 bit")]
        let (black, saturated) = (black as f32, saturated_from((white - black) as f32));
        let (channels, height, width) = planes.dim();
        planes.axis_iter_mut(Axis(1)).into_par_iter().enumerate().for_each(|(y, mut row)| {
            for ((channel, x), value) in row.indexed_iter_mut() {
                let color = match bayer {
                    Some(pattern) if channels == 1 => pattern.channel(y, x),
                    _ => channel,
                };
                let gains = self.gains.iter().map(|gain| gain.at([y, x], [height, width], channel, color));
                #[expect(clippy::cast_possible_truncation, reason = "images are kept in 32 bit")]
                let gain = gains.product::<f64>() as f32;
                let light = *value - black;
                let corrected = light * gain;
                *value = black + if light >= saturated { corrected.max(light) } else { corrected };
            }
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A map of nodes 0.5 of the frame apart, from its border on.
    fn map(area: [u32; 4], planes: [u32; 2], pitch: [u32; 2], nodes: [u32; 3], values: &[f32]) -> Vec<u8> {
        let numbers = [&area[..], &planes, &pitch, &nodes[..2]].concat();
        let grid = [0.5, 0.5, 0.0, 0.0].map(f64::to_be_bytes).concat();
        let values: Vec<u8> = values.iter().flat_map(|value| value.to_be_bytes()).collect();
        let numbers: Vec<u8> = numbers.iter().flat_map(|number| number.to_be_bytes()).collect();
        opcode(GAIN_MAP, &[numbers, grid, nodes[2].to_be_bytes().to_vec(), values].concat())
    }

    fn opcode(id: u32, parameters: &[u8]) -> Vec<u8> {
        let length = u32::try_from(parameters.len()).unwrap();
        [&[id, 0x0103_0000, 0, length].map(u32::to_be_bytes).concat(), parameters].concat()
    }

    /// The corrections of opcodes for linear light, or for colours.
    fn corrections(opcodes: &[Vec<u8>], is_of_colors: bool) -> Corrections {
        let count = u32::try_from(opcodes.len()).unwrap().to_be_bytes();
        let list = [&count[..], &opcodes.concat()].concat();
        let mut corrections = Corrections::default();
        corrections.read(&mut Reader(&list), false, is_of_colors).unwrap();
        corrections
    }

    const EVERYWHERE: [u32; 4] = [0, 0, u32::MAX, u32::MAX];

    #[test]
    fn a_map_for_one_photosite_of_the_mosaic_leaves_the_others() {
        let gains = corrections(&[map([0, 1, 4, 6], [0, 1], [2, 2], [1, 1, 1], &[3.0])], false);
        let mut planes = Array3::from_elem((1, 6, 6), 0.3);
        gains.apply(&mut planes, [0.1, 1.1], Some(BayerPattern::Rggb));
        for ((_, y, x), value) in planes.indexed_iter() {
            let expected = if y < 4 && y % 2 == 0 && x % 2 == 1 { 0.7 } else { 0.3 };
            assert!((value - expected).abs() < 1e-6, "{value} at {y}, {x}");
        }
    }

    /// Two by one nodes in the middle of the rows: gains between them by the distance of the photosites' centres.
    #[test]
    fn gains_between_nodes_are_interpolated_and_those_beyond_are_the_last() {
        let gains = corrections(&[map(EVERYWHERE, [0, 3], [1, 1], [1, 2, 1], &[1.0, 2.0])], true);
        let mut planes = Array3::from_elem((3, 1, 8), 0.25);
        gains.apply(&mut planes, [0.0, 1.0], None);
        for ((_, _, x), value) in planes.indexed_iter() {
            let gain = 1.0 + ((x as f32 + 0.5) / 8.0 / 0.5).min(1.0);
            assert!((value - 0.25 * gain).abs() < 1e-6, "{value} at {x}");
        }
    }

    /// A map after the colours were interpolated has a plane for each; the mosaic's photosites take their colour's.
    #[test]
    fn maps_of_colours_apply_to_the_photosites_of_the_colour() {
        let gains = corrections(&[map(EVERYWHERE, [0, 3], [1, 1], [1, 1, 3], &[2.0, 1.0, 0.5])], true);
        let mut planes = Array3::from_elem((1, 2, 2), 0.2);
        gains.apply(&mut planes, [0.0, 1.0], Some(BayerPattern::Grbg));
        assert_eq!(planes.as_slice().unwrap(), [0.2, 0.4, 0.1, 0.2]);
    }

    #[test]
    fn what_is_saturated_stays_saturated() {
        let gains = corrections(&[map(EVERYWHERE, [0, 1], [1, 1], [1, 1, 1], &[0.5])], false);
        let mut planes = Array3::from_shape_vec((1, 1, 3), vec![0.5, 0.98, 1.0]).unwrap();
        gains.apply(&mut planes, [0.0, 1.0], None);
        assert_eq!(planes.as_slice().unwrap(), [0.25, 0.49, 1.0]);
    }

    #[test]
    fn the_gain_of_a_vignette_is_a_polynomial_of_the_distance() {
        let numbers = [0.5, 0.25, 0.125, 0.0625, 0.03125, 0.5, 0.5].map(f64::to_be_bytes).concat();
        let gains = corrections(&[opcode(FIX_VIGNETTE_RADIAL, &numbers)], true);
        let mut planes = Array3::from_elem((3, 5, 5), 0.1);
        gains.apply(&mut planes, [0.0, 1.0], None);
        // Row 2, column 0 lies at 1/√2 of the corner's distance.
        let halfway = 1.0 + 0.5 / 2.0 + 0.25 / 4.0 + 0.125 / 8.0 + 0.0625 / 16.0 + 0.03125 / 32.0;
        for ([y, x], gain) in [([2, 2], 1.0), ([0, 0], 1.968_75), ([4, 0], 1.968_75), ([2, 0], halfway)] {
            assert!((planes[[1, y, x]] - 0.1 * gain).abs() < 1e-6, "{} at {y}, {x}", planes[[1, y, x]]);
        }
    }
}
