//! `udc train`: a whole run, its death and resurrection, and what it says of mistakes.

use std::fs;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use ndarray::{Array1, Array2, Array3};
use udc::core::image::LinearImage;
use udc::core::kernel_code::{CodeBasis, KernelBank};
use udc::core::psf::Psf;
use udc::core::tone::ToneCurve;
use udc::dataset::{DatasetConfig, FORMAT, FormationConfig, Split, Triplet, VERSION};
use udc::io;
use udc::network::Model;

use super::common::{fail, succeed, udc};
use super::events;

/// A network small enough that a step takes some milliseconds.
pub(crate) const CONFIG: &str = r#"
iterations = 24
log-every = 1
[architecture]
features = 2
filter-size = 3
code-dim = 2
[data]
crop = 16
batch = 2
accumulate = 2
[optimizer]
ema-decay = 0.9
clip-norm = 1.0
[schedule]
period = 10
[validation]
every = 8
images = 2
crop = 24
[checkpoint]
every = 5
keep = 2
"#;

/// Makes a dataset of four scenes and two kernels, one of which halves and one of which keeps the light, and
/// a configuration beside it.
pub(crate) fn prepare(folder: &Path) {
    let root = folder.join("dataset");
    for part in ["gt", "degraded/k01", "degraded/k02"] {
        fs::create_dir_all(root.join(part)).expect("the folder is writable");
    }
    let bank = bank();
    io::write_bank(&root.join("kernels.safetensors"), &bank, false).expect("the bank is written");
    let config = DatasetConfig {
        format: FORMAT.to_owned(),
        version: VERSION,
        program: "udc".to_owned(),
        bank: "kernels.safetensors".to_owned(),
        bank_sha256: io::bank_sha256(&root.join("kernels.safetensors")).expect("the bank is there"),
        field_sha256: None,
        scene_domain: None,
        scene_primaries: None,
        seed: 0,
        division: "test-fraction 0.25".to_owned(),
        image_format: "npy".to_owned(),
        archive_bytes: None,
        half: false,
        formation: FormationConfig { alpha: curve().alpha, ..FormationConfig::default() },
    };
    fs::write(root.join("dataset.toml"), config.to_toml()).expect("the folder is writable");
    let lines: Vec<String> = (0..8).map(|index| write_triplet(&root, index / 2, index % 2)).collect();
    fs::write(root.join("triplets.jsonl"), lines.join("\n")).expect("the folder is writable");
    fs::write(folder.join("config.toml"), CONFIG).expect("the folder is writable");
}

/// Another one than the published.
fn curve() -> ToneCurve {
    ToneCurve { alpha: 0.3, ..ToneCurve::default() }
}

fn bank() -> KernelBank {
    let energy = |weight: f32| Array3::from_shape_fn((3, 3, 3), |(_, y, x)| weight + (y * 3 + x) as f32);
    let psfs = [1.0, 9.0].map(|weight| Psf::from_energy(energy(weight)).expect("the energy is positive"));
    let basis = CodeBasis {
        mean: Array1::zeros(27),
        components: Array2::zeros((2, 27)),
        explained_variance: Array1::zeros(2),
    };
    let codes = Array2::from_shape_vec((2, 2), vec![0.5, -1.0, 1.5, 0.25]).expect("two codes of two");
    KernelBank::new(psfs.to_vec(), codes, basis, None).expect("the parts fit")
}

fn write_triplet(root: &Path, scene: usize, kernel: usize) -> String {
    let id = format!("scene{scene}");
    let clean = Array3::from_shape_fn((3, 26, 30), |(c, y, x)| {
        ((y + scene) as f32 * 0.7).sin().abs() * (1.0 + c as f32) + (x as f32 * 0.4).cos().abs()
    });
    let share = [0.5, 1.0][kernel];
    let triplet = Triplet {
        gt: format!("gt/{id}.npy"),
        degraded: format!("degraded/k{:02}/{id}.npy", kernel + 1),
        split: if scene == 3 { Split::Test } else { Split::Train },
        kernel: format!("k{:02}", kernel + 1),
        angle_deg: None,
        source: id.clone(),
        sha256: None,
        scene_sha256: None,
        id,
    };
    for (name, planes) in [(&triplet.gt, clean.clone()), (&triplet.degraded, clean * share)] {
        let image = LinearImage::from_planes(planes).expect("the values are finite");
        let options = io::WriteOptions { overwrite: true, ..Default::default() };
        io::write_image(&root.join(name), &image, &options).expect("the folder is writable");
    }
    serde_json::to_string(&triplet).expect("triplets are plain data")
}

