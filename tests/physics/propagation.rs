//! Analytic truth: propagation. What light does behind a pupil and a panel, whatever software computes it.

use std::f64::consts::PI;
use std::path::PathBuf;

use ndarray::{Array2, Array3, ArrayView2};
use udc::core::progress::Progress;
use udc::io::{PixelOptions, Pixels, write_pixels};
use udc::psf::display::{
    LayoutConfig, LayoutKind, OpticsConfig, RegionConfig, SamplingConfig, SpectrumConfig,
};
use udc::psf::optics::Optics;
use udc::psf::{DisplayConfig, SimulatedPsf, assess_psf, simulate_psf};

const GREEN: usize = 1;
const GREEN_M: f64 = 530e-9;

fn simulate(config: &DisplayConfig) -> SimulatedPsf {
    simulate_psf(config, &Progress::default()).unwrap()
}

fn bare_lens(aperture_mm: f64, pixel_pitch_um: f64, size_px: usize) -> DisplayConfig {
    let mut config = DisplayConfig::default();
    config.optics.aperture_mm = aperture_mm;
    config.sensor.pixel_pitch_um = pixel_pitch_um;
    config.sensor.size_px = size_px;
    // One wavelength: the same for all channels, and computed once.
    let line = vec![(GREEN_M * 1e9, 1.0)];
    config.spectrum = SpectrumConfig { red: line.clone(), green: line.clone(), blue: line };
    config
}

/// Opaque but for one rectangular opening in each pixel.
fn grating(pitch_um: f64, width_um: f64, height_um: f64) -> LayoutConfig {
    let opening = RegionConfig { width_um, height_um, transmittance: 1.0, ..RegionConfig::default() };
    LayoutConfig {
        kind: LayoutKind::Stripe,
        pitch_um: Some(pitch_um),
        background_transmittance: Some(0.0),
        green: Some(opening),
        ..LayoutConfig::default()
    }
}

/// A picture of squares of `pixel_size_um`, kept in a folder that lives as long as the test.
fn picture(transmittance: &Array2<f32>, pixel_size_um: f64, folder: &tempfile::TempDir) -> LayoutConfig {
    let file: PathBuf = folder.path().join("layout.npy");
    let planes = Array3::from_shape_fn((3, transmittance.nrows(), transmittance.ncols()), |(_, y, x)| {
        transmittance[[y, x]]
    });
    write_pixels(&file, &Pixels::of_planes(planes), PixelOptions::default()).unwrap();
    LayoutConfig {
        kind: LayoutKind::Image,
        file: Some(file),
        pixel_size_um: Some(pixel_size_um),
        ..LayoutConfig::default()
    }
}

/// J₁ by its power series; below v = 20 it loses seven of sixteen digits.
fn bessel_j1(v: f64) -> f64 {
    let mut term = v / 2.0;
    let mut sum = term;
    for k in 1..80 {
        term *= -(v * v / 4.0) / f64::from(k * (k + 1));
        sum += term;
    }
    sum
}

/// The share of a circular pupil's light that falls on each pixel, (2J₁(v)/v)² averaged over 12 × 12 points.
fn airy(config: &DisplayConfig, wavelength_m: f64, row: f64, column: f64) -> f64 {
    let optics = Optics::new(&config.optics).unwrap();
    let pitch = config.sensor.pixel_pitch_um * 1e-6;
    let per_metre = optics.aperture_m / (wavelength_m * optics.sensor_distance_m);
    let mut sum = 0.0;
    for (dy, weight_y) in GAUSS_LEGENDRE {
        for (dx, weight_x) in GAUSS_LEGENDRE {
            let v = PI * per_metre * pitch * (row + dy / 2.0).hypot(column + dx / 2.0);
            let light = if v < 1e-9 { 1.0 } else { (2.0 * bessel_j1(v) / v).powi(2) };
            sum += weight_y * weight_x / 4.0 * light;
        }
    }
    PI / 4.0 * (per_metre * pitch).powi(2) * sum
}

/// Nodes and weights of the quadrature on [−1, 1] that is exact for polynomials of degree 9.
const GAUSS_LEGENDRE: [(f64, f64); 5] = [
    (-0.906_179_845_938_664, 0.236_926_885_056_189),
    (-0.538_469_310_105_683, 0.478_628_670_499_366),
    (0.0, 0.568_888_888_888_889),
    (0.538_469_310_105_683, 0.478_628_670_499_366),
    (0.906_179_845_938_664, 0.236_926_885_056_189),
];

