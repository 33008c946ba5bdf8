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
pub(super) const SIZE: (f64, f64) = (760.0, 300.0);
pub(super) const MARGIN: (f64, f64, f64, f64) = (70.0, 20.0, 28.0, 42.0);

/// The widest legend; longer names lose their middle.
const WIDEST_LEGEND: f64 = 260.0;

/// Height of a line of the legend, and width of the piece of line before its name.
const LEGEND_LINE: f64 = 14.0;
const LEGEND_SAMPLE: f64 = 22.0;

/// Lines of at most this many points show them.
const MARKED_POINTS: usize = 24;

/// Colours told apart by people with any common colour vision (after Okabe and Ito).
pub(super) const COLOURS: [&str; 7] =
    ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#8a8a8a"];

/// Colours of the channels red, green and blue, told apart on light and on dark.
pub(super) const CHANNEL_COLOURS: [&str; 3] = ["#d9442e", "#2f9e44", "#3b7ddd"];

/// How lines are drawn whose colour was used before: once, twice, and so on.
const DASHES: [&str; 4] = ["", "7 4", "2 3", "9 3 2 3"];

/// Draws the series as lines on common axes.
///
/// Points that are not finite are left out; without any point the chart says so.
///
/// # Panics
/// Never: writing to a string cannot fail.
pub fn line_chart(series: &[Series], axes: &Axes) -> String {
    coloured_line_chart(series, axes, &COLOURS)
}

/// As [`line_chart`], in these colours; lines for which none is left take them again, with dashes.
///
/// # Panics
/// As [`line_chart`].
pub fn coloured_line_chart(series: &[Series], axes: &Axes, colours: &[&str]) -> String {
    let usable =
        |point: &(f64, f64)| point.0.is_finite() && point.1.is_finite() && (!axes.log_y || point.1 > 0.0);
    let height = |y: f64| if axes.log_y { y.log10() } else { y };
    let lines: Vec<Vec<(f64, f64)>> = series
        .iter()
        .map(|one| one.points.iter().filter(|p| usable(p)).map(|&(x, y)| (x, height(y))).collect())
        .collect();
    let Some(mut frame) = Frame::around(lines.iter().flatten().copied()) else {
        return "<p>No points to draw.</p>".to_owned();
    };
    frame.legend = legend_width(series.iter().map(|one| one.name.as_str())) + LEGEND_SAMPLE;
    #[expect(clippy::cast_precision_loss, reason = "a chart has few series")]
    let height = MARGIN.2 + LEGEND_LINE * (series.len() + 1) as f64 + MARGIN.3;
    frame.height = height.max(SIZE.1);
    let mut svg = open(SIZE.0, frame.height, &format!("{} by {}", axes.y, axes.x));
    frame.draw_axes(&mut svg, axes).expect("writing to a string cannot fail");
    for (index, (one, line)) in series.iter().zip(&lines).enumerate() {
        frame
            .draw_line(&mut svg, (index, colours), &one.name, line)
            .expect("writing to a string cannot fail");
    }
    svg.push_str("</svg>");
    svg
}

/// Makes a drawing a file of its own: on white, wherever it is looked at.
pub fn standalone(svg: &str) -> String {
    svg.replacen("<svg ", "<svg style=\"background:#ffffff;color:#1c1e21\" ", 1) + "\n"
}

/// The first tag of a drawing, with what it shows for those who cannot see it.
pub(super) fn open(width: f64, height: f64, shown: &str) -> String {
    format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width} {height}\" width=\"{width}\" \
         font-family=\"sans-serif\" font-size=\"12\" role=\"img\" aria-label=\"{}\">\n",
        escape(shown)
    )
}

/// The width that names take, beside a margin.
pub(super) fn legend_width<'a>(names: impl Iterator<Item = &'a str>) -> f64 {
    (names.map(text_width).fold(0.0, f64::max) + 12.0).min(WIDEST_LEGEND)
}

/// The name as it fits into the legend.
pub(super) fn legend_name(name: &str) -> String {
    shorten(name, WIDEST_LEGEND - 12.0)
}