pub(crate) fn train(folder: &Path, run: &str, rest: &[&str]) -> String {
    let mut args = vec!["train", "config.toml", "--data", "dataset", "-o", run];
    args.extend(rest);
    succeed(folder, &args)
}

/// What a run must repeat: its model and its log.
pub(crate) fn result(folder: &Path, run: &str) -> (Vec<u8>, String) {
    let read = |name: &str| fs::read(folder.join(run).join(name)).expect("the run has written it");
    (read("model.safetensors"), String::from_utf8(read("metrics.jsonl")).expect("the log is text"))
}

pub(crate) fn losses(log: &str) -> Vec<f64> {
    let line = |line| -> serde_json::Value { serde_json::from_str(line).expect("log lines are JSON") };
    log.lines().map(line).filter_map(|line| line["loss"].as_f64()).collect()
}

#[test]
fn trains_a_network_that_learns_and_can_be_loaded() {
    let folder = tempfile::tempdir().unwrap();
    prepare(folder.path());
    let settings = ["--set", "optimizer.learning-rate=0.003", "--set", "iterations=60"];
    let said = train(folder.path(), "run", &settings);
    assert!(said.contains("validation PSNR (dB)") && said.contains("trained for 60 iterations"), "{said}");
    assert!(said.contains("validation SSIM"), "{said}");
    let run = folder.path().join("run");
    let (_, log) = result(folder.path(), "run");
    let losses = losses(&log);
    assert_eq!(losses.len(), 60);
    let mean = |part: &[f64]| part.iter().sum::<f64>() / part.len() as f64;
    assert!(mean(&losses[50..]) < 0.7 * mean(&losses[..5]), "{losses:?}");
    assert!(log.contains("\"degraded_psnr\"") && log.contains("\"ssim\""), "{log}");
    let model = Model::load(&run.join("model.safetensors")).unwrap();
    assert_eq!(model.architecture().features, 2);
    let bank_sha256 = io::bank_sha256(&folder.path().join("dataset/kernels.safetensors")).unwrap();
    assert_eq!(model.origin().kernel_bank_sha256, Some(bank_sha256));
    assert_eq!(model.origin().tone_curve(), Some(curve()));
    assert!(Model::load(&run.join("best.safetensors")).is_ok());
    // A validation every 8 iterations, of two images.
    let previews = run.join("previews");
    assert_eq!(io::list_folder(&previews).unwrap().len(), 7);
    assert_eq!(io::list_folder(&previews.join("56")).unwrap(), ["1.png", "2.png"]);
    assert_eq!(io::read_pixels(&previews.join("56/1.png")).unwrap().planes.dim(), (3, 24, 72));
    let resolved = fs::read_to_string(run.join("config.toml")).unwrap();
    assert!(resolved.contains("learning-rate = 0.003") && resolved.contains("beta1 = 0.9"), "{resolved}");
}

#[test]
fn a_killed_run_ends_with_the_bytes_of_one_that_was_not() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    prepare(folder);
    train(folder, "whole", &[]);
    // Before the first checkpoint, after one, and after the validation that is between two.
    for (round, lines) in [2, 8, 19].into_iter().enumerate() {
        let mut args = vec!["train", "config.toml", "--data", "dataset", "-o", "killed"];
        args.extend((round > 0).then_some("--resume"));
        kill_after_lines(folder, &args, "killed/metrics.jsonl", lines);
    }
    train(folder, "killed", &["--resume"]);
    assert!(result(folder, "whole") == result(folder, "killed"), "the bytes differ");
    let best = |run: &str| fs::read(folder.join(run).join("best.safetensors")).unwrap();
    assert!(best("whole") == best("killed"), "the best model differs");
    let preview = |run: &str| fs::read(folder.join(run).join("previews/24/1.png")).unwrap();
    assert!(preview("whole") == preview("killed"), "the previews differ");
    let (log, events) = (scalars_of_log(folder, "killed"), scalars_of_events(folder, "killed"));
    assert_eq!(log.len(), events.len(), "every step is there once");
    for (log, event) in log.iter().zip(&events) {
        // The reader of JSON and the event's 32 bits each round.
        let is_close = (log.2 - event.2).abs() <= 1e-6 * log.2.abs();
        assert!((log.0, &log.1) == (event.0, &event.1) && is_close, "{log:?} {event:?}");
    }
    let names = |run: &str| io::list_folder(&folder.join(run).join("checkpoints")).unwrap();
    assert_eq!(names("killed"), ["20", "24"]);
    assert_eq!(names("whole"), ["20", "24"]);
}

