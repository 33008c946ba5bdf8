//! `udc restore` without a model and without a method: the network for any panel.

use std::path::Path;

use ndarray::Array3;
use rand::RngExt as _;
use udc::core::capture::CaptureInfo;
use udc::core::fft::{Boundary, Convolver};
use udc::core::image::{Linear, LinearImage, ToneMapped};
use udc::core::psf::Psf;
use udc::core::rng::stream;
use udc::core::tone::ToneCurve;
use udc::io::{self, WriteOptions};

use super::common::{fail, succeed, udc};
use super::restore::scratch;

pub(super) const SATURATION: f32 = 4.0;

/// A core, a halo and four orders, as of a panel with a square grid.
fn psf() -> Psf {
    let energy = |(_, y, x): (usize, usize, usize)| {
        let spot = |cy: f32, cx: f32| (-((y as f32 - cy).powi(2) + (x as f32 - cx).powi(2)) / 2.0).exp();
        let orders = spot(20.0, 6.0) + spot(20.0, 34.0) + spot(6.0, 20.0) + spot(34.0, 20.0);
        // Faint enough not to be saturated by the lamp, whose light they tell.
        spot(20.0, 20.0) + 0.003 * orders
    };
    Psf::from_energy(Array3::from_shape_fn((3, 41, 41), energy)).unwrap()
}

/// A pattern with a lamp a hundred times above saturation.
fn scene() -> LinearImage {
    let value = |(c, y, x): (usize, usize, usize)| {
        if y.abs_diff(40) < 3 && x.abs_diff(44) < 3 {
            100.0 * SATURATION
        } else {
            0.3 + 0.1 * ((c + y / 9 + x / 7) % 3) as f32
        }
    };
    LinearImage::from_planes(Array3::from_shape_fn((3, 80, 88), value)).unwrap()
}

/// The scene through the PSF.
fn seen() -> Array3<f32> {
    let (scene, psf) = (scene(), psf());
    let convolver = Convolver::new([80, 88], [41, 41], Boundary::Replicate).unwrap();
    convolver.convolve(&convolver.spectrum(&scene).unwrap(), &convolver.otf(&psf).unwrap())
}

/// Writes the capture of the scene through the PSF, and the PSF.
pub(super) fn write_capture(folder: &Path) {
    let psf = psf();
    let capture = LinearImage::from_planes(seen().mapv(|light| light.min(SATURATION))).unwrap();
    io::write_image(&folder.join("capture.exr"), &capture, &WriteOptions::default()).unwrap();
    io::write_psf(&folder.join("psf.exr"), &psf, &WriteOptions::default()).unwrap();
}

/// The mean error of tone-mapped values where the scene is not saturated.
fn error(path: &Path) -> f32 {
    let curve = ToneCurve::new(0.25, SATURATION).unwrap();
    let (image, scene) = (io::read_image::<Linear>(path).unwrap(), scene());
    let errors: Vec<f32> = image
        .as_slice()
        .iter()
        .zip(scene.as_slice())
        .filter(|(_, truth)| **truth < SATURATION)
        .map(|(value, truth)| (curve.compress(*value) - curve.compress(*truth)).abs())
        .collect();
    errors.iter().sum::<f32>() / errors.len() as f32
}

