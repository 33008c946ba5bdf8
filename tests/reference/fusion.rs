//! Reference vectors: fusion. A scene of high dynamic range, recorded in 14 bits with the paper's exposures.

use std::path::PathBuf;

use udc::capture::{Bracket, FuseConfig, fuse};
use udc::io::read_pixels;

const EXPOSURES: [f64; 3] = [1.0, 1.0 / 32.0, 1.0 / 768.0];

fn fixture(name: &str) -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures/fusion").join(name)
}

/// Half a step of 14 bits of the exposure that was used, over its time.
#[test]
fn is_within_the_rounding_of_the_exposure_used() {
    let pictures =
        (0..3).map(|k| read_pixels(&fixture(&format!("exposure_{k}.npy"))).unwrap().planes).collect();
    let truth = read_pixels(&fixture("truth.npy")).unwrap().planes;
    let fused = fuse(Bracket::new(pictures, &EXPOSURES).unwrap(), &FuseConfig::default()).unwrap();
    let mut used = [0; 3];
    for ((place, &expected), &source) in truth.indexed_iter().zip(&fused.source) {
        let time = EXPOSURES[usize::from(source)];
        used[usize::from(source)] += 1;
        let found = f64::from(fused.image.planes()[place]);
        // Values of some hundreds are stored in 32 bit: 2⁻²⁴ of them.
        let bound = 0.5 / 16383.0 / time + 1e-6 + found * f64::from(f32::EPSILON);
        let miss = (found - f64::from(expected)).abs();
        assert!(miss <= bound, "{place:?} from exposure {time}: {found} instead of {expected}");
    }
    assert!(used.iter().all(|&count| count > 0), "the case exercises every exposure: {used:?}");
    assert_eq!(fused.saturated.iter().sum::<usize>(), 0);
}
