//! Turns the outline of a sub-pixel into the share of each raster square that it covers.

use serde::{Deserialize, Serialize};

/// The outline of a region.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ShapeKind {
    /// A rectangle, its corners rounded by `corner-um`.
    #[default]
    Rectangle,
    /// An ellipse; a circle when width and height are equal.
    Ellipse,
    /// A rhombus standing on its corner.
    Diamond,
}

/// An outline around the origin; lengths in one unit of the caller's choice.
#[derive(Clone, Copy, Debug)]
pub struct Outline {
    kind: ShapeKind,
    half_width: f64,
    half_height: f64,
    corner: f64,
}

/// Points per side with which a square on an outline is sampled: edges are placed to 1/16 of a square, areas
/// to about 1/256 of it.
const EDGE_SAMPLES: usize = 16;

impl Outline {
    /// An outline of these sides; only a rectangle has corners to round.
    pub fn new(kind: ShapeKind, [height, width]: [f64; 2], corner: f64) -> Self {
        Self { kind, half_width: width / 2.0, half_height: height / 2.0, corner }
    }

    /// Whether a point lies inside.
    pub fn contains(&self, y: f64, x: f64) -> bool {
        let (y, x) = (y.abs(), x.abs());
        match self.kind {
            ShapeKind::Rectangle => {
                let (over_y, over_x) =
                    (y - (self.half_height - self.corner), x - (self.half_width - self.corner));
                let inside = y < self.half_height && x < self.half_width;
                let in_corner = over_y > 0.0 && over_x > 0.0;
                inside && (!in_corner || over_y.hypot(over_x) < self.corner)
            }
            ShapeKind::Ellipse => (y / self.half_height).powi(2) + (x / self.half_width).powi(2) < 1.0,
            ShapeKind::Diamond => y / self.half_height + x / self.half_width < 1.0,
        }
    }

    /// The share of the square of side `side` around a point that lies inside, from 0 to 1.
    ///
    /// # Accuracy
    /// Exact for rectangles with sharp corners. Else squares whose corners and centre agree count as wholly in
    /// or out, right for outlines that are smooth on the scale of a square; the others are sampled at 16 × 16
    /// points.
    pub fn coverage(&self, y: f64, x: f64, side: f64) -> f64 {
        let half = side / 2.0;
        if self.kind == ShapeKind::Rectangle && self.corner <= 0.0 {
            let shared =
                |place: f64, reach: f64| ((place + half).min(reach) - (place - half).max(-reach)).max(0.0);
            return shared(y, self.half_height) * shared(x, self.half_width) / (side * side);
        }
        let centre = self.contains(y, x);
        let uniform = [(-half, -half), (-half, half), (half, -half), (half, half)]
            .into_iter()
            .all(|(dy, dx)| self.contains(y + dy, x + dx) == centre);
        if uniform {
            return f64::from(u8::from(centre));
        }
        let place = |index: usize| ((index as f64 + 0.5) / EDGE_SAMPLES as f64 - 0.5) * side;
        let rows = (0..EDGE_SAMPLES).map(place);
        let hits: usize = rows
            .map(|dy| (0..EDGE_SAMPLES).filter(|&column| self.contains(y + dy, x + place(column))).count())
            .sum();
        hits as f64 / (EDGE_SAMPLES * EDGE_SAMPLES) as f64
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::PI;

    fn area(kind: ShapeKind, corner_um: f64) -> f64 {
        let outline = Outline::new(kind, [12.0, 20.0], corner_um);
        let side = 0.37;
        let places = |index: i32| f64::from(index) * side;
        let squares = (-40..=40).flat_map(|y| (-40..=40).map(move |x| (places(y), places(x))));
        squares.map(|(y, x)| outline.coverage(y, x, side)).sum::<f64>() * side * side
    }

    /// Straight sides are placed to 1/32 of a square of 0.37 µm: at worst 2 · 0.012 · (1/20 + 1/12) of the area.
    #[test]
    fn covers_the_area_of_its_outline() {
        let rounded = 240.0 - (4.0 - PI) * 9.0;
        let cases = [
            (ShapeKind::Rectangle, 0.0, 240.0),
            (ShapeKind::Rectangle, 3.0, rounded),
            (ShapeKind::Ellipse, 0.0, PI * 60.0),
            (ShapeKind::Diamond, 0.0, 120.0),
        ];
        for (kind, corner, expected) in cases {
            let found = area(kind, corner);
            assert!((found / expected - 1.0).abs() < 3.1e-3, "{kind:?}: {found} instead of {expected}");
        }
    }
}
