//! Images of either domain, as the user tells of them.

use std::path::Path;

use anyhow::{Result, bail};

use udc::core::capture::CaptureInfo;
use udc::io::{AnyImage, DomainTag, Format, inspect_any_image};

use super::Session;
use super::domain::{DomainArg, OutputDomainArg};

/// Reads an image as `domain`, or as what the file says, or as linear, with what is known of its capture; integers must
/// be told. Warns of what the file says against it.
pub(crate) fn read_any(
    path: &Path,
    domain: Option<DomainArg>,
    session: &Session,
) -> Result<(AnyImage, Option<CaptureInfo>)> {
    let reading = inspect_any_image(path, domain.map(DomainTag::from))?;
    reading.contradiction.into_iter().for_each(|contradiction| session.warn(contradiction));
    Ok((reading.image, reading.info))
}

/// The domain that is written: the one that is asked for, or that of the input.
pub(crate) fn domain_of_output(asked: Option<OutputDomainArg>, input: &AnyImage) -> DomainTag {
    asked.map_or(input.domain(), DomainTag::from)
}

/// Refuses linear light in a file of integers, before the work.
pub(crate) fn check_domain_of_output(path: &Path, domain: DomainTag) -> Result<()> {
    let holds_floats = matches!(Format::of_extension(path)?, Format::Exr | Format::Npy | Format::Hdr);
    if domain == DomainTag::Linear && !holds_floats {
        bail!(
            "{} cannot hold linear light above one: add --output-domain tone-mapped, or write .exr or .npy",
            path.display()
        );
    }
    Ok(())
}