fn sum_around(plane: ArrayView2<'_, f32>, row: f64, column: f64, reach: i64) -> f64 {
    let (row, column) = (row.round() as i64, column.round() as i64);
    let square = (-reach..=reach).flat_map(|dy| (-reach..=reach).map(move |dx| (row + dy, column + dx)));
    square.map(|(y, x)| f64::from(plane[[y as usize, x as usize]])).sum()
}

fn centroid_around(plane: ArrayView2<'_, f32>, row: f64, column: f64, reach: i64) -> (f64, f64) {
    let (near_y, near_x) = (row.round() as i64, column.round() as i64);
    let (mut sum, mut y_sum, mut x_sum) = (0.0, 0.0, 0.0);
    for (y, x) in (-reach..=reach).flat_map(|dy| (-reach..=reach).map(move |dx| (near_y + dy, near_x + dx))) {
        let value = f64::from(plane[[y as usize, x as usize]]);
        sum += value;
        y_sum += value * y as f64;
        x_sum += value * x as f64;
    }
    (y_sum / sum, x_sum / sum)
}

/// 1.22 λz₂/D = 19.7 pixels; the pixel's width moves the zero by about (1/24)·(1/19.7)², far below 1 %.
#[test]
fn the_airy_pattern_of_an_empty_pupil_has_its_first_zero_at_1_22_wavelengths_over_aperture() {
    let config = bare_lens(0.5, 0.25, 161);
    let simulated = simulate(&config);
    let row = simulated.psf.channel(GREEN).row(80).to_owned();
    let zero = (82..160).find(|&x| row[x + 1] > row[x]).unwrap();
    let (left, middle, right) = (row[zero - 1], row[zero], row[zero + 1]);
    let vertex = 0.5 * (left - right) / (left - 2.0 * middle + right);
    let found = (zero as f64 - 80.0 + f64::from(vertex)) * 0.25e-6;
    let expected = 1.219_67 * GREEN_M * simulated.optics.sensor_distance_m / 0.5e-3;
    assert!((found / expected - 1.0).abs() < 0.01, "{found} instead of {expected}");
}

/// Every pixel, for fine pixels and for pixels as large as the core: within 2·10⁻⁴ of the peak, the error of a pupil
/// whose rim is drawn by covered area (10⁻⁴ of its area) and of the pixel integral (3·10⁻⁵).
#[test]
fn every_pixel_holds_the_airy_patterns_integral_over_it() {
    for config in [bare_lens(0.5, 0.25, 65), bare_lens(1.2, 1.12, 8), bare_lens(0.5, 0.25, 64)] {
        let simulated = simulate(&config);
        let (centre, inside) = (simulated.psf.centre(), 1.0 - simulated.light[GREEN].outside);
        let peak = airy(&config, GREEN_M, 0.0, 0.0);
        let mut total = 0.0;
        for ((y, x), &value) in simulated.psf.channel(GREEN).indexed_iter() {
            let expected = airy(&config, GREEN_M, y as f64 - centre.0 as f64, x as f64 - centre.1 as f64);
            total += expected;
            let found = f64::from(value) * inside;
            assert!((found - expected).abs() < 2e-4 * peak, "({y}, {x}): {found} instead of {expected}");
        }
        assert!((inside - total).abs() < 5e-4, "{inside} of the light inside, not {total}");
    }
}

/// Orders of period p stand at multiples of λz₂/p · z₁/(z₁+d); with the source at 20 mm and a gap of 5 mm the factor
/// is 0.8 and moves the fourth order by 28 pixels.
#[test]
fn grating_orders_stand_where_source_and_gap_scale_them() {
    for (source_distance_m, display_to_lens_mm) in [(1.0, 1.0), (0.02, 5.0), (f64::INFINITY, 3.0)] {
        let mut config = bare_lens(1.9, 1.12, 320);
        config.optics = OpticsConfig { source_distance_m, display_to_lens_mm, ..config.optics };
        config.spectrum = SpectrumConfig::default();
        config.display = grating(60.0, 13.0, 11.0);
        let simulated = simulate(&config);
        let z2 = simulated.optics.sensor_distance_m;
        let factor = 1.0 / (1.0 + display_to_lens_mm * 1e-3 / source_distance_m);
        for (channel, wavelength) in [610e-9, 530e-9, 465e-9].into_iter().enumerate() {
            let step = wavelength * z2 / 60e-6 * factor / 1.12e-6;
            for (m, n) in [(0, 1), (0, 2), (0, 4), (1, 0), (4, 0), (-3, 0), (2, 3), (-1, -3)] {
                let (row, column) = (160.0 + f64::from(m) * step, 160.0 + f64::from(n) * step);
                let (y, x) = centroid_around(simulated.psf.channel(channel), row, column, 6);
                let miss = (y - row).abs().max((x - column).abs());
                assert!(miss < 0.5, "order ({m}, {n}) misses by {miss} pixels");
            }
        }
    }
}

