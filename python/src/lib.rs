//! The crate `udc` for Python: the functions behind the package's own, which give them defaults, names and documentation.

mod bank;
mod degrade;
mod error;
mod files;
mod finish;
mod fuse;
mod metrics;
mod psf;
mod restore;
mod source;
mod work;

/// The compiled part of the package.
#[pyo3::pymodule(gil_used = false)]
mod _native {
    #[pymodule_export]
    use crate::bank::{KernelBank, codes_of, project, read_bank, write_bank};
    #[pymodule_export]
    use crate::degrade::Degrader;
    #[pymodule_export]
    use crate::files::{read_image, read_psf, write_image_file};
    #[pymodule_export]
    use crate::finish::finish;
    #[pymodule_export]
    use crate::fuse::fuse;
    #[pymodule_export]
    use crate::metrics::measure;
    #[pymodule_export]
    use crate::psf::simulate_psf;
    #[pymodule_export]
    use crate::restore::restore;
    #[pymodule_export]
    use crate::work::set_threads;

    #[pymodule_export]
    const VERSION: &str = env!("CARGO_PKG_VERSION");
}
