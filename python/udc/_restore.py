"""From a capture to a photograph."""

import json

import numpy as np

from . import _native
from ._errors import UdcError
from ._given import files, info_of, info_text, is_path, path_of, source, tell
from ._native import KernelBank


def restore(
    capture,
    psf=None,
    *,
    bank=None,
    angle=None,
    field=None,
    code=None,
    psf_domain=None,
    recenter=False,
    model=None,
    method=None,
    refine=None,
    true_highlights=False,
    pose=None,
    noise=None,
    balance=None,
    border=None,
    iterations=None,
    mask_saturated=False,
    seed=None,
    domain=None,
    output_domain=None,
    highlights="restored",
    precision="f32",
    tile=None,
    max_memory="2GiB",
    alpha=None,
    x_max=None,
    info=None,
    return_info=False,
):
    """Restores a capture, as `udc restore` does: of any panel, given its PSF; or by a network of your own, or by deconvolution.

    With neither model nor method, the capture is deconvolved, the light of lamps that the sensor clipped and the pose of the
    panel are measured by their flare, and the guided network corrects the result.

    Parameters
    ----------
    capture : float32 [H, W, 3] or path
        Also a DNG. A bracket is fused first: `fuse`.
    psf : float32 [h, w, 3] or path
        PSF of the panel: what a deconvolution and the guided restoration need, or what `bank` turns into a code.
    bank : KernelBank or path, optional
        Kernel bank that the model was trained with.
    angle : float or "auto", optional
        Rotation of the panel in degrees, counter-clockwise, with bank; "auto" finds it in the capture (not guided).
    field : path, optional
        PSFs of several places of the frame (.toml), with bank and model.
    code : float32 [b] or path, optional
        The kernel code itself, for a model.
    psf_domain, recenter :
        How the PSF is read, as `domain` and `recenter` in `read_psf`.
    model : path, optional
        Network to restore with (.safetensors, or a PyTorch .pth); "guided" is the one for any panel.
    method : {"wiener", "wiener-orieux", "richardson-lucy", "constrained", "joint"}, optional
        Deconvolution to restore with.
    refine : float, optional
        How much of the guided network's corrections to take, from 0 (the deconvolution) to 1, which is the default.
    true_highlights : bool
        Give lamps the light that their flare tells, far above what saturates (guided, with highlights "restored").
    pose : path or "psf", optional
        Pose of the panel, a file of `udc pose`; "psf" takes the PSF as it is. By default what the flare tells (guided).
    noise : str, optional
        The capture's noise, as in `Degrader`; by default it is estimated (guided, joint).
    balance : float, optional
        Weight of smoothness against fidelity (wiener), 0.01 by default.
    border : {"smooth", "periodic", "zero"}, optional
        What lies beyond the frame: a scene that goes on, the frame again, darkness (method, guided).
    iterations : int, optional
        Largest number of iterations (richardson-lucy, constrained), 30 by default.
    mask_saturated : bool
        Treat saturated pixels as unknown (wiener, wiener-orieux).
    seed : int, optional
        Of the random numbers (wiener-orieux), 0 by default.
    domain : {"linear", "tone-mapped", "srgb"}, optional
        What the capture holds; by default what a file or info says, else linear; required for integers.
    output_domain : {"linear", "tone-mapped"}, optional
        What to return; by default the same as the capture.
    highlights : {"restored", "keep", "blend"}
        What to do where the capture is saturated.
    precision : {"f32", "bf16"}
        Of the network.
    tile : int, optional
        Side of the tiles, by default as max_memory allows.
    max_memory : str
        Memory to stay under: "2GiB", "500MB".
    alpha, x_max : float, optional
        Irradiance that the tone mapping maps to one half, and at which the capture saturates; by default those of the model's
        training, else 0.25 and 500.
    info : dict, optional
        What is known of the capture, as read, fuse and degrade return it: the light at which it saturates.
    return_info : bool
        Also return what is known of the capture, for `finish` and `write`, with what was found in it under "found": the
        panel's angle and pose, the light of lamps, the levels at which it saturates.

    Returns
    -------
    restored : float32 [H, W, 3]
    info : dict, with return_info
    """
    info, domain = _known(info, domain)
    settings = {
        "angle": None if angle is None or angle == "auto" else float(angle),
        "search_angle": isinstance(angle, str) and angle == "auto",
        "field": None if field is None else path_of(field),
        "psf_domain": psf_domain,
        "recenter": recenter,
        "model": model if model is None or model == "guided" else path_of(model),
        "method": method,
        "refine": refine,
        "true_highlights": true_highlights,
        "pose": None if pose is None or pose == "psf" else path_of(pose),
        "pose_of_psf": isinstance(pose, str) and pose == "psf",
        "noise": noise,
        "balance": balance,
        "border": border,
        "iterations": iterations,
        "mask_saturated": mask_saturated,
        "seed": seed,
        "domain": domain,
        "output_domain": output_domain,
        "highlights": highlights,
        "precision": precision,
        "tile": tile,
        "max_memory": max_memory,
        "alpha": alpha,
        "x_max": x_max,
    }
    with files() as given:
        settings["psf"] = given.of(psf, "psf")
        settings["code"] = given.of(code, "code")
        settings["bank"] = _bank_file(bank, given)
        made = _native.restore(source(capture, "capture"), info, settings)
        restored, found_domain, known, found, notices = made
        tell(notices, given)
    if not return_info:
        return restored
    return restored, {"domain": found_domain, **info_of(known), "found": json.loads(found)}


