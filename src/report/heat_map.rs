//! Turns a matrix of numbers into coloured cells with their values, as SVG.

use std::fmt::Write as _;

use super::chart::{legend_name, legend_width, open, shorten, text_width};
use super::page::escape;

/// A matrix with the names of its rows and columns.
#[derive(Clone, Debug)]
pub struct HeatMap {
    /// What the rows are.
    pub row_label: String,
    /// What the columns are.
    pub column_label: String,
    /// The names of the rows, from the top.
    pub rows: Vec<String>,
    /// The names of the columns, from the left.
    pub columns: Vec<String>,
    /// One number for each cell, row by row.
    pub values: Vec<Vec<f64>>,
    /// Decimals that the cells show.
    pub decimals: usize,
}

/// Width and height of a cell, in user units.
const CELL: (f64, f64) = (58.0, 30.0);

/// The widest title; a longer one loses its middle.
const WIDEST_TITLE: f64 = 640.0;

/// The heights of the two lines above the cells, and of what is below.
const TOP: f64 = 46.0;
const BOTTOM: f64 = 12.0;

/// Colours of the smallest, middle and largest value: dark blue, teal, light yellow, which differ in lightness
/// so that they are told apart in grey as well.
const SCALE: [[f64; 3]; 3] = [[46.0, 40.0, 110.0], [50.0, 140.0, 140.0], [250.0, 230.0, 120.0]];

/// Draws the matrix, the largest value lightest; cells that are not finite are white.
///
/// # Panics
/// Never: writing to a string cannot fail.
pub fn heat_map(map: &HeatMap) -> String {
    let finite = map.values.iter().flatten().copied().filter(|value| value.is_finite());
    let range = finite.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| (v.min(low), v.max(high)));
    let left = 26.0 + legend_width(map.rows.iter().map(String::as_str));
    #[expect(clippy::cast_precision_loss, reason = "a matrix has few rows")]
    let size = |count: usize, side: f64| count as f64 * side;
    let (width, height) = (size(map.columns.len(), CELL.0), size(map.rows.len(), CELL.1));
    let title = shorten(&map.column_label, WIDEST_TITLE);
    let size = (
        (left + width).max(text_width(&title) + 10.0) + 10.0,
        (TOP + height).max(text_width(&map.row_label)) + BOTTOM,
    );
    let mut svg = open(size.0, size.1, &format!("{} by {}", map.row_label, map.column_label));
    let drawing = Drawing { left, size, title, range, decimals: map.decimals };
    drawing.draw_names(&mut svg, map, (width, height)).expect("writing to a string cannot fail");
    for (row, values) in map.values.iter().enumerate() {
        for (column, value) in values.iter().enumerate() {
            drawing.draw_cell(&mut svg, (row, column), *value).expect("writing to a string cannot fail");
        }
    }
    svg.push_str("</svg>");
    svg
}

/// What every cell needs to know.
struct Drawing {
    left: f64,
    /// Width and height of the whole drawing.
    size: (f64, f64),
    title: String,
    range: (f64, f64),
    decimals: usize,
}

impl Drawing {
    #[expect(clippy::cast_precision_loss, reason = "a matrix has few rows")]
    fn place(&self, row: usize, column: usize) -> (f64, f64) {
        (self.left + column as f64 * CELL.0, TOP + row as f64 * CELL.1)
    }

    fn draw_names(&self, svg: &mut String, map: &HeatMap, (width, height): (f64, f64)) -> std::fmt::Result {
        // Over the middle of the cells where there is room, and within the drawing in any case.
        let within = |middle: f64, text: &str, side: f64| {
            let half = (text_width(text) / 2.0).min(side / 2.0);
            middle.clamp(half, side - half)
        };
        let middle_x = within(self.left + width / 2.0, &self.title, self.size.0);
        let middle_y = within(TOP + height / 2.0, &map.row_label, self.size.1);
        writeln!(
            svg,
            "<text x=\"{middle_x:.1}\" y=\"15\" text-anchor=\"middle\" fill=\"currentColor\">{}</text>\
             <text x=\"14\" y=\"{middle_y:.1}\" text-anchor=\"middle\" fill=\"currentColor\" \
             transform=\"rotate(-90 14 {middle_y:.1})\">{}</text>",
            escape(&self.title),
            escape(&map.row_label)
        )?;
        for (column, name) in map.columns.iter().enumerate() {
            let x = self.place(0, column).0 + CELL.0 / 2.0;
            writeln!(
                svg,
                "<text x=\"{x:.1}\" y=\"{}\" text-anchor=\"middle\" fill=\"currentColor\">{}</text>",
                TOP - 8.0,
                escape(&shorten(name, CELL.0 - 2.0))
            )?;
        }
        for (row, name) in map.rows.iter().enumerate() {
            let y = self.place(row, 0).1 + CELL.1 / 2.0 + 4.0;
            writeln!(
                svg,
                "<text x=\"{}\" y=\"{y:.1}\" text-anchor=\"end\" fill=\"currentColor\">{}</text>",
                self.left - 8.0,
                escape(&legend_name(name))
            )?;
        }
        Ok(())
    }

