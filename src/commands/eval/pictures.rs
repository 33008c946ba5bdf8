//! Keeps some of the measured images as pictures to look at.

use std::path::PathBuf;

use udc::core::error::Result;
use udc::core::image::ToneMappedImage;
use udc::core::io::{self, WriteOptions};
use udc::eval::{Method, Sample};

/// Which samples are kept as pictures, and where.
pub(in crate::commands) struct Pictures {
    pub(in crate::commands) folder: PathBuf,
    pub(in crate::commands) count: usize,
    /// What their names begin with.
    pub(in crate::commands) prefix: String,
}

impl Pictures {
    /// Writes the images of sample `index` of `total` if it is one of those to keep, which are spread evenly.
    pub(super) fn keep(
        &self,
        (index, total): (usize, usize),
        scene: &str,
        methods: &[Method],
        sample: &Sample,
    ) -> Result<()> {
        let count = self.count.min(total);
        if !(0..count).any(|k| k * total / count == index) {
            return Ok(());
        }
        io::create_folder(&self.folder)?;
        let scene = &format!("{}{scene}", self.prefix);
        for (position, (method, image)) in methods.iter().zip(&sample.images).enumerate() {
            // A dot separates the scene from what the picture shows.
            let name = method.name.trim_end_matches(".safetensors").replace(['/', '\\', '.'], "-");
            self.write(scene, &format!("{}-{name}", position + 1), image)?;
        }
        self.write(scene, "9-ground truth", &sample.ground_truth)
    }

    fn write(&self, scene: &str, what: &str, image: &ToneMappedImage) -> Result<()> {
        let path = self.folder.join(format!("{scene}.{what}.png"));
        let shown: ToneMappedImage = image.map_values(|value| value.clamp(0.0, 1.0));
        io::write_image(&path, &shown, &WriteOptions { overwrite: true, ..WriteOptions::default() })
    }
}