/// An opening of width w passes order m with sinc²(m·w/p) of the zeroth order's light. 31 periods in the pupil
/// leave about a percent of leakage between orders.
#[test]
fn each_order_carries_the_light_of_its_fourier_coefficient() {
    let mut config = bare_lens(1.9, 1.12, 320);
    config.display = grating(60.0, 13.0, 11.0);
    let simulated = simulate(&config);
    // The openings spread light over λd/w = 48 µm: across the rim it interferes, in a ring of a tenth of the pupil.
    assert!((simulated.light[GREEN].transmitted / (143.0 / 3600.0) - 1.0).abs() < 0.03);
    let plane = simulated.psf.channel(GREEN);
    let step = GREEN_M * simulated.optics.sensor_distance_m / 60e-6 / 1.001 / 1.12e-6;
    let light = |m: f64, n: f64| sum_around(plane, 160.0 + m * step, 160.0 + n * step, 10);
    let sinc2 = |x: f64| if x == 0.0 { 1.0 } else { ((PI * x).sin() / (PI * x)).powi(2) };
    for (m, n) in [(0.0, 1.0), (0.0, 3.0), (2.0, 0.0), (1.0, 2.0), (-2.0, 1.0)] {
        let expected = sinc2(m * 11.0 / 60.0) * sinc2(n * 13.0 / 60.0);
        let found = light(m, n) / light(0.0, 0.0);
        assert!((found / expected - 1.0).abs() < 0.02, "order ({m}, {n}): {found} instead of {expected}");
    }
    // The zeroth order's share of what passes is the open fraction; 2 % of an Airy pattern lies beyond 10 px.
    let zeroth = light(0.0, 0.0) * (1.0 - simulated.light[GREEN].outside);
    assert!((zeroth / (143.0 / 3600.0) - 1.0).abs() < 0.03, "{zeroth}");
}

/// The light is all accounted for: what a larger window gains, the outside loses. The bare lens adds up to the rounding
/// of 32 bit; behind a panel, the light of orders too far out to be followed is known to about a percent (how many openings
/// stand in the pupil) of its share.
#[test]
fn light_inside_and_outside_of_the_window_adds_up() {
    for (layout, tolerance) in [(LayoutConfig::default(), 1e-6), (grating(60.0, 13.0, 11.0), 5e-3)] {
        let light_in_middle = |size: usize| {
            let mut config = bare_lens(1.9, 1.12, size);
            config.display = layout.clone();
            config.sampling = SamplingConfig { grid_pitch_um: Some(1.6), grid_size: None };
            let simulated = simulate(&config);
            let centre = (size / 2) as f64;
            let middle = sum_around(simulated.psf.channel(GREEN), centre, centre, 49);
            middle * (1.0 - simulated.light[GREEN].outside)
        };
        let (small, large) = (light_in_middle(99), light_in_middle(399));
        assert!((small / large - 1.0).abs() < tolerance, "{small} and {large}");
    }
}

#[test]
fn red_orders_lie_further_out_than_blue_ones() {
    let mut config = bare_lens(1.9, 1.12, 201);
    config.spectrum = SpectrumConfig::default();
    config.display = grating(60.0, 13.0, 11.0);
    let simulated = simulate(&config);
    let step = |wavelength: f64| wavelength * simulated.optics.sensor_distance_m / 60e-6 / 1.12e-6;
    let offset = |channel: usize, wavelength| {
        centroid_around(simulated.psf.channel(channel), 100.0, 100.0 + 2.0 * step(wavelength), 6).1 - 100.0
    };
    let (red, blue) = (offset(0, 610e-9), offset(2, 465e-9));
    assert!((red / blue - 610.0 / 465.0).abs() < 0.01, "{red} and {blue}");
}