def finish(
    image,
    *,
    domain=None,
    ccm=None,
    no_ccm=False,
    reference=None,
    orientation=None,
    saturation=None,
    baseline_exposure=None,
    clip=None,
    no_clip=False,
    curve=None,
    gamma=None,
    max=None,
    roll_off=None,
    color_space="srgb",
    noise=None,
    clip_limit=None,
    grid=None,
    no_clahe=False,
    bits=8,
    alpha=None,
    x_max=None,
    info=None,
):
    """Finishes an image for viewing, as `udc finish` does: colour matrix, curve, reference scaling, local contrast.

    The exposure is chosen from the picture, unless there is a reference or an argument of the curve.

    Parameters
    ----------
    image : float32 [H, W, 3] or path
    domain : {"linear", "tone-mapped", "srgb"}, optional
        What the image holds; by default what a file or info says, else linear.
    ccm : float [3, 3] or path, optional
        Colour matrix, row i being what output channel i takes of red, green and blue; by default that of the camera, if info says
        it, which no_ccm leaves out.
    reference : array [H, W, 3] or path, optional
        Picture, of any size, whose channel means to take over.
    orientation : int, optional
        How the picture lies, as EXIF numbers it, from 1 to 8.
    saturation : (r, g, b), optional
        Light at which the capture clips; what is clipped is made neutral.
    baseline_exposure : float, optional
        Stops by which the camera wants its captures brightened.
    clip : float, optional
        Light above which the image is clipped before the colour matrix: 16 by default, none with an automatic exposure or
        no_clip.
    curve : {"gamma", "srgb", "aces", "none"}, optional
        How light becomes display values; by default gamma with a reference, gamma or max, else photographic.
    gamma : float, optional
        Of curve "gamma", 2.8 by default.
    max : float, optional
        Light that is shown as white: 6 for gamma by default, else 1.
    roll_off : {"hue", "channels"}, optional
        How highlights roll off; by default "hue" with an automatic exposure, else "channels".
    color_space : {"srgb", "display-p3"}
        Colours of the picture; `write` embeds their profile.
    noise : float or "auto", optional
        Noise whose local contrast is not raised: its standard deviation in 8-bit codes of lightness, "auto" to estimate it, 0 for
        none; by default "auto" with an automatic exposure, else 0.
    clip_limit, grid : float and int, optional
        Of CLAHE: height to which histograms are cut (1), tiles on each side (8); no_clahe leaves it out.
    bits : {8, 16, 32}
        8 and 16 are what PNGs of so many bits hold, 32 is what an OpenEXR holds.
    alpha, x_max : float, optional
        Of the tone mapping of tone-mapped images; by default what their file says, else 0.25 and 500.
    info : dict, optional
        What is known of the capture, as restore, fuse and read return it.

    Returns
    -------
    picture : uint8, uint16 or float32 in [0, 1], [H, W, 3], upright
    """
    info, domain = _known(info, domain)
    settings = {
        "domain": domain,
        "no_ccm": no_ccm,
        "orientation": orientation,
        "saturation": None if saturation is None else [float(level) for level in saturation],
        "baseline_exposure": baseline_exposure,
        "clip": clip,
        "no_clip": no_clip,
        "curve": curve,
        "gamma": gamma,
        "max": max,
        "roll_off": roll_off,
        "color_space": color_space,
        "noise": None if noise is None or noise == "auto" else float(noise),
        "estimate_noise": isinstance(noise, str),
        "clip_limit": clip_limit,
        "grid": grid,
        "no_clahe": no_clahe,
        "bits": bits,
        "alpha": alpha,
        "x_max": x_max,
    }
    with files() as given:
        settings["ccm"] = _matrix_file(ccm, given)
        reference = None if reference is None else source(reference, "reference")
        picture, notices = _native.finish(source(image, "image"), info, reference, settings)
        tell(notices, given)
    return picture


def _known(info, domain):
    """What is known of the capture for the compiled part, and the domain, which info may say."""
    if info is None:
        return None, domain
    info = dict(info)
    said = info.pop("domain", None)
    info.pop("found", None)
    if domain is None and said == "tone-mapped":
        domain = said
    return info_text(info), domain


def _bank_file(bank, given):
    if not isinstance(bank, KernelBank):
        return None if bank is None else path_of(bank)
    path = given.new("bank.safetensors")
    _native.write_bank(path, bank, False)
    return path


def _matrix_file(ccm, given):
    if ccm is None or is_path(ccm):
        return None if ccm is None else path_of(ccm)
    matrix = np.asarray(ccm, dtype=np.float64)
    if matrix.shape != (3, 3):
        raise UdcError(f"ccm: expected a matrix [3, 3], found shape {list(matrix.shape)}")
    path = given.new("ccm.npy")
    np.save(path, matrix)
    return path
