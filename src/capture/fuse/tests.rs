mod darks;

use super::*;
use crate::capture::scaling::check_black;
use ndarray::Array2;

const TIMES: [f64; 3] = [1.0, 1.0 / 32.0, 1.0 / 768.0];

fn scene() -> Array3<f32> {
    Array3::from_shape_fn((3, 20, 24), |(c, y, x)| 0.01 * 1.6f32.powi((x + c) as i32 - (y / 4) as i32))
}

fn expose(scene: &Array3<f32>, time: f64) -> Array3<f32> {
    scene.mapv(|v| (v * time as f32).min(1.0))
}

fn bracket(scene: &Array3<f32>) -> Bracket {
    Bracket::new(TIMES.iter().map(|t| expose(scene, *t)).collect(), &TIMES).unwrap()
}

#[test]
fn takes_the_longest_exposure_that_is_not_saturated() {
    let scene = scene();
    let fused = fuse(bracket(&scene), &FuseConfig::default()).unwrap();
    for (place, &value) in scene.indexed_iter() {
        let source = TIMES.iter().position(|t| f64::from(value * *t as f32) < 0.99).unwrap_or(2);
        assert_eq!(usize::from(fused.source[place]), source);
        assert!((fused.image.planes()[place] / value.min(768.0) - 1.0).abs() < 1e-6);
    }
}

#[test]
fn counts_what_is_saturated_everywhere() {
    let mut scene = scene();
    scene.fill(0.1);
    scene[[1, 3, 3]] = 5000.0;
    let fused = fuse(bracket(&scene), &FuseConfig::default()).unwrap();
    assert_eq!(fused.saturated, [0, 1, 0]);
    assert!((fused.image.planes()[[1, 3, 3]] - 768.0).abs() < 1e-3);
}

#[test]
fn the_order_of_the_pictures_does_not_matter_as_long_as_the_times_agree() {
    let scene = scene();
    let times = [TIMES[2], TIMES[0], TIMES[1]];
    let shuffled = Bracket::new(times.iter().map(|t| expose(&scene, *t)).collect(), &times).unwrap();
    let config = FuseConfig::default();
    assert_eq!(fuse(shuffled, &config).unwrap().image, fuse(bracket(&scene), &config).unwrap().image);
}

#[test]
fn refuses_times_in_a_wrong_order() {
    let scene = scene();
    let wrong = [TIMES[1], TIMES[0], TIMES[2]];
    let bracket = Bracket::new(TIMES.iter().map(|t| expose(&scene, *t)).collect(), &wrong).unwrap();
    let message = fuse(bracket, &FuseConfig::default()).unwrap_err().to_string();
    assert!(message.contains("picture 1 (exposure 1/32) is brighter than picture 2"), "{message}");
}

#[test]
fn refuses_brackets_that_do_not_fit() {
    let picture = || Array3::zeros((3, 4, 4));
    assert!(Bracket::new(Vec::new(), &[]).unwrap_err().to_string().contains("at least one"));
    let sizes = vec![picture(), Array3::zeros((3, 4, 5)), picture()];
    let sizes = Bracket::new(sizes, &TIMES).unwrap_err().to_string();
    assert!(sizes.contains("picture 2") && sizes.contains("4 × 5"), "{sizes}");
    assert!(Bracket::new(vec![picture(); 3], &[1.0, 0.5, 0.0]).is_err());
    assert!(Bracket::new(vec![picture(); 3], &[1.0, 0.5]).is_err());
    let grey = Bracket::new(vec![Array3::zeros((1, 4, 4)); 3], &TIMES).unwrap();
    assert!(fuse(grey, &FuseConfig::default()).unwrap_err().to_string().starts_with("bayer"));
}

#[test]
fn one_and_two_exposures_follow_the_same_rule() {
    let scene = scene();
    for count in [1, 2] {
        let times = &TIMES[..count];
        let pictures = times.iter().map(|t| expose(&scene, *t)).collect();
        let fused = fuse(Bracket::new(pictures, times).unwrap(), &FuseConfig::default()).unwrap();
        let brightest = (1.0 / times[count - 1]) as f32;
        for (found, value) in fused.image.planes().iter().zip(&scene) {
            assert!((found / value.min(brightest) - 1.0).abs() < 1e-6, "{found} instead of {value}");
        }
    }
}

