//! Turns series of numbers into line charts as SVG.

use std::fmt::Write as _;

use super::page::escape;

/// A named line of points (x, y).
#[derive(Clone, Debug)]
pub struct Series {
    /// The name in the legend.
    pub name: String,
    /// The points, by rising x.
    pub points: Vec<(f64, f64)>,
}

/// What a chart shows along its axes.
#[derive(Clone, Debug)]
pub struct Axes {
    /// Label of the horizontal axis.
    pub x: String,
    /// Label of the vertical axis.
    pub y: String,
    /// Whether the vertical axis is logarithmic; points at or below zero are left out then.
    pub log_y: bool,
}

/// Width and height of the drawing and the margins left, right, top, bottom, in user units.
const SIZE: (f64, f64) = (760.0, 300.0);
const MARGIN: (f64, f64, f64, f64) = (70.0, 20.0, 28.0, 42.0);

/// Colours told apart by people with any common colour vision (after Okabe and Ito).
const COLOURS: [&str; 7] = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#8a8a8a"];

/// Draws the series as lines on common axes.
///
/// Points that are not finite are left out; without any point the chart says so.
///
/// # Panics
/// Never: writing to a string cannot fail.
pub fn line_chart(series: &[Series], axes: &Axes) -> String {
    let usable =
        |point: &(f64, f64)| point.0.is_finite() && point.1.is_finite() && (!axes.log_y || point.1 > 0.0);
    let height = |y: f64| if axes.log_y { y.log10() } else { y };
    let lines: Vec<Vec<(f64, f64)>> = series
        .iter()
        .map(|one| one.points.iter().filter(|p| usable(p)).map(|&(x, y)| (x, height(y))).collect())
        .collect();
    let Some(frame) = Frame::around(lines.iter().flatten().copied()) else {
        return "<p>No points to draw.</p>".to_owned();
    };
    let mut svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {} {}\" width=\"{}\" font-family=\"sans-serif\" \
         font-size=\"12\" role=\"img\">\n",
        SIZE.0, SIZE.1, SIZE.0
    );
    frame.draw_axes(&mut svg, axes).expect("writing to a string cannot fail");
    for (index, (one, line)) in series.iter().zip(&lines).enumerate() {
        frame.draw_line(&mut svg, index, &one.name, line).expect("writing to a string cannot fail");
    }
    svg.push_str("</svg>");
    svg
}

/// The range of the data, mapped to the drawing.
struct Frame {
    x: (f64, f64),
    y: (f64, f64),
}

impl Frame {
    fn around(points: impl Iterator<Item = (f64, f64)>) -> Option<Self> {
        let empty = (f64::INFINITY, f64::NEG_INFINITY);
        let (x, y) = points.fold((empty, empty), |(x, y), point| {
            ((x.0.min(point.0), x.1.max(point.0)), (y.0.min(point.1), y.1.max(point.1)))
        });
        (x.0 <= x.1).then(|| Self { x: widen(x, 0.0), y: widen(y, 0.05) })
    }

    fn place(&self, (x, y): (f64, f64)) -> (f64, f64) {
        let along = |value: f64, range: (f64, f64)| (value - range.0) / (range.1 - range.0);
        let (left, right, top, bottom) = MARGIN;
        (
            left + along(x, self.x) * (SIZE.0 - left - right),
            SIZE.1 - bottom - along(y, self.y) * (SIZE.1 - top - bottom),
        )
    }

    fn draw_axes(&self, svg: &mut String, axes: &Axes) -> std::fmt::Result {
        let (left, right, top, bottom) = MARGIN;
        for tick in ticks(self.y) {
            let y = self.place((self.x.0, tick)).1;
            let label = if axes.log_y { format_number(10f64.powf(tick)) } else { format_number(tick) };
            writeln!(
                svg,
                "<line x1=\"{left}\" x2=\"{}\" y1=\"{y:.1}\" y2=\"{y:.1}\" stroke=\"currentColor\" \
                 stroke-opacity=\"0.15\"/><text x=\"{}\" y=\"{:.1}\" text-anchor=\"end\" \
                 fill=\"currentColor\">{label}</text>",
                SIZE.0 - right,
                left - 8.0,
                y + 4.0
            )?;
        }
        for tick in ticks(self.x) {
            let x = self.place((tick, self.y.0)).0;
            writeln!(
                svg,
                "<text x=\"{x:.1}\" y=\"{}\" text-anchor=\"middle\" fill=\"currentColor\">{}</text>",
                SIZE.1 - bottom + 18.0,
                format_number(tick)
            )?;
        }
        let middle = (left + SIZE.0 - right) / 2.0;
        writeln!(
            svg,
            "<text x=\"{middle}\" y=\"{}\" text-anchor=\"middle\" fill=\"currentColor\">{}</text>\
             <text x=\"{left}\" y=\"{}\" fill=\"currentColor\">{}</text>",
            SIZE.1 - 6.0,
            escape(&axes.x),
            top - 12.0,
            escape(&axes.y)
        )
    }

