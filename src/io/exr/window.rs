//! Places what an OpenEXR file stores into what it shows: its data window into its display window.

use ::exr::math::Vec2;
use ::exr::meta::header::Header;
use ndarray::{Array3, s};

/// How many pixels of the display window have no data.
pub(super) fn pixels_without_data(header: &Header) -> usize {
    let (display, data) = (header.shared_attributes.display_window, header.data_window());
    let shared = |data: (i32, usize), display: (i32, usize)| {
        Overlap::of(i64::from(data.0) - i64::from(display.0), data.1, display.1)
            .map_or(0, |overlap| overlap.length)
    };
    let rows = shared((data.position.1, data.size.1), (display.position.1, display.size.1));
    let columns = shared((data.position.0, data.size.0), (display.position.0, display.size.0));
    display.size.area() - rows * columns
}

/// Cuts or extends the data window to the display window; pixels outside of the data are black, as the format
/// defines.
pub(super) fn place_in_display_window(planes: Array3<f32>, header: &Header) -> Result<Array3<f32>, String> {
    let display = header.shared_attributes.display_window;
    let data = header.data_window();
    if display == data {
        return Ok(planes);
    }
    let offset = |data: i32, display: i32| i64::from(data) - i64::from(display);
    let rows = Overlap::of(offset(data.position.1, display.position.1), data.size.1, display.size.1);
    let columns = Overlap::of(offset(data.position.0, display.position.0), data.size.0, display.size.0);
    let (Some(rows), Some(columns)) = (rows, columns) else {
        return Err(
            "has its data window outside of its display window: nothing of it would be visible".into()
        );
    };
    let Vec2(width, height) = display.size;
    let mut placed = Array3::zeros((planes.dim().0, height, width));
    let source = planes.slice(s![
        ..,
        rows.source..rows.source + rows.length,
        columns.source..columns.source + columns.length
    ]);
    placed
        .slice_mut(s![
            ..,
            rows.target..rows.target + rows.length,
            columns.target..columns.target + columns.length
        ])
        .assign(&source);
    Ok(placed)
}

/// The part that two intervals share, as seen from the start of each.
struct Overlap {
    source: usize,
    target: usize,
    length: usize,
}

impl Overlap {
    /// The overlap of `[offset, offset + size)` with `[0, window)`.
    fn of(offset: i64, size: usize, window: usize) -> Option<Self> {
        let shift = usize::try_from(offset.unsigned_abs()).ok()?;
        let (source, target) = if offset < 0 { (shift, 0) } else { (0, shift) };
        let length = size.checked_sub(source)?.min(window.checked_sub(target)?);
        (length > 0).then_some(Self { source, target, length })
    }
}