/// As RGB, and as a packed mosaic, whose mask is that of the whole one.
#[test]
fn values_that_a_mask_discards_need_not_be_finite() {
    for (channels, bayer, sides) in [(3, None, (20, 24)), (4, Some(BayerPattern::Rggb), (40, 48))] {
        let pictures = || {
            TIMES.map(|time| {
                let mut picture = Array3::from_elem((channels, 20, 24), 0.4 * time as f32);
                picture[[channels - 1, 5, 6]] = f32::NAN;
                picture[[channels - 1, 5, 7]] = f32::INFINITY;
                picture
            })
        };
        let config = FuseConfig { bayer, ..FuseConfig::default() };
        let bracket = || Bracket::new(pictures().to_vec(), &TIMES).unwrap();
        let message = fuse(bracket(), &config).unwrap_err().to_string();
        assert!(message.contains("NaN") && message.contains("mask"), "{message}");
        let holes = if channels == 4 { [[11, 13], [11, 15]] } else { [[5, 6], [5, 7]] };
        let valid = Array2::from_shape_fn(sides, |(y, x)| !holes.contains(&[y, x]));
        let fused = fuse(bracket().with_mask(valid).unwrap(), &config).unwrap();
        assert!(fused.image.planes().iter().all(|v| (v - 0.4).abs() < 1e-4));
    }
}

#[test]
fn removes_black_and_scales_to_white() {
    let scene = scene();
    let raw = |t: &f64| expose(&scene, *t).mapv(|v| 64.0 + v * (1023.0 - 64.0));
    let bracket = Bracket::new(TIMES.iter().map(raw).collect(), &TIMES).unwrap();
    let config = FuseConfig { white: 1023.0, black: 64.0, ..FuseConfig::default() };
    let fused = fuse(bracket, &config).unwrap();
    // The level of 64 leaves 1023·2⁻²⁴ of rounding on values of some 10⁻³ · 959.
    for (found, value) in fused.image.planes().iter().zip(&scene) {
        let expected = value.min(768.0);
        assert!((found / expected - 1.0).abs() < 1e-3, "{found} instead of {expected}");
    }
}

#[test]
fn refuses_a_black_level_above_the_signal() {
    let config = FuseConfig { black: 0.3, ..FuseConfig::default() };
    let dim = Array3::from_elem((3, 9, 9), 0.2);
    assert!(fuse(bracket(&dim), &config).unwrap_err().to_string().starts_with("black: lies above 100 %"));
}

/// Noise about the right level is let through, though half of a night's values lie below it.
#[test]
fn refuses_a_black_level_above_the_shorter_exposures() {
    let scene = Array3::from_shape_fn((3, 20, 24), |(c, y, x)| if (c + y + x) % 2 == 0 { 0.9 } else { 0.2 });
    let config = FuseConfig { black: 0.1, ..FuseConfig::default() };
    assert!(fuse(bracket(&scene), &config).unwrap_err().to_string().starts_with("black: lies above"));
    let noise = Array3::from_shape_fn((3, 20, 24), |(c, y, x)| 0.002 * ((c * 480 + y * 24 + x) as f32).sin());
    assert!(check_black(&[noise.clone(), noise], &config).is_ok());
}

#[test]
fn weighting_by_time_averages_all_usable_exposures() {
    let times = [1.0, 0.5, 0.25];
    let pictures = [0.5, 0.3, 0.1].map(|v| Array3::from_elem((3, 4, 4), v));
    let bracket = Bracket::new(pictures.to_vec(), &times).unwrap();
    let config = FuseConfig { merge: MergeRule::Weighted, ..FuseConfig::default() };
    let fused = fuse(bracket, &config).unwrap();
    assert!((fused.image.planes()[[0, 0, 0]] - 0.9 / 1.75).abs() < 1e-6);
}

#[test]
fn masked_pixels_are_filled_and_not_counted_as_saturated() {
    let mut scene = Array3::from_elem((3, 9, 9), 0.2);
    scene[[0, 4, 4]] = 1e6;
    let valid = Array2::from_shape_fn((9, 9), |place| place != (4, 4));
    let fused = fuse(bracket(&scene).with_mask(valid).unwrap(), &FuseConfig::default()).unwrap();
    assert!((fused.image.planes()[[0, 4, 4]] - 0.2).abs() < 1e-6);
    assert_eq!((fused.saturated, fused.discarded), (vec![0, 0, 0], 1));
    assert!(bracket(&scene).with_mask(Array2::from_elem((9, 8), true)).is_err());
}

