//! `udc eval` on datasets: deconvolutions, regions, wrong kernels, scenes of a monitor's range.

use std::fs;
use std::path::Path;

use ndarray::Array3;
use serde_json::Value;
use udc::core::image::LinearImage;
use udc::core::psf::Psf;
use udc::io::{self, WriteOptions};
use udc::network::weights::{self, Weights};
use udc::network::{Architecture, Initialisation, Origin, Parameters};

use super::common::{fail, succeed, udc};

const HEIGHT: usize = 40;
const WIDTH: usize = 48;

/// A PSF with a long horizontal tail: turning it matters.
fn psf() -> Psf {
    let energy = |(_, y, x): (usize, usize, usize)| match (y as i32 - 10, x as i32 - 10) {
        (0, 0) => 1.0,
        (0, _) => 0.06,
        _ => 0.0,
    };
    Psf::from_energy(Array3::from_shape_fn((3, 21, 21), energy)).unwrap()
}

/// A lamp of 800, which saturates, before a faint texture around 0.3.
fn scene(phase: f32) -> LinearImage {
    let value = |(c, y, x): (usize, usize, usize)| {
        let lamp = (18..21).contains(&y) && (20..23).contains(&x);
        if lamp {
            800.0
        } else {
            0.3 + 0.05 * ((x as f32 * 0.9 + phase).sin() * (y as f32 * 0.7 + c as f32).cos())
        }
    };
    LinearImage::from_planes(Array3::from_shape_fn((3, HEIGHT, WIDTH), value)).unwrap()
}

/// A folder with a dataset of one training and one test scene seen through three rotations, and a network.
fn scratch() -> tempfile::TempDir {
    let scratch = tempfile::tempdir().unwrap();
    let folder = scratch.path();
    io::write_psf(&folder.join("psf.exr"), &psf(), &WriteOptions::default()).unwrap();
    fs::create_dir(folder.join("scenes")).unwrap();
    for (name, phase) in [("a_00", 0.0), ("b_00", 1.0)] {
        let path = folder.join(format!("scenes/{name}.exr"));
        io::write_image(&path, &scene(phase), &WriteOptions::default()).unwrap();
    }
    succeed(folder, &["codes", "psf.exr", "--angles=-40:40:40", "--dim", "2", "-o", "bank.safetensors"]);
    let synth = ["synth", "scenes", "--bank", "bank.safetensors", "-o", "dataset", "--test-fraction", "0.5"];
    succeed(folder, &synth);
    let architecture = Architecture { features: 2, filter_size: 3, code_dim: 2, ..Architecture::default() };
    let parameters = Parameters::random(&architecture, Initialisation::Released, 7);
    let network = Weights { architecture, parameters, origin: Origin::default() };
    weights::write(&folder.join("net.safetensors"), &network, false).unwrap();
    scratch
}

fn json(folder: &Path, name: &str) -> Value {
    serde_json::from_str(&fs::read_to_string(folder.join(name)).unwrap()).unwrap()
}

fn svg(folder: &Path, name: &str) -> String {
    let svg = fs::read_to_string(folder.join(name)).unwrap();
    assert!(svg.starts_with("<svg") && svg.trim_end().ends_with("</svg>"), "{name}");
    svg
}

#[test]
fn what_is_named_twice_is_refused() {
    let scratch = scratch();
    let folder = scratch.path();
    let wiener = ["--method", "wiener", "-o", "results"];
    for twice in [
        &[&["eval", "dataset", "dataset"], &wiener[..]].concat()[..],
        &[&["eval", "dataset", "./dataset/../dataset"], &wiener[..]].concat(),
        &[&["eval", "dataset", "--method", "wiener"], &wiener[..]].concat(),
        &[&["eval", "dataset", "--model", "net.safetensors", "net.safetensors"], &wiener[..]].concat(),
        &[&["eval", "dataset", "--model", "net.safetensors", "./net.safetensors"], &wiener[..]].concat(),
    ] {
        let said = fail(folder, twice, 1);
        assert!(said.contains("twice"), "{twice:?}: {said}");
        assert!(!folder.join("results").exists());
    }
}

