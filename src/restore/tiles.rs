//! Restores an image window by window, so that the result is that of the whole image and the memory that of
//! one window.

use std::sync::atomic::{AtomicUsize, Ordering};

use ndarray::{Array3, s};

use crate::core::bytes::format_bytes;
use crate::core::error::{Error, Result};
use crate::core::image::{CHANNELS, ToneMappedImage};
use crate::core::progress::{PIXELS, Progress};

/// Tiles and windows start at multiples of this at least: the published network halves its resolution twice.
pub(super) const ALIGNMENT: usize = 4;

/// The shortest side of a tile that is chosen by itself: below it most of the work is halo.
pub(super) const SHORTEST_TILE: usize = 64;

/// RGB frames of 32-bit floats that exist at once around a restoration: the capture, the result and the bytes of a file.
pub(super) const FRAMES_IN_MEMORY: u64 = 3;

/// What the restoration of one window of an image on its own takes.
pub(super) trait WindowCost {
    /// Pixels around a tile that its restoration may depend on, a multiple of the alignment.
    fn halo(&self) -> usize;

    /// What tiles and windows start at multiples of, itself one of [`ALIGNMENT`].
    fn alignment(&self) -> usize;

    /// Bytes that it takes to restore one window beside the window itself and the result, with `room` bytes more than the
    /// least for many threads. Tiles are chosen without room, since results depend on tiles.
    fn window_bytes(&self, height: usize, width: usize, room: u64) -> u64;

    /// Floats of every pixel that are copied with a window out of several, beside the window itself and the result.
    fn copied_floats(&self) -> usize {
        0
    }
}

/// A restoration of one window of an image on its own, which looks no further than a halo around what it restores.
pub(super) trait WindowOperator: WindowCost {
    /// Restores `image`, which starts at (`top`, `left`) of the whole image and ends before it or with it.
    ///
    /// # Errors
    /// Those of the method of restoration; [`Error::Interrupted`].
    fn apply(
        &self,
        image: &ToneMappedImage,
        top: usize,
        left: usize,
        progress: &Progress,
    ) -> Result<ToneMappedImage>;
}

/// A half-open range of rows or columns with the halo that its restoration needs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Span {
    /// What is kept.
    pub(super) start: usize,
    pub(super) end: usize,
    /// What is computed.
    pub(super) window_start: usize,
    pub(super) window_end: usize,
}

/// The tiles that an image is restored in.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Tiling {
    rows: Vec<Span>,
    columns: Vec<Span>,
}

impl Tiling {
    /// Cuts an image into tiles of at most `tile` × `tile` pixels.
    ///
    /// # Errors
    /// [`Error::Config`] when `tile` is zero or no multiple of the operator's alignment.
    pub(super) fn with_tile(
        [height, width]: [usize; 2],
        tile: usize,
        operator: &dyn WindowCost,
    ) -> Result<Self> {
        let alignment = operator.alignment();
        if tile == 0 || !tile.is_multiple_of(alignment) {
            let reason = format!("must be a positive multiple of {alignment}, found {tile}");
            return Err(Error::config("tile", reason));
        }
        let halo = operator.halo();
        Ok(Self { rows: cut(height, tile, halo), columns: cut(width, tile, halo) })
    }

    /// Chooses the tiles with the least work whose restoration stays under `max_bytes`, of which `beside` are taken by
    /// something else.
    ///
    /// # Errors
    /// [`Error::Config`] naming the smallest limit that would do.
    pub(super) fn within(
        [height, width]: [usize; 2],
        max_bytes: u64,
        beside: u64,
        operator: &dyn WindowCost,
    ) -> Result<Self> {
        let most = |side: usize| side.div_ceil(SHORTEST_TILE);
        let mut best: Option<(usize, Self)> = None;
        let mut least = u64::MAX;
        for count in 1..=most(width) {
            let columns = cut_evenly(width, count, operator);
            let mut tilings = (1..=most(height))
                .map(|count| Self { rows: cut_evenly(height, count, operator), columns: columns.clone() });
            let fitting = tilings.find(|tiling| {
                let bytes = tiling.bytes(operator) + beside;
                least = least.min(bytes);
                bytes <= max_bytes
            });
            if let Some(tiling) = fitting
                && best.as_ref().is_none_or(|(work, _)| tiling.work() < *work)
            {
                best = Some((tiling.work(), tiling));
            }
        }
        best.map(|(_, tiling)| tiling).ok_or_else(|| {
            let reason = format!(
                "too little for an image of {height} × {width}; allow at least {}",
                format_bytes(least)
            );
            Error::config("max-memory", reason)
        })
    }

