//! Of lamps outside of the frame, of which not all colours see the same.

use super::*;

/// A sun, and red lights around it that have more pixels than any sun.
#[test]
fn finds_a_sun_beyond_the_border_that_two_colours_see_alone() {
    const CUT: usize = 16;
    let whole = |light: f32| {
        let at = move |c: usize, y: usize, x: usize| match (y % 24, y, x) {
            (_, 40..44, 8..12) => 750.0 * light + 0.3,
            (2..11, _, 2..12) if c == 0 => 300.0 * light + 0.3,
            _ => 0.2 + 0.05 * ((y as f32 / 9.0).sin() + (x as f32 / (7.0 + c as f32)).cos()),
        };
        image(at, [SIZE, SIZE])
    };
    let [seen, alone] =
        [1.0, 0.0].map(|light| capture(&whole(light), 0.005, 16.0).crop(0, CUT, SIZE, SIZE - CUT));
    let config = config(Method::Joint, Border::Smooth, 16.0);
    let found = without_lamps_outside(&seen, &psf(), &config, &Progress::default()).unwrap().unwrap();
    let [y, x] = found.lamps[0].position;
    assert!((y - 41.5).abs() < 1.0 && (x + 6.5).abs() < 1.0, "{:?}", found.lamps);
    let error = |image: &LinearImage| (&image.channel(1) - &alone.channel(1)).mapv(|e| e * e).mean().unwrap();
    let [before, after] = [&seen, &found.image].map(error);
    assert!(after < 0.2 * before, "{before}, then {after}");
}