    fn draw_cell(&self, svg: &mut String, (row, column): (usize, usize), value: f64) -> std::fmt::Result {
        let (x, y) = self.place(row, column);
        let (colour, ink) = self.colours(value);
        let text = if value.is_finite() { format!("{value:.*}", self.decimals) } else { "∞".to_owned() };
        writeln!(
            svg,
            "<rect x=\"{x:.1}\" y=\"{y:.1}\" width=\"{}\" height=\"{}\" fill=\"{colour}\"/><text x=\"{:.1}\" \
             y=\"{:.1}\" text-anchor=\"middle\" fill=\"{ink}\">{text}</text>",
            CELL.0 - 1.0,
            CELL.1 - 1.0,
            x + CELL.0 / 2.0,
            y + CELL.1 / 2.0 + 4.0
        )
    }

    /// The colour of a cell and of the number on it.
    fn colours(&self, value: f64) -> (String, &'static str) {
        if !value.is_finite() {
            return ("#ffffff".to_owned(), "#000000");
        }
        let width = self.range.1 - self.range.0;
        let share = if width > 0.0 { (value - self.range.0) / width } else { 0.5 };
        let (low, high, within) = if share < 0.5 { (0, 1, share * 2.0) } else { (1, 2, share * 2.0 - 1.0) };
        let [red, green, blue] = [0, 1, 2].map(|c| SCALE[low][c] + within * (SCALE[high][c] - SCALE[low][c]));
        (format!("rgb({red:.0},{green:.0},{blue:.0})"), if share < 0.6 { "#ffffff" } else { "#000000" })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn colours_run_from_the_smallest_to_the_largest_value() {
        let map = HeatMap {
            row_label: "simulated".to_owned(),
            column_label: "told".to_owned(),
            rows: vec!["r-03".to_owned(), "r+00".to_owned()],
            columns: vec!["r-03".to_owned(), "r+00".to_owned()],
            values: vec![vec![30.0, 20.0], vec![25.0, f64::INFINITY]],
            decimals: 1,
        };
        let svg = heat_map(&map);
        let colours: Vec<&str> = (svg.split("<rect ").skip(1))
            .filter_map(|cell| cell.split("fill=\"").nth(1).and_then(|rest| rest.split('"').next()))
            .collect();
        assert_eq!(colours, ["rgb(250,230,120)", "rgb(46,40,110)", "rgb(50,140,140)", "#ffffff"]);
        assert!(svg.contains(">30.0<") && svg.contains(">∞<") && svg.contains("simulated"));
    }
    #[test]
    fn a_title_is_never_wider_than_its_drawing() {
        for name in ["net", &"a-rather-long-name-of-a-network".repeat(8)] {
            let map = HeatMap {
                row_label: "kernel of the image".to_owned(),
                column_label: format!("PSNR (dB) of {name} by the kernel that it is told"),
                rows: vec!["r+00".to_owned()],
                columns: vec!["r+00".to_owned()],
                values: vec![vec![30.0]],
                decimals: 1,
            };
            let svg = heat_map(&map);
            let number = |after: &str| -> f64 {
                let rest = svg.split_once(after).unwrap().1;
                rest.split(['"', ' ']).next().unwrap().parse().unwrap()
            };
            let title =
                svg.split("fill=\"currentColor\">").nth(1).and_then(|rest| rest.split('<').next()).unwrap();
            let (half, middle) = (text_width(title) / 2.0, number("<text x=\""));
            assert!(middle - half >= 0.0 && middle + half <= number("viewBox=\"0 0 "), "{title}");
            assert!(title.starts_with("PSNR (dB) of") && title.ends_with("that it is told"), "{title}");
        }
    }
}