    /// Tiles of half the sides, or none where they would be hardly larger than their halo.
    fn halved(&self, operator: &dyn WindowCost) -> Option<Self> {
        let halved = |spans: &[Span]| {
            let longest = spans.iter().map(|span| span.end - span.start).max()?;
            let side = spans.last()?.end;
            let half = longest.div_ceil(2).next_multiple_of(operator.alignment());
            (longest >= 2 * SHORTEST_TILE).then(|| cut(side, half, operator.halo()))
        };
        let (rows, columns) = (halved(&self.rows), halved(&self.columns));
        (rows.is_some() || columns.is_some()).then(|| Self {
            rows: rows.unwrap_or_else(|| self.rows.clone()),
            columns: columns.unwrap_or_else(|| self.columns.clone()),
        })
    }

    /// Number of tiles.
    pub fn len(&self) -> usize {
        self.rows.len() * self.columns.len()
    }

    /// Whether there are no tiles; there always are.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Rows and columns of each tile, from top to bottom, each row from left to right.
    pub(super) fn tiles(&self) -> impl Iterator<Item = [Span; 2]> {
        self.rows.iter().flat_map(|row| self.columns.iter().map(move |column| [*row, *column]))
    }

    /// Height and width of the largest window, halo included.
    pub fn window(&self) -> (usize, usize) {
        let largest = |spans: &[Span]| spans.iter().map(Span::window_len).max().unwrap_or(0);
        (largest(&self.rows), largest(&self.columns))
    }

    /// How many times the image's pixels its windows have in all.
    pub(super) fn times(&self) -> f64 {
        let of_axis = |spans: &[Span]| {
            let windows: usize = spans.iter().map(Span::window_len).sum();
            windows as f64 / spans.last().map_or(1, |last| last.end) as f64
        };
        of_axis(&self.rows) * of_axis(&self.columns)
    }

    /// Bytes that the restoration of the whole image takes at least, the image and the result included.
    pub(super) fn bytes(&self, operator: &dyn WindowCost) -> u64 {
        let (height, width) = self.window();
        let side = |spans: &[Span]| spans.last().map_or(0, |span| span.end);
        let rgb = |height: usize, width: usize| (CHANNELS * size_of::<f32>() * height * width) as u64;
        // The only window is the image; one of several is copied out of it and restored to another copy.
        let more = (operator.copied_floats() * size_of::<f32>() * height * width) as u64;
        let copies = if self.len() == 1 { 0 } else { 2 * rgb(height, width) + more };
        let frames = FRAMES_IN_MEMORY * rgb(side(&self.rows), side(&self.columns));
        frames + copies + operator.window_bytes(height, width, 0)
    }

    /// Pixels that are computed, halos included.
    fn work(&self) -> usize {
        let sum = |spans: &[Span]| spans.iter().map(Span::window_len).sum::<usize>();
        sum(&self.rows) * sum(&self.columns)
    }
}

impl Span {
    pub(super) fn window_len(&self) -> usize {
        self.window_end - self.window_start
    }
}

/// Cuts `side` pixels into spans of `tile`, the last one shorter, each with its halo.
fn cut(side: usize, tile: usize, halo: usize) -> Vec<Span> {
    let span = |start: usize| {
        let end = side.min(start + tile);
        Span { start, end, window_start: start.saturating_sub(halo), window_end: side.min(end + halo) }
    };
    (0..side).step_by(tile).map(span).collect()
}

/// Cuts `side` pixels into at most `count` spans of nearly one length.
fn cut_evenly(side: usize, count: usize, operator: &dyn WindowCost) -> Vec<Span> {
    cut(side, side.div_ceil(count).next_multiple_of(operator.alignment()), operator.halo())
}

