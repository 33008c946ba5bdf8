//! Dark frames: what they take away, and those that do not fit.

use super::*;

/// A sensor with a pattern of its own in the dark, and pixels that shine, by the exposure's time.
fn dark(time: f64) -> Array3<f32> {
    let mut dark = Array3::from_shape_fn((3, 40, 40), |(c, y, x)| {
        (time * (0.01 + 0.002 * ((c + 3 * y + 5 * x) % 7) as f64 / 7.0)) as f32
    });
    for (place, shine) in [([0, 7, 9], 0.3), ([2, 20, 21], 0.6), ([1, 39, 0], 5.0)] {
        dark[place] += (shine * time) as f32;
    }
    dark
}

fn with_dark(scene: &Array3<f32>, time: f64) -> Array3<f32> {
    (scene.mapv(|v| v * time as f32) + dark(time)).mapv(|v| v.min(1.0))
}

/// The pixel at 20, 21 shines in the longest exposures; the lamp there is taken of the shortest, where the pixel does not
/// stand out, and stays.
#[test]
fn dark_frames_are_subtracted_and_hot_pixels_filled() {
    let scene = Array3::from_shape_fn((3, 40, 40), |(_, y, x)| {
        let squared = (y as f32 - 20.0).powi(2) + (x as f32 - 21.0).powi(2);
        0.1 + 300.0 * (-squared / 8.0).exp()
    });
    let pictures = || TIMES.map(|time| with_dark(&scene, time)).to_vec();
    let bracket = Bracket::new(pictures(), &TIMES).unwrap();
    let bracket = bracket.with_darks(TIMES.map(dark).to_vec(), Some(&TIMES)).unwrap();
    let fused = fuse(bracket, &FuseConfig::default()).unwrap();
    assert_eq!(fused.hot_pixels, Some(3));
    for (place, (found, expected)) in fused.image.planes().iter().zip(&scene).enumerate() {
        // 2⁻²⁴ of white, over the shortest time.
        assert!((found - expected).abs() < 1e-4 + 1e-4 * expected, "{place}: {found} instead of {expected}");
    }
    let without = fuse(Bracket::new(pictures(), &TIMES).unwrap(), &FuseConfig::default()).unwrap();
    assert!(without.image.planes()[[0, 7, 9]] > 0.4 && without.hot_pixels.is_none());
}

/// Whatever is black to the pictures is black to their dark frames.
#[test]
fn dark_frames_of_mosaics_are_levelled_like_pictures() {
    let pattern = BayerPattern::Rggb;
    let colour = [0.2, 0.5, 0.35];
    let raw = |light: f32, (y, x): (usize, usize)| {
        let hot = if (y, x) == (12, 13) { 400.0 } else { 0.0 };
        (64.0 + 959.0 * light + hot + ((y * 5 + x * 3) % 4) as f32).min(1023.0)
    };
    let picture = Array3::from_shape_fn((1, 40, 44), |(_, y, x)| raw(colour[pattern.channel(y, x)], (y, x)));
    let darks = vec![Array3::from_shape_fn((1, 40, 44), |(_, y, x)| raw(0.0, (y, x))); 2];
    let config = FuseConfig { white: 1023.0, black: 64.0, bayer: Some(pattern), ..FuseConfig::default() };
    let bracket = Bracket::single(picture).unwrap().with_darks(darks, None).unwrap();
    let fused = fuse(bracket, &config).unwrap();
    assert_eq!(fused.hot_pixels, Some(1));
    for ((c, y, x), value) in fused.image.planes().indexed_iter() {
        assert!((value - colour[c]).abs() < 1e-4, "{value} at {y}, {x} of channel {c}");
    }
}

/// Values that are full with their darkness are no light that was measured.
#[test]
fn what_is_saturated_stays_so_when_the_dark_is_subtracted() {
    let dark = Array3::from_elem((3, 8, 8), 0.1);
    let scene = Array3::from_elem((3, 8, 8), 2.0);
    let times = [1.0, 0.25];
    let pictures = times.map(|time: f32| scene.mapv(|v| (v * time + 0.1).min(1.0)));
    let bracket =
        Bracket::new(pictures.to_vec(), &[1.0, 0.25]).unwrap().with_darks(vec![dark], None).unwrap();
    let fused = fuse(bracket, &FuseConfig::default()).unwrap();
    assert!(fused.image.planes().iter().all(|v| (v - 2.0).abs() < 1e-5));
}