/// Every scalar of a run's log as (step, tag, value), in order.
fn scalars_of_log(folder: &Path, run: &str) -> Vec<(u64, String, f32)> {
    let mut scalars = Vec::new();
    for line in result(folder, run).1.lines() {
        let line: serde_json::Value = serde_json::from_str(line).unwrap();
        let group = if line["loss"].is_null() { "validation" } else { "train" };
        for (key, value) in line.as_object().unwrap().iter().filter(|(key, _)| *key != "iteration") {
            let value = value.as_f64().unwrap() as f32;
            scalars.push((line["iteration"].as_u64().unwrap(), format!("{group}/{key}"), value));
        }
    }
    scalars.sort_by(|a, b| (a.0, &a.1).cmp(&(b.0, &b.1)));
    scalars
}

/// The same of a run's event files.
fn scalars_of_events(folder: &Path, run: &str) -> Vec<(u64, String, f32)> {
    let mut scalars = Vec::new();
    for (index, file) in events::read_folder(&folder.join(run)).iter().enumerate() {
        assert_eq!(file[0].file_version, "brain.Event:2");
        assert_eq!(file[1].restart, index > 0, "a file after the first says from where on it counts");
        let now = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH).unwrap().as_secs_f64();
        for event in file {
            assert!((now - event.wall_time).abs() < 3600.0, "{event:?}");
            scalars.extend(event.scalars.iter().map(|(tag, value)| (event.step, tag.clone(), *value)));
        }
    }
    scalars.sort_by(|a, b| (a.0, &a.1).cmp(&(b.0, &b.1)));
    scalars
}

#[test]
fn keeps_the_best_model_by_the_metric_of_choice() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    prepare(folder);
    let settings = ["--set", "validation.every=2", "--set", "validation.best=ssim"];
    train(folder, "run", &[&settings[..], &["--set", "optimizer.learning-rate=0.02"]].concat());
    let log = result(folder, "run").1;
    let lines = log.lines().map(|line| serde_json::from_str::<serde_json::Value>(line).unwrap());
    let best = lines
        .filter(|line| !line["ssim"].is_null())
        .reduce(|best, line| if line["ssim"].as_f64() > best["ssim"].as_f64() { line } else { best });
    let model = Model::load(&folder.join("run/best.safetensors")).unwrap();
    assert_eq!(model.origin().training.as_ref().unwrap()["iteration"], best.unwrap()["iteration"]);
    let run = ["train", "config.toml", "--data", "dataset", "-o", "other", "--set", "validation.best=lpips"];
    let message = fail(folder, &run, 2);
    assert!(message.contains("validation.best"), "{message}");
}

/// Starts `udc`, and kills it without a warning when the log has `lines` lines.
pub(crate) fn kill_after_lines(folder: &Path, args: &[&str], log: &str, lines: usize) {
    let mut command = Command::new(env!("CARGO_BIN_EXE_udc"));
    let mut child = command.args(args).current_dir(folder).stdout(Stdio::null()).spawn().expect("udc starts");
    let deadline = Instant::now() + Duration::from_secs(120);
    let log = folder.join(log);
    while fs::read_to_string(&log).unwrap_or_default().lines().count() < lines {
        assert!(Instant::now() < deadline, "the run does not get to {lines} lines");
        if child.try_wait().expect("the child can be asked").is_some() {
            break;
        }
        std::thread::sleep(Duration::from_millis(1));
    }
    // It may have ended meanwhile: then resuming has nothing to do, which must work as well.
    let _ = child.kill();
    child.wait().expect("the child ends");
}

