//! The table of restorations on panels that nothing was trained for: `cargo bench --bench panels -- PANORAMA… -o DIR`.
//!
//! For each of three random panels, whose seeds no training used, views of the panoramas are degraded without noise and by a
//! 10-bit sensor at two levels of light, and restored: by Wiener's filter, by deconvolution, by the guided network as it
//! comes, by the guided network adapted to the panel, and by DISCNet trained on the panel with half of the panoramas; an
//! oracle beside them says what is left. These captures are of the unrotated panel; those of the brighter sensor are also made
//! through the panel at nine angles (-12° to 12°), and restored by what needs no training. A PSF with the errors of a measurement is tried
//! beside the true one. Everything is a command of `udc`, printed before it runs;
//! what is there is not made again, so that a run can be stopped and gone on with.
//!
//! `--panels N` takes more or fewer panels, `--steps N` changes the steps that DISCNet is trained for (2600, of 8 crops of
//! 96²), `--lpips ALEXNET LINEAR` measures LPIPS too.

#![expect(clippy::print_stdout, reason = "a benchmark prints its result")]

use std::path::{Path, PathBuf};
use std::process::Command;

/// The first panel's seed; those of training are drawn from another stream.
const FIRST_SEED: u64 = 900_001;

/// Noise of the datasets: none, a bright and a dim exposure of the sensor, as electrons at white.
const NOISES: [(&str, Option<u32>); 3] = [("clean", None), ("bright", Some(6000)), ("dim", Some(375))];

/// What is wrong with a measured PSF.
const ERRORS: [&str; 6] = ["--turn", "0.3", "--scale", "0.005", "--noise", "1e-5"];

struct Table {
    root: PathBuf,
    panoramas: Vec<String>,
    panels: u64,
    steps: u64,
    lpips: Option<[String; 2]>,
}

fn main() {
    let table = Table::of_arguments(std::env::args().skip(1));
    if table.panoramas.len() < 4 {
        // `cargo bench` without a name starts every benchmark.
        println!("panels: names no panoramas, at least four; see the head of benches/panels.rs");
        return;
    }
    std::fs::create_dir_all(&table.root).expect("the folder can be made");
    let (training, testing) = table.panoramas.split_at(table.panoramas.len() / 2);
    for (name, panoramas) in [("train-views", training), ("test-views", testing)] {
        let crop = ["--size", "384", "--fov", "90", "--views", "2"];
        table.make(
            name,
            &[&["crop"], &panoramas.iter().map(String::as_str).collect::<Vec<_>>()[..], &crop].concat(),
        );
    }
    (0..table.panels).for_each(|panel| table.measure(panel));
}

impl Table {
    fn of_arguments(mut arguments: impl Iterator<Item = String>) -> Self {
        let mut table =
            Self { root: "panels".into(), panoramas: Vec::new(), panels: 3, steps: 2600, lpips: None };
        while let Some(argument) = arguments.next() {
            let mut value = || arguments.next().unwrap_or_else(|| panic!("{argument} wants a value"));
            match argument.as_str() {
                "-o" => table.root = value().into(),
                "--panels" => table.panels = value().parse().expect("a number of panels"),
                "--steps" => table.steps = value().parse().expect("a number of steps"),
                "--lpips" => table.lpips = Some([value(), value()]),
                // Cargo's own.
                "--bench" => {}
                _ => table.panoramas.push(argument),
            }
        }
        table
    }

    fn path(&self, name: &str) -> String {
        self.root.join(name).to_string_lossy().into_owned()
    }

    /// Makes a file or a folder by a command, unless it is there.
    fn make(&self, name: &str, arguments: &[&str]) {
        let path = self.path(name);
        if Path::new(&path).exists() {
            return;
        }
        let unfinished = self.path(&format!("unfinished-{}", name.replace('/', "-")));
        run(&[arguments, &["-o", &unfinished, "--overwrite"]].concat());
        std::fs::rename(&unfinished, &path).expect("what was made can be renamed");
    }