#[test]
fn dark_frames_that_do_not_fit_say_what_to_do() {
    let scene = Array3::from_elem((3, 40, 40), 0.3);
    let refusal = |darks: Vec<Array3<f32>>, times: Option<&[f64]>| {
        let bracket = bracket(&scene).with_darks(darks, times);
        bracket.and_then(|bracket| fuse(bracket, &FuseConfig::default())).unwrap_err().to_string()
    };
    let said = refusal(vec![dark(1.0)], Some(&[1.0]));
    assert!(said.contains("exposure time 1/32") && said.contains("each exposure time"), "{said}");
    let said = refusal(vec![Array3::zeros((3, 40, 41))], None);
    assert!(said.contains("dark frame 1") && said.contains("40 × 41"), "{said}");
    for light in [1.0, 0.5] {
        let said = refusal(vec![dark(1.0), Array3::from_elem((3, 40, 40), light)], None);
        assert!(said.contains("dark frame 2 has seen light") && said.contains("cap"), "{said}");
    }
    let said = refusal(vec![Array3::from_elem((3, 40, 40), 0.2)], None);
    assert!(said.contains("brighter than most of picture 2"), "{said}");
    let said = refusal(vec![dark(1.0)], Some(&[1.0, 0.5]));
    assert!(said.contains("dark frames: expected 2"), "{said}");
    let said = refusal(vec![Array3::from_elem((3, 40, 40), f32::NAN)], None);
    assert!(said.contains("dark frame 1 holds NaN"), "{said}");
    assert!(bracket(&scene).with_darks(Vec::new(), None).is_err());
}

#[test]
fn a_dark_frame_without_hot_pixels_is_fine() {
    let mut noise = noise("dark", 0.002);
    let darks = (0..3).map(|_| Array3::from_shape_simple_fn((3, 40, 40), &mut noise)).collect();
    let scene = Array3::from_elem((3, 40, 40), 0.3);
    let fused = fuse(bracket(&scene).with_darks(darks, None).unwrap(), &FuseConfig::default()).unwrap();
    assert_eq!(fused.hot_pixels, Some(0));
}

/// Twenty pixels of one colour shine in the picture of a point source.
#[test]
fn hot_pixels_of_a_point_source_without_dark_frames_are_told() {
    let source = Array3::from_shape_fn((3, 128, 128), |(_, y, x)| {
        let squared = (y as f32 - 64.0).powi(2) + (x as f32 - 64.0).powi(2);
        600.0 * (-squared / 2.0).exp() + 1e-3
    });
    let dark = |time: f64| {
        let mut dark = Array3::zeros(source.dim());
        (0..20).for_each(|k| dark[[k % 3, 3 * k + 1, 7 * k % 64]] = (0.2 * time) as f32);
        dark
    };
    let pictures = TIMES.map(|time| (source.mapv(|v| v * time as f32) + dark(time)).mapv(|v| v.min(1.0)));
    let config = FuseConfig { demosaic_linear: true, ..FuseConfig::default() };
    let told = |bracket: Bracket, config: &FuseConfig| {
        let said = fuse(bracket, config).unwrap().warnings();
        said.into_iter().find(|said| said.contains("hot pixels"))
    };
    let bracket = || Bracket::new(pictures.to_vec(), &TIMES).unwrap();
    let said = told(bracket(), &config).unwrap();
    assert!(said.starts_with("20 of its values stand alone") && said.contains("--dark"), "{said}");
    assert_eq!(told(bracket(), &FuseConfig::default()), None, "a scene has lone lights");
    let with_darks = bracket().with_darks(TIMES.map(dark).to_vec(), Some(&TIMES)).unwrap();
    assert_eq!(told(with_darks, &config), None);
}
