//! Turns PSFs and kernel banks into the blocks of a page: pictures, curves, the strip of rotations, codes.

use ndarray::{Array3, ArrayView3};

use super::chart::{Axes, CHANNEL_COLOURS, Series, coloured_line_chart};
use super::page::{Block, Figure};
use super::picture;
use super::scatter::{Point, scatter};
use crate::core::kernel_code::KernelBank;
use crate::core::psf::Psf;
use crate::core::spread::spread;
use crate::psf::{PsfProfile, assess_psf};

/// Decades of the logarithmic stretch of PSFs: a panel's sidelobes lie three to five below the peak.
const PSF_DECADES: f32 = 5.0;

const CHANNEL_NAMES: [&str; 3] = ["red", "green", "blue"];

/// Kernels in the strip of a bank at most, and the side of each picture in pixels at most.
const STRIP_LENGTH: usize = 25;
const STRIP_SIDE: usize = 129;

/// Components of a bank's codes that are shown as pictures at most.
const SHOWN_COMPONENTS: usize = 8;

/// Shows PSFs side by side, and how each spreads its light.
pub fn psfs(named: &[(String, Psf)]) -> Vec<Block> {
    let figure = |(name, psf): &(String, Psf)| Figure {
        picture: picture::log_psf(psf, PSF_DECADES),
        caption: format!("{name}: {} × {} pixels, {}", psf.height(), psf.width(), peak_shares(psf)),
    };
    let mut blocks = vec![
        Block::Heading("Point spread functions".to_owned()),
        Block::Text(format!(
            "Logarithmic stretch: the peak of each channel is white, {PSF_DECADES} decades below it is black."
        )),
        Block::Figures(named.iter().map(figure).collect()),
        quality_table(named),
    ];
    for (name, psf) in named {
        blocks.push(Block::Subheading(name.clone()));
        blocks.push(Block::Charts(curves(psf)));
    }
    blocks
}

fn peak_shares(psf: &Psf) -> String {
    let peak = |channel| 100.0 * psf.channel(channel).iter().copied().fold(0.0, f32::max);
    format!(
        "{:.1} / {:.1} / {:.1} % of red / green / blue light in the peak pixel",
        peak(0),
        peak(1),
        peak(2)
    )
}

/// The numbers that PSFs are judged by, a row for each channel.
fn quality_table(named: &[(String, Psf)]) -> Block {
    let head = [
        "PSF",
        "channel",
        "in peak pixel (%)",
        "peak / sidelobe",
        "50 % within px",
        "90 % within px",
        "99 % within px",
    ];
    let mut rows = Vec::new();
    for (name, psf) in named {
        for (channel, quality) in CHANNEL_NAMES.iter().zip(assess_psf(psf).channels) {
            let sidelobe = quality.peak_to_sidelobe.map_or("–".to_owned(), |ratio| format!("{ratio:.1}"));
            let mut row = vec![name.clone(), (*channel).to_owned()];
            row.extend([format!("{:.2}", 100.0 * quality.peak_share), sidelobe]);
            row.extend(quality.encircled_px.map(|radius| format!("{radius:.1}")));
            rows.push(row);
        }
    }
    Block::Table(head.map(str::to_owned).to_vec(), rows)
}