#[test]
fn the_number_of_threads_does_not_change_a_byte() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    prepare(folder);
    // Larger than elsewhere, so that there is work to share out.
    let larger = ["--set", "architecture.features=8", "--set", "data.crop=24", "--set", "iterations=4"];
    for threads in ["1", "2", "3"] {
        train(folder, threads, &[&larger[..], &["--threads", threads]].concat());
    }
    assert!(result(folder, "1") == result(folder, "2"), "one thread against two");
    assert!(result(folder, "1") == result(folder, "3"), "one thread against three");
}

#[test]
fn every_kind_of_network_is_trained_and_restores() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    prepare(folder);
    let code = Array1::from_vec(vec![0.5, -1.0]).into_dyn();
    io::write_array(&folder.join("code.npy"), &code, false).expect("the folder is writable");
    io::write_psf(&folder.join("psf.exr"), &bank().psfs[0], &io::WriteOptions::default())
        .expect("the folder is writable");
    let kinds = [
        ("unet", "none"),
        ("srmdnf", "image+psf"),
        ("sftmd", "image+psf"),
        ("de-unet", "image"),
        ("guided", "none"),
    ];
    for (kind, condition) in kinds {
        let set = [format!("architecture.kind={kind}"), format!("architecture.condition={condition}")];
        let set =
            ["--set", &set[0], "--set", &set[1], "--set", "architecture.features=8", "--set", "iterations=3"];
        let runs = ["1", "3"].map(|threads| {
            let run = format!("{kind}-{threads}");
            train(folder, &run, &[&set[..], &["--threads", threads]].concat());
            result(folder, &run)
        });
        assert!(runs[0] == runs[1], "{kind}: one thread against three");
        let (model, restored) = (format!("{kind}-1/model.safetensors"), format!("{kind}.exr"));
        let described = succeed(folder, &["info", &model]);
        assert!(described.contains(kind) && described.contains("GMAC"), "{described}");
        let mut args = vec!["restore", "dataset/degraded/k01/scene0.npy", "--model", &model, "-o", &restored];
        args.extend(["--tile", "16", "--domain", "linear"]);
        if condition == "image+psf" {
            args.extend(["--code", "code.npy"]);
        } else if kind == "guided" {
            args.extend(["--psf", "psf.exr"]);
        }
        succeed(folder, &args);
        assert!(folder.join(restored).is_file());
    }
}

#[test]
fn a_loss_without_its_weights_says_where_they_come_from() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    prepare(folder);
    let run =
        ["train", "config.toml", "--data", "dataset", "-o", "run", "--set", "loss.perceptual.weight=0.01"];
    for file in [&[][..], &["--set", "loss.perceptual.file=absent.pth"]] {
        let message = fail(folder, &[&run[..], file].concat(), 1);
        assert!(message.contains("VGG-19") && message.contains("vgg19-dcbb9e9d.pth"), "{message}");
        assert!(!folder.join("run").exists());
    }
}

#[test]
fn begins_with_the_weights_of_a_model() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    prepare(folder);
    train(folder, "first", &["--set", "iterations=2"]);
    let tiny =
        ["--set", "iterations=1", "--set", "optimizer.learning-rate=1e-9", "--set", "schedule.minimum=0"];
    train(folder, "second", &[&tiny[..], &["--init", "first/model.safetensors"]].concat());
    let weights =
        |run: &str| udc::network::weights::read(&folder.join(run).join("model.safetensors")).unwrap();
    for (a, b) in weights("first").parameters.iter().zip(weights("second").parameters.iter()) {
        assert!(a.values.iter().zip(&b.values).all(|(a, b)| (a - b).abs() < 1e-7), "{}", a.name);
    }
    let args =
        ["train", "config.toml", "--data", "dataset", "-o", "third", "--init", "first/model.safetensors"];
    let message = fail(folder, &[&args[..], &["--set", "architecture.features=4"]].concat(), 1);
    assert!(message.contains("another architecture"), "{message}");
}

