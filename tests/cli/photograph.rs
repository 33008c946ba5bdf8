//! From a single raw capture to a photograph: colours, clipped lamps, exposure, orientation, lens shading.

use std::fs;
use std::path::Path;

use ndarray::{Array2, Array3, s};
use udc::core::bayer::BayerPattern;
use udc::core::image::Linear;
use udc::core::psf::Psf;
use udc::io::{self, WriteOptions, read_pixels};

use super::common::{fail, succeed, udc};
use super::tiff::{Field, Tiff};

/// Height and width of the picture as it is seen.
const SIDES: [usize; 2] = [96, 128];
const BLACK: f64 = 64.0;
const WHITE: f64 = 1023.0;
/// Gains that make grey grey.
const GAINS: [f64; 3] = [1.9, 1.0, 1.6];

/// White-balanced camera colours to linear sRGB; rows sum to one.
const TO_SRGB: [[f64; 3]; 3] = [[1.6, -0.5, -0.1], [-0.2, 1.5, -0.3], [0.05, -0.45, 1.4]];
/// Its inverse, to five digits.
const TO_CAMERA: [[f64; 3]; 3] =
    [[0.652_82, 0.247_51, 0.099_67], [0.088_04, 0.745_85, 0.166_11], [0.004_98, 0.230_90, 0.764_12]];
/// Linear sRGB to XYZ of D65 (IEC 61966-2-1).
const SRGB_TO_XYZ: [[f64; 3]; 3] =
    [[0.412_456, 0.357_576, 0.180_438], [0.212_673, 0.715_152, 0.072_175], [0.019_334, 0.119_192, 0.950_304]];

fn product(a: &[[f64; 3]; 3], b: &[[f64; 3]; 3]) -> [[f64; 3]; 3] {
    a.map(|row| [0, 1, 2].map(|j| (0..3).map(|k| row[k] * b[k][j]).sum()))
}

fn inverse(a: &[[f64; 3]; 3]) -> [[f64; 3]; 3] {
    let minor = |i: usize, j: usize| {
        let (r, q) = ((i + 1) % 3, (i + 2) % 3);
        let (c, d) = ((j + 1) % 3, (j + 2) % 3);
        a[r][c] * a[q][d] - a[r][d] * a[q][c]
    };
    let whole: f64 = (0..3).map(|j| a[0][j] * minor(0, j)).sum();
    [0, 1, 2].map(|i| [0, 1, 2].map(|j| minor(j, i) / whole))
}

/// The matrix that a negative of this camera has under D65: XYZ to colours before white balance.
fn color_matrix() -> [[f64; 3]; 3] {
    let balanced = product(&TO_CAMERA, &inverse(&SRGB_TO_XYZ));
    [0, 1, 2].map(|c| balanced[c].map(|value| value / GAINS[c]))
}

fn kernel() -> Array2<f64> {
    let k = Array2::from_shape_fn((9, 9), |(y, x)| {
        let (dy, dx) = (y as f64 - 4.0, x as f64 - 4.0);
        (-(dy * dy + dx * dx) / 1.5).exp() + 0.002
    });
    let sum = k.sum();
    k / sum
}

const LAMP: [usize; 2] = [24, 32];
const RED_LAMP: [usize; 2] = [70, 32];
const LAMP_RADIUS: f64 = 9.0;

fn is_at(lamp: [usize; 2], y: usize, x: usize) -> bool {
    (y as f64 - lamp[0] as f64).hypot(x as f64 - lamp[1] as f64) < LAMP_RADIUS
}

/// A grey card, as bright as `card`, a lamp a hundred times as bright, and a red one.
fn scene(card: f64) -> Array3<f64> {
    let [height, width] = SIDES;
    Array3::from_shape_fn((3, height, width), |(c, y, x)| {
        if is_at(LAMP, y, x) {
            return 100.0 * card;
        }
        if is_at(RED_LAMP, y, x) {
            return [30.0, 1.0, 1.0][c] * card;
        }
        card
    })
}

/// What is seen behind the panel: the scene convolved, its border replicated.
fn blurred(scene: &Array3<f64>) -> Array3<f64> {
    let kernel = kernel();
    let [height, width] = SIDES;
    Array3::from_shape_fn(scene.dim(), |(c, y, x)| {
        let tap = |((dy, dx), weight): ((usize, usize), &f64)| {
            let at = |place: usize, step: usize, side: usize| (place + 4).saturating_sub(step).min(side - 1);
            weight * scene[[c, at(y, dy, height), at(x, dx, width)]]
        };
        kernel.indexed_iter().map(tap).sum()
    })
}