/// Radial profile, encircled energy and MTF of the channels.
fn curves(psf: &Psf) -> Vec<(String, String)> {
    let profiles = [0, 1, 2].map(|channel| PsfProfile::of(psf, channel));
    let chart = |series: &[Series], x: &str, y: &str, log_y| {
        let axes = Axes { x: x.to_owned(), y: y.to_owned(), log_y };
        coloured_line_chart(series, &axes, &CHANNEL_COLOURS)
    };
    let series = |suffix: &str, of: fn(&PsfProfile) -> &Vec<(f64, f64)>| {
        let one = |(name, profile): (&&str, &PsfProfile)| Series {
            name: format!("{name}{suffix}"),
            points: of(profile).clone(),
        };
        CHANNEL_NAMES.iter().zip(&profiles).map(one).collect::<Vec<_>>()
    };
    let mut mtf = series(", across", |profile| &profile.mtf_across);
    mtf.extend(series(", down", |profile| &profile.mtf_down));
    let radial = series("", |profile| &profile.radial);
    let encircled = series("", |profile| &profile.encircled);
    let captioned = |svg: String, caption: &str| (svg, caption.to_owned());
    vec![
        captioned(
            chart(&radial, "radius in pixels", "share of the light in a pixel", true),
            "Radial profile: mean over rings one pixel wide; logarithmic scale.",
        ),
        captioned(
            chart(&encircled, "radius in pixels", "share of the light within", false),
            "Encircled energy.",
        ),
        captioned(
            chart(&mtf, "cycles per pixel", "contrast", false),
            "Modulation transfer function, of gratings across the columns and down the rows.",
        ),
    ]
}

/// Shows a bank: the strip of its kernels, the components of the codes, how the codes lie, and the code of every kernel.
pub fn bank(name: &str, bank: &KernelBank) -> Vec<Block> {
    let shown: Vec<usize> = spread(STRIP_LENGTH, bank.len()).collect();
    let figure =
        |&index: &usize| Figure { picture: small_psf(&bank.psfs[index]), caption: bank.kernel_name(index) };
    let mut counted = format!("{} kernels, described by codes of {} numbers.", bank.len(), bank.code_dim());
    if shown.len() < bank.len() {
        counted += &format!(" The strip shows {} of them.", shown.len());
    }
    let mut blocks = vec![
        Block::Heading(format!("Kernel bank: {name}")),
        Block::Text(counted),
        Block::Strip(shown.iter().map(figure).collect()),
    ];
    blocks.extend(components(bank));
    blocks.extend(codes_chart(bank));
    blocks.push(codes_table(bank));
    blocks
}

/// The middle of a PSF on the logarithmic stretch; larger ones are made smaller, each pixel the brightest of those that it
/// stands for, so that no sidelobe is lost.
fn small_psf(psf: &Psf) -> Vec<u8> {
    let (_, height, width) = psf.planes().dim();
    let step = height.max(width).div_ceil(STRIP_SIDE);
    if step == 1 {
        return picture::log_psf(psf, PSF_DECADES);
    }
    let brightest = brightest_of(psf.planes(), step);
    Psf::from_energy(brightest)
        .map_or_else(|_| picture::log_psf(psf, PSF_DECADES), |small| picture::log_psf(&small, PSF_DECADES))
}

/// The largest value of each square of `step` × `step` pixels.
fn brightest_of(planes: ArrayView3<'_, f32>, step: usize) -> Array3<f32> {
    let (channels, height, width) = planes.dim();
    let mut brightest = Array3::zeros((channels, height.div_ceil(step), width.div_ceil(step)));
    for ((channel, y, x), &value) in planes.indexed_iter() {
        let place = &mut brightest[[channel, y / step, x / step]];
        *place = value.max(*place);
    }
    brightest
}

/// The first components of the codes' basis: what each number of a code adds to the mean PSF.
fn components(bank: &KernelBank) -> Vec<Block> {
    let shape = bank.psfs[0].planes().dim();
    let total: f32 = bank.basis.explained_variance.iter().sum();
    let figure = |index: usize| {
        let row = bank.basis.components.row(index);
        let planes = Array3::from_shape_vec(shape, row.to_vec()).ok()?;
        let share = 100.0 * bank.basis.explained_variance[index] / total;
        let share = if share.is_finite() {
            format!(": {share:.1} % of the variance shown by codes")
        } else {
            String::new()
        };
        Some(Figure { picture: picture::signed(planes.view()), caption: format!("c{}{share}", index + 1) })
    };
    let figures: Vec<Figure> = (0..bank.code_dim().min(SHOWN_COMPONENTS)).filter_map(figure).collect();
    if figures.is_empty() {
        return Vec::new();
    }
    let text = "What each number of a code adds: brighter than grey is light added, darker is light taken away, by the \
                square root of its amount.";
    vec![
        Block::Subheading("Components of the codes".to_owned()),
        Block::Text(text.to_owned()),
        Block::Strip(figures),
    ]
}