#[test]
fn degrades_on_the_fly_from_a_dataset_or_from_views_and_a_bank() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    prepare(folder);
    let live = ["--set", "data.degradation=on-the-fly", "--set", "iterations=3"];
    train(folder, "of-dataset", &live);
    let (model, log) = result(folder, "of-dataset");
    assert_eq!(losses(&log).len(), 3);
    train(folder, "again", &[&live[..], &["--threads", "1"]].concat());
    assert!((model, log) == result(folder, "again"), "the bytes differ");
    let views = ["train", "config.toml", "--data", "dataset/gt", "-o", "of-views"];
    let bank = ["--bank", "dataset/kernels.safetensors"];
    succeed(folder, &[&views[..], &bank, &live].concat());
    // What was not used is not written down.
    let recorded = |run: &str| fs::read_to_string(folder.join(run).join("config.toml")).unwrap();
    assert!(recorded("of-views").contains("[data.formation]"));
    assert!(!recorded("of-dataset").contains("formation") && !recorded("of-dataset").contains("x-max"));
    succeed(folder, &["train", "--data", "dataset", "-o", "of-dataset", "--resume"]);
    let message = fail(folder, &[&views[..], &bank].concat(), 1);
    assert!(message.contains("data.degradation"), "{message}");
    let message = fail(folder, &views, 1);
    assert!(message.contains("is no dataset"), "{message}");
}

/// Another picture under the same name, of the same size and age.
#[test]
fn a_training_on_the_fly_does_not_go_on_with_other_scenes_of_the_same_names() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    prepare(folder);
    let live = ["--set", "data.degradation=on-the-fly", "--set"];
    let views = ["--bank", "dataset/kernels.safetensors", "--data", "dataset/gt"];
    for (run, data) in [("of-views", &views[..]), ("of-dataset", &["--data", "dataset"])] {
        let train = [&["train", "config.toml", "-o", run][..], data, &live].concat();
        succeed(folder, &[&train[..], &["iterations=2"]].concat());
        let resume = [&train[..], &["iterations=3", "--resume"]].concat();
        let path = folder.join("dataset/gt/scene0.npy");
        let (kept, age) = (fs::read(&path).unwrap(), path.metadata().unwrap().modified().unwrap());
        let options = io::WriteOptions { overwrite: true, ..Default::default() };
        let other = LinearImage::from_planes(Array3::from_elem((3, 26, 30), 0.4)).unwrap();
        io::write_image(&path, &other, &options).unwrap();
        fs::File::options().write(true).open(&path).unwrap().set_modified(age).unwrap();
        let said = fail(folder, &resume, 1);
        assert!(said.contains("other data than the run learned from: scenes-sha256"), "{said}");
        // The scenes themselves, wherever they lie and however old.
        fs::write(&path, kept).unwrap();
        succeed(folder, &resume);
    }
}

#[test]
fn a_model_can_be_described_and_a_checkpoint_converted() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let checkpoint = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures/discnet/5.pth");
    let checkpoint = checkpoint.to_str().expect("the path is text");
    let said = succeed(folder, &["convert", checkpoint, "model.safetensors"]);
    assert!(said.contains("image+psf") && said.contains("55137"), "{said}");
    assert_eq!(Model::load(&folder.join("model.safetensors")).unwrap().architecture().filter_size, 3);
    let said = succeed(folder, &["info", "model.safetensors"]);
    assert!(said.contains("features      4") && said.contains("filter-size   3"), "{said}");
    succeed(folder, &["convert", "model.safetensors", "half.safetensors", "--half"]);
    assert_eq!(
        succeed(folder, &["info", "half.safetensors"]),
        said.replace("model.safetensors", "half.safetensors")
    );
    let bytes = |name: &str| fs::metadata(folder.join(name)).unwrap().len();
    // Of each number two bytes, and some digits of the places in the header.
    let saved = bytes("model.safetensors") - bytes("half.safetensors");
    assert!((2 * 55137..2 * 55137 + 2000).contains(&saved), "{saved}");
    let kept = fs::read(folder.join("half.safetensors")).unwrap();
    let refusal = fail(folder, &["convert", checkpoint, "half.safetensors", "--half"], 1);
    assert!(
        refusal.contains("half.safetensors") && fs::read(folder.join("half.safetensors")).unwrap() == kept
    );
    let said = succeed(folder, &["info", "--json", checkpoint]);
    let description: serde_json::Value = serde_json::from_str(&said).unwrap();
    assert_eq!(description["architecture"]["condition"], "image+psf");
    fs::write(folder.join("other.pth"), "no checkpoint").unwrap();
    assert!(fail(folder, &["info", "other.pth"], 1).contains("not a PyTorch checkpoint"));
}

