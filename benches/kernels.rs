//! Times each kernel on the network's shapes: `cargo bench --bench kernels [-- NAME]`.
#![expect(clippy::print_stdout, reason = "a benchmark's output is its table")]

use std::time::Duration;

use udc::kernels::{Isa, benchmark, peak};

fn main() {
    let wanted = std::env::args().skip(1).find(|argument| !argument.starts_with('-')).unwrap_or_default();
    let threads = rayon::current_num_threads();
    let peak = peak::measure(Isa::current()) * threads as f64;
    println!("{}, {threads} threads, peak {:.0} GFLOP/s", Isa::current().name(), peak / 1e9);
    benchmark::run(&wanted, Duration::from_millis(300), &|| false, |timing| {
        let speed = timing.operations / timing.seconds;
        println!(
            "{:44} {:9.2} ms {:7.0} GFLOP/s {:5.0} % of peak",
            timing.name,
            timing.seconds * 1e3,
            speed / 1e9,
            speed / peak * 100.0
        );
    });
}