/// A negative of the scene on a sensor that was turned: the picture must be turned right to be upright.
struct Negative {
    card: f64,
    stops: Option<(i32, i32)>,
    /// k₀ of the vignette, which the file declares.
    vignette: f64,
    /// Lists of opcodes beside: the tag, and the list.
    lists: Vec<(u16, Vec<u8>)>,
    /// The chromaticity of the scene's white, in place of the colours of grey.
    white: Option<[f64; 2]>,
}

impl Default for Negative {
    fn default() -> Self {
        Self { card: 0.1, stops: None, vignette: 1.0, lists: Vec::new(), white: None }
    }
}

fn opcode(id: u32, flags: u32, parameters: &[u8]) -> Vec<u8> {
    let length = u32::try_from(parameters.len()).unwrap();
    let head = [id, 0x0104_0000, flags, length].map(u32::to_be_bytes).concat();
    [&head[..], parameters].concat()
}

fn list(opcodes: &[Vec<u8>]) -> Vec<u8> {
    [&u32::try_from(opcodes.len()).unwrap().to_be_bytes()[..], &opcodes.concat()].concat()
}

fn vignette(k0: f64) -> Vec<u8> {
    let numbers = [k0, 0.0, 0.0, 0.0, 0.0, 0.5, 0.5].map(f64::to_be_bytes).concat();
    opcode(3, 1, &numbers)
}

fn gain_at([y, x]: [usize; 2], [height, width]: [usize; 2], k0: f64) -> f64 {
    let (dy, dx) = (y as f64 - (height - 1) as f64 / 2.0, x as f64 - (width - 1) as f64 / 2.0);
    let whole = ((height - 1) as f64 / 2.0).powi(2) + ((width - 1) as f64 / 2.0).powi(2);
    1.0 + k0 * (dy * dy + dx * dx) / whole
}

impl Negative {
    fn write(self, path: &Path) {
        let light = blurred(&scene(self.card));
        // Row 0 of the sensor is the right side of the picture, its column 0 the top.
        let [height, width] = [SIDES[1], SIDES[0]];
        let sample = |index: usize| {
            let (y, x) = (index / width, index % width);
            let [row, column] = [x, height - 1 - y];
            let color = BayerPattern::Rggb.channel(y, x);
            let balanced: f64 = (0..3).map(|k| TO_CAMERA[color][k] * light[[k, row, column]]).sum();
            let recorded = balanced / GAINS[color] / gain_at([y, x], [height, width], self.vignette);
            (BLACK + recorded.min(1.0) * (WHITE - BLACK)).round() as u16
        };
        let samples: Vec<u16> = (0..height * width).map(sample).collect();
        let mut file = Tiff::new();
        let fraction = |value: f64| ((value * 1e6).round() as i32, 1_000_000);
        let mut fields = file.image(32803, &samples, [height, width]);
        fields.extend([
            (274, Field::Shorts(vec![6])),
            (33421, Field::Shorts(vec![2, 2])),
            (33422, Field::Bytes(vec![0, 1, 1, 2])),
            (50706, Field::Bytes(vec![1, 4, 0, 0])),
            (50714, Field::Shorts(vec![BLACK as u16])),
            (50717, Field::Longs(vec![WHITE as u32])),
            (50721, Field::SignedRationals(color_matrix().iter().flatten().map(|v| fraction(*v)).collect())),
            (50728, Field::Rationals(GAINS.map(|gain| ((1e6 / gain).round() as u32, 1_000_000)).to_vec())),
            (50778, Field::Shorts(vec![21])),
            (51022, Field::Data(list(&[vignette(self.vignette)]))),
        ]);
        if let Some(stops) = self.stops {
            fields.push((50730, Field::SignedRationals(vec![stops])));
        }
        if let Some(white) = self.white {
            fields.retain(|(tag, _)| *tag != 50728);
            fields.push((50729, Field::Rationals(white.map(|v| ((v * 1e6) as u32, 1_000_000)).to_vec())));
        }
        for (tag, list) in self.lists {
            fields.retain(|(other, _)| *other != tag);
            fields.push((tag, Field::Data(list)));
        }
        let first = file.directory(fields);
        fs::write(path, file.finish(first)).unwrap();
    }
}