/// Restores an image tile by tile.
///
/// Each tile is computed with its halo and, at the image's border, with the image's own border, so that the
/// result is that of the whole image to the rounding of f32.
///
/// # Errors
/// Those of the operator; [`Error::Interrupted`].
///
/// # Panics
/// When the tiling was made for an image of another size, or the operator changes a window's size: broken
/// invariants of the caller.
pub(super) fn restore_tiled(
    image: &ToneMappedImage,
    tiling: &Tiling,
    operator: &dyn WindowOperator,
    progress: &Progress,
) -> Result<ToneMappedImage> {
    if tiling.len() == 1 {
        progress.check()?;
        let restored = operator.apply(image, 0, 0, progress)?;
        assert_eq!(restored.planes().dim(), image.planes().dim());
        return Ok(restored);
    }
    let bar = progress.bar((image.height() * image.width()) as u64, PIXELS);
    let mut restored = Array3::zeros(image.planes().dim());
    for [row, column] in tiling.tiles() {
        progress.check()?;
        let (top, left) = (row.window_start, column.window_start);
        let window = image.crop(top, left, row.window_len(), column.window_len());
        let window = operator.apply(&window, top, left, progress)?;
        assert_eq!((window.height(), window.width()), (row.window_len(), column.window_len()));
        let kept = s![.., row.start - top..row.end - top, column.start - left..column.end - left];
        restored
            .slice_mut(s![.., row.start..row.end, column.start..column.end])
            .assign(&window.planes().slice(kept));
        bar.inc(((row.end - row.start) * (column.end - column.start)) as u64);
    }
    bar.finish_and_clear();
    ToneMappedImage::from_planes(restored)
}