#[test]
fn compares_networks_and_deconvolutions_under_every_rotation() {
    let scratch = scratch();
    let folder = scratch.path();
    let methods = ["--method", "richardson-lucy", "--method", "wiener,oracle"];
    let eval =
        [&["eval", "dataset", "--model", "net.safetensors"], &methods[..], &["-o", "results"]].concat();
    let said = succeed(folder, &eval);
    let results = json(folder, "results/metrics.json");
    let all = results["methods"].as_array().unwrap();
    let names: Vec<_> = all.iter().map(|method| method["name"].as_str().unwrap()).collect();
    assert_eq!(names, ["degraded", "net.safetensors", "richardson-lucy", "wiener", "oracle"]);
    let psnr = |method: usize| all[method]["kernels"]["r+00"]["psnr"].as_f64().unwrap();
    assert!((0..4).all(|method| psnr(4) > psnr(method)), "an oracle is told the scene: {}", psnr(4));
    let architecture = Architecture { features: 2, filter_size: 3, code_dim: 2, ..Architecture::default() };
    assert_eq!(all[1]["parameters"], architecture.parameters());
    let gmac = architecture.macs(HEIGHT, WIDTH) as f64 / 1e9;
    assert!((all[1]["gmac-evaluated"].as_f64().unwrap() - gmac).abs() < 1e-12);
    assert!(all[2]["parameters"].is_null());
    assert!(said.contains("| method | params | GMAC at 800² | GMAC | images | PSNR (dB) | SSIM |"), "{said}");
    for name in ["psnr-by-rotation.svg", "ssim-distribution.svg"] {
        assert!(names.iter().all(|method| svg(folder, &format!("results/{name}")).contains(method)));
    }

    // The same image restored by `udc restore` with the PSF itself scores the same, told the border of the dataset.
    let degraded = fs::read_dir(folder.join("dataset/degraded/r+00")).unwrap();
    let tested = results["images"][0]["id"].as_str().unwrap();
    let path =
        degraded.map(|entry| entry.unwrap().path()).find(|path| path.to_string_lossy().contains(tested));
    let path = path.unwrap();
    fs::create_dir_all(folder.join("clean")).unwrap();
    let gt = format!("{tested}.exr");
    fs::copy(folder.join("dataset/gt").join(&gt), folder.join("clean").join(&gt)).unwrap();
    fs::create_dir(folder.join("restored")).unwrap();
    let how = ["--method", "richardson-lucy", "--border", "zero", "--psf", "psf.exr", "-o", "restored"];
    succeed(folder, &[&["restore", path.to_str().unwrap()], &how[..]].concat());
    succeed(folder, &["eval", "--restored", "restored", "--gt", "clean", "-o", "alone"]);
    let (alone, within) = (json(folder, "alone/metrics.json"), &all[2]["kernels"]["r+00"]);
    let difference = alone["mean"]["psnr"].as_f64().unwrap() - within["psnr"].as_f64().unwrap();
    assert!(difference.abs() < 0.01, "{} {within}", alone["mean"]);
}

#[test]
fn measures_highlights_flare_and_the_rest_apart() {
    let scratch = scratch();
    let folder = scratch.path();
    let said = succeed(folder, &["eval", "dataset", "--regions", "-o", "results"]);
    assert!(said.contains("| degraded | highlights | 3 |"), "{said}");
    let results = json(folder, "results/metrics.json");
    let regions = &results["methods"][0]["regions"];
    let pixels = |name: &str| regions[name]["pixels"].as_u64().unwrap();
    assert_eq!(pixels("highlights") + pixels("flare") + pixels("rest"), 3 * (HEIGHT * WIDTH) as u64);
    assert!(pixels("highlights") >= 3 * 9 && pixels("flare") > 0);
    let psnr = |name: &str| regions[name]["mean"]["psnr"].as_f64().unwrap();
    assert!(psnr("flare") < psnr("rest"), "flare is where the formation did most: {regions}");
    assert!(results["definition"]["regions"]["flare"].as_str().unwrap().contains("d − b"));
    let csv = fs::read_to_string(folder.join("results/regions.csv")).unwrap();
    assert!(
        csv.starts_with("method,id,kernel,region,pixels,psnr,ssim\n") && csv.lines().count() == 10,
        "{csv}"
    );
    assert!(json(folder, "results/metrics.json")["methods"][0]["mean"]["psnr"].is_number());
}

