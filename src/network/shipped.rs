//! The models that the program carries.

use std::path::Path;

/// The name of the network that restores captures of any panel.
pub const GUIDED: &str = "guided";

/// Its weights; `assets/README.md` says what they were trained on.
static GUIDED_FILE: &[u8] = include_bytes!("../../assets/guided.safetensors");

/// The bytes of the model that a name stands for, unless a file of that name is there.
pub fn shipped(name: &Path) -> Option<&'static [u8]> {
    (name == Path::new(GUIDED) && !name.exists()).then_some(GUIDED_FILE)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::network::{Kind, Model};

    #[test]
    fn the_guided_network_is_carried_in_half_precision_and_reads_like_a_file() {
        let model = Model::load(Path::new(GUIDED)).unwrap();
        assert_eq!(model.architecture().kind, Kind::Guided);
        assert!(GUIDED_FILE.len() <= 3 << 20, "{} bytes", GUIDED_FILE.len());
        assert!(shipped(Path::new("guided.safetensors")).is_none());
    }
}
