"""How near images are."""

from . import _native
from ._given import source, tell


def _measure(metric, image, ground_truth, definition, domain, alpha, x_max):
    settings = {"metric": metric, "definition": definition, "domain": domain, "alpha": alpha, "x_max": x_max}
    value, notices = _native.measure(source(image, "image"), source(ground_truth, "ground_truth"), settings)
    tell(notices, stacklevel=4)
    return value


def psnr(image, ground_truth, *, definition="released", domain=None, alpha=0.25, x_max=500.0):
    """The PSNR in dB of an image against the ground truth, both tone-mapped, as `udc eval` measures it.

    Parameters
    ----------
    image, ground_truth : float32 [H, W, 3] or path
    definition : {"released", "float"}
        Round both to 8 bits first, as the published evaluation does, or not.
    domain : {"linear", "tone-mapped", "srgb"}, optional
        What both hold: by default what files say, and linear light for arrays, which is tone-mapped by x / (x + alpha) after it
        was clipped to [0, x_max].
    alpha, x_max : float
        Of the tone mapping, in units of irradiance.

    Returns
    -------
    float
        inf for equal images.
    """
    return _measure("psnr", image, ground_truth, definition, domain, alpha, x_max)


def ssim(image, ground_truth, *, definition="released", domain=None, alpha=0.25, x_max=500.0):
    """The SSIM of an image against the ground truth, both tone-mapped, as `udc eval` measures it; 1 for equal images.

    Windows are Gaussian, 11 pixels wide, of standard deviation 1.5. The parameters are those of `psnr`.
    """
    return _measure("ssim", image, ground_truth, definition, domain, alpha, x_max)