/// Times off by a quarter show in the pictures.
#[test]
fn compares_the_times_with_the_pictures() {
    let scene = Array3::from_shape_fn((3, 40, 40), |(_, y, _)| 0.1 + y as f32 / 4.0);
    let times = [1.0, 0.25, 0.05];
    let wrong = [1.0, 0.2, 0.05];
    let bracket = Bracket::new(times.iter().map(|t| expose(&scene, *t)).collect(), &wrong).unwrap();
    let found = fuse(bracket, &FuseConfig::default()).unwrap().ratio_found;
    assert!((found[0].unwrap() - 1.25).abs() < 1e-4 && (found[1].unwrap() - 0.8).abs() < 1e-4);
}

/// The times of an exposure that is not needed are nobody's concern.
#[test]
fn times_that_nothing_confirms_are_told_where_the_exposure_is_used() {
    let lamp = |brightness: f32| {
        let mut scene = Array3::from_elem((3, 40, 40), 0.001);
        scene[[1, 20, 20]] = brightness;
        fuse(bracket(&scene), &FuseConfig::default()).unwrap().warnings()
    };
    assert_eq!(lamp(0.5), Vec::<String>::new());
    let warnings = lamp(5.0);
    assert!(warnings.len() == 1 && warnings[0].contains("times of 1 and 1/32 could not be"), "{warnings:?}");
    let dark = vec![Array3::from_elem((3, 40, 40), 0.001); 3];
    let fused = fuse(Bracket::new(dark, &[1.0; 3]).unwrap(), &FuseConfig::default()).unwrap();
    let warnings = fused.warnings();
    assert!(warnings.len() == 1 && warnings[0].contains("checked of 2, 3: too little"), "{warnings:?}");
}

/// 14 bits in words of 16: the longer exposures end at a quarter of white, which is no saturation.
#[test]
fn a_white_that_is_too_high_is_told() {
    let scene = scene();
    let pictures = |white: f32| TIMES.map(|time| scene.mapv(|v| white * (v * time as f32).min(1.0))).to_vec();
    let warnings = |white| {
        fuse(Bracket::new(pictures(white), &TIMES).unwrap(), &FuseConfig::default()).unwrap().warnings()
    };
    assert_eq!(warnings(1.0), Vec::<String>::new());
    let said = warnings(0.25);
    assert!(said[0].contains("exposure 1 end at 0.2500 of white, where 1/32 shows more"), "{said:?}");
    assert!(said[0].contains("--white") && said.iter().all(|said| !said.contains("lets expect")), "{said:?}");
}

/// The second ratio is that of the pictures, too: 0.25 / 0.05, whatever the times say.
#[test]
fn takes_the_times_from_the_pictures_when_asked() {
    let scene = Array3::from_shape_fn((3, 40, 40), |(_, y, _)| 0.1 + y as f32 / 4.0);
    let times = [1.0, 0.25, 0.05];
    let bracket =
        Bracket::new(times.iter().map(|t| expose(&scene, *t)).collect(), &[1.0, 0.2, 0.06]).unwrap();
    let config = FuseConfig { estimate_exposures: true, ..FuseConfig::default() };
    let fused = fuse(bracket, &config).unwrap();
    for (found, expected) in fused.times.iter().zip(times) {
        assert!((found / expected - 1.0).abs() < 1e-4, "{found} instead of {expected}");
    }
    assert!(fused.ratio_found.iter().flatten().all(|ratio| (ratio - 1.0).abs() < 1e-4));
    for (found, expected) in fused.image.planes().iter().zip(&scene) {
        assert!((found / expected - 1.0).abs() < 1e-4);
    }
    let dark = bracket_of_darkness();
    let message = fuse(dark, &config).unwrap_err().to_string();
    assert!(message.contains("estimate-exposures") && message.contains("1/32"), "{message}");
}

fn bracket_of_darkness() -> Bracket {
    bracket(&Array3::from_elem((3, 40, 40), 0.01))
}

#[test]
fn balances_planes_and_mosaics_alike() {
    let gains = [2.0, 1.0, 1.5];
    let flat = Array3::from_elem((3, 12, 12), 0.2);
    let config = FuseConfig { white_balance: gains, ..FuseConfig::default() };
    let planes = fuse(bracket(&flat), &config).unwrap();
    let mosaic = Array3::from_elem((1, 12, 12), 0.2);
    let config = FuseConfig { bayer: Some(BayerPattern::Gbrg), ..config };
    let demosaiced = fuse(bracket(&mosaic), &config).unwrap();
    for fused in [planes, demosaiced] {
        for (channel, gain) in gains.iter().enumerate() {
            let expected = (0.2 * gain) as f32;
            assert!(fused.image.channel(channel).iter().all(|v| (v - expected).abs() < 1e-5));
            assert!((fused.saturation[channel] / (768.0 * gain) - 1.0).abs() < 1e-9);
        }
    }
}