/// The width of text in the drawing's font, and rather more: sans-serif fonts are as wide as `DejaVu` Sans or narrower.
pub(super) fn text_width(text: &str) -> f64 {
    let width = |character: char| match character {
        'f' | 'i' | 'j' | 'l' | 'r' | 't' | 'I' | 'J' | ' ' | '.' | ',' | ':' | ';' | '|' | '!' | '\''
        | '-' | '(' | ')' | '[' | ']' | '/' => 4.9,
        'm' | 'w' | 'M' | 'W' | '@' | '%' | '+' | '<' | '>' | '=' | '…' => 12.0,
        'A'..='Z' => 9.5,
        _ if character.is_ascii() => 7.7,
        _ => 12.0,
    };
    text.chars().map(width).sum()
}

/// Replaces as much of the text's middle by an ellipsis as is necessary for this width.
pub(super) fn shorten(text: &str, width: f64) -> String {
    let characters: Vec<char> = text.chars().collect();
    let without = |left_out: usize| {
        let kept = characters.len() - left_out;
        let (start, end) = (kept.div_ceil(2), characters.len() - kept / 2);
        characters[..start].iter().chain(['…'].iter()).chain(&characters[end..]).collect::<String>()
    };
    if text_width(text) <= width {
        return text.to_owned();
    }
    let shorter = (1..=characters.len()).map(without);
    shorter.into_iter().find(|text| text_width(text) <= width).unwrap_or_else(|| "…".to_owned())
}

/// The range of the data, mapped to the drawing.
pub(super) struct Frame {
    x: (f64, f64),
    y: (f64, f64),
    /// Width of the legend, right of the lines.
    legend: f64,
    /// Height of the drawing.
    height: f64,
}

impl Frame {
    pub(super) fn around(points: impl Iterator<Item = (f64, f64)>) -> Option<Self> {
        let empty = (f64::INFINITY, f64::NEG_INFINITY);
        let (x, y) = points.fold((empty, empty), |(x, y), point| {
            ((x.0.min(point.0), x.1.max(point.0)), (y.0.min(point.1), y.1.max(point.1)))
        });
        (x.0 <= x.1).then(|| Self { x: widen(x, 0.0), y: widen(y, 0.05), legend: 0.0, height: SIZE.1 })
    }

    /// Where the lines end.
    fn right(&self) -> f64 {
        SIZE.0 - MARGIN.1 - self.legend
    }

    pub(super) fn place(&self, (x, y): (f64, f64)) -> (f64, f64) {
        let along = |value: f64, range: (f64, f64)| (value - range.0) / (range.1 - range.0);
        let (left, _, top, bottom) = MARGIN;
        (
            left + along(x, self.x) * (self.right() - left),
            self.height - bottom - along(y, self.y) * (self.height - top - bottom),
        )
    }

    pub(super) fn draw_axes(&self, svg: &mut String, axes: &Axes) -> std::fmt::Result {
        let (left, _, top, bottom) = MARGIN;
        let right = self.right();
        let rising = if axes.log_y { log_ticks(self.y) } else { ticks(self.y) };
        for tick in rising {
            let y = self.place((self.x.0, tick)).1;
            let label = if axes.log_y { format_number(10f64.powf(tick)) } else { format_number(tick) };
            writeln!(
                svg,
                "<line x1=\"{left}\" x2=\"{}\" y1=\"{y:.1}\" y2=\"{y:.1}\" stroke=\"currentColor\" \
                 stroke-opacity=\"0.15\"/><text x=\"{}\" y=\"{:.1}\" text-anchor=\"end\" \
                 fill=\"currentColor\">{label}</text>",
                right,
                left - 8.0,
                y + 4.0
            )?;
        }
        for tick in ticks(self.x) {
            let x = self.place((tick, self.y.0)).0;
            writeln!(
                svg,
                "<text x=\"{x:.1}\" y=\"{}\" text-anchor=\"middle\" fill=\"currentColor\">{}</text>",
                self.height - bottom + 18.0,
                format_number(tick)
            )?;
        }
        let middle = (left + right) / 2.0;
        writeln!(
            svg,
            "<text x=\"{middle}\" y=\"{}\" text-anchor=\"middle\" fill=\"currentColor\">{}</text>\
             <text x=\"{left}\" y=\"{}\" fill=\"currentColor\">{}</text>",
            self.height - 6.0,
            escape(&axes.x),
            top - 12.0,
            escape(&axes.y)
        )
    }

