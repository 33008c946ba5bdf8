"""From a bracket or a display to a PSF, and from PSFs to codes."""

import json
import os

import numpy as np

from . import _native
from ._errors import UdcError
from ._given import files, info_of, is_path, path_of, tell


def fuse(
    pictures,
    *,
    exposures=None,
    estimate_exposures=False,
    white=None,
    black=None,
    bayer=None,
    white_balance=None,
    merge="longest",
    allow_motion=False,
    dark=None,
    dark_exposures=None,
    domain=None,
    mask=None,
    point_source=False,
    size=None,
    normalize=None,
    return_info=False,
):
    """Fuses a bracket of exposures to one linear HDR image or PSF, as `udc fuse` does.

    Parameters
    ----------
    pictures : list of arrays or paths
        Arrays are [H, W, 3], [H, W] (a mosaic, with `bayer`) or [H, W, 4] (a packed one), of float16, float32, float64, uint8 or
        uint16. DNGs say times, levels, mosaic and gains themselves.
    exposures : list of float, optional
        Exposure times in the order of the pictures, of which only the ratios count; pictures of one time are averaged. By
        default what files say, else 1, 1/4, 1/16, and 1, 1/32, 1/768 with point_source.
    estimate_exposures : bool
        Take the ratios of the times from the pictures.
    white, black : float, optional
        Values of a full and of a dark photosite as the pictures have them; above 1 in their integers: white=16383, black=64.
    bayer : {"rggb", "bggr", "grbg", "gbrg"}, optional
        Colours of the first two rows of a mosaic.
    white_balance : (r, g, b), optional
        Gains of red, green and blue.
    merge : {"longest", "weighted"}
        Take the longest unsaturated exposure, or the mean of all weighted by time.
    allow_motion : bool
        Fuse exposures even if the camera moved by more than a pixel between them.
    dark : list of arrays or paths, optional
        Pictures taken with the cap on, and their times, `dark_exposures`, in the unit of `exposures`.
    domain : {"linear", "srgb"}, optional
        What the pictures hold; required for integers without levels.
    mask : bool [H, W] or path, optional
        False (black) where pixels are to be discarded and filled from their neighbours.
    point_source : bool
        The bracket is of a point source: cut out its PSF, a square of `size` pixels (800), of which each channel sums to one
        (normalize="channel"), all together to three ("total"), or nothing ("none").
    return_info : bool
        Also return what is known of the capture, for `restore`, `finish` and `write`.

    Returns
    -------
    light : float32 [H, W, 3] in units of white of the longest exposure; or the PSF, float32 [size, size, 3]
    info : dict, with return_info
    """
    if not point_source and (size is not None or normalize is not None):
        raise UdcError("size and normalize belong to point_source=True: leave them out, or add it")
    if dark_exposures is not None and (dark is None or exposures is None):
        raise UdcError("dark_exposures belongs to dark and exposures: give both")
    settings = {
        "exposures": _numbers(exposures),
        "estimate_exposures": estimate_exposures,
        "white": white,
        "black": black,
        "bayer": bayer,
        "white_balance": _numbers(white_balance),
        "merge": merge,
        "allow_motion": allow_motion,
        "dark_exposures": _numbers(dark_exposures),
        "domain": domain,
        "point_source": point_source,
        "size": size,
        "normalize": normalize,
    }
    with files() as given:
        settings["dark"] = given.of_each(dark, "dark")
        is_array = mask is not None and not is_path(mask)
        settings["mask"] = given.of(np.asarray(mask, dtype=bool).astype(np.uint8) * 255 if is_array else mask, "mask")
        light, info, notices = _native.fuse(given.of_each(pictures, "pictures"), settings)
        tell(notices, given)
    return (light, {"domain": "linear", **info_of(info)}) if return_info else light