#[test]
fn devices_that_do_not_exchange_gradients_train_no_network_together() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    prepare(folder);
    let run = ["train", "config.toml", "--data", "dataset", "-o", "run"];
    let message = fail(folder, &[&run[..], &["--devices", "0,1"]].concat(), 1);
    assert!(message.contains("name one device") && message.contains("--devices"), "{message}");
    let message = fail(folder, &[&run[..], &["--devices", "1,1"]].concat(), 1);
    assert!(message.contains("1 stands twice"), "{message}");
    fail(folder, &[&run[..], &["--devices", "0", "--device", "cpu"]].concat(), 2);
    assert!(!folder.join("run").exists());
}

#[test]
fn bfloat16_is_refused_where_the_cpu_trains() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    prepare(folder);
    let run = ["train", "config.toml", "--data", "dataset", "-o", "run"];
    for how in [["--precision", "bf16"], ["--set", "precision=bf16"]] {
        let message = fail(folder, &[&run[..], &how].concat(), 1);
        assert!(message.contains("precision") && message.contains("--device gpu"), "{message}");
    }
    assert!(!folder.join("run").exists());
}

#[test]
fn refuses_to_mix_runs() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    prepare(folder);
    let run = ["train", "config.toml", "--data", "dataset", "-o", "run", "--set", "iterations=1"];
    let message = fail(folder, &[&run[..], &["--resume"]].concat(), 1);
    assert!(message.contains("no run to resume"), "{message}");
    succeed(folder, &run);
    let message = fail(folder, &run, 1);
    assert!(message.contains("--resume") && message.contains("--overwrite"), "{message}");
    let message = fail(folder, &[&run[..], &["--resume", "--set", "optimizer.beta2=0.5"]].concat(), 1);
    assert!(message.contains("optimizer.beta2 is 0.5 and was 0.999"), "{message}");
    succeed(folder, &[&run[..], &["--overwrite"]].concat());
    succeed(folder, &["train", "--data", "dataset", "-o", "run", "--resume", "--set", "iterations=3"]);
    assert_eq!(losses(&result(folder, "run").1).len(), 3);
}

#[test]
fn what_a_run_did_not_write_is_kept() {
    let folder = tempfile::tempdir().unwrap();
    prepare(folder.path());
    let train = |more: &[&'static str]| {
        let call = ["train", "config.toml", "--data", "dataset", "-o", "run", "--set", "iterations=2"];
        [&call[..], more].concat()
    };
    let [config, best] = ["config.toml", "best.safetensors"].map(|name| folder.path().join("run").join(name));
    fs::create_dir(folder.path().join("run")).unwrap();
    let own = format!("# of mine\n{CONFIG}");
    fs::write(&config, &own).unwrap();
    assert!(fail(folder.path(), &train(&[]), 1).contains("config.toml: it is not of a run"));
    assert_eq!(fs::read_to_string(&config).unwrap(), own);
    fs::remove_file(&config).unwrap();
    succeed(folder.path(), &train(&["--set", "validation.every=1"]));
    for name in io::list_folder(&folder.path().join("run")).unwrap() {
        if name != "best.safetensors" && name != "config.toml" {
            io::remove(&folder.path().join("run").join(name)).unwrap();
        }
    }
    let before = fs::read(&best).unwrap();
    assert!(fail(folder.path(), &train(&[]), 1).contains("there is a run already"));
    assert_eq!(fs::read(&best).unwrap(), before);
    fs::remove_file(&best).unwrap();
    succeed(folder.path(), &train(&[]));
}

#[test]
fn images_of_a_triplet_must_be_of_one_size() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    prepare(folder);
    let options = io::WriteOptions { overwrite: true, ..Default::default() };
    for (height, width) in [(20, 30), (26, 40)] {
        let clean = LinearImage::from_planes(Array3::ones((3, height, width))).unwrap();
        for scene in 0..3 {
            let path = folder.join(format!("dataset/gt/scene{scene}.npy"));
            io::write_image(&path, &clean, &options).unwrap();
        }
        let message = fail(folder, &["train", "config.toml", "--data", "dataset", "-o", "run"], 1);
        assert!(message.contains(&format!("expected {height} × {width}, found 26 × 30")), "{message}");
        assert!(message.contains("degraded/k0"), "{message}");
    }
}

