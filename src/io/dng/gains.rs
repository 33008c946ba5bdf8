//! The gains by which opcodes correct the shading of a lens: a map of them, and a polynomial of the distance.

use super::reader::Reader;

/// A gain for each place of the frame.
pub(super) enum Gain {
    Map {
        map: GainMap,
        /// Whether its planes are colours, not the one plane of a mosaic.
        is_of_colors: bool,
    },
    Vignette(Vignette),
}

impl Gain {
    pub(super) fn at(&self, place: [usize; 2], size: [usize; 2], channel: usize, color: usize) -> f64 {
        match self {
            Self::Map { map, is_of_colors } => {
                map.at(place, size, if *is_of_colors { color } else { channel })
            }
            Self::Vignette(vignette) => vignette.at(place, size),
        }
    }
}

/// Gains at the nodes of a grid, for the places that it applies to.
pub(super) struct GainMap {
    /// Top, left, bottom, right.
    area: [usize; 4],
    /// First plane, and how many.
    planes: [usize; 2],
    /// Distance of the rows and of the columns that it applies to.
    pitch: [usize; 2],
    nodes: [usize; 2],
    /// Distance of the nodes and the place of the first, in heights and widths of the image.
    spacing: [f64; 2],
    origin: [f64; 2],
    node_planes: usize,
    /// Row by row, column by column, plane by plane.
    values: Vec<f32>,
}

impl GainMap {
    /// None where there are fewer bytes than there should be, or impossible numbers.
    pub(super) fn read(parameters: &mut Reader<'_>) -> Option<Self> {
        let mut numbers = [0; 10];
        for number in &mut numbers {
            *number = usize::try_from(parameters.u32()?).ok()?;
        }
        let [top, left, bottom, right, plane, planes, row_pitch, column_pitch, rows, columns] = numbers;
        let spacing = [parameters.f64()?, parameters.f64()?];
        let origin = [parameters.f64()?, parameters.f64()?];
        let node_planes = usize::try_from(parameters.u32()?).ok()?;
        let count = rows.checked_mul(columns)?.checked_mul(node_planes)?;
        let bytes = parameters.take(count.checked_mul(4)?)?;
        let values: Vec<f32> =
            bytes.as_chunks::<4>().0.iter().map(|bytes| f32::from_be_bytes(*bytes)).collect();
        let map = Self {
            area: [top, left, bottom, right],
            planes: [plane, planes],
            pitch: [row_pitch, column_pitch],
            nodes: [rows, columns],
            spacing,
            origin,
            node_planes,
            values,
        };
        map.is_sound().then_some(map)
    }

    fn is_sound(&self) -> bool {
        let is_gain = |gain: &f32| gain.is_finite() && *gain >= 0.0;
        let is_grid = |axis: usize| self.nodes[axis] == 1 || self.spacing[axis] > 0.0;
        let is_placed = self.origin.iter().chain(&self.spacing).all(|value| value.is_finite());
        !self.values.is_empty()
            && self.values.iter().all(is_gain)
            && self.pitch.iter().all(|pitch| *pitch > 0)
            && is_grid(0)
            && is_grid(1)
            && is_placed
    }

    /// The gain of a photosite or of a colour: bilinear between nodes, those at the border beyond it; 1 where the map does
    /// not apply.
    fn at(&self, place: [usize; 2], size: [usize; 2], plane: usize) -> f64 {
        let [top, left, bottom, right] = self.area;
        let is_inside = (top..bottom).contains(&place[0]) && (left..right).contains(&place[1]);
        let [first, count] = self.planes;
        if !is_inside
            || !(place[0] - top).is_multiple_of(self.pitch[0])
            || !(place[1] - left).is_multiple_of(self.pitch[1])
            || plane < first
            || plane - first >= count
        {
            return 1.0;
        }
        let [(y, below), (x, right)] = [0, 1].map(|axis| self.between(axis, place[axis], size[axis]));
        let plane = plane.min(self.node_planes - 1);
        let node = |y: usize, x: usize| {
            let (y, x) = (y.min(self.nodes[0] - 1), x.min(self.nodes[1] - 1));
            f64::from(self.values[(y * self.nodes[1] + x) * self.node_planes + plane])
        };
        let along = |y: usize| (1.0 - right) * node(y, x) + right * node(y, x + 1);
        (1.0 - below) * along(y) + below * along(y + 1)
    }

    /// The node before a place, and how far it lies towards the next.
    fn between(&self, axis: usize, place: usize, size: usize) -> (usize, f64) {
        if self.nodes[axis] == 1 {
            return (0, 0.0);
        }
        let relative = (place as f64 + 0.5) / size as f64;
        let node = (relative - self.origin[axis]) / self.spacing[axis];
        let node = node.clamp(0.0, (self.nodes[axis] - 1) as f64);
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "the number of a node")]
        let before = node.floor() as usize;
        (before, node - node.floor())
    }
}

/// A gain that grows with the distance from the optical centre.
///
/// # Equation
/// `1 + k₀r² + k₁r⁴ + k₂r⁶ + k₃r⁸ + k₄r¹⁰`, r being the distance over that of the farthest corner.
pub(super) struct Vignette {
    coefficients: [f64; 5],
    /// Column and row, as shares of the frame.
    center: [f64; 2],
}

impl Vignette {
    pub(super) fn read(parameters: &mut Reader<'_>) -> Option<Self> {
        let mut coefficients = [0.0; 5];
        for coefficient in &mut coefficients {
            *coefficient = parameters.finite()?;
        }
        Some(Self { coefficients, center: [parameters.finite()?, parameters.finite()?] })
    }

    fn at(&self, [y, x]: [usize; 2], [height, width]: [usize; 2]) -> f64 {
        let last = [width - 1, height - 1].map(|last| last as f64);
        let center = [0, 1].map(|axis| self.center[axis] * last[axis]);
        let farthest = [0, 1].map(|axis: usize| center[axis].abs().max((last[axis] - center[axis]).abs()));
        let square = (x as f64 - center[0]).powi(2) + (y as f64 - center[1]).powi(2);
        let whole = farthest[0].powi(2) + farthest[1].powi(2);
        let r2 = if whole > 0.0 { square / whole } else { 0.0 };
        let sum = self.coefficients.iter().rev().fold(0.0, |sum, k| (sum + k) * r2);
        (1.0 + sum).max(0.0)
    }
}