/// A hole to the right and above, seen by the camera. With the sensor behind the focus the rays have crossed: the
/// spot is at the left on the sensor and, in the picture that the camera turns by 180°, at the right.
#[test]
fn a_defocused_hole_appears_where_the_camera_sees_it() {
    let folder = tempfile::tempdir().unwrap();
    let (x_um, y_um) = (500.0, -300.0);
    let squares = Array2::from_shape_fn((240, 240), |(row, column)| {
        let (y, x) = (row as f64 * 10.0 - 1195.0, column as f64 * 10.0 - 1195.0);
        f32::from(u8::from((y - y_um).hypot(x - x_um) < 100.0))
    });
    let layout = picture(&squares, 10.0, &folder);
    let focus = Optics::new(&OpticsConfig::default()).unwrap().sensor_distance_m;
    let spot = |sensor_factor: f64, angle_deg: f64, offset_um: [f64; 2]| {
        let mut config = bare_lens(1.9, 1.12, 128);
        config.optics.sensor_distance_mm = Some(focus * 1e3 * sensor_factor);
        config.display = LayoutConfig { angle_deg, offset_um, ..layout.clone() };
        let simulated = simulate(&config);
        let (y, x) = centroid_around(simulated.psf.channel(GREEN), 64.0, 64.0, 60);
        // −z₂ε: how far the ray of each metre off the axis lands, turned by 180°.
        let scale = -simulated.optics.sensor_distance_m * simulated.optics.defocus_per_m * 1.001 / 1.12;
        ((x - 64.0) / scale, (y - 64.0) / scale)
    };
    let near = |found: (f64, f64), expected: (f64, f64)| {
        // 20 µm are a fiftieth of the picture's hole distance, and 1 pixel at the sensor.
        let miss = (found.0 - expected.0).hypot(found.1 - expected.1);
        assert!(miss < 20.0, "hole found at {found:?} µm, expected {expected:?}");
    };
    assert!(
        Optics::new(&OpticsConfig {
            sensor_distance_mm: Some(focus * 1e3 * 1.08),
            ..OpticsConfig::default()
        })
        .unwrap()
        .defocus_per_m
            < 0.0
    );
    near(spot(1.08, 0.0, [0.0; 2]), (x_um, y_um));
    near(spot(0.92, 0.0, [0.0; 2]), (x_um, y_um));
    // Counter-clockwise: what is right goes up, what is up goes left.
    near(spot(1.08, 90.0, [0.0; 2]), (-300.0, -500.0));
    near(spot(1.08, 0.0, [-200.0, 100.0]), (300.0, -200.0));
}

/// The panel's turn turns the orders with it, counter-clockwise.
#[test]
fn a_turned_grating_turns_its_orders() {
    let mut config = bare_lens(1.9, 1.12, 201);
    config.display = LayoutConfig { angle_deg: 12.0, offset_um: [17.0, 5.0], ..grating(60.0, 8.0, 60.0) };
    let simulated = simulate(&config);
    let step = GREEN_M * simulated.optics.sensor_distance_m / 60e-6 / 1.001 / 1.12e-6;
    let (sin, cos) = 12f64.to_radians().sin_cos();
    for m in [1.0, -2.0, 3.0] {
        let (row, column) = (100.0 - m * step * sin, 100.0 + m * step * cos);
        let (y, x) = centroid_around(simulated.psf.channel(GREEN), row, column, 6);
        assert!((y - row).hypot(x - column) < 0.5, "order {m} at ({y}, {x}), expected ({row}, {column})");
    }
}

/// Two slits s apart: fringes of period λz₂/(M·s) of contrast one, so that the profile's spectrum there is half of its
/// sum, less the pixel's sinc.
#[test]
fn two_slits_make_fringes() {
    let folder = tempfile::tempdir().unwrap();
    let slits = Array2::from_shape_fn((100, 300), |(_, column)| {
        let x = column as f64 * 10.0 - 1495.0;
        f32::from(u8::from((x.abs() - 200.0).abs() < 20.0))
    });
    let mut config = bare_lens(1.9, 0.56, 801);
    config.display = picture(&slits, 10.0, &folder);
    let simulated = simulate(&config);
    let profile = simulated.psf.channel(GREEN).sum_axis(ndarray::Axis(0));
    let spectrum = |period_px: f64| {
        let (mut re, mut im) = (0.0, 0.0);
        for (x, &value) in profile.iter().enumerate() {
            let (sin, cos) = (2.0 * PI * (x as f64 - 400.0) / period_px).sin_cos();
            re += f64::from(value) * cos;
            im += f64::from(value) * sin;
        }
        re.hypot(im)
    };
    let period = GREEN_M * simulated.optics.sensor_distance_m / 1.001 / 400e-6 / 0.56e-6;
    let best = (-40..=40).map(|k| period * (1.0 + f64::from(k) / 1000.0));
    let best = best.max_by(|a, b| spectrum(*a).total_cmp(&spectrum(*b))).unwrap();
    assert!((best / period - 1.0).abs() < 0.005, "period {best} instead of {period}");
    let pixel = (PI / period).sin() / (PI / period);
    // 5 % of a slit pattern's light lies outside of the window.
    assert!((spectrum(period) / (0.5 * pixel) - 1.0).abs() < 0.05, "{}", spectrum(period));
}