/// A folder with a negative `a.dng` and the PSF.
fn scratch(negative: Negative) -> tempfile::TempDir {
    let scratch = tempfile::tempdir().unwrap();
    negative.write(&scratch.path().join("a.dng"));
    let kernel = kernel();
    let energy = Array3::from_shape_fn((3, 9, 9), |(_, y, x)| kernel[[y, x]] as f32);
    let path = scratch.path().join("psf.exr");
    io::write_psf(&path, &Psf::from_energy(energy).unwrap(), &WriteOptions::default()).unwrap();
    scratch
}

fn restore<'a>(output: &'a str, more: &[&'a str]) -> Vec<&'a str> {
    [&["restore", "a.dng", "--method", "constrained", "--psf", "psf.exr", "-o", output][..], more].concat()
}

/// Tiles of local contrast that have more pixels than lightness has codes, as those of any photograph.
const GRID: [&str; 2] = ["--grid", "2"];

/// Display values of 8 bits, `[3, height, width]`.
fn picture(folder: &Path, name: &str) -> Array3<f32> {
    read_pixels(&folder.join(name)).unwrap().planes * 255.0
}

/// The smallest and the largest value of each channel in a square around a place.
fn range(picture: &Array3<f32>, [y, x]: [usize; 2], reach: usize) -> [[f32; 2]; 3] {
    let square = picture.slice(s![.., y - reach..=y + reach, x - reach..=x + reach]);
    [0, 1, 2].map(|c| {
        let plane = square.index_axis(ndarray::Axis(0), c);
        [plane.iter().copied().fold(f32::MAX, f32::min), plane.iter().copied().fold(0.0, f32::max)]
    })
}

/// The matrix of the file, the levels of its channels, its orientation and its vignette are all taken over; a card of 18 %
/// is shown by sRGB as 118, and local contrast moves it a little.
#[test]
fn a_dng_of_a_grey_card_under_a_lamp_finishes_grey_with_white_lamps() {
    let scratch = scratch(Negative::default());
    succeed(scratch.path(), &restore("restored.exr", &[]));
    succeed(scratch.path(), &["finish", "restored.exr", "-o", "finished.png", GRID[0], GRID[1]]);
    let finished = picture(scratch.path(), "finished.png");
    assert_eq!(finished.dim(), (3, SIDES[0], SIDES[1]), "it is put upright");
    // In the middle, in a corner far from the lamps, and at the border.
    for place in [[48, 64], [90, 120], [8, 120], [48, 100]] {
        let [red, green, blue] = range(&finished, place, 3);
        for (name, other) in [("red", red), ("blue", blue)] {
            let off = (other[0] - green[0]).abs().max((other[1] - green[1]).abs());
            assert!(off < 5.0, "{name} at {place:?}: {red:?} {green:?} {blue:?}");
        }
        assert!(green[0] > 100.0 && green[1] < 140.0, "at {place:?}: {green:?}");
    }
    let lamp = range(&finished, LAMP, 5);
    assert!(lamp.iter().all(|[least, _]| *least >= 254.0), "the lamp is white: {lamp:?}");
    let [red, green, blue] = range(&finished, RED_LAMP, 4);
    assert!(
        red[0] > 250.0 && green[1] < 150.0 && blue[1] < 150.0,
        "a red one red: {red:?} {green:?} {blue:?}"
    );
}

/// Two stops under what the camera would have to expose: the median is still shown as middle grey.
#[test]
fn a_single_dark_capture_does_not_finish_dark() {
    let scratch = scratch(Negative { card: 0.045, ..Negative::default() });
    succeed(scratch.path(), &restore("restored.exr", &[]));
    let finish = ["finish", "restored.exr", "-o", "finished.png", "-v", GRID[0], GRID[1]];
    let said = udc(scratch.path(), &finish);
    let said = String::from_utf8_lossy(&said.stderr).into_owned();
    assert!(said.contains("middle grey at light 0.04"), "{said}");
    let [_, green, _] = range(&picture(scratch.path(), "finished.png"), [48, 100], 3);
    assert!(green[0] > 100.0 && green[1] < 140.0, "{green:?}");
    // A flag of the curve keeps what it was before: light up to 6 by gamma 2.8.
    succeed(scratch.path(), &["finish", "restored.exr", "-o", "gamma.png", "--curve", "gamma", "--no-clahe"]);
    let [_, green, _] = range(&picture(scratch.path(), "gamma.png"), [48, 100], 3);
    assert!((green[0] - 255.0 * (0.045f32 / 6.0).powf(1.0 / 2.8)).abs() < 4.0, "{green:?}");
}

#[test]
fn a_dng_is_restored_as_it_lies_on_the_sensor_and_finished_upright() {
    let scratch = scratch(Negative::default());
    succeed(scratch.path(), &restore("restored.exr", &[]));
    let restored = io::read_image::<Linear>(&scratch.path().join("restored.exr")).unwrap();
    assert_eq!([restored.height(), restored.width()], [SIDES[1], SIDES[0]]);
    succeed(scratch.path(), &["finish", "restored.exr", "-o", "flat.png", "--orientation", "1"]);
    assert_eq!(picture(scratch.path(), "flat.png").dim(), (3, SIDES[1], SIDES[0]));
    let said = fail(scratch.path(), &["finish", "restored.exr", "-o", "b.png", "--orientation", "9"], 2);
    assert!(said.contains("from 1 to 8"), "{said}");
}

/// Without the correction the corners have half of the light.
#[test]
fn lens_shading_is_corrected_before_restoring() {
    let flat = |name: &str, negative: Negative| {
        let scratch = scratch(negative);
        succeed(scratch.path(), &restore(name, &[]));
        io::read_image::<Linear>(&scratch.path().join(name)).unwrap().into_planes()
    };
    let even = |planes: &Array3<f32>| {
        let green = planes.index_axis(ndarray::Axis(0), 1);
        green[[124, 4]] / green[[64, 44]]
    };
    let radial = flat("a.exr", Negative::default());
    // Ten bits of light of 0.05 are good to two percent.
    assert!((even(&radial) - 1.0).abs() < 0.04, "{}", even(&radial));
    let uncorrected = flat("b.exr", Negative { lists: vec![(51022, list(&[]))], ..Negative::default() });
    assert!(even(&uncorrected) < 0.65, "{}", even(&uncorrected));
    // The same by a map of gains before the colours are interpolated.
    let map =
        Negative { lists: vec![(51022, list(&[])), (51009, list(&[gain_map()]))], ..Negative::default() };
    let map = flat("c.exr", map);
    assert!((even(&map) - 1.0).abs() < 0.04, "{}", even(&map));
}

/// The vignette sampled at 33 × 33 nodes from border to border.
fn gain_map() -> Vec<u8> {
    let [height, width] = [SIDES[1], SIDES[0]];
    let long = |value: usize| u32::try_from(value).unwrap().to_be_bytes();
    let head = [0, 0, height, width, 0, 1, 1, 1, 33, 33].map(long).concat();
    let spacing = [1.0 / 32.0, 1.0 / 32.0, 0.0, 0.0].map(f64::to_be_bytes).concat();
    let node = |index: usize| {
        let at = |node: usize, side: usize| node as f64 / 32.0 * side as f64 - side as f64 / 2.0;
        let (dy, dx) = (at(index / 33, height), at(index % 33, width));
        let whole = ((height - 1) as f64 / 2.0).powi(2) + ((width - 1) as f64 / 2.0).powi(2);
        (1.0 + (dy * dy + dx * dx) / whole) as f32
    };
    let nodes: Vec<u8> = (0..33 * 33).flat_map(|index| node(index).to_be_bytes()).collect();
    opcode(9, 0, &[head, spacing, long(1).to_vec(), nodes].concat())
}

#[test]
fn corrections_that_are_not_made_are_named() {
    let warp = opcode(1, 0, &[0; 20]);
    let pixels = opcode(4, 1, &[0; 8]);
    let scratch = scratch(Negative {
        lists: vec![(51022, list(&[vignette(1.0), warp])), (51008, list(&[pixels, opcode(99, 1, &[])]))],
        ..Negative::default()
    });
    let output = udc(scratch.path(), &restore("restored.exr", &[]));
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success(), "{said}");
    assert!(said.contains("warning: a.dng: restored without the correction of WarpRectilinear"), "{said}");
    assert!(said.contains("FixBadPixelsConstant") && said.contains("requires WarpRectilinear"), "{said}");
    let said = succeed(scratch.path(), &["info", "a.dng"]);
    assert!(said.contains("corrected FixVignetteRadial"), "{said}");
    assert!(
        said.contains("ignored   FixBadPixelsConstant (optional), opcode 99 (optional), WarpRectilinear"),
        "{said}"
    );
}

