//! Draws what an example is made of, from the seed and its number alone.

use rand::RngExt as _;

use super::config::{ExamplesConfig, Range};
use super::panoramas::PanoramaFile;
use crate::core::image::CHANNELS;
use crate::core::rng::{self, Rng};
use crate::dataset::Split;
use crate::restore::deconvolution::Border;
use crate::scenes::natural::NaturalKind;

/// What an example is made of.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Recipe {
    /// The example's number, from 0.
    pub(super) index: usize,
    /// What it is for.
    pub(super) split: Split,
    /// Number of the panel.
    pub(super) panel: usize,
    /// How far the panel is turned.
    pub(super) angle_deg: f64,
    /// What is seen.
    pub(super) scene: SceneRecipe,
    /// The median of its green light.
    pub(super) brightness: f64,
    /// What lies beyond the border.
    pub(super) border: Border,
    /// The irradiance at which green saturates.
    pub(super) x_max: f64,
    /// The sensor; none without noise.
    pub(super) sensor: Option<SensorRecipe>,
    /// What sets it apart from the simulator's captures.
    pub(super) harder: Option<HarderRecipe>,
}

/// Where a scene comes from.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum SceneRecipe {
    /// A view out of a panorama.
    Panorama {
        /// Number of the panorama.
        panorama: usize,
        /// Where the camera looks along the horizon.
        yaw_deg: f64,
        /// How far it looks up.
        pitch_deg: f64,
        /// How many pixels of the panorama a pixel spans.
        texels_per_pixel: f64,
    },
    /// Painted.
    Painted {
        /// What it shows.
        kind: NaturalKind,
        /// Of this seed.
        seed: u64,
    },
}

/// A sensor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct SensorRecipe {
    /// Electrons at white.
    pub(super) full_well_e: f64,
    /// Standard deviation of the read-out noise.
    pub(super) read_noise_e: f64,
    /// Bits of the converter.
    pub(super) bits: u32,
}

/// What sets an example apart from the simulator's captures.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct HarderRecipe {
    /// The gains of red, green and blue.
    pub(super) gains: [f64; CHANNELS],
    /// The share of the light that is stray.
    pub(super) stray_light: f64,
}

/// The bits of usual converters.
const BITS: [u32; 3] = [10, 12, 14];

impl Recipe {
    /// Draws the recipe of an example.
    pub(super) fn draw(config: &ExamplesConfig, panoramas: &[PanoramaFile], index: usize) -> Self {
        let mut rng = rng::stream(config.seed, &format!("example/{index}"));
        let split = split_of(index, config.validation_share);
        let scene = draw_scene(config, panoramas, split, &mut rng);
        let is_harder = happens(config.harder.share, &mut rng);
        let border = if happens(config.zero_border_share, &mut rng) && !is_harder {
            Border::Zero
        } else {
            Border::Smooth
        };
        let sensor = &config.sensor;
        let is_usual = happens(sensor.usual_share, &mut rng);
        Self {
            index,
            split,
            panel: rng.random_range(config.panels_of(split)),
            angle_deg: draw_even(config.panels.angle_deg, &mut rng),
            scene,
            brightness: draw_log(config.scenes.brightness, &mut rng),
            border,
            x_max: draw_log(if is_usual { sensor.usual_x_max } else { sensor.x_max }, &mut rng),
            sensor: (!happens(sensor.noise_free_share, &mut rng)).then(|| SensorRecipe {
                full_well_e: draw_log(sensor.full_well_e, &mut rng),
                read_noise_e: draw_log(sensor.read_noise_e, &mut rng),
                bits: BITS[rng.random_range(0..BITS.len())],
            }),
            harder: is_harder.then(|| HarderRecipe {
                gains: [
                    draw_log(config.harder.red_gain, &mut rng),
                    1.0,
                    draw_log(config.harder.blue_gain, &mut rng),
                ],
                stray_light: draw_log(config.harder.stray_light, &mut rng),
            }),
        }
    }

    /// The example's name, which its files begin with.
    pub(super) fn id(&self) -> String {
        format!("{:06}", self.index)
    }
}

/// Spreads the examples for validation evenly over all, whatever their number.
fn split_of(index: usize, share: f64) -> Split {
    let before = |count: usize| (count as f64 * share).floor();
    if before(index + 1) > before(index) { Split::Val } else { Split::Train }
}