#[test]
fn the_psf_alone_restores_a_capture_and_finds_its_lamp_and_its_level() {
    let scratch = tempfile::tempdir().unwrap();
    write_capture(scratch.path());
    let output =
        udc(scratch.path(), &["restore", "capture.exr", "--psf", "psf.exr", "-o", "restored.exr", "-v"]);
    let said = String::from_utf8(output.stderr).unwrap();
    assert!(output.status.success(), "{said}");
    assert!(said.contains("lamp at row 40, column 44"), "{said}");
    assert!(said.contains("saturates at 4 in all colours"), "{said}");
    let (before, after) =
        (error(&scratch.path().join("capture.exr")), error(&scratch.path().join("restored.exr")));
    assert!(after < 0.5 * before, "{after} of {before}");
    assert!(succeed(scratch.path(), &["info", "restored.exr"]).contains("clips at  4.0"));
    let provenance = io::read_provenance(&scratch.path().join("restored.exr")).unwrap().unwrap();
    assert_eq!(provenance.config["how"]["model-sha256"], udc::network::guided_sha256());
    assert_eq!(provenance.config["device"], "the CPU");
    assert_eq!(provenance.config["instruction-set"], udc::kernels::Isa::current().name());
    let found = provenance.found.unwrap();
    assert_eq!(found["saturation"], serde_json::json!([4.0, 4.0, 4.0]));
    let lamp = &found["lamps"][0];
    // 25 pixels of 100 times saturation.
    let light = lamp["light"][1].as_f64().unwrap() / f64::from(SATURATION);
    assert!((2000.0..3125.0).contains(&light), "as much as {light} saturated pixels");
    succeed(
        scratch.path(),
        &["restore", "capture.exr", "--psf", "psf.exr", "-o", "photo.jpg", "--model", "guided"],
    );
    assert!(scratch.path().join("photo.jpg").is_file());
}

/// Of a capture with noise, whose PSF is as a picture of it has it that was encoded for a screen.
#[test]
fn a_psf_that_contradicts_its_capture_is_warned_of() {
    let scratch = tempfile::tempdir().unwrap();
    write_capture(scratch.path());
    let mut noise = stream(7, "noise");
    let noisy = seen().mapv(|light| {
        let uniform: f32 = (0..12).map(|_| noise.random::<f32>()).sum::<f32>() - 6.0;
        (light + 0.01 * (light + 0.1) * uniform).clamp(0.0, SATURATION)
    });
    let noisy = LinearImage::from_planes(noisy).unwrap();
    io::write_image(&scratch.path().join("noisy.exr"), &noisy, &WriteOptions::default()).unwrap();
    let encoded = Psf::from_energy(psf().planes().mapv(|energy| energy.max(0.0).powf(1.0 / 2.4))).unwrap();
    io::write_psf(&scratch.path().join("encoded.exr"), &encoded, &WriteOptions::default()).unwrap();
    for (psf, is_wrong) in [("psf.exr", false), ("encoded.exr", true)] {
        let output =
            udc(scratch.path(), &["restore", "noisy.exr", "--psf", psf, "-o", "out.exr", "--overwrite"]);
        let said = String::from_utf8(output.stderr).unwrap();
        assert!(output.status.success(), "{said}");
        let is_told = said.contains("explains it badly") || said.contains("does not look like");
        assert_eq!(is_told, is_wrong, "{psf}: {said}");
    }
}

/// Writes the capture of a wall with a sun six columns beyond the left border, behind a panel with many orders, and its PSF.
fn write_sun_outside(folder: &Path) {
    const CUT: usize = 16;
    let orders = |y: usize, x: usize| {
        let distance = (y as f32 - 32.0).hypot(x as f32 - 32.0);
        let order = if y.is_multiple_of(8) && x.is_multiple_of(8) { 1e-3 } else { 1e-5 };
        (-distance * distance / 0.8).exp() + order * (-distance / 12.0).exp()
    };
    let psf = Psf::from_energy(Array3::from_shape_fn((3, 65, 65), |(_, y, x)| orders(y, x))).unwrap();
    let light = |(c, y, x): (usize, usize, usize)| match (y, x) {
        (30..32, 10..12) => 3000.0,
        _ => 0.2 + 0.05 * ((y as f32 / 9.0).sin() + (x as f32 / (7.0 + c as f32)).cos()),
    };
    let scene = LinearImage::from_planes(Array3::from_shape_fn((3, 96, 96), light)).unwrap();
    let convolver = Convolver::new([96, 96], [65, 65], Boundary::Zero).unwrap();
    let seen = convolver.convolve(&convolver.spectrum(&scene).unwrap(), &convolver.otf(&psf).unwrap());
    let seen = LinearImage::from_planes(seen.mapv(|light| light.clamp(0.0, 16.0))).unwrap();
    let capture = seen.crop(0, CUT, 96, 96 - CUT);
    io::write_image(&folder.join("capture.exr"), &capture, &WriteOptions::default()).unwrap();
    io::write_psf(&folder.join("psf.exr"), &psf, &WriteOptions::default()).unwrap();
}

