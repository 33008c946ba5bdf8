use ndarray::{Array3, s};

use super::*;

/// What every colour sees at one place may have any number of pixels; what is seen at several has to explain much.
#[test]
fn colours_that_see_one_place_see_a_lamp() {
    let plane = |value| Array3::from_elem((CHANNELS, 60, 60), value);
    let image = LinearImage::from_planes(plane(0.2)).unwrap();
    let psf = Psf::from_energy(Array3::from_elem((CHANNELS, 31, 31), 1.0)).unwrap();
    let view = View::new(&image, &psf, [16.0; CHANNELS]);
    let suspect = |columns: usize, x: usize, left: f64| {
        let mut light = view.frame.plane();
        light.slice_mut(s![20..30, 60..60 + columns]).fill(1.0);
        let mut flare = light.clone();
        flare[[22, 60 + x]] = 2.0;
        Suspect { light, flare, left }
    };
    let of = |columns: usize, places: [usize; 3], left: f64| {
        view.may_be_lamp(&places.map(|x| suspect(columns, x, left)))
    };
    assert!(of(14, [3, 4, 5], 0.8) && of(5, [3, 4, 5], 0.8));
    assert!(!of(14, [3, 4, 6], 0.6), "many pixels");
    assert!(!of(5, [3, 4, 6], 0.7) && of(5, [3, 4, 6], 0.6), "few pixels, of several lamps");
}

/// Light that explains a capture at a low resolution has to explain it at a finer one, too: a lamp's does, other light does not.
#[test]
fn light_leaves_little_where_the_lamp_is() {
    let dots = |(_, y, x): (usize, usize, usize)| match (y * 7 + x * 11) % 61 {
        _ if (y, x) == (30, 30) => 1.0,
        0 => 0.004,
        _ => 0.0,
    };
    let psf = Psf::from_energy(Array3::from_shape_fn((CHANNELS, 61, 61), dots)).unwrap();
    let dark = LinearImage::from_planes(Array3::zeros((CHANNELS, 64, 64))).unwrap();
    let view = View::new(&dark, &psf, [16.0; CHANNELS]);
    let light_at = |x: usize| {
        let mut light = view.frame.plane();
        light[[31, 64 + x]] = 300.0;
        vec![light; CHANNELS]
    };
    let detail = |(c, y, x): (usize, usize, usize)| 0.2 + 0.01 * ((c + y * 5 + x * 3) % 7) as f32;
    let mut seen = Array3::from_shape_fn((CHANNELS, 64, 64), detail);
    for (mut seen, flare) in seen.outer_iter_mut().zip(view.flare(&light_at(4)).unwrap()) {
        seen += &flare;
    }
    let seen = LinearImage::from_planes(seen).unwrap();
    let view = View::new(&seen, &psf, [16.0; CHANNELS]);
    let left_by = |x| view.improve(light_at(x), (0.25, &ALL), &Progress::default()).unwrap().1;
    assert!(left_by(4) < 0.6, "{}", left_by(4));
    assert!(left_by(14) > EXPLAINED_AGAIN, "{}", left_by(14));
}