/// The first two numbers of each code, where there are two.
fn codes_chart(bank: &KernelBank) -> Option<Block> {
    if bank.code_dim() < 2 || bank.len() < 2 {
        return None;
    }
    let point = |index: usize| {
        let code = bank.code(index);
        Point { name: bank.kernel_name(index), place: (f64::from(code[0]), f64::from(code[1])) }
    };
    let points: Vec<Point> = (0..bank.len()).map(point).collect();
    let axes = Axes { x: "c1".to_owned(), y: "c2".to_owned(), log_y: false };
    Some(Block::Chart(
        scatter(&points, &axes),
        "The kernels by the first two numbers of their codes.".to_owned(),
    ))
}

fn codes_table(bank: &KernelBank) -> Block {
    let mut head = vec!["kernel".to_owned()];
    head.extend((1..=bank.code_dim()).map(|i| format!("c{i}")));
    let row = |index: usize| {
        let code = bank.code(index);
        let values = code.iter().map(|value| format!("{value:.4e}"));
        std::iter::once(bank.kernel_name(index)).chain(values).collect()
    };
    Block::Table(head, (0..bank.len()).map(row).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::kernel_code::CodeBasis;
    use ndarray::{Array1, Array2};

    fn point(side: usize) -> Psf {
        let mut planes = Array3::zeros((3, side, side));
        planes.slice_mut(ndarray::s![.., side / 2, side / 2]).fill(1.0);
        Psf::from_energy(planes).unwrap()
    }

    #[test]
    fn every_psf_has_its_picture_numbers_and_curves() {
        let blocks = psfs(&[("<one>".to_owned(), point(5)), ("two".to_owned(), point(1))]);
        let Block::Table(_, rows) = &blocks[3] else { panic!("numbers follow the pictures") };
        assert_eq!((rows.len(), &rows[0][..3]), (6, &["<one>", "red", "100.00"].map(str::to_owned)[..]));
        let charts: Vec<_> = blocks
            .iter()
            .filter_map(|block| match block {
                Block::Charts(charts) => Some(charts.len()),
                _ => None,
            })
            .collect();
        assert_eq!(charts, [3, 3]);
    }

    #[test]
    fn a_bank_has_its_strip_components_scatter_and_codes() {
        let psfs: Vec<Psf> = (0..30).map(|_| point(3)).collect();
        let basis = CodeBasis {
            mean: Array1::zeros(27),
            components: Array2::from_shape_fn((2, 27), |(row, at)| if row == at { 1.0 } else { 0.0 }),
            explained_variance: Array1::from_vec(vec![3.0, 1.0]),
        };
        let codes = Array2::from_shape_fn((30, 2), |(kernel, at)| (kernel * (at + 1)) as f32);
        let angles = (0..30).map(|kernel| f64::from(kernel) - 15.0).collect();
        let blocks = bank("bank", &KernelBank::new(psfs, codes, basis, Some(angles)).unwrap());
        let strips: Vec<usize> = blocks
            .iter()
            .filter_map(|block| match block {
                Block::Strip(figures) => Some(figures.len()),
                _ => None,
            })
            .collect();
        assert_eq!(strips, [STRIP_LENGTH, 2]);
        assert!(
            blocks
                .iter()
                .any(|block| matches!(block, Block::Chart(svg, _) if svg.matches("<circle").count() == 30))
        );
    }

    #[test]
    fn a_smaller_picture_keeps_the_brightest() {
        let planes = Array3::from_shape_fn((3, 5, 4), |(_, y, x)| if (y, x) == (4, 1) { 2.0 } else { 0.5 });
        let small = brightest_of(planes.view(), 2);
        assert_eq!(small.dim(), (3, 3, 2));
        assert_eq!((small[[0, 2, 0]], small[[0, 0, 0]]), (2.0, 0.5));
    }
}