/// The right PSF restores best, whatever the rotation; the diagonal is what is measured without `--mismatch`.
#[test]
fn tells_every_kernel_to_every_image() {
    let scratch = scratch();
    let folder = scratch.path();
    let compared = ["--model", "net.safetensors", "--method", "richardson-lucy"];
    succeed(folder, &[&["eval", "dataset", "--mismatch", "-o", "results"], &compared[..]].concat());
    let matrices = json(folder, "results/mismatch.json")["matrices"].clone();
    let results = json(folder, "results/metrics.json");
    assert_eq!(matrices.as_array().unwrap().len(), 4, "two methods, two metrics");
    for (matrix, method) in [(&matrices[0], 1), (&matrices[2], 2)] {
        assert_eq!(matrix["metric"], "psnr");
        assert_eq!(matrix["method"], results["methods"][method]["name"]);
        for (index, kernel) in ["r-40", "r+00", "r+40"].into_iter().enumerate() {
            assert_eq!(matrix["simulated"][index], kernel);
            assert_eq!(matrix["mean"][index][index], results["methods"][method]["kernels"][kernel]["psnr"]);
        }
    }
    for row in 0..3 {
        let psnr = |column: usize| matrices[2]["mean"][row][column].as_f64().unwrap();
        let wrong = (0..3).filter(|column| *column != row);
        assert!(wrong.into_iter().all(|column| psnr(column) < psnr(row) - 0.5), "{}", matrices[2]);
    }
    let csv = fs::read_to_string(folder.join("results/mismatch.csv")).unwrap();
    assert_eq!(csv.lines().count(), 1 + 4 * 9);
    assert_eq!(svg(folder, "results/mismatch-2-psnr.svg").matches("<rect").count(), 9);
}

#[test]
fn flare_is_gone_from_scenes_of_a_monitors_range() {
    let scratch = scratch();
    let folder = scratch.path();
    let said = succeed(folder, &["eval", "dataset", "--ldr", "-o", "results"]);
    assert!(said.contains("with scenes clipped at 1: 0.00 %"), "{said}");
    let mean = json(folder, "results/ldr.json")["mean"].clone();
    assert!(mean["hdr"]["flare_share"].as_f64().unwrap() > 0.01, "{mean}");
    assert_eq!(mean["ldr"]["flare_share"], 0.0);
    assert_eq!(mean["ldr"]["highlight_share"], 0.0);
    assert!(mean["ldr"]["largest_brightening"].as_f64() < mean["hdr"]["largest_brightening"].as_f64());
    let picture = io::read_pixels(&folder.join("results/ldr.png")).unwrap();
    assert_eq!(picture.planes.dim(), (3, 2 * HEIGHT + 6, 3 * WIDTH + 12));
    let csv = fs::read_to_string(folder.join("results/ldr.csv")).unwrap();
    assert_eq!(csv.lines().count(), 1 + 2 * 3);
}

/// One is gone from the folder, one is cut off.
#[test]
fn images_that_cannot_be_read_are_left_out_where_that_is_allowed() {
    let scratch = scratch();
    let folder = scratch.path();
    let triplets = fs::read_to_string(folder.join("dataset/triplets.jsonl")).unwrap();
    let mut tested = triplets.lines().filter(|line| line.contains("\"test\""));
    let mut next = || {
        let triplet: Value = serde_json::from_str(tested.next().unwrap()).unwrap();
        folder.join("dataset").join(triplet["degraded"].as_str().unwrap())
    };
    fs::remove_file(next()).unwrap();
    fs::write(next(), "cut").unwrap();
    let call = ["eval", "dataset", "--method", "wiener", "--ldr", "--regions", "-o", "results"];
    assert!(fail(folder, &call, 1).contains("1 of its images are missing"));
    succeed(folder, &[&call[..], &["--allow-missing"]].concat());
    assert_eq!(json(folder, "results/metrics.json")["excluded"].as_array().unwrap().len(), 2);
    assert_eq!(fs::read_to_string(folder.join("results/ldr.csv")).unwrap().lines().count(), 1 + 2);
}

#[test]
fn sets_datasets_side_by_side() {
    let scratch = scratch();
    let folder = scratch.path();
    let noisy = ["synth", "scenes", "--bank", "bank.safetensors", "-o", "noisy", "--noise", "gaussian:0.2"];
    succeed(folder, &[&noisy[..], &["--test-fraction", "0.5"]].concat());
    let said = succeed(folder, &["eval", "dataset", "noisy", "-o", "results"]);
    assert!(
        said.contains("| dataset | method | images |") && said.contains("| noisy | degraded | 3 |"),
        "{said}"
    );
    let results = json(folder, "results/metrics.json");
    let psnr = |method: usize| results["methods"][method]["mean"]["psnr"].as_f64().unwrap();
    assert!(psnr(1) < psnr(0) - 1.0, "noise costs");
    let said = fail(folder, &["eval", "dataset", "noisy", "--ldr", "-o", "other"], 1);
    assert!(said.contains("one dataset"), "{said}");
}