/// A sensor 5 % behind the focus: the pupil's shadow, a disc of diameter D·0.05, half of its light within 1/√2 of its
/// radius. Diffraction softens its rim by about √(λz₂) = 45 µm at the lens, 5 % of the pupil's radius.
#[test]
fn defocus_blurs_over_the_geometric_disc() {
    let focus = Optics::new(&OpticsConfig::default()).unwrap().sensor_distance_m;
    let mut config = bare_lens(1.9, 1.12, 160);
    config.optics.sensor_distance_mm = Some(focus * 1.05e3);
    let simulated = simulate(&config);
    let radius_px = 1.9e-3 * 0.05 / 2.0 / 1.12e-6;
    let [half, ..] = assess_psf(&simulated.psf).channels[GREEN].encircled_px;
    assert!((half / (radius_px / 2f64.sqrt()) - 1.0).abs() < 0.05, "{half} px");
}

/// Eq. 2 as it is printed, its integrals done by summation: two rectangular openings, source and gap so near that
/// every phase matters, sensor out of focus.
#[expect(clippy::too_many_lines, reason = "one derivation, step by step")]
#[test]
fn agrees_with_the_integrals_of_equation_2() {
    let folder = tempfile::tempdir().unwrap();
    // Rows and columns of 4 µm squares, in micrometres from the centre: [top, bottom], [left, right].
    let openings = [([-60.0, -20.0], [12.0, 80.0]), ([0.0, 72.0], [-68.0, -40.0])];
    let inside = |at: f64, [from, to]: [f64; 2]| at > from && at < to;
    let squares = Array2::from_shape_fn((120, 120), |(row, column)| {
        let (y, x) = (row as f64 * 4.0 - 238.0, column as f64 * 4.0 - 238.0);
        f32::from(u8::from(openings.iter().any(|(rows, columns)| inside(y, *rows) && inside(x, *columns))))
    });
    let mut config = bare_lens(0.2, 1.0, 64);
    config.optics = OpticsConfig {
        source_distance_m: 0.02,
        display_to_lens_mm: 5.0,
        focal_length_mm: 3.8,
        aperture_mm: 0.2,
        sensor_distance_mm: Some(5.5),
    };
    config.display = picture(&squares, 4.0, &folder);
    let simulated = simulate(&config);
    let (z1, d, f, z2) = (0.02, 5e-3, 3.8e-3, 5.5e-3);

    // One axis of the field at the lens: ∫ exp(iπξ²/λz₁) exp(iπ(x−ξ)²/λd) dξ over an opening.
    let to_lens = |x: f64, [from, to]: [f64; 2]| {
        let steps = 400;
        let (mut re, mut im) = (0.0, 0.0);
        for step in 0..steps {
            let xi = (from + (to - from) * (f64::from(step) + 0.5) / f64::from(steps)) * 1e-6;
            let phase = PI / GREEN_M * (xi * xi / z1 + (x - xi).powi(2) / d);
            re += phase.cos();
            im += phase.sin();
        }
        let weight = (to - from) / f64::from(steps);
        (re * weight, im * weight)
    };
    let times = |a: (f64, f64), b: (f64, f64)| (a.0 * b.0 - a.1 * b.1, a.0 * b.1 + a.1 * b.0);
    let points = 250;
    let place = |index: usize| (index as f64 + 0.5) / points as f64 * 0.2e-3 - 0.1e-3;
    let along = |range: [f64; 2]| (0..points).map(|i| to_lens(place(i), range)).collect::<Vec<_>>();
    let lines: Vec<_> = openings.iter().map(|(rows, columns)| (along(*rows), along(*columns))).collect();
    let intensity = |v: f64, u: f64| {
        let (mut re, mut im) = (0.0, 0.0);
        for (y, x) in (0..points).flat_map(|y| (0..points).map(move |x| (y, x))) {
            let (py, px) = (place(y), place(x));
            if py.hypot(px) > 0.1e-3 {
                continue;
            }
            let field = lines.iter().map(|(rows, columns)| times(rows[y], columns[x]));
            let field = field.fold((0.0, 0.0), |sum, term| (sum.0 + term.0, sum.1 + term.1));
            let to_sensor = ((v - py).powi(2) + (u - px).powi(2)) / z2 - (py * py + px * px) / f;
            let (sin, cos) = (PI / GREEN_M * to_sensor).sin_cos();
            let landed = times(field, (cos, sin));
            re += landed.0;
            im += landed.1;
        }
        re * re + im * im
    };
    let places = [(0, 0), (3, -5), (-8, 6), (12, 9), (-15, -4), (7, 14), (-3, -13), (18, -2), (-11, 17)];
    let pairs: Vec<(f64, f64)> = places
        .into_iter()
        .map(|(row, column)| {
            // The camera turns its picture by 180°; pixels of 1 µm are averaged over 3 × 3 points (Simpson).
            let weights = [(-0.5, 1.0 / 6.0), (0.0, 4.0 / 6.0), (0.5, 1.0 / 6.0)];
            let pixel =
                weights.iter().flat_map(|(dy, wy)| weights.iter().map(move |(dx, wx)| (dy, dx, wy * wx)));
            let expected: f64 = pixel
                .map(|(dy, dx, weight)| {
                    weight * intensity(-(f64::from(row) + dy) * 1e-6, -(f64::from(column) + dx) * 1e-6)
                })
                .sum();
            let found = simulated.psf.planes()[[GREEN, (32 + row) as usize, (32 + column) as usize]];
            (f64::from(found), expected)
        })
        .collect();
    let scale = pairs.iter().map(|p| p.0 * p.1).sum::<f64>() / pairs.iter().map(|p| p.1 * p.1).sum::<f64>();
    let brightest = pairs.iter().map(|p| p.0).fold(0.0, f64::max);
    for ((found, expected), place) in pairs.iter().zip(places) {
        // Summation and hard-edged pupil of 250 points: 1 %.
        assert!(
            (found - scale * expected).abs() < 0.01 * brightest,
            "{place:?}: {found}, not {}",
            scale * expected
        );
    }
}

