//! Of several lamps outside of the frame.

use super::*;

const CUT: usize = 16;

/// Five lamps, whose light together has more pixels than that of a sun: what tells them is that it explains most of the capture.
#[test]
fn finds_several_lamps_beyond_the_border() {
    let whole = |lamp: f32| {
        let light = move |c: usize, y: usize, x: usize| match (y % 18, x) {
            (8..13, 6..11) => lamp * (1.0 + 0.1 * c as f32),
            _ => 0.2 + 0.05 * ((y as f32 / 9.0).sin() + (x as f32 / (7.0 + c as f32)).cos()),
        };
        image(light, [SIZE, SIZE])
    };
    let [seen, alone] =
        [500.0, 0.3].map(|lamp| capture(&whole(lamp), 0.005, 16.0).crop(0, CUT, SIZE, SIZE - CUT));
    let config = config(Method::Joint, Border::Smooth, 16.0);
    let found = without_lamps_outside(&seen, &psf(), &config, &Progress::default()).unwrap().unwrap();
    let pixels: Vec<_> = found.lamps.iter().map(|lamp| lamp.pixels).collect();
    let [before, after] = [&seen, &found.image].map(|image| psnr(image, &alone, 16.0));
    assert!(after > before + 6.0, "{before} dB, then {after} dB; {pixels:?}");
}