#[test]
fn an_image_that_is_smaller_than_the_crop_is_named_before_the_work() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    prepare(folder);
    let options = io::WriteOptions { overwrite: true, ..Default::default() };
    let clean = LinearImage::from_planes(Array3::ones((3, 15, 30))).unwrap();
    io::write_image(&folder.join("dataset/gt/scene2.npy"), &clean, &options).unwrap();
    let said = fail(folder, &["train", "config.toml", "--data", "dataset", "-o", "run"], 1);
    assert!(said.contains("checking dataset/gt/scene2.npy"), "{said}");
    assert!(said.contains("16 pixels do not fit an image of 15 × 30"), "{said}");
    assert!(!folder.join("run").exists());
}

#[test]
fn only_an_absent_split_turns_validation_off() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    prepare(folder);
    let run = ["train", "config.toml", "--data", "dataset", "-o", "run", "--set", "iterations=1"];
    let list = folder.join("dataset/triplets.jsonl");
    let lines = fs::read_to_string(&list).unwrap();
    let in_test = |line: &&str| line.contains("\"test\"");
    let unknown = |line| if in_test(&line) { line.replace("\"k01\"", "\"k77\"") } else { line.to_owned() };
    fs::write(&list, lines.lines().map(unknown).collect::<Vec<_>>().join("\n")).unwrap();
    let message = fail(folder, &run, 1);
    assert!(message.contains("names kernel k77"), "{message}");
    let train_only: Vec<&str> = lines.lines().filter(|line| !in_test(line)).collect();
    fs::write(&list, train_only.join("\n")).unwrap();
    let output = udc(folder, &run);
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success() && said.contains("no val or test split"), "{said}");
}

#[test]
fn warns_once_of_highlights_that_stored_ground_truths_lost() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    prepare(folder);
    let live = ["--set", "data.degradation=on-the-fly", "--set", "iterations=2"];
    let warnings = |data: &str, run: &str, more: &[&str]| {
        let args = [&["train", "config.toml", "--data", data, "-o", run], &live[..], more].concat();
        let output = udc(folder, &args);
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(output.status.success(), "{said}");
        said.matches("reach x-max = 500").count()
    };
    assert_eq!(warnings("dataset", "dim", &[]), 0);
    let options = io::WriteOptions { overwrite: true, ..Default::default() };
    let clipped = LinearImage::from_planes(Array3::from_elem((3, 26, 30), 500.0)).unwrap();
    for scene in 0..3 {
        io::write_image(&folder.join(format!("dataset/gt/scene{scene}.npy")), &clipped, &options).unwrap();
    }
    assert_eq!(warnings("dataset", "bright", &[]), 1);
    assert_eq!(warnings("dataset/gt", "views", &["--bank", "dataset/kernels.safetensors"]), 0);
}

#[test]
fn names_what_is_wrong_with_a_configuration() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    prepare(folder);
    let run = ["train", "config.toml", "--data", "dataset", "-o", "run"];
    let refused = |rest: &[&str]| fail(folder, &[&run[..], rest].concat(), 1);
    let misused = |setting| fail(folder, &[&run[..], &["--set", setting]].concat(), 2);
    assert!(misused("data.corp=8").contains("near it are data.crop"));
    assert!(misused("data.crop=large").contains("--set data.crop=large: invalid type"));
    assert!(misused("data.batch=0").contains("data.batch: must be at least 1"));
    assert!(misused("data.batch=100000000").contains("make data.batch or data.crop smaller"));
    assert!(refused(&["--set", "data.crop=64"]).contains("64 pixels do not fit an image of 26 × 30"));
    assert!(refused(&["--set", "architecture.code-dim=5"]).contains("codes of 2 numbers"));
    assert!(!folder.join("run/model.safetensors").exists());
    fs::write(folder.join("config.toml"), "[optimiser]\nbeta1 = 0.5\n").unwrap();
    assert!(refused(&[]).contains("line 1, column 2"));
    let message = fail(folder, &["train", "--data", "dataset", "-o", "run"], 2);
    assert!(message.contains("CONFIG"), "{message}");
}