def simulate_psf(
    display=None,
    *,
    random=None,
    from_=None,
    size=None,
    domain=None,
    recenter=False,
    turn=0.0,
    scale=0.0,
    defocus=0.0,
    noise=0.0,
    reach=None,
    seed=0,
    return_display=False,
):
    """Simulates a PSF from a display layout by light propagation, as `udc psf` does.

    Parameters
    ----------
    display : path or dict, optional
        Display file (TOML), or its contents: what `return_display` returns, or tomllib.loads makes of the file.
    random : int, optional
        Draw a plausible panel with lens, sensor and light at random: the same for the same seed.
    from_ : float32 [h, w, 3] or path, optional
        A PSF that there is, to give it a measurement's errors. One of display, random and from_ is needed.
    size : int, optional
        Side of the square PSF in pixels, instead of the display's, or of the 401 of a random panel.
    domain, recenter :
        How the PSF of from_ is read, as in `read_psf`.
    turn : float
        Errors of a measurement: turned by so many degrees, counter-clockwise,
    scale : float
        larger by this share,
    defocus : float
        blurred by this standard deviation in pixels,
    noise : float
        noise of this standard deviation where it is dark, as a share of the brightest pixel, drawn by `seed`,
    reach : int, optional
        cut off: only a square of this side was measured.
    return_display : bool
        Also return the display as a dict (None with from_).

    Returns
    -------
    psf : float32 [size, size, 3], each channel of unit sum
    """
    if sum(given is not None for given in (display, random, from_)) != 1:
        raise UdcError("name one of display, random and from_: a display file, the seed of a random panel, or a PSF")
    if from_ is None and (domain is not None or recenter):
        raise UdcError("domain and recenter are for a PSF that is read with from_: leave them out")
    if from_ is not None and size is not None:
        raise UdcError("size is of simulated PSFs: leave it out, or cut the PSF by reach")
    settings = {
        **_display(display),
        "random": random,
        "size": size,
        "domain": domain,
        "recenter": recenter,
        "turn": turn,
        "scale": scale,
        "defocus": defocus,
        "noise": noise,
        "reach": reach,
        "seed": seed,
    }
    with files() as given:
        settings["from_"] = given.of(from_, "from_")
        psf, found, notices = _native.simulate_psf(settings)
        tell(notices, given)
    return (psf, found and json.loads(found)) if return_display else psf


def codes(psfs=None, *, display=None, size=None, angles=None, dim=5, domain=None, recenter=False):
    """Makes kernel codes, as `udc codes` does: rotates a PSF, and finds the PCA basis of the rotations.

    Parameters
    ----------
    psfs : float32 [h, w, 3] or path, or a list of them
        One PSF is rotated to each of the angles, by interpolation; several are the set as they are.
    display : path or dict, optional
        Display of a panel to turn and simulate instead, with PSFs of `size` pixels: exact, nothing is interpolated.
    angles : list of float or str, optional
        Degrees, counter-clockwise; or "start:stop:step". By default -12:12:3.
    dim : int
        Length of a kernel code.
    domain, recenter :
        How PSFs are read, as in `read_psf`.

    Returns
    -------
    KernelBank
    """
    if (psfs is None) == (display is None):
        raise UdcError("name either psfs or a display")
    if display is not None and (domain is not None or recenter):
        raise UdcError("domain and recenter are for PSFs that are read: leave them out with display")
    if display is None and size is not None:
        raise UdcError("size is of PSFs that are simulated, with display: leave it out")
    with files() as given:
        paths = given.of_each(psfs, "psfs") or []
        if display is None and not paths:
            raise UdcError("psfs: expected at least one PSF, found none")
        if angles is not None and len(paths) > 1:
            count = len(paths)
            raise UdcError(f"angles rotates one PSF, and {count} were given; leave it out to use them as the set")
        settings = {
            "psfs": paths,
            **_display(display),
            "size": size,
            "angles": None if isinstance(angles, str) else _numbers(angles),
            "angles_text": angles if isinstance(angles, str) else None,
            "dim": dim,
            "domain": domain,
            "recenter": recenter,
        }
        bank, notices = _native.codes_of(settings)
        tell(notices, given)
    return bank


def _display(display):
    if display is None or is_path(display):
        path = None if display is None else path_of(os.fspath(display))
        return {"display": path, "description": None}
    try:
        return {"display": None, "description": json.dumps(display)}
    except TypeError as error:
        raise UdcError(f"display: expected a path or a dict: {error}") from error


def _numbers(numbers):
    return None if numbers is None else [float(number) for number in numbers]