#[test]
fn a_sun_outside_of_the_frame_is_told_of_by_all_that_take_its_flare_away() {
    let scratch = tempfile::tempdir().unwrap();
    write_sun_outside(scratch.path());
    for flags in [&[][..], &["--method", "joint"]] {
        let call = ["restore", "capture.exr", "--psf", "psf.exr", "-o", "restored.exr", "-v", "--overwrite"];
        let output = udc(scratch.path(), &[&call[..], flags].concat());
        let said = String::from_utf8(output.stderr).unwrap();
        assert!(output.status.success(), "{said}");
        assert!(said.contains("lamp outside of the frame, at row 3"), "{said}");
        let provenance = io::read_provenance(&scratch.path().join("restored.exr")).unwrap().unwrap();
        let lamp = &provenance.found.unwrap()["lamps-outside"][0];
        let at = |axis: usize| lamp["position"][axis].as_f64().unwrap();
        assert!((at(0) - 30.5).abs() < 1.0 && (at(1) + 5.5).abs() < 1.0, "{lamp}");
    }
}

/// A file that does not say where its sensor clipped.
#[test]
fn deconvolutions_notice_that_a_capture_is_clipped() {
    let scratch = tempfile::tempdir().unwrap();
    write_capture(scratch.path());
    let restore = |method: &str, flags: &[&str]| {
        let call =
            ["restore", "capture.exr", "--psf", "psf.exr", "--method", method, "-o", "r.exr", "--overwrite"];
        let output = udc(scratch.path(), &[&call[..], flags].concat());
        let said = String::from_utf8(output.stderr).unwrap();
        assert!(output.status.success(), "{said}");
        (said, io::read_image::<Linear>(&scratch.path().join("r.exr")).unwrap())
    };
    let ((said, found), (_, told)) = (restore("joint", &[]), restore("joint", &["--x-max", "4"]));
    assert!(said.contains("saturates at 4 in all colours"), "{said}");
    assert_eq!(found, told);
    for (method, flags) in [("constrained", &[][..]), ("wiener", &["--mask-saturated"])] {
        let (said, _) = restore(method, flags);
        assert!(said.contains("warning") && said.contains("tell the x-max: 4"), "{said}");
    }
    assert!(!restore("wiener", &[]).0.contains("x-max"));
    assert!(!restore("constrained", &["--x-max", "4"]).0.contains("x-max"));
    for method in ["constrained", "joint"] {
        let (said, _) = restore(method, &["--x-max", "4.1"]);
        assert!(said.contains("end at 4 in all colours") && said.contains("tell the x-max: 4"), "{said}");
    }
}