fn draw_scene(
    config: &ExamplesConfig,
    panoramas: &[PanoramaFile],
    split: Split,
    rng: &mut Rng,
) -> SceneRecipe {
    let scenes = &config.scenes;
    if happens(scenes.procedural_share, rng) {
        // Every example has a painting of its own, whatever it is for.
        let seed: u64 = rng.random();
        let kind = match scenes.kinds.len() {
            0 => NaturalKind::of_seed(seed),
            count => scenes.kinds[rng.random_range(0..count)],
        };
        return SceneRecipe::Painted { kind, seed };
    }
    let of_split: Vec<usize> = (0..panoramas.len()).filter(|&i| panoramas[i].split == split).collect();
    SceneRecipe::Panorama {
        panorama: of_split[rng.random_range(0..of_split.len())],
        yaw_deg: draw_even([-180.0, 180.0], rng),
        pitch_deg: draw_even([-scenes.pitch_deg, scenes.pitch_deg], rng),
        texels_per_pixel: draw_log(scenes.texels_per_pixel, rng),
    }
}

/// Takes one number whatever the share is, so that what is drawn next does not depend on it.
fn happens(share: f64, rng: &mut Rng) -> bool {
    rng.random::<f64>() < share
}

fn draw_even([low, high]: Range, rng: &mut Rng) -> f64 {
    low + (high - low) * rng.random::<f64>()
}

fn draw_log([low, high]: Range, rng: &mut Rng) -> f64 {
    low * (high / low).powf(rng.random::<f64>())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn config() -> ExamplesConfig {
        ExamplesConfig { validation_share: 0.2, ..ExamplesConfig::default() }
    }

    fn panoramas() -> Vec<PanoramaFile> {
        let file = |(name, split): (&str, Split)| PanoramaFile {
            name: name.to_owned(),
            path: name.into(),
            sha256: String::new(),
            split,
        };
        [("a", Split::Train), ("b", Split::Val), ("c", Split::Train)].map(file).into()
    }

    fn recipes(count: usize) -> Vec<Recipe> {
        (0..count).map(|index| Recipe::draw(&config(), &panoramas(), index)).collect()
    }

    #[test]
    fn panels_and_panoramas_of_validation_are_never_learned_from() {
        let (panels, panoramas) = (config().panels, panoramas());
        let (mut seen, mut views) = (0, 0);
        for recipe in recipes(500) {
            let is_kept = recipe.panel >= panels.count - panels.validation;
            assert_eq!(is_kept, recipe.split == Split::Val, "{recipe:?}");
            seen += usize::from(is_kept);
            if let SceneRecipe::Panorama { panorama, .. } = recipe.scene {
                assert_eq!(panoramas[panorama].split, recipe.split);
                views += 1;
            }
        }
        assert_eq!(seen, 100, "a fifth");
        assert!((200..300).contains(&views), "{views}: half");
    }

    #[test]
    fn a_recipe_depends_on_seed_and_number_alone() {
        let mut more = config();
        more.count = 9;
        let draw = |config: &ExamplesConfig, index| Recipe::draw(config, &panoramas(), index);
        assert_eq!(draw(&config(), 7), draw(&more, 7));
        assert_ne!(draw(&config(), 7).angle_deg, draw(&config(), 8).angle_deg);
        let other = ExamplesConfig { seed: 1, ..config() };
        assert_ne!(draw(&config(), 7).angle_deg, draw(&other, 7).angle_deg);
    }

    /// Of 2000 drawings a share scatters by less than 0.012; three of these are allowed.
    #[test]
    fn kinds_come_as_often_as_is_said() {
        let recipes = recipes(2000);
        let share =
            |holds: &dyn Fn(&Recipe) -> bool| recipes.iter().filter(|r| holds(r)).count() as f64 / 2000.0;
        let near =
            |found: f64, expected: f64| assert!((found - expected).abs() < 0.036, "{found}, not {expected}");
        near(share(&|r| r.harder.is_some()), 0.5);
        near(share(&|r| r.sensor.is_none()), 0.15);
        near(share(&|r| r.border == Border::Zero), 0.125);
        // Usual ones, and a third of the others: log 8 of log 500.
        near(share(&|r| (4.0..=32.0).contains(&r.x_max)), 0.6 + 0.4 * 8f64.ln() / 500f64.ln());
        assert!(
            recipes.iter().all(|r| (1.0..=500.0).contains(&r.x_max) && (0.03..=0.5).contains(&r.brightness))
        );
    }
}