/// Counts and lengths that promise more than the file has, and numbers that are no gains.
#[test]
fn damaged_corrections_are_refused() {
    let whole = gain_map();
    let changed = |place: usize, bytes: &[u8]| {
        let mut map = whole.clone();
        map[place..place + bytes.len()].copy_from_slice(bytes);
        list(&[map])
    };
    let lists = [
        u32::MAX.to_be_bytes().to_vec(),
        list(&[whole[..60].to_vec()]),
        changed(12, &u32::MAX.to_be_bytes()),
        // Rows and columns of nodes, the distance of rows, the first gain.
        changed(16 + 32, &u32::MAX.to_be_bytes()),
        changed(16 + 32, &[0; 4]),
        changed(16 + 24, &[0; 4]),
        changed(16 + 76, &f32::NAN.to_be_bytes()),
        list(&[opcode(3, 0, &[0xff; 56])]),
        list(&[opcode(3, 0, &[0; 8])]),
    ];
    for (index, bytes) in lists.into_iter().enumerate() {
        let scratch = scratch(Negative { lists: vec![(51009, bytes)], ..Negative::default() });
        let said = fail(scratch.path(), &restore("restored.exr", &[]), 1);
        assert!(said.contains("corrections of the lens"), "{index}: {said}");
        assert!(!scratch.path().join("restored.exr").exists());
    }
}