#[test]
fn true_highlights_are_far_above_saturation_and_others_are_not() {
    let scratch = tempfile::tempdir().unwrap();
    write_capture(scratch.path());
    let brightest = |flags: &[&str], name: &str| {
        let call = ["restore", "capture.exr", "--psf", "psf.exr", "--x-max", "4", "-o", name];
        succeed(scratch.path(), &[&call[..], flags].concat());
        let image = io::read_image::<Linear>(&scratch.path().join(name)).unwrap();
        image.as_slice().iter().fold(0.0f32, |most, value| most.max(*value))
    };
    assert!(brightest(&[], "restored.exr") <= SATURATION * 1.001);
    assert!(brightest(&["--true-highlights"], "true.exr") > 20.0 * SATURATION);
    // No capture of such light clips at 4, whoever says it of this one.
    let folder = scratch.path();
    let capture = io::read_image::<Linear>(&folder.join("capture.exr")).unwrap();
    let info = CaptureInfo { saturation: Some([SATURATION; 3]), ..CaptureInfo::default() };
    let told = WriteOptions { capture: Some(info), ..WriteOptions::default() };
    io::write_image(&folder.join("told.exr"), &capture, &told).unwrap();
    for (flags, clips) in [(&[][..], true), (&["--true-highlights"], false), (&["--method", "joint"], false)]
    {
        let call = ["restore", "told.exr", "--psf", "psf.exr", "-o", "of-told.exr", "--overwrite"];
        succeed(folder, &[&call[..], flags].concat());
        assert_eq!(succeed(folder, &["info", "of-told.exr"]).contains("clips at"), clips, "{flags:?}");
    }
    let call = ["restore", "capture.exr", "--psf", "psf.exr", "--true-highlights", "-o", "t.exr"];
    let message = fail(scratch.path(), &[&call[..], &["--output-domain", "tone-mapped"]].concat(), 2);
    assert!(message.contains("--true-highlights"), "{message}");
    for picture in ["t.png", "t.tif", "t.jpg"] {
        let call = ["restore", "capture.exr", "--psf", "psf.exr", "--true-highlights", "-o", picture];
        let message = fail(folder, &call, 2);
        assert!(message.contains(picture) && message.contains("write .exr, .npy or .hdr"), "{message}");
    }
}

/// φ of the light that there may be, by the curve that the file says.
#[test]
fn tone_mapped_results_end_where_the_light_does_and_say_it() {
    let scratch = tempfile::tempdir().unwrap();
    let folder = scratch.path();
    write_capture(folder);
    for (flags, name) in [(&[][..], "found.exr"), (&["--x-max", "4"], "told.exr")] {
        let call =
            ["restore", "capture.exr", "--psf", "psf.exr", "--output-domain", "tone-mapped", "-o", name];
        succeed(folder, &[&call[..], flags].concat());
        let image = io::read_image::<ToneMapped>(&folder.join(name)).unwrap();
        let most = ToneCurve::new(0.25, SATURATION).unwrap().compress(SATURATION);
        let (least, found) =
            image.as_slice().iter().fold((1.0f32, 0.0f32), |(l, m), v| (l.min(*v), m.max(*v)));
        assert!(least >= 0.0 && found <= most && found > 0.99 * most, "{name}: {least} {found} {most}");
        let inverse = format!("inverse-of-{name}");
        succeed(folder, &["tonemap", "--inverse", name, "-o", &inverse]);
        let light = io::read_image::<Linear>(&folder.join(&inverse)).unwrap().max();
        assert!((light / SATURATION - 1.0).abs() < 0.02, "{name}: {light}");
    }
}

/// So that whoever develops it knows where it is clipped.
#[test]
fn a_level_that_is_told_is_written_as_one_that_is_found() {
    let scratch = tempfile::tempdir().unwrap();
    let folder = scratch.path();
    write_capture(folder);
    for flags in [&[][..], &["--x-max", "4"], &["--x-max", "4", "--method", "constrained"]] {
        let call = ["restore", "capture.exr", "--psf", "psf.exr", "-o", "out.exr", "--overwrite"];
        succeed(folder, &[&call[..], flags].concat());
        assert!(succeed(folder, &["info", "out.exr"]).contains("clips at  4.0"), "{flags:?}");
    }
}