#[test]
fn says_what_a_dataset_lacks() {
    let scratch = scratch();
    let folder = scratch.path();
    let said = fail(folder, &["eval", "dataset", "--mismatch", "-o", "results"], 1);
    assert!(said.contains("--model") && said.contains("--method"), "{said}");
    assert!(
        fail(folder, &["eval", "dataset", "--ldr", "0", "-o", "results"], 1).contains("positive irradiance")
    );
    assert!(!folder.join("results").exists(), "nothing begins that cannot be finished");
    // An image that was replaced by one of another size.
    let triplets = fs::read_to_string(folder.join("dataset/triplets.jsonl")).unwrap();
    let first = triplets.lines().find(|line| line.contains("\"test\"")).unwrap();
    let triplet: Value = serde_json::from_str(first).unwrap();
    let small = scene(0.0).crop(0, 0, 24, 24);
    let options = WriteOptions { overwrite: true, ..WriteOptions::default() };
    io::write_image(&folder.join("dataset").join(triplet["degraded"].as_str().unwrap()), &small, &options)
        .unwrap();
    let said = fail(folder, &["eval", "dataset", "-o", "sizes"], 1);
    assert!(said.contains(triplet["id"].as_str().unwrap()) && said.contains("24 × 24"), "{said}");
    let said = succeed(folder, &["eval", "dataset", "--allow-missing", "-o", "sizes"]);
    assert!(said.contains("Left out of every mean: 1 images") && said.contains("| degraded | 2 |"), "{said}");
}

/// The published dataset has codes and no PSFs.
#[test]
fn deconvolutions_need_the_psfs_of_the_dataset() {
    let scratch = tempfile::tempdir().unwrap();
    let root = scratch.path().join("published");
    let write = |name: String| {
        let path = root.join(name);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        io::write_image(&path, &scene(0.0), &WriteOptions::default()).unwrap();
    };
    write("synthetic_data/GT/test/street.npy".to_owned());
    fs::create_dir_all(root.join("PSF/kernel_code")).unwrap();
    for i in 1..=9 {
        write(format!("synthetic_data/input/panel_{i}/street.npy"));
        let code = ndarray::ArrayD::from_elem(vec![5], 0.1 * i as f32);
        io::write_array(&root.join(format!("PSF/kernel_code/panel_code_{i}.npy")), &code, false).unwrap();
    }
    let output = udc(scratch.path(), &["eval", "published", "-o", "results"]);
    assert!(output.status.success() && !String::from_utf8_lossy(&output.stderr).contains("left out"));
    write("synthetic_data/input/other_1/street.npy".to_owned());
    let output = udc(scratch.path(), &["eval", "published", "-o", "again"]);
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success() && said.contains("which are left out: other_1"), "{said}");
    let output = udc(scratch.path(), &["doctor", "published"]);
    let said = [output.stdout, output.stderr].concat();
    assert!(String::from_utf8_lossy(&said).contains("which are left out: other_1"));
    for more in [["--method", "wiener"], ["--ldr", "1"]] {
        let said = fail(scratch.path(), &[&["eval", "published", "-o", "other"][..], &more].concat(), 1);
        assert!(said.contains("no PSFs") && said.contains("udc synth"), "{said}");
    }
}

/// Nobody told the restoration that the captures clip at 16: their files do, and those of what is made of them.
#[test]
fn restored_files_are_measured_up_to_the_light_that_their_captures_held() {
    let scratch = tempfile::tempdir().unwrap();
    let folder = scratch.path();
    succeed(folder, &["scenes", "-o", "scenes", "--count", "2", "--size", "32"]);
    succeed(folder, &["psf", "--random", "3", "--size", "9", "-o", "psf.exr"]);
    let synth =
        ["synth", "scenes", "--psf", "psf.exr", "--split", "test", "--noise", "sensor", "--x-max", "16"];
    succeed(folder, &[&synth[..], &["-o", "dataset"]].concat());
    let captures = fs::read_dir(folder.join("dataset/degraded")).unwrap().next().unwrap().unwrap().path();
    let captures = captures.to_str().unwrap();
    succeed(folder, &["restore", captures, "--psf", "psf.exr", "--method", "wiener", "-o", "restored"]);
    succeed(folder, &["eval", "--restored", "restored", "--gt", "dataset/gt", "-o", "measured"]);
    let measured = fs::read_to_string(folder.join("measured/metrics.json")).unwrap();
    let measured: Value = serde_json::from_str(&measured).unwrap();
    assert!(measured.to_string().contains("\"x-max\":16.0"), "{measured}");
}
