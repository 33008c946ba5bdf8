//! Times each kernel on the network's shapes: `cargo bench --bench kernels [-- name]`.
#![expect(clippy::print_stdout, reason = "a benchmark's output is its table")]

use std::time::Instant;

use udc::kernels::{Convolution, Finish, Geometry, Isa, Shape, peak};

fn main() {
    let wanted = std::env::args().skip(1).find(|a| !a.starts_with('-')).unwrap_or_default();
    let peak = peak::measure(Isa::current()) / 1e9 * rayon::current_num_threads() as f64;
    println!("{} · {} threads · peak {peak:.0} GFLOP/s", Isa::current().name(), rayon::current_num_threads());
    let table = Table { wanted, peak };
    for (channels, side) in [(32, 800), (64, 400), (128, 200), (32, 128), (128, 32)] {
        three_by_three(&table, "conv 3x3", Geometry::three_by_three(channels, channels), side);
    }
    three_by_three(&table, "first conv", Geometry::three_by_three(3, 32), 800);
    three_by_three(&table, "first conv", Geometry::three_by_three(8, 32), 800);
    three_by_three(&table, "last conv", Geometry::three_by_three(32, 3), 800);
    for (inputs, side) in [(32, 800), (64, 400)] {
        let geometry = Geometry { inputs, outputs: 2 * inputs, side: 3, stride: 2 };
        three_by_three(&table, "stride 2", geometry, side);
    }
}

struct Table {
    wanted: String,
    peak: f64,
}

impl Table {
    /// Times the best of several calls and prints a line.
    fn row(&self, name: &str, operations: f64, mut call: impl FnMut()) {
        if !name.contains(&self.wanted) {
            return;
        }
        call();
        let (mut best, mut best_cpu) = (f64::INFINITY, f64::INFINITY);
        let begun = Instant::now();
        while begun.elapsed().as_secs_f64() < 0.3 {
            let (start, cpu) = (Instant::now(), cpu_seconds());
            call();
            best = best.min(start.elapsed().as_secs_f64());
            best_cpu = best_cpu.min(cpu_seconds() - cpu);
        }
        let speed = operations / best / 1e9;
        let share = speed / self.peak * 100.0;
        println!(
            "{name:36} {:8.2} ms {speed:7.0} GFLOP/s {share:5.0} %   cpu {:8.2} ms",
            best * 1e3,
            best_cpu * 1e3
        );
    }
}

/// CPU time of all threads so far, where the system tells: what a busy machine does not disturb.
fn cpu_seconds() -> f64 {
    let Ok(tasks) = std::fs::read_dir("/proc/self/task") else { return f64::NAN };
    let of_task = |task: std::io::Result<std::fs::DirEntry>| -> Option<f64> {
        let text = std::fs::read_to_string(task.ok()?.path().join("schedstat")).ok()?;
        text.split(' ').next()?.parse::<f64>().ok()
    };
    tasks.filter_map(of_task).sum::<f64>() / 1e9
}

fn values(len: usize) -> Vec<f32> {
    (0..len).map(|i| ((i * 2_654_435_761) % 1000) as f32 / 1000.0 - 0.5).collect()
}

fn three_by_three(table: &Table, name: &str, geometry: Geometry, side: usize) {
    let shape = Shape::new(1, side, side, geometry.inputs);
    let convolution = Convolution::new(geometry, &values(geometry.weight_len()), &values(geometry.outputs));
    let input = values(shape.len());
    let out = convolution.output_shape(shape);
    let mut output = vec![0.0; out.len()];
    let name = format!("{name} {}->{} @{side}", geometry.inputs, geometry.outputs);
    table.row(&name, (2 * geometry.weight_len() * out.pixels()) as f64, || {
        convolution.forward(&input, shape, Finish::Leak(0.2), &mut output);
    });
}