#[test]
fn a_level_above_that_of_the_file_is_said_to_change_nothing() {
    let scratch = tempfile::tempdir().unwrap();
    let folder = scratch.path();
    write_capture(folder);
    let restore = |capture: &str, flags: &[&str], name: &str| {
        let call = ["restore", capture, "--psf", "psf.exr", "-o", name];
        let output = udc(folder, &[&call[..], flags].concat());
        assert!(output.status.success());
        String::from_utf8(output.stderr).unwrap()
    };
    let light = io::read_image::<Linear>(&folder.join("capture.exr")).unwrap();
    let info = CaptureInfo { saturation: Some([SATURATION; 3]), ..CaptureInfo::default() };
    let options = WriteOptions { capture: Some(info), ..WriteOptions::default() };
    io::write_image(&folder.join("told.exr"), &light, &options).unwrap();
    restore("told.exr", &[], "own.exr");
    let said = restore("told.exr", &["--x-max", "16"], "above.exr");
    assert!(said.contains("saturates at 4, which is taken; --x-max 16 is above that"), "{said}");
    let [own, above] =
        ["own.exr", "above.exr"].map(|name| io::read_image::<Linear>(&folder.join(name)).unwrap());
    assert_eq!(own, above);
    assert!(!restore("told.exr", &["--x-max", "4"], "same.exr").contains("changes nothing"));
}

#[test]
fn a_capture_that_is_mostly_saturated_is_warned_of() {
    let scratch = tempfile::tempdir().unwrap();
    let folder = scratch.path();
    write_capture(folder);
    let light = |(_, _, x): (usize, usize, usize)| if x < 40 { SATURATION } else { 0.5 };
    let bright = LinearImage::from_planes(Array3::from_shape_fn((3, 48, 64), light)).unwrap();
    io::write_image(&folder.join("bright.exr"), &bright, &WriteOptions::default()).unwrap();
    let output = udc(folder, &["restore", "bright.exr", "--psf", "psf.exr", "-o", "out.exr"]);
    let said = String::from_utf8(output.stderr).unwrap();
    assert!(output.status.success() && said.contains("62 % of its pixels are saturated"), "{said}");
}

#[test]
fn without_refinement_the_joint_deconvolution_stays() {
    let scratch = tempfile::tempdir().unwrap();
    write_capture(scratch.path());
    let restore = |flags: &[&str], name: &str| {
        let call = ["restore", "capture.exr", "--psf", "psf.exr", "--x-max", "4", "-o", name];
        succeed(scratch.path(), &[&call[..], flags].concat());
        io::read_image::<Linear>(&scratch.path().join(name)).unwrap()
    };
    let (plain, joint) =
        (restore(&["--refine", "0"], "plain.exr"), restore(&["--method", "joint"], "joint.exr"));
    for (plain, joint) in plain.as_slice().iter().zip(joint.as_slice()) {
        // There and back through φ, which flattens bright light.
        let most = 1e-5 * (1.0 + joint.min(SATURATION) / 0.25).powi(2);
        assert!((plain - joint.min(SATURATION)).abs() <= most, "{plain} {joint}");
    }
}

#[test]
fn the_kernel_of_a_bank_at_an_angle_restores_too() {
    let scratch = scratch();
    let call = ["restore", "scene.exr", "--bank", "bank.safetensors", "-o"];
    let at =
        |angle: &str, name: &str| succeed(scratch.path(), &[&call[..], &[name, "--angle", angle]].concat());
    at("4", "a.exr");
    at("5.5", "b.exr");
    let read = |name: &str| io::read_image::<Linear>(&scratch.path().join(name)).unwrap();
    assert_ne!(read("a.exr"), read("b.exr"));
    for (angle, is_outside) in [("12", false), ("5.5", false), ("12.5", true), ("-40", true)] {
        let angle = format!("--angle={angle}");
        let output = udc(scratch.path(), &[&call[..], &["c.exr", &angle, "--overwrite"]].concat());
        let said = String::from_utf8(output.stderr).unwrap();
        assert!(output.status.success(), "{said}");
        assert_eq!(said.contains("which has kernels from -12° to 12°"), is_outside, "{angle}: {said}");
    }
}

