//! Turns samples of several groups into rows of dots with their quartiles, as SVG.

use std::fmt::Write as _;

use super::chart::{COLOURS, MARGIN, SIZE, format_number, legend_name, legend_width, open, ticks, widen};
use super::page::escape;

/// A group of samples.
#[derive(Clone, Debug)]
pub struct Group {
    /// The name of the row.
    pub name: String,
    /// The samples.
    pub values: Vec<f64>,
}

/// Height of a group's row, in user units.
const ROW: f64 = 34.0;

/// Height of the box of the quartiles.
const BOX: f64 = 18.0;

/// Draws each group as a row: a dot a sample, a box from the lower to the upper quartile, a line at the median.
///
/// Values that are not finite are left out; without any value the chart says so.
///
/// # Panics
/// Never: writing to a string cannot fail.
pub fn distribution_chart(groups: &[Group], label: &str) -> String {
    let values = groups.iter().flat_map(|group| &group.values).copied().filter(|value| value.is_finite());
    let range = values.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| (v.min(low), v.max(high)));
    if range.0 > range.1 {
        return "<p>No values to draw.</p>".to_owned();
    }
    let left = 12.0 + legend_width(groups.iter().map(|group| group.name.as_str()));
    #[expect(clippy::cast_precision_loss, reason = "a chart has few groups")]
    let bottom = MARGIN.2 + ROW * groups.len() as f64;
    let axis = Axis { range: widen(range, 0.03), left, bottom };
    let mut svg = open(SIZE.0, bottom + MARGIN.3, label);
    axis.draw(&mut svg, label).expect("writing to a string cannot fail");
    for (index, group) in groups.iter().enumerate() {
        axis.draw_group(&mut svg, index, group).expect("writing to a string cannot fail");
    }
    svg.push_str("</svg>");
    svg
}

/// The horizontal axis of the values.
struct Axis {
    range: (f64, f64),
    left: f64,
    bottom: f64,
}

impl Axis {
    fn place(&self, value: f64) -> f64 {
        let along = (value - self.range.0) / (self.range.1 - self.range.0);
        self.left + along * (SIZE.0 - MARGIN.1 - self.left)
    }

    fn draw(&self, svg: &mut String, label: &str) -> std::fmt::Result {
        let (top, bottom) = (MARGIN.2 - 8.0, self.bottom);
        for tick in ticks(self.range) {
            let x = self.place(tick);
            writeln!(
                svg,
                "<line x1=\"{x:.1}\" x2=\"{x:.1}\" y1=\"{top}\" y2=\"{bottom}\" stroke=\"currentColor\" \
                 stroke-opacity=\"0.15\"/><text x=\"{x:.1}\" y=\"{}\" text-anchor=\"middle\" \
                 fill=\"currentColor\">{}</text>",
                bottom + 18.0,
                format_number(tick)
            )?;
        }
        let middle = (self.left + SIZE.0 - MARGIN.1) / 2.0;
        writeln!(
            svg,
            "<text x=\"{middle:.1}\" y=\"{}\" text-anchor=\"middle\" fill=\"currentColor\">{}</text>",
            bottom + 36.0,
            escape(label)
        )
    }

    fn draw_group(&self, svg: &mut String, index: usize, group: &Group) -> std::fmt::Result {
        let colour = COLOURS[index % COLOURS.len()];
        #[expect(clippy::cast_precision_loss, reason = "a chart has few groups")]
        let y = MARGIN.2 + ROW * (index as f64 + 0.5);
        writeln!(
            svg,
            "<text x=\"{}\" y=\"{}\" text-anchor=\"end\" fill=\"currentColor\">{}</text>",
            self.left - 8.0,
            y + 4.0,
            escape(&legend_name(&group.name))
        )?;
        let mut values: Vec<f64> = group.values.iter().copied().filter(|value| value.is_finite()).collect();
        values.sort_by(f64::total_cmp);
        if values.is_empty() {
            return Ok(());
        }
        let [low, median, high] = [0.25, 0.5, 0.75].map(|share| self.place(quantile(&values, share)));
        writeln!(
            svg,
            "<rect x=\"{low:.1}\" y=\"{:.1}\" width=\"{:.1}\" height=\"{BOX}\" fill=\"{colour}\" \
             fill-opacity=\"0.18\" stroke=\"{colour}\"/><line x1=\"{median:.1}\" x2=\"{median:.1}\" y1=\"{:.1}\" \
             y2=\"{:.1}\" stroke=\"{colour}\" stroke-width=\"2.5\"/>",
            y - BOX / 2.0,
            high - low,
            y - BOX / 2.0,
            y + BOX / 2.0
        )?;
        for value in values {
            let x = self.place(value);
            writeln!(
                svg,
                "<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"2.5\" fill=\"{colour}\" fill-opacity=\"0.55\"/>"
            )?;
        }
        Ok(())
    }
}

/// The value below which a share of sorted values lies, interpolated between neighbours.
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a position within the samples")]
fn quantile(sorted: &[f64], share: f64) -> f64 {
    let position = share * (sorted.len() - 1) as f64;
    let below = position.floor() as usize;
    let above = (below + 1).min(sorted.len() - 1);
    sorted[below] + (position - position.floor()) * (sorted[above] - sorted[below])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_lie_between_neighbours() {
        let sorted = [1.0, 2.0, 3.0, 10.0];
        assert_eq!([0.0, 0.25, 0.5, 1.0].map(|share| quantile(&sorted, share)), [1.0, 1.75, 2.5, 10.0]);
        assert_eq!(quantile(&[4.0], 0.75), 4.0);
    }

    #[test]
    fn draws_every_finite_sample_once() {
        let group = |name: &str, values: &[f64]| Group { name: name.to_owned(), values: values.to_vec() };
        let groups =
            [group("a<b", &[20.0, 21.0, 25.0]), group("equal", &[f64::INFINITY]), group("c", &[30.0])];
        let svg = distribution_chart(&groups, "PSNR (dB)");
        assert_eq!((svg.matches("<circle").count(), svg.matches("<rect").count()), (4, 2));
        assert!(svg.contains("a&lt;b") && svg.contains("equal"));
        assert!(distribution_chart(&groups[1..2], "PSNR (dB)").contains("No values"));
    }
}