#[test]
fn formats_that_cannot_carry_the_capture_say_what_to_give_instead() {
    let scratch = scratch(Negative::default());
    let output = udc(scratch.path(), &restore("restored.npy", &[]));
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success(), "{said}");
    assert!(said.contains("--saturation 1.9000,1.0000,1.6000"), "{said}");
    assert!(said.contains("--orientation 6") && said.contains("ccm: "), "{said}");
    let matrix = said.split("`ccm: ").nth(1).and_then(|rest| rest.split('`').next()).unwrap();
    fs::write(scratch.path().join("ccm.txt"), format!("ccm: {matrix}\n")).unwrap();
    for (found, expected) in matrix.split(' ').zip(TO_SRGB.as_flattened()) {
        assert!((found.parse::<f64>().unwrap() - expected).abs() < 2e-3, "{matrix}");
    }
    succeed(scratch.path(), &restore("restored.exr", &[]));
    succeed(scratch.path(), &["finish", "restored.exr", "-o", "a.png"]);
    let flags = ["--saturation", "1.9,1,1.6", "--orientation", "6", "--ccm", "ccm.txt"];
    let finish = [&["finish", "restored.npy", "-o", "b.png"][..], &flags].concat();
    succeed(scratch.path(), &finish);
    let [a, b] = ["a.png", "b.png"].map(|name| picture(scratch.path(), name));
    let worst = a.iter().zip(&b).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
    assert!(worst <= 2.0, "{worst}");
}

#[test]
fn info_shows_the_colours_of_a_negative_and_of_what_is_made_of_it() {
    let scratch = scratch(Negative { stops: Some((35, 100)), ..Negative::default() });
    succeed(scratch.path(), &restore("restored.exr", &[]));
    succeed(scratch.path(), &["fuse", "a.dng", "-o", "fused.exr"]);
    for name in ["a.dng", "restored.exr", "fused.exr"] {
        let said = succeed(scratch.path(), &["info", name]);
        for part in ["to be turned right", "baseline  +0.35 stops", "light     65", "matrix      1.60"] {
            assert!(said.contains(part), "{name}: {part} is not in {said}");
        }
        assert!(name == "a.dng" || said.contains("clips at  1.900 1.000 1.600"), "{said}");
    }
}

/// Grey under the light of D65 is what the camera's matrix makes of that light.
#[test]
fn a_negative_may_say_the_chromaticity_of_its_white_instead() {
    let scratch = scratch(Negative { white: Some([0.3127, 0.3290]), ..Negative::default() });
    let raw = read_pixels(&scratch.path().join("a.dng")).unwrap().raw.unwrap();
    for (found, expected) in raw.white_balance.unwrap().into_iter().zip(GAINS) {
        assert!((found / expected - 1.0).abs() < 1e-3, "{found} instead of {expected}");
    }
}

/// A fused raw capture says its levels, so that restoring it is restoring the raw file.
#[test]
fn restoring_a_fused_negative_is_restoring_the_negative() {
    let scratch = scratch(Negative::default());
    succeed(scratch.path(), &restore("a.exr", &[]));
    succeed(scratch.path(), &["fuse", "a.dng", "-o", "fused.exr"]);
    let how = ["--method", "constrained", "--psf", "psf.exr"];
    succeed(scratch.path(), &[&["restore", "fused.exr", "-o", "b.exr"][..], &how].concat());
    let [a, b] = ["a.exr", "b.exr"].map(|name| read_pixels(&scratch.path().join(name)).unwrap());
    assert_eq!((a.planes, a.capture), (b.planes, b.capture));
}