fn shipped(name: &str) -> DisplayConfig {
    let file = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("configs/display").join(name);
    DisplayConfig::parse(&udc::io::read_text(&file).unwrap(), &file).unwrap()
}

#[test]
fn a_bare_lens_is_much_more_compact_than_one_behind_a_panel() {
    let spread = |name: &str| {
        let mut config = shipped(name);
        config.sensor.size_px = 400;
        assess_psf(&simulate(&config).psf).channels[GREEN].encircled_px[1]
    };
    let bare = spread("none.toml");
    assert!(bare < 4.0, "{bare}");
    for panel in ["pentile.toml", "stripe.toml"] {
        assert!(spread(panel) > 10.0 * bare, "{panel}: {} and {bare}", spread(panel));
    }
}

/// Half the grid pitch follows twice as many orders and draws the pupil's rim twice as finely.
#[test]
fn a_finer_grid_changes_less_than_one_percent() {
    let mut config = shipped("pentile.toml");
    config.sensor.size_px = 201;
    config.display.angle_deg = 7.0;
    let automatic = simulate(&config);
    config.sampling.grid_pitch_um = Some(automatic.grid.pitch_m * 1e6 / 2.0);
    let finer = simulate(&config);
    for channel in 0..3 {
        let pixels = automatic.psf.channel(channel).to_owned() - finer.psf.channel(channel);
        let change: f64 = pixels.iter().map(|v| f64::from(v.abs())).sum();
        assert!(change < 0.01, "channel {channel} changes by {change}");
    }
}

#[test]
fn a_grid_that_aliases_is_refused() {
    let mut config = shipped("pentile.toml");
    config.sampling.grid_pitch_um = Some(5.0);
    let message = simulate_psf(&config, &Progress::default()).unwrap_err().to_string();
    assert!(message.contains("aliases") && message.contains("would do"), "{message}");
}

#[test]
fn the_number_of_threads_changes_no_bit() {
    let mut config = shipped("stripe.toml");
    config.sensor.size_px = 100;
    let on = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| simulate(&config).psf.sha256())
    };
    assert_eq!(on(1), on(3));
}