#[test]
fn what_the_guided_restoration_lacks_or_would_ignore_is_named() {
    let scratch = scratch();
    for (flags, code, expected) in [
        (&[][..], 1, "name it with --psf"),
        (&["--bank", "bank.safetensors"], 1, "--angle auto"),
        (&["--field", "field.toml"], 1, "takes one PSF for all of the frame"),
        (&["--psf", "psf.exr", "--refine", "1.5"], 1, "between 0 and 1"),
        (&["--psf", "psf.exr", "--method", "wiener", "--refine", "0.5"], 2, "--refine"),
        (&["--psf", "psf.exr", "--bank", "bank.safetensors"], 2, "ignore it beside --psf"),
        (&["--psf", "psf.exr", "--true-highlights", "--highlights", "keep"], 2, "leave one of them out"),
        (&["--model", "other.safetensors", "--refine", "0.5"], 2, "belongs to the guided restoration"),
        (&["--model", "other.safetensors", "--border", "zero"], 2, "--border"),
    ] {
        let message = fail(scratch.path(), &[&["restore", "scene.exr", "-o", "o.exr"], flags].concat(), code);
        assert!(message.contains(expected), "{flags:?}: {message}");
    }
    assert!(!scratch.path().join("o.exr").exists());
}

#[test]
fn info_describes_the_network_for_any_panel() {
    let scratch = tempfile::tempdir().unwrap();
    let said = succeed(scratch.path(), &["info", "guided"]);
    assert!(said.contains("guided") && said.contains("deconvolved, noise, saturated"), "{said}");
}

/// The same light in units that make it a hundred thousandth as large is restored as well.
#[test]
fn light_in_small_units_is_restored_like_other_light() {
    let scratch = tempfile::tempdir().unwrap();
    let folder = scratch.path();
    write_capture(folder);
    let scaled = |from: &str, to: &str, factor: f32| {
        let image = io::read_image::<Linear>(&folder.join(from)).unwrap();
        io::write_image(
            &folder.join(to),
            &image.map_values::<Linear>(|v| factor * v),
            &WriteOptions::default(),
        )
        .unwrap();
    };
    scaled("capture.exr", "dim.npy", 1e-5);
    let before = error(&folder.join("capture.exr"));
    for method in [&[][..], &["--method", "joint"]] {
        let args =
            [&["restore", "dim.npy", "--psf", "psf.exr", "-o", "dim-restored.npy", "--overwrite"], method];
        let said = udc(folder, &args.concat());
        assert!(said.status.success());
        let restored = format!("restored{}.npy", method.concat());
        scaled("dim-restored.npy", &restored, 1e5);
        let after = error(&folder.join(restored));
        // α follows the median, and weighs noise a little otherwise.
        assert!(after < 0.7 * before, "{method:?}: {after} of {before}");
    }
}

/// With an α as large beside it as usual; by 0.25, light of 10⁻⁵ would be explained before the first step.
#[test]
fn light_in_small_units_is_deconvolved_alone_too() {
    let scratch = tempfile::tempdir().unwrap();
    let folder = scratch.path();
    write_capture(folder);
    let capture = io::read_image::<Linear>(&folder.join("capture.exr")).unwrap();
    let dim = capture.map_values::<Linear>(|light| 1e-5 * light);
    io::write_image(&folder.join("dim.npy"), &dim, &WriteOptions::default()).unwrap();
    succeed(folder, &["restore", "dim.npy", "--psf", "psf.exr", "--method", "constrained", "-o", "r.npy"]);
    let restored = io::read_image::<Linear>(&folder.join("r.npy")).unwrap();
    let sum = |values: &mut dyn Iterator<Item = f32>| values.map(f64::from).sum::<f64>();
    let (light, was) = (restored.as_slice().iter(), dim.as_slice());
    let moved =
        sum(&mut light.zip(was).map(|(light, was)| (light - was).abs())) / sum(&mut was.iter().copied());
    assert!(moved > 0.01, "{moved}");
}