    fn draw_line(&self, svg: &mut String, index: usize, name: &str, line: &[(f64, f64)]) -> std::fmt::Result {
        let colour = COLOURS[index % COLOURS.len()];
        svg.push_str("<polyline fill=\"none\" stroke-width=\"1.6\" points=\"");
        for &point in line {
            let (x, y) = self.place(point);
            write!(svg, "{x:.1},{y:.1} ")?;
        }
        #[expect(clippy::cast_precision_loss, reason = "a chart has few series")]
        let y = MARGIN.2 + 14.0 * (index as f64 + 1.0);
        writeln!(
            svg,
            "\" stroke=\"{colour}\"/><text x=\"{}\" y=\"{y}\" text-anchor=\"end\" fill=\"{colour}\">{}</text>",
            SIZE.0 - MARGIN.1 - 6.0,
            escape(name)
        )
    }
}

/// Adds a share of the range on both sides, and width to a range that has none.
fn widen((low, high): (f64, f64), share: f64) -> (f64, f64) {
    let width = high - low;
    if width > 0.0 {
        (low - share * width, high + share * width)
    } else {
        let half = low.abs().max(1.0) * 0.5;
        (low - half, high + half)
    }
}

/// Between four and ten round numbers within a range.
fn ticks((low, high): (f64, f64)) -> Vec<f64> {
    let rough = (high - low) / 5.0;
    let decade = 10f64.powf(rough.log10().floor());
    let step =
        [1.0, 2.0, 5.0, 10.0].map(|m| m * decade).into_iter().find(|step| *step >= rough).unwrap_or(rough);
    let mut tick = (low / step).ceil() * step;
    let mut ticks = Vec::new();
    while tick <= high + 1e-9 * step {
        ticks.push(if tick.abs() < 1e-9 * step { 0.0 } else { tick });
        tick += step;
    }
    ticks
}

fn format_number(value: f64) -> String {
    let magnitude = value.abs();
    if magnitude != 0.0 && !(1e-3..1e5).contains(&magnitude) {
        return format!("{value:.1e}");
    }
    let text = format!("{value:.4}");
    text.trim_end_matches('0').trim_end_matches('.').to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn axes(log_y: bool) -> Axes {
        Axes { x: "iteration".to_owned(), y: "loss".to_owned(), log_y }
    }

    #[test]
    fn ticks_are_round_and_inside() {
        assert_eq!(ticks((0.0, 1.0)), vec![0.0, 0.2, 0.4, 0.6000000000000001, 0.8, 1.0]);
        assert!(ticks((3.1, 97.0)).iter().all(|t| (3.1..=97.0).contains(t) && t % 20.0 == 0.0));
    }

    #[test]
    fn draws_what_is_finite_and_survives_what_is_not() {
        let points = vec![(0.0, 1.0), (1.0, f64::NAN), (2.0, 0.0), (3.0, 0.1)];
        let series = [Series { name: "a".to_owned(), points }];
        let svg = line_chart(&series, &axes(true));
        let drawn = svg.split("points=\"").nth(1).and_then(|rest| rest.split('"').next()).unwrap();
        assert_eq!(drawn.split_whitespace().count(), 2);
        assert!(line_chart(&[], &axes(false)).contains("No points"));
    }

    #[test]
    fn higher_values_are_drawn_higher() {
        let frame = Frame::around([(0.0, 0.0), (1.0, 1.0)].into_iter()).unwrap();
        assert!(frame.place((0.0, 1.0)).1 < frame.place((0.0, 0.0)).1);
    }
}
