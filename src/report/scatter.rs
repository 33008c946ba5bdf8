//! Turns named points into a scatter chart as SVG.

use std::fmt::Write as _;

use super::chart::{Axes, COLOURS, Frame, MARGIN, SIZE, open, text_width};
use super::page::escape;

/// A point with its name.
#[derive(Clone, Debug)]
pub struct Point {
    /// The name beside it.
    pub name: String,
    /// Its place (x, y).
    pub place: (f64, f64),
}

/// Draws the points, joined by a thin line in their order, and names them where a name finds room.
///
/// Points that are not finite are left out; without any point the chart says so.
///
/// # Panics
/// Never: writing to a string cannot fail.
pub fn scatter(points: &[Point], axes: &Axes) -> String {
    let points: Vec<&Point> =
        points.iter().filter(|point| point.place.0.is_finite() && point.place.1.is_finite()).collect();
    let Some(frame) = Frame::around(points.iter().map(|point| point.place)) else {
        return "<p>No points to draw.</p>".to_owned();
    };
    let mut svg = open(SIZE.0, SIZE.1, &format!("{} by {}", axes.y, axes.x));
    frame.draw_axes(&mut svg, axes).expect("writing to a string cannot fail");
    draw_points(&mut svg, &frame, &points).expect("writing to a string cannot fail");
    svg.push_str("</svg>");
    svg
}

fn draw_points(svg: &mut String, frame: &Frame, points: &[&Point]) -> std::fmt::Result {
    let colour = COLOURS[0];
    svg.push_str("<polyline fill=\"none\" points=\"");
    for point in points {
        let (x, y) = frame.place(point.place);
        write!(svg, "{x:.1},{y:.1} ")?;
    }
    writeln!(svg, "\" stroke=\"{colour}\" stroke-opacity=\"0.35\"/>")?;
    // The room that names took: left, right and baseline.
    let mut taken: Vec<(f64, f64, f64)> = Vec::new();
    for point in points {
        let (x, y) = frame.place(point.place);
        let name = escape(&point.name);
        writeln!(
            svg,
            "<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"3.5\" fill=\"{colour}\"><title>{name}</title></circle>"
        )?;
        let width = text_width(&point.name);
        let left = if x + 6.0 + width > SIZE.0 { x - 6.0 - width } else { x + 6.0 };
        let room = (left, left + width, (y + 4.0).max(MARGIN.2));
        let is_free =
            |other: &(f64, f64, f64)| room.1 < other.0 || room.0 > other.1 || (room.2 - other.2).abs() > 12.0;
        if left >= 0.0 && taken.iter().all(is_free) {
            writeln!(svg, "<text x=\"{left:.1}\" y=\"{:.1}\" fill=\"currentColor\">{name}</text>", room.2)?;
            taken.push(room);
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn axes() -> Axes {
        Axes { x: "c1".to_owned(), y: "c2".to_owned(), log_y: false }
    }

    #[test]
    fn every_point_is_drawn_and_named_where_there_is_room() {
        let point = |name: &str, place| Point { name: name.to_owned(), place };
        let points = [
            point("a<b", (0.0, 0.0)),
            point("hidden", (0.0, 0.0)),
            point("c", (1.0, 1.0)),
            point("n", (f64::NAN, 1.0)),
        ];
        let svg = scatter(&points, &axes());
        assert_eq!(svg.matches("<circle").count(), 3);
        assert!(svg.contains(">a&lt;b</text>") && svg.contains(">c</text>"), "{svg}");
        assert!(!svg.contains(">hidden</text>") && svg.contains("<title>hidden</title>"), "{svg}");
        assert!(scatter(&[], &axes()).contains("No points"));
    }
}