#[test]
fn a_single_picture_is_levelled_like_a_bracket() {
    let raw = Array3::from_elem((3, 8, 8), 0.3);
    let config = FuseConfig { white: 0.5, black: 0.1, ..FuseConfig::default() };
    let fused = fuse(Bracket::single(raw).unwrap(), &config).unwrap();
    assert!(fused.image.planes().iter().all(|v| (v - 0.5).abs() < 1e-6));
}

#[test]
fn a_mosaic_is_merged_before_it_is_demosaiced() {
    let pattern = BayerPattern::Grbg;
    let colour = [0.3, 20.0, 0.6];
    let mosaic = Array3::from_shape_fn((1, 12, 12), |(_, y, x)| colour[pattern.channel(y, x)]);
    let config = FuseConfig { bayer: Some(pattern), ..FuseConfig::default() };
    let fused = fuse(bracket(&mosaic), &config).unwrap();
    let planes = fused.image.planes();
    let flat =
        (0..3).all(|c| planes.index_axis(Axis(0), c).iter().all(|v| (v / colour[c] - 1.0).abs() < 1e-4));
    assert!(flat);
    assert_eq!(fused.source.dim(), (1, 12, 12));
}

/// As of a raw file whose white is that of its converter: a lamp is of one colour, whatever the balance.
#[test]
fn a_mosaic_that_ends_below_white_has_its_white_there() {
    let (pattern, gains) = (BayerPattern::Rggb, [2.0, 1.0, 1.6]);
    let picture = |end: f32| {
        let light =
            |y: usize, x: usize| 0.1 + 30.0 / (1.0 + (y as f32 - 24.0).hypot(x as f32 - 24.0).powi(2));
        Array3::from_shape_fn((1, 48, 48), |(_, y, x)| light(y, x).min(end))
    };
    let fused = |end, finds_white| {
        let bayer = Some(pattern);
        let config = FuseConfig { bayer, white_balance: gains, finds_white, ..FuseConfig::default() };
        fuse(Bracket::single(picture(end)).unwrap(), &config).unwrap()
    };
    for end in [0.82, 0.95] {
        let found = fused(end, true);
        assert!(found.white_found.is_some_and(|white| (white / f64::from(end) - 1.0).abs() < 1e-6));
        assert!(found.saturated[0] > 50 && found.warnings()[0].contains("of the white that the file says"));
        for (channel, gain) in gains.iter().enumerate() {
            let lamp = found.image.channel(channel)[[24, 24]];
            assert!((f64::from(lamp) / gain - 1.0).abs() < 1e-4, "{channel}: {lamp}");
        }
        assert_eq!(fused(end, false).white_found, None);
    }
    assert_eq!([0.5, 1.0].map(|end| fused(end, true).white_found), [None; 2], "flat light, and white itself");
    // As of 12 bits that were told to be 14.
    let doubted = fused(0.25, false);
    assert!(doubted.warnings()[0].contains("end at 0.2500 of white"), "{:?}", doubted.warnings());
    assert_eq!([0.95, 1.0].map(|end| fused(end, true).white_doubted), [None; 2]);
    let wall = Bracket::single(Array3::from_elem((3, 48, 48), 0.25)).unwrap();
    assert_eq!(fuse(wall, &FuseConfig::default()).unwrap().white_doubted, None);
}

/// Noise that repeats nowhere, with a mean of zero.
fn noise(label: &str, deviation: f32) -> impl FnMut() -> f32 + use<> {
    use rand_distr::{Distribution as _, Normal};
    let mut rng = crate::core::rng::stream(3, label);
    let normal = Normal::new(0.0, deviation).unwrap();
    move || normal.sample(&mut rng)
}

fn deviation_from(image: &LinearImage, expected: f32) -> f64 {
    let squares: f64 = image.as_slice().iter().map(|v| f64::from(v - expected).powi(2)).sum();
    (squares / image.as_slice().len() as f64).sqrt()
}

