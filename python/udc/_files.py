"""Files: images, PSFs, kernel banks."""

from pathlib import Path

import numpy as np

from . import _native
from ._given import files, info_of, info_text, path_of, source, tell
from ._native import KernelBank


def read(path, *, domain=None, return_info=False):
    """Reads an image: OpenEXR, .npy, PNG, TIFF, JPEG, Radiance HDR, DNG; or a kernel bank (.safetensors).

    A DNG is developed to linear light, as `udc restore` does.

    Parameters
    ----------
    path : str or PathLike
    domain : {"linear", "tone-mapped", "srgb"}, optional
        What the file holds: sRGB is decoded to linear light. By default what the file says, else linear; required for files of
        8 and 16 bits that do not say it.
    return_info : bool
        Also return what is known of the capture: a dict that `restore`, `finish` and `write` take as `info`.

    Returns
    -------
    image : float32 [H, W, 3], or KernelBank
    info : dict, with return_info
        "domain" is that of the values; "saturation" the light at which red, green and blue saturate; "orientation",
        "white-balance", "color", "baseline-exposure-ev" what a camera says.
    """
    path = path_of(path)
    if Path(path).suffix.lower() == ".safetensors":
        return read_bank(path)
    image, found, info, notices = _native.read_image(path, domain)
    tell(notices)
    return (image, {"domain": found, **info_of(info)}) if return_info else image


def read_psf(path, *, domain=None, recenter=False):
    """Reads a PSF, float32 [h, w, 3], non-negative and of unit sum in each channel.

    Parameters
    ----------
    path : str or PathLike
    domain : {"linear", "srgb"}, optional
        What the file holds; required for files of 8 and 16 bits that do not say it.
    recenter : bool
        Move a peak that is not at the centre, index N // 2, there.
    """
    psf, notices = _native.read_psf(path_of(path), domain, recenter)
    tell(notices)
    return psf


def read_bank(path):
    """Reads a kernel bank (.safetensors)."""
    return _native.read_bank(path_of(path))


def write(path, image, *, domain=None, info=None, bits=None, color_space="srgb", half=False, overwrite=False):
    """Writes an image, a PSF or a kernel bank in the format of the path's extension: whole, or not at all.

    Parameters
    ----------
    path : str or PathLike
        .exr, .npy, .png, .tif, .jpg, .hdr; a bank .safetensors. Linear light above 1 needs .exr, .npy or .hdr.
    image : array [H, W, 3], or KernelBank
        uint8 and uint16 are pictures for viewing, as `finish` returns them.
    domain : {"linear", "tone-mapped", "display"}, optional
        What the values are; by default that of `info`, else "display" for integers and "linear" for floats.
    info : dict, optional
        What is known of the capture; OpenEXR carries it.
    bits : {8, 16}, optional
        Bits of PNG and TIFF of display values; by default those of the array, and 16 for floats.
    color_space : {"srgb", "display-p3"}
        What red, green and blue of display values are: PNG, JPEG and TIFF carry the profile.
    half : bool
        Half floats, in formats that have them.
    overwrite : bool
        Replace a file that exists.
    """
    if isinstance(image, KernelBank):
        _native.write_bank(path_of(path), image, overwrite)
        return
    dtype = getattr(image, "dtype", None)
    is_integer = dtype in (np.uint8, np.uint16)
    info = dict(info) if info else {}
    said = info.pop("domain", None)
    usual = "display" if is_integer else (said or "linear")
    settings = {
        "domain": domain or usual,
        "color_space": color_space,
        "half": half,
        "overwrite": overwrite,
        "eight_bit": bits == 8 or (bits is None and dtype == np.uint8),
        "info": info_text(info),
    }
    _native.write_image_file(path_of(path), source(image, "image"), settings)


def project(bank, psf, *, domain=None, recenter=False):
    """Finds the code of a PSF in a bank, as `udc codes --project` does.

    Parameters
    ----------
    bank : KernelBank or path
    psf : float32 [h, w, 3] or path

    Returns
    -------
    code : float32 [b]
    residual : float
        The share of the PSF (of its norm) that lies outside of what the bank can describe.
    fits : bool
        Whether the bank can describe the PSF.
    """
    bank = bank if isinstance(bank, KernelBank) else read_bank(bank)
    with files() as given:
        code, residual, fits, notices = _native.project(bank, given.of(psf, "psf"), domain, recenter)
        tell(notices, given, stacklevel=4)
    return code, residual, fits
