//! Tests of configurations and of the settings put over them.

use super::settings::known_keys;
use super::*;

fn message(text: &str, settings: &[&str]) -> String {
    let settings: Vec<String> = settings.iter().map(ToString::to_string).collect();
    TrainConfig::from_toml(text, &settings).unwrap_err().to_string()
}

#[test]
fn round_trips_through_toml() {
    let config = TrainConfig { seed: 7, ..TrainConfig::default() };
    assert_eq!(TrainConfig::from_toml(&config.to_toml(), &[]).unwrap(), config);
}

#[test]
fn every_shipped_configuration_is_understood_and_the_first_spells_out_the_defaults() {
    let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("configs");
    let files = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    let mut count = 0;
    for path in files.filter(|path| path.extension().is_some_and(|extension| extension == "toml")) {
        let text = std::fs::read_to_string(&path).unwrap();
        let config = TrainConfig::from_toml(&text, &[]).unwrap();
        if path.ends_with("discnet.toml") {
            assert_eq!(config, TrainConfig::default());
            assert!(known_keys().iter().all(|key| text.contains(key.rsplit('.').next().unwrap())));
        }
        count += 1;
    }
    assert_eq!(count, 19);
}

#[test]
fn settings_go_over_the_file() {
    let settings = ["data.crop=64", "architecture.condition=image+psf", "optimizer.beta2=0.99"];
    let text = "[data]\ncrop = 128\nbatch = 4\n";
    let config = TrainConfig::from_toml(text, &settings.map(String::from)).unwrap();
    assert_eq!((config.data.crop, config.data.batch), (64, 4));
    assert!((config.optimizer.beta2 - 0.99).abs() < 1e-12);
}

#[test]
fn settings_that_belong_together_are_checked_together() {
    let formation = |text: &str, settings: &[&str]| {
        let settings: Vec<String> = settings.iter().map(ToString::to_string).collect();
        TrainConfig::from_toml(text, &settings).unwrap().data.formation
    };
    let (kind, sigma) = ("data.formation.noise.kind=gaussian", "data.formation.noise.sigma=0.01");
    let gaussian = NoiseConfig::Gaussian { sigma: 0.01 };
    assert_eq!(formation("", &[kind, sigma]).noise, gaussian);
    assert_eq!(formation("", &[sigma, kind]).noise, gaussian);
    let sensor = "[data.formation.noise]\nkind = \"sensor\"\n";
    let table = "data.formation.noise={kind = \"gaussian\", sigma = 0.01}";
    assert_eq!(formation(sensor, &[table]).noise, gaussian);
    let message = message("", &["iterations=2", kind]);
    assert!(message.starts_with(&format!("--set {kind}: ")) && message.contains("sigma"), "{message}");
    let message = self::message("", &["data.formation.noise=gaussian"]);
    assert!(message.contains("is a section") && message.contains("data.formation.noise.kind"), "{message}");
}

#[test]
fn a_sensor_says_where_images_saturate_unless_the_user_does() {
    let x_max = |settings: &[&str]| {
        let settings: Vec<String> = settings.iter().map(ToString::to_string).collect();
        TrainConfig::from_toml("", &settings).unwrap().data.formation.x_max
    };
    let sensor = "data.formation.noise.kind=sensor";
    let near = |found: f32, expected: f32| assert!((found - expected).abs() < 1e-3, "{found}");
    near(x_max(&[]), 500.0);
    near(x_max(&[sensor]), 16.0);
    near(x_max(&[sensor, "data.formation.noise.white-irradiance=2"]), 32.0);
    near(x_max(&[sensor, "data.formation.x-max=400"]), 400.0);
}

#[test]
fn mistakes_of_the_file_are_reported_at_their_line() {
    let message = message("seed = 1\n[data]\ncorp = 128\n", &["data.crop=64"]);
    assert!(message.contains("line 3, column 1") && message.contains("corp"), "{message}");
}

#[test]
fn misspelt_settings_name_the_nearest_keys() {
    let message = message("", &["optimizer.learning_rate=1e-4"]);
    assert!(message.contains("no key optimizer.learning_rate"), "{message}");
    assert!(message.contains("optimizer.learning-rate"), "{message}");
}

#[test]
fn values_of_another_type_or_out_of_range_are_refused() {
    for (setting, expected) in [
        ("data.crop=large", "a whole number"),
        ("data.crop=8.5", "a whole number"),
        ("seed=-1", "a whole number"),
        ("loss.l1=much", "a number"),
        ("data.shuffle=maybe", "true or false"),
        ("validation.lpips-linear=1", "text"),
    ] {
        let message = message("", &["iterations=2", setting, "data.batch=1"]);
        assert!(message.starts_with(&format!("--set {setting}: ")), "{message}");
        assert!(message.contains(&format!("expected {expected}")), "{message}");
    }
    assert!(message("", &["data.batch=0"]).contains("data.batch: must be at least 1"));
    let large = message("", &["data.batch=100000000"]);
    assert!(large.contains("data.batch: 100000000 × 256 × 256 pixels take 150000000 MiB"), "{large}");
    assert!(message("", &["data.crop=4000000000"]).contains("data.batch: 1 × 4000000000"));
    assert!(message("", &["data.accumulate=100000000"]).contains("at most 16777216"));
    assert!(message("", &["data.kernels=[]"]).contains("data.kernels: names no kernel"));
    assert!(message("", &["data.kernels=3"]).contains("expected \"all\", or a list of names"));
    assert!(message("", &["optimizer.beta1=1.0"]).contains("optimizer.beta1"));
    assert!(message("", &["loss.relative-floor=2"]).contains("loss.relative-floor: must be between 0 (off)"));
    assert!(message("", &["loss.l1=0"]).contains("loss.l1: must be positive, or 0 where loss.l2 is"));
    assert!(message("", &["loss.l1=0", "loss.l2=-1"]).contains("loss.l2: must be 0 (off) or positive"));
    assert!(message("", &["loss.perceptual.weight=-1"]).contains("loss.perceptual.weight: must be 0 (off)"));
    assert!(message("", &["architecture.kind=unet"]).contains("must be \"none\""));
    assert!(message("", &["architecture.kind=sftmd", "initialisation=paper"]).contains("\"released\""));
    assert!(message("", &["schedule.minimum=1.0"]).contains("schedule.minimum"));
    assert!(message("", &["data.crop"]).contains("expected key.path=value"));
    assert!(message("", &["validation.best=lpips"]).contains("validation.best"));
    assert!(message("", &["validation.metrics=[\"ssim\"]"]).contains("validation.best: must be one of"));
    assert!(message("", &["validation.crop=10"]).contains("at least 11 for ssim"));
}

#[test]
fn only_what_cannot_change_the_network_may_change_when_resuming() {
    let before = TrainConfig::default();
    let mut after = before.clone();
    (after.iterations, after.checkpoint.keep) = (5, 9);
    (after.log_every, after.data.cache_mib) = (3, 100);
    assert_eq!(after.first_difference(&before), None);
    after.optimizer.beta2 = 0.99;
    assert_eq!(after.first_difference(&before).unwrap(), "optimizer.beta2 is 0.99 and was 0.999");
}