/// Sixteen pictures of σ = 0.02 leave 0.005; of 12 288 values, their deviation is known to 0.6 %.
#[test]
fn averaging_sixteen_pictures_leaves_a_quarter_of_the_noise() {
    let pictures = (0..16).map(|k| {
        let mut noise = noise(&format!("picture {k}"), 0.02);
        Array3::from_shape_simple_fn((3, 64, 64), || 0.3 + noise())
    });
    let fused = fuse(Bracket::new(pictures.collect(), &[0.5; 16]).unwrap(), &FuseConfig::default()).unwrap();
    assert_eq!((fused.averaged.clone(), fused.times.clone()), (vec![16], vec![1.0]));
    assert!((deviation_from(&fused.image, 0.3) / 0.005 - 1.0).abs() < 0.04);
}

/// Two pictures of 1 and eight of 1/4 collect light for as long: their mean weighs both alike.
#[test]
fn exposures_are_weighted_by_the_time_of_all_their_pictures() {
    let times = [&[1.0; 2][..], &[0.25; 8]].concat();
    let pictures = times.iter().map(|time| Array3::from_elem((3, 4, 4), if *time > 0.5 { 0.5 } else { 0.1 }));
    let config = FuseConfig { merge: MergeRule::Weighted, ..FuseConfig::default() };
    let fused = fuse(Bracket::new(pictures.collect(), &times).unwrap(), &config).unwrap();
    assert!((fused.image.planes()[[0, 0, 0]] - (2.0 * 0.5 + 8.0 * 0.1) / 4.0).abs() < 1e-6);
    assert_eq!(fused.averaged, [2, 8]);
}

/// The mean of those that are not would be of low noise alone. Without a shorter exposure, it is the mean of all.
#[test]
fn where_one_picture_is_saturated_the_shorter_exposure_is_taken() {
    let mut pictures = [0.6, 0.7, 0.8, 0.18].map(|v| Array3::from_elem((3, 4, 4), v));
    pictures[2][[1, 2, 2]] = 1.0;
    pictures[..3].iter_mut().for_each(|picture| picture[[0, 0, 0]] = 1.0);
    for merge in [MergeRule::Longest, MergeRule::Weighted] {
        let config = FuseConfig { merge, ..FuseConfig::default() };
        let fused = fuse(Bracket::new(pictures.to_vec(), &[1.0, 1.0, 1.0, 0.25]).unwrap(), &config).unwrap();
        let value = |place| fused.image.planes()[place];
        assert!((value([1, 2, 2]) - 0.72).abs() < 1e-6 && (value([0, 0, 0]) - 0.72).abs() < 1e-6);
        assert_eq!(fused.saturated, [0, 0, 0]);
        let alone = fuse(Bracket::new(pictures[..3].to_vec(), &[1.0; 3]).unwrap(), &config).unwrap();
        let value = |place| alone.image.planes()[place];
        assert!((value([2, 2, 2]) - 0.7).abs() < 1e-6);
        assert!((value([1, 2, 2]) - 2.3 / 3.0).abs() < 1e-6 && (value([0, 0, 0]) - 1.0).abs() < 1e-6);
        assert_eq!(alone.saturated, [1, 1, 0]);
    }
}

/// Light of 0.9 to 1.05 of white, in rows of one value each, and pictures of it by a sensor with noise.
fn near_white() -> Array3<f32> {
    Array3::from_shape_fn((3, 31, 4096), |(_, y, _)| 0.9 + 0.005 * y as f32)
}

fn noisy(scene: &Array3<f32>, count: usize, deviation: f32) -> Vec<Array3<f32>> {
    let picture = |k| {
        let mut noise = noise(&format!("near white {k}"), deviation);
        scene.mapv(|v| (v + noise()).min(1.0))
    };
    (0..count).map(picture).collect()
}

/// The quarter is free of noise, so that each value deviates by at most σ, and a row's mean by σ / √(3 · 4096); five of those for
/// each of both biases.
#[test]
fn averaging_more_pictures_does_not_bias_light_near_white() {
    const DEVIATION: f32 = 0.015;
    let scene = near_white();
    let worst_bias = |count: usize| {
        let mut pictures = noisy(&scene, count, DEVIATION);
        pictures.push(expose(&scene, 0.25));
        let times = [&vec![1.0; count][..], &[0.25]].concat();
        let fused = fuse(Bracket::new(pictures, &times).unwrap(), &FuseConfig::default()).unwrap();
        let planes = fused.image.planes();
        let bias_of = |y: usize| {
            let mean = |planes: ndarray::ArrayView3<'_, f32>| {
                let row = planes.index_axis(Axis(1), y);
                row.iter().map(|v| f64::from(*v)).sum::<f64>() / row.len() as f64
            };
            (mean(planes) / mean(scene.view()) - 1.0).abs()
        };
        (0..31).map(bias_of).fold(0.0, f64::max)
    };
    let (one, eight) = (worst_bias(1), worst_bias(8));
    let tolerance = 10.0 * f64::from(DEVIATION) / (3.0 * 4096.0_f64).sqrt();
    assert!(eight <= one + tolerance, "{eight} with eight files, {one} with one");
}