    fn draw_line(
        &self,
        svg: &mut String,
        (index, colours): (usize, &[&str]),
        name: &str,
        line: &[(f64, f64)],
    ) -> std::fmt::Result {
        let colour = colours[index % colours.len()];
        let round = index / colours.len();
        let stroke = match DASHES[round % DASHES.len()] {
            "" => format!("stroke=\"{colour}\" stroke-width=\"1.6\""),
            dashes => format!("stroke=\"{colour}\" stroke-width=\"1.6\" stroke-dasharray=\"{dashes}\""),
        };
        svg.push_str("<polyline fill=\"none\" points=\"");
        for &point in line {
            let (x, y) = self.place(point);
            write!(svg, "{x:.1},{y:.1} ")?;
        }
        writeln!(svg, "\" {stroke}/>")?;
        if line.len() <= MARKED_POINTS {
            for &point in line {
                let (x, y) = self.place(point);
                writeln!(svg, "<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"2.6\" fill=\"{colour}\"/>")?;
            }
        }
        #[expect(clippy::cast_precision_loss, reason = "a chart has few series")]
        let y = MARGIN.2 + LEGEND_LINE * (index as f64 + 1.0);
        let x = self.right() + 10.0;
        writeln!(
            svg,
            "<path d=\"M{x:.1} {:.1}h{:.1}\" {stroke}/><text x=\"{:.1}\" y=\"{y}\" fill=\"currentColor\">{}</text>",
            y - 4.0,
            LEGEND_SAMPLE - 4.0,
            x + LEGEND_SAMPLE,
            escape(&legend_name(name))
        )
    }
}

/// Ranges narrower than this share of their numbers hold one number but for rounding: a sum of light that is 1, say.
const NARROWEST: f64 = 1e-12;

/// Adds a share of the range on both sides, and width to a range that has none.
pub(super) fn widen((low, high): (f64, f64), share: f64) -> (f64, f64) {
    let width = high - low;
    if width > NARROWEST * low.abs().max(high.abs()) {
        (low - share * width, high + share * width)
    } else {
        let half = low.abs().max(1.0) * 0.5;
        (low - half, high + half)
    }
}

/// More ticks than any range asks for: steps are a fifth of it or more.
const MOST_TICKS: u8 = 8;

/// Between three and six round numbers within a range; fewer where its numbers are too large to differ.
pub(super) fn ticks((low, high): (f64, f64)) -> Vec<f64> {
    let rough = (high - low) / 5.0;
    let decade = 10f64.powf(rough.log10().floor());
    let step =
        [1.0, 2.0, 5.0, 10.0].map(|m| m * decade).into_iter().find(|step| *step >= rough).unwrap_or(rough);
    // Counted and not added up, which makes no progress where a step is less than a number's last digit.
    let first = (low / step).ceil();
    let ticks = (0..MOST_TICKS).map(|index| (first + f64::from(index)) * step);
    let mut ticks: Vec<f64> = ticks
        .take_while(|tick| *tick <= high + 1e-9 * step)
        .map(|tick| if tick.abs() < 1e-9 * step { 0.0 } else { tick })
        .collect();
    ticks.dedup();
    ticks
}

/// The logarithms of a few round numbers within a range of logarithms: of powers of ten, with threes, or with twos and
/// fives between them where those are too few, and of numbers at equal distances within less.
fn log_ticks((low, high): (f64, f64)) -> Vec<f64> {
    const FEWEST: usize = 3;
    let (first, last) = (low.floor(), high.ceil());
    if last - first > 6.0 {
        return ticks((low, high)).into_iter().filter(|tick| tick.fract() == 0.0).collect();
    }
    let decades =
        || std::iter::successors(Some(first), |decade| Some(decade + 1.0)).take_while(|d| *d <= last);
    let steps: [&[f64]; 3] = [&[1.0], &[1.0, 3.0], &[1.0, 2.0, 5.0]];
    let mut candidates = steps.into_iter().map(|steps| {
        let ticks = decades().flat_map(|decade| steps.iter().map(move |step: &f64| decade + step.log10()));
        ticks.filter(|tick| (low..=high).contains(tick)).collect::<Vec<_>>()
    });
    let between = || ticks((10f64.powf(low), 10f64.powf(high))).into_iter().map(f64::log10).collect();
    candidates.find(|ticks| ticks.len() >= FEWEST).unwrap_or_else(between)
}