    fn measure(&self, panel: u64) {
        let name = |what: &str| format!("{panel}-{what}");
        let seed = (FIRST_SEED + panel).to_string();
        let psf = self.path(&name("psf.exr"));
        self.make(&name("psf.exr"), &["psf", "--random", &seed]);
        let measured = self.path(&name("measured.exr"));
        self.make(&name("measured.exr"), &[&["psf", "--from", &psf, "--seed", &seed][..], &ERRORS].concat());
        let unrotated = ["--psf", &psf];
        for (noise, electrons) in NOISES {
            self.synthesise(&name(noise), ("test", &seed), unrotated, electrons);
        }
        self.synthesise(&name("train"), ("train", &seed), unrotated, NOISES[1].1);
        let (bank, rotated) = (self.path(&name("bank.safetensors")), name("rotated"));
        self.make(&name("bank.safetensors"), &["codes", &psf]);
        self.synthesise(&rotated, ("test", &seed), ["--bank", &bank], NOISES[1].1);
        let steps = [format!("iterations={}", self.steps), format!("schedule.period={}", self.steps)];
        let train = self.path(&name("train"));
        let discnet =
            ["train", "configs/discnet.toml", "--data", &train, "--set", "architecture.condition=image"];
        let smaller = ["--set", "data.crop=96", "--set", "data.batch=8", "--set", "data.accumulate=1"];
        self.make(
            &name("discnet"),
            &[&discnet[..], &smaller, &["--set", &steps[0], "--set", &steps[1]]].concat(),
        );
        self.make(&name("adapted"), &["train", "--psf", &psf]);
        let models =
            [self.path(&name("discnet/model.safetensors")), self.path(&name("adapted/best.safetensors"))];
        let datasets = NOISES.map(|(noise, _)| self.path(&name(noise)));
        let [clean, bright, dim] = &datasets;
        let mut how = vec!["--model", &models[0], &models[1], "--regions"];
        how.extend(["--method", "wiener,constrained,joint,guided,oracle"]);
        if let Some([alexnet, linear]) = &self.lpips {
            how.extend([
                "--metrics",
                "psnr,ssim,lpips",
                "--lpips-alexnet",
                alexnet,
                "--lpips-linear",
                linear,
            ]);
        }
        self.make(&name("results"), &[&["eval", "--data", bright][..], &how].concat());
        self.make(&name("other-noise"), &[&["eval", "--data", clean, dim][..], &how].concat());
        let untrained = ["--method", "wiener,constrained,guided"];
        self.make(
            &name("rotated-results"),
            &[&["eval", "--data", &self.path(&rotated)][..], &untrained].concat(),
        );
        // Told a PSF with errors, a restoration looks for the pose in each capture.
        let captures = format!("{bright}/degraded/r+00/*");
        self.make(
            &name("restored"),
            &["restore", &captures, "--psf", &measured, "--border", "zero", "--x-max", "16"],
        );
        self.make(
            &name("measured-results"),
            &[
                "eval",
                "--restored",
                &self.path(&name("restored")),
                "--gt",
                &format!("{bright}/gt"),
                "--x-max",
                "16",
            ],
        );
        for results in ["results", "other-noise", "rotated-results", "measured-results"] {
            println!("panel {panel}: {}", self.path(&name(&format!("{results}/table.md"))));
        }
    }

    fn synthesise(&self, name: &str, (split, seed): (&str, &str), panel: [&str; 2], electrons: Option<u32>) {
        let views = self.path(&format!("{split}-views"));
        let mut synth = vec!["synth", &views, "--split", split, "--x-max", "16", "--seed", seed];
        synth.extend(panel);
        let noise = electrons.map(|electrons| format!("sensor:{}", self.sensor(electrons)));
        synth.extend(noise.iter().flat_map(|noise| ["--noise", noise]));
        self.make(name, &synth);
    }

    /// The 10-bit sensor with fewer electrons at white.
    fn sensor(&self, electrons: u32) -> String {
        let path = self.path(&format!("sensor-{electrons}.toml"));
        let text = include_str!("../configs/sensor/phone-10bit.toml");
        let text = text.replace("full-well-e = 6000.0", &format!("full-well-e = {electrons}.0"));
        std::fs::write(&path, text).expect("the folder can be written to");
        path
    }
}

/// Prints a command of the program and runs it.
fn run(arguments: &[&str]) {
    println!("$ udc {}", arguments.join(" "));
    let status =
        Command::new(env!("CARGO_BIN_EXE_udc")).args(arguments).status().expect("the program starts");
    assert!(status.success(), "the command failed");
}
