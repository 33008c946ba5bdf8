//! Times the convolution of one 800 × 800 scene with nine PSFs of 800 × 800: `cargo bench --bench synth`.
//!
//! Twice: a scene of moderate range, which 32-bit transforms serve, and one with a highlight, which needs 64 bits.
//! Computation only: plans and OTFs are made beforehand, as they are for a whole dataset, and outputs exist.
//! `RAYON_NUM_THREADS` sets the number of threads. `compare_synth.py` runs this beside other pipelines.

#![expect(clippy::print_stdout, reason = "a benchmark prints its result")]

use std::time::{Duration, Instant};

use ndarray::{Array3, s};
use rand::Rng as _;
use udc::core::fft::{Boundary, Convolver, Otf};
use udc::core::image::LinearImage;
use udc::core::psf::Psf;
use udc::core::rng::stream;

const SIDE: usize = 800;
const KERNELS: usize = 9;

fn random(label: &str) -> Array3<f32> {
    let mut rng = stream(0, label);
    Array3::from_shape_simple_fn((3, SIDE, SIDE), || rng.next_u32() as f32 / u32::MAX as f32)
}

fn main() {
    let runs = std::env::args().find_map(|arg| arg.parse().ok()).unwrap_or(20);
    let mut planes = random("scene");
    let convolver =
        Convolver::new([SIDE, SIDE], [SIDE, SIDE], Boundary::Zero).expect("the sizes are positive");
    let otfs: Vec<_> = (0..KERNELS)
        .map(|kernel| Psf::from_energy(random(&format!("psf {kernel}"))).expect("the PSF has light"))
        .map(|psf| convolver.otf(&psf).expect("the PSF has the convolver's size"))
        .collect();
    measure("moderate range", &planes, &convolver, &otfs, runs);
    planes.slice_mut(s![.., SIDE / 2, SIDE / 3]).fill(500.0);
    measure("with a highlight", &planes, &convolver, &otfs, runs);
}

fn measure(what: &str, planes: &Array3<f32>, convolver: &Convolver, otfs: &[Otf], runs: usize) {
    let scene = LinearImage::from_planes(planes.clone()).expect("the scene is finite");
    let mut outs = vec![vec![0.0; 3 * SIDE * SIDE]; KERNELS];
    let (mut best, mut best_forward) = (Duration::MAX, Duration::MAX);
    for _ in 0..runs {
        let started = Instant::now();
        let spectrum = convolver.spectrum(&scene).expect("the scene has the convolver's size");
        best_forward = best_forward.min(started.elapsed());
        for (otf, out) in otfs.iter().zip(&mut outs) {
            convolver.convolve_into(&spectrum, otf, out);
        }
        convolver.reuse(spectrum);
        best = best.min(started.elapsed());
    }
    println!(
        "udc, {what}: {:.1} ms for {KERNELS} kernels ({:.1} ms of it for the scene's transform), {} threads, best of {runs}{}",
        best.as_secs_f64() * 1e3,
        best_forward.as_secs_f64() * 1e3,
        rayon::current_num_threads(),
        peak_memory()
    );
}

fn peak_memory() -> String {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"));
    line.map_or(String::new(), |size| format!(", peak memory {}", size.trim()))
}