/// As above, of the ratio of the two exposures, whose truth is 1/4.
#[test]
fn averaging_more_pictures_does_not_bias_the_exposures_found() {
    let scene = near_white();
    let error = |count: usize| {
        let mut pictures = noisy(&scene, count, 0.015);
        pictures.push(expose(&scene, 0.25));
        let times = [&vec![1.0; count][..], &[0.25]].concat();
        let config = FuseConfig { estimate_exposures: true, ..FuseConfig::default() };
        let fused = fuse(Bracket::new(pictures, &times).unwrap(), &config).unwrap();
        (fused.times[1] / 0.25 - 1.0).abs()
    };
    let (one, eight) = (error(1), error(8));
    assert!(eight <= one && eight < 0.01, "{eight} with eight files, {one} with one");
}

/// A negative whose photosites sit at their level reads just below zero once 32 bits have rounded it, and half a step below where
/// the level is a mean.
#[test]
fn a_night_at_its_black_level_is_no_wrong_black_level() {
    let night = |offset: f64| {
        let config = FuseConfig {
            black: (512.0 + offset) / 65535.0,
            white: 16383.0 / 65535.0,
            ..FuseConfig::default()
        };
        let picture = Array3::from_elem((3, 20, 24), (512.0 / 65535.0) as f32);
        fuse(Bracket::single(picture).unwrap(), &config).map(|fused| fused.image)
    };
    for offset in [0.0, 1e-4, 0.25, 0.5] {
        assert!(night(offset).unwrap().planes().iter().all(|v| v.abs() < 1e-4), "{offset}");
    }
    assert!(night(1.0).unwrap_err().to_string().starts_with("black: lies above 100 %"));
}

/// 1/60 s and 0.0167 s are one setting of a shutter.
#[test]
fn times_that_files_round_are_one_time() {
    let pictures = [0.4, 0.5, 0.1].map(|v| Array3::from_elem((3, 4, 4), v));
    let times = [1.0 / 60.0, 0.0167, 1.0 / 240.0];
    let fused = fuse(Bracket::new(pictures.to_vec(), &times).unwrap(), &FuseConfig::default()).unwrap();
    assert_eq!(fused.averaged, [2, 1]);
    assert!((fused.image.planes()[[0, 0, 0]] - 0.45).abs() < 1e-6);
    // A third of a stop is another time.
    let times = [1.0 / 60.0, 1.0 / 80.0, 1.0 / 240.0];
    assert_eq!(Bracket::new(pictures.to_vec(), &times).unwrap().times().len(), 3);
}

#[test]
fn times_further_apart_than_any_bracket_are_refused() {
    let picture = || Array3::from_elem((3, 4, 4), 0.5);
    for times in [&[1e308, 1.0, 1e-308][..], &[1.0, 1e-30]] {
        let said = Bracket::new(vec![picture(); times.len()], times).unwrap_err().to_string();
        assert!(said.starts_with("exposures") && said.contains("further apart"), "{said}");
    }
    assert!(Bracket::new(vec![picture(); 2], &[1.0, 1e-9]).is_ok());
}

#[test]
fn pictures_of_one_time_that_are_not_as_bright_are_told() {
    let pictures = [0.6, 0.6, 0.3, 0.15].map(|v| Array3::from_elem((3, 20, 20), v));
    let fused =
        fuse(Bracket::new(pictures.to_vec(), &[1.0, 1.0, 1.0, 0.25]).unwrap(), &FuseConfig::default())
            .unwrap();
    assert_eq!(fused.uneven.len(), 1);
    assert_eq!(fused.uneven[0].pictures, [1, 3]);
    assert!((fused.uneven[0].ratio.unwrap() - 0.5).abs() < 1e-6);
}

/// As many as a bracket may have.
#[test]
fn the_last_of_256_exposures_is_counted() {
    let values = || std::iter::repeat_n(1.0, 256);
    let times = [1.0; 256];
    assert_eq!(longest(values(), &times, 0.99), (1.0, 255));
    assert_eq!(weighted(values().zip(&[1; 256]), &times, 0.99), (1.0, 255));
}