pub(super) fn format_number(value: f64) -> String {
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

    /// As the encircled energy of a PSF of a single pixel is, whose sum rounds to the number beside 1.
    #[test]
    fn a_range_of_one_rounding_has_a_few_ticks() {
        let below = 1f64.next_down();
        for range in [(below, 1.0), (1e15, 1e15 + 0.125), (0.0, f64::MIN_POSITIVE), (f64::MIN, f64::MAX)] {
            assert!(ticks(range).len() <= usize::from(MOST_TICKS), "{range:?}");
        }
        let points = vec![(0.0, below), (1.0, 1.0)];
        let svg = line_chart(&[Series { name: "a".to_owned(), points }], &axes(false));
        assert!(svg.contains(">1</text>") && svg.len() < 5000, "{svg}");
    }

    #[test]
    fn logarithmic_ticks_stand_for_round_numbers() {
        let shown = |low: f64, high: f64| {
            let ticks = log_ticks((low.log10(), high.log10())).into_iter();
            ticks.map(|tick| format_number(10f64.powf(tick))).collect::<Vec<_>>()
        };
        assert_eq!(shown(0.005, 2.0), ["0.01", "0.1", "1"]);
        assert_eq!(shown(0.015, 0.4), ["0.03", "0.1", "0.3"]);
        assert_eq!(shown(0.04, 0.25), ["0.05", "0.1", "0.2"]);
        assert_eq!(shown(0.041, 0.062), ["0.045", "0.05", "0.055", "0.06"]);
        assert_eq!(shown(1e-8, 1.0).first().map(String::as_str), Some("1.0e-8"));
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
    fn many_lines_leave_their_legend_beside_them() {
        let series = ["a", "b", "a long name"]
            .map(|name| Series { name: name.to_owned(), points: vec![(0.0, 1.0), (9.0, 2.0)] });
        let svg = line_chart(&series, &axes(false));
        let end = |text: &str, key: &str| -> f64 {
            text.rsplit(key).next().and_then(|rest| rest.split('"').next()).unwrap().parse().unwrap()
        };
        let legend = svg.lines().find(|line| line.contains("a long name")).unwrap();
        assert!(end(legend, "<text x=\"") > end(&svg, "circle cx=\""), "{svg}");
        assert_eq!(svg.matches("<circle").count(), 6);
        assert!(standalone(&svg).contains("background:#ffffff"));
    }

    #[test]
    fn a_name_that_is_too_long_loses_its_middle() {
        assert_eq!(shorten("short", 100.0), "short");
        let name = format!("first-{}-last", "m".repeat(80));
        let shown = legend_name(&name);
        assert!(shown.starts_with("first-") && shown.ends_with("-last") && shown.contains('…'), "{shown}");
        assert!(text_width(&shown) <= WIDEST_LEGEND - 12.0, "{shown}");
        assert_eq!(legend_width([name.as_str()].into_iter()), WIDEST_LEGEND);
        assert_eq!(shorten("name", 0.0), "…");
    }

    #[test]
    fn lines_of_one_colour_differ_and_all_have_a_name() {
        let line =
            |index: usize| Series { name: format!("line {index}"), points: vec![(0.0, 1.0), (9.0, 2.0)] };
        let svg = line_chart(&(0..30).map(line).collect::<Vec<_>>(), &axes(false));
        let strokes: std::collections::BTreeSet<&str> = (svg.lines())
            .filter(|line| line.starts_with("<polyline"))
            .filter_map(|line| line.split_once("stroke=").map(|(_, stroke)| stroke))
            .collect();
        assert_eq!(strokes.len(), COLOURS.len() * DASHES.len());
        let after = |text: &str, key: &str| -> f64 {
            text.rsplit(key).next().and_then(|rest| rest.split(['"', ' ']).next()).unwrap().parse().unwrap()
        };
        let height = after(svg.lines().next().unwrap().split("\" width").next().unwrap(), " ");
        let last = svg.lines().find(|line| line.contains("line 29<")).unwrap();
        assert!(after(last, " y=\"") < height, "{last} in {height}");
    }

    #[test]
    fn higher_values_are_drawn_higher() {
        let frame = Frame::around([(0.0, 0.0), (1.0, 1.0)].into_iter()).unwrap();
        assert!(frame.place((0.0, 1.0)).1 < frame.place((0.0, 0.0)).1);
    }
}