/// As [`restore_tiled`]; tiles that a device cannot do are halved until it can.
///
/// `halvings` is how often tiles were halved for images before, which this one begins with, and for this one. Returned is also
/// the height and width of the windows, where this image is the first that needs them smaller.
///
/// # Errors
/// Those of the operator, [`Error::Device`] where the smallest tiles are too large; [`Error::Interrupted`].
pub(super) fn restore_halving(
    image: &ToneMappedImage,
    tiling: &Tiling,
    operator: &dyn WindowOperator,
    (halvings, progress): (&AtomicUsize, &Progress),
) -> Result<(ToneMappedImage, Option<[usize; 2]>)> {
    let before = halvings.load(Ordering::Relaxed);
    let mut tiling = tiling.clone();
    for _ in 0..before {
        tiling = tiling.halved(operator).unwrap_or(tiling);
    }
    let mut needed = before;
    loop {
        match restore_tiled(image, &tiling, operator, progress) {
            Ok(restored) => {
                halvings.fetch_max(needed, Ordering::Relaxed);
                let (height, width) = tiling.window();
                return Ok((restored, (needed > before).then_some([height, width])));
            }
            Err(error) if error.is_of_device() => tiling = tiling.halved(operator).ok_or(error)?,
            Err(error) => return Err(error),
        }
        needed += 1;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::bytes::parse_bytes;

    const HALO: usize = 80;

    /// Sums the four pixels at a halo's distance, with zeros beyond the border as the network pads.
    struct Corners;

    impl WindowCost for Corners {
        fn halo(&self) -> usize {
            HALO
        }

        fn alignment(&self) -> usize {
            ALIGNMENT
        }

        fn window_bytes(&self, height: usize, width: usize, _: u64) -> u64 {
            (height * width * 1000) as u64
        }
    }

    impl WindowOperator for Corners {
        fn apply(
            &self,
            image: &ToneMappedImage,
            top: usize,
            left: usize,
            _: &Progress,
        ) -> Result<ToneMappedImage> {
            assert!(top.is_multiple_of(ALIGNMENT) && left.is_multiple_of(ALIGNMENT), "{top} {left}");
            let around = |at: usize| [at.checked_sub(HALO), Some(at + HALO)].into_iter().flatten();
            let sum = |(c, y, x): (usize, usize, usize)| {
                let corners = around(y).flat_map(|y| around(x).map(move |x| [c, y, x]));
                corners.filter_map(|corner| image.planes().get(corner).copied()).sum::<f32>()
            };
            ToneMappedImage::from_planes(Array3::from_shape_fn(image.planes().dim(), sum))
        }
    }

    fn image(height: usize, width: usize) -> ToneMappedImage {
        let value = |(c, y, x)| ((c * 7919 + y * 104_729 + x * 1299) % 1000) as f32 / 1000.0;
        ToneMappedImage::from_planes(Array3::from_shape_fn((3, height, width), value)).unwrap()
    }

    #[test]
    fn tiled_restoration_is_that_of_the_whole_image() {
        let image = image(203, 310);
        let whole = Corners.apply(&image, 0, 0, &Progress::default()).unwrap();
        for tile in [64, 100, 200, 400] {
            let tiling = Tiling::with_tile([203, 310], tile, &Corners).unwrap();
            let tiled = restore_tiled(&image, &tiling, &Corners, &Progress::default()).unwrap();
            assert_eq!(tiled, whole, "tiles of {tile}");
        }
    }

    /// [`Corners`] on a device with memory for so many pixels.
    struct Small(usize);

    impl WindowCost for Small {
        fn halo(&self) -> usize {
            HALO
        }

        fn alignment(&self) -> usize {
            ALIGNMENT
        }

        fn window_bytes(&self, height: usize, width: usize, room: u64) -> u64 {
            Corners.window_bytes(height, width, room)
        }
    }

    impl WindowOperator for Small {
        fn apply(
            &self,
            image: &ToneMappedImage,
            top: usize,
            left: usize,
            progress: &Progress,
        ) -> Result<ToneMappedImage> {
            if image.height() * image.width() > self.0 {
                return Err(Error::Device("no memory".to_owned()).while_doing("restoring"));
            }
            Corners.apply(image, top, left, progress)
        }
    }

    #[test]
    fn tiles_that_a_device_has_no_memory_for_are_halved() {
        let (image, halvings) = (image(203, 600), AtomicUsize::new(0));
        let whole = Tiling::with_tile([203, 600], 600, &Corners).unwrap();
        let expected = Corners.apply(&image, 0, 0, &Progress::default()).unwrap();
        let restore = |device: Small, halvings: &AtomicUsize| {
            restore_halving(&image, &whole, &device, (halvings, &Progress::default()))
        };
        let (restored, window) = restore(Small(60_000), &halvings).unwrap();
        assert_eq!((restored, window), (expected.clone(), Some([184, 312])));
        assert_eq!(halvings.load(Ordering::Relaxed), 2);
        // The next image of a folder does not fail first, and says nothing.
        assert_eq!(restore(Small(60_000), &halvings).unwrap(), (expected.clone(), None));
        // With memory for all nothing is halved.
        assert_eq!(restore(Small(200_000), &AtomicUsize::new(0)).unwrap(), (expected, None));
        let refusal = restore(Small(10_000), &AtomicUsize::new(0)).unwrap_err();
        assert!(refusal.is_of_device(), "{refusal:?}");
    }

    #[test]
    fn overlapping_windows_have_each_pixel_several_times() {
        let tiling = Tiling::with_tile([1024, 64], 128, &Corners).unwrap();
        // Of eight windows six have two halos.
        let expected = (1024 + 14 * Corners.halo()) as f64 / 1024.0;
        assert!((tiling.times() - expected).abs() < 1e-9, "{} {expected}", tiling.times());
    }

    #[test]
    fn windows_keep_a_full_halo_except_at_the_border() {
        for tiling in [
            Tiling::with_tile([501, 333], 96, &Corners).unwrap(),
            Tiling::with_tile([64, 64], 4, &Corners).unwrap(),
        ] {
            for (spans, side) in
                [(&tiling.rows, tiling.rows.last()), (&tiling.columns, tiling.columns.last())]
            {
                let side = side.unwrap().end;
                assert_eq!(spans.iter().map(|span| span.end - span.start).sum::<usize>(), side);
                for span in spans {
                    assert!(span.window_start == 0 || span.start - span.window_start >= HALO);
                    assert!(span.window_end == side || span.window_end - span.end >= HALO);
                    assert!(span.window_start.is_multiple_of(ALIGNMENT));
                }
            }
        }
    }

    #[test]
    fn chooses_tiles_that_stay_under_the_limit() {
        let (height, width) = (2448, 3264);
        for limit in [500_u64 << 20, 1 << 30, 2 << 30] {
            let tiling = Tiling::within([height, width], limit, 0, &Corners).unwrap();
            assert!(tiling.bytes(&Corners) <= limit, "{limit}");
            assert!(tiling.len() > 1);
        }
        assert_eq!(Tiling::within([height, width], 16 << 30, 0, &Corners).unwrap().len(), 1);
    }

    #[test]
    fn names_the_smallest_limit_and_honours_it() {
        let message = Tiling::within([2448, 3264], 1 << 20, 0, &Corners).unwrap_err().to_string();
        let smallest = message.split("at least ").nth(1).expect("a smallest limit").to_owned();
        let smallest = parse_bytes(&smallest).unwrap();
        assert!(Tiling::within([2448, 3264], smallest, 0, &Corners).is_ok(), "{message}");
        assert!(Tiling::within([2448, 3264], smallest - (1 << 20), 0, &Corners).is_err(), "{message}");
    }

    #[test]
    fn refuses_tiles_off_the_alignment() {
        assert!(Tiling::with_tile([100, 100], 90, &Corners).is_err());
        assert!(Tiling::with_tile([100, 100], 0, &Corners).is_err());
    }
}