/// A bracket that measured a lamp of 1800 says that it clips above that; light without a level is not cut off either.
#[test]
fn light_above_the_usual_level_is_kept() {
    let scratch = tempfile::tempdir().unwrap();
    let folder = scratch.path();
    write_capture(folder);
    let capture = LinearImage::from_planes(seen() * 50.0).unwrap();
    let brightest = capture.max();
    assert!(brightest > 1000.0);
    let info = CaptureInfo { saturation: Some([1e5; 3]), ..CaptureInfo::default() };
    let told = WriteOptions { capture: Some(info), ..WriteOptions::default() };
    io::write_image(&folder.join("told.exr"), &capture, &told).unwrap();
    io::write_image(&folder.join("untold.npy"), &capture, &WriteOptions::default()).unwrap();
    for name in ["told.exr", "untold.npy"] {
        for method in [&[][..], &["--method", "joint"], &["--method", "constrained"]] {
            let args = [&["restore", name, "--psf", "psf.exr", "-o", "restored.npy", "--overwrite"], method];
            succeed(folder, &args.concat());
            let restored = io::read_image::<Linear>(&folder.join("restored.npy")).unwrap();
            assert!(restored.max() > 0.9 * brightest, "{name} {method:?}: {} of {brightest}", restored.max());
        }
    }
}

/// As `-o guided/` and results of that name leave it.
#[test]
fn what_is_named_as_the_network_does_not_stand_in_for_it() {
    let scratch = scratch();
    let folder = scratch.path();
    let restore = |flags: &[&'static str]| {
        [&["restore", "scene.exr", "--psf", "psf.exr", "--overwrite", "-o"][..], flags].concat()
    };
    succeed(folder, &restore(&["guided/"]));
    succeed(folder, &restore(&["guided/"]));
    succeed(folder, &restore(&["a.exr", "--model", "guided"]));
    let said = succeed(folder, &["info", "guided"]);
    assert!(said.contains("scene.exr") && !said.contains("deconvolved"), "the folder is looked at: {said}");
    let synth = ["synth", "scene.exr", "--psf", "psf.exr", "--split", "test", "-o", "dataset"];
    succeed(folder, &synth);
    succeed(
        folder,
        &["eval", "dataset", "--method", "guided", "-o", "guided", "--metrics", "psnr", "--overwrite"],
    );
    std::fs::remove_dir_all(folder.join("guided")).unwrap();
    std::fs::write(folder.join("guided"), "no network").unwrap();
    succeed(folder, &restore(&["a.exr"]));
    assert!(fail(folder, &restore(&["a.exr", "--model", "guided"]), 1).contains("guided"));
}

/// Its light is a thousandth of what networks know, for which an α is chosen unless it is told.
#[test]
fn an_alpha_that_is_told_is_used() {
    let scratch = tempfile::tempdir().unwrap();
    let folder = scratch.path();
    write_capture(folder);
    let image = io::read_image::<Linear>(&folder.join("capture.exr")).unwrap();
    let dim = image.map_values::<Linear>(|light| 1e-3 * light);
    io::write_image(&folder.join("dim.exr"), &dim, &WriteOptions::default()).unwrap();
    for method in [&[][..], &["--method", "joint"]] {
        let restore = |output: &str, alpha: &[&str]| {
            let call = ["restore", "dim.exr", "--psf", "psf.exr", "-o", output, "--overwrite"];
            succeed(folder, &[&call[..], method, alpha].concat());
            let found = io::read_provenance(&folder.join(output)).unwrap().unwrap().found;
            found.and_then(|found| found.get("alpha")?.as_f64())
        };
        let suited = restore("suited.exr", &[]).expect("another than 0.25");
        assert!(suited < 0.01, "{method:?}: {suited}");
        assert_eq!(restore("told.exr", &["--alpha", "0.25"]), None, "{method:?}");
        let read = |name: &str| io::read_image::<Linear>(&folder.join(name)).unwrap();
        assert_ne!(read("suited.exr"), read("told.exr"), "{method:?}");
    }
}