#[test]
fn info_describes_a_checkpoint_of_a_run() {
    let scratch = tempfile::tempdir().unwrap();
    let folder = scratch.path();
    prepare(folder);
    train(folder, "run", &["--set", "iterations=2"]);
    let said = succeed(folder, &["info", "run/checkpoints/2"]);
    assert!(
        said.contains("checkpoint of a training, iteration 2") && said.contains("computed with"),
        "{said}"
    );
    assert!(said.contains("parameters"), "{said}");
    let object: serde_json::Value =
        serde_json::from_str(&succeed(folder, &["info", "--json", "run/checkpoints/2"])).unwrap();
    assert_eq!((&object["kind"], &object["model"]["kind"]), (&"checkpoint".into(), &"model".into()));
    assert_eq!(object["iteration"], 2);
}

/// A learning rate that no network survives.
#[test]
fn a_training_that_diverges_says_what_is_kept_and_keeps_nothing_useless() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    prepare(folder);
    let train = ["train", "config.toml", "--data", "dataset", "-o", "run", "--overwrite"];
    let diverge = |rate: &str, more: &[&str]| {
        let rate = format!("optimizer.learning-rate={rate}");
        let said = fail(folder, &[&train[..], &["--set", &rate], more].concat(), 1);
        assert!(said.contains("diverged") || said.contains("overflowed"), "{said}");
        assert!(said.contains("a smaller optimizer.learning-rate"), "{said}");
        assert!(!said.contains("the image holds"), "{said}");
        let has_model = folder.join("run/model.safetensors").exists();
        assert_eq!(has_model, folder.join("run/checkpoints").is_dir(), "{said}");
        assert_eq!(said.contains("no checkpoint yet, begin it again"), !has_model, "{said}");
        said
    };
    let often = ["--set", "checkpoint.every=1"];
    assert!(diverge("1e30", &often).contains("iteration 1,"));
    assert!(diverge("1e30", &["--set", "validation.every=1"]).contains("no checkpoint yet"));
    // With the weights of a run to begin with, these are kept.
    self::train(folder, "good", &["--set", "iterations=2"]);
    let said = diverge("1e30", &["--init", "good/model.safetensors"]);
    assert!(said.contains("--init run/checkpoints/0/model.safetensors"), "{said}");
}

#[test]
fn a_model_that_has_diverged_is_blamed_and_not_the_capture() {
    use udc::network::weights;
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    prepare(folder);
    train(folder, "run", &["--set", "iterations=1", "--set", "architecture.condition=image"]);
    let path = folder.join("run/model.safetensors");
    let mut model = weights::read(&path).unwrap();
    model.parameters.iter_mut().for_each(|p| p.values.fill(1e30));
    weights::write(&path, &model, true).unwrap();
    let model = ["--model", "run/model.safetensors"];
    let restore = ["restore", "dataset/degraded/k01/scene3.npy", "--domain", "linear", "-o", "out.exr"];
    let said = fail(folder, &[&restore[..], &model].concat(), 1);
    assert!(said.contains("the network's output holds") && said.contains("weights have diverged"), "{said}");
    let said = fail(folder, &[&["eval", "dataset", "-o", "report"][..], &model].concat(), 1);
    assert!(said.contains("weights have diverged"), "{said}");
}

/// Its model would be written over by that of a run that begins anew.
#[test]
fn a_run_whose_checkpoints_are_gone_is_not_begun_anew_in_its_place() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    prepare(folder);
    train(folder, "run", &["--set", "iterations=6"]);
    let model = fs::read(folder.join("run/model.safetensors")).unwrap();
    fs::remove_dir_all(folder.join("run/checkpoints")).unwrap();
    let resume = ["train", "--data", "dataset", "-o", "run", "--resume"];
    let said = fail(folder, &resume, 1);
    assert!(said.contains("holds no checkpoint") && said.contains("--init run/model.safetensors"), "{said}");
    assert_eq!(fs::read(folder.join("run/model.safetensors")).unwrap(), model);
    fs::remove_file(folder.join("run/model.safetensors")).unwrap();
    assert!(
        fail(folder, &resume, 1).contains("holds no checkpoint"),
        "the log has more steps than one checkpoint"
    );
    // A run that was killed before its first checkpoint begins at its beginning.
    let log = folder.join("run/metrics.jsonl");
    let first = fs::read_to_string(&log).unwrap().lines().next().unwrap().to_owned();
    fs::write(&log, first + "\n").unwrap();
    succeed(folder, &resume);
}
