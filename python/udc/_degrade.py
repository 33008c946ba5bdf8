"""The image formation model."""

import json
import operator

import numpy as np

from . import _native
from ._errors import UdcError
from ._files import KernelBank, read_bank
from ._given import files, source, tell


class Degrader:
    """Degrades scenes by the image formation model C(x∗k + n), as `udc synth` does, many of one size fast.

    What is transformed of the kernels is kept for scenes of the same size. An object may be used by several threads at once, and
    can be pickled, so that the workers of a data loader have it.

    Parameters
    ----------
    psf : float32 [h, w, 3] or path, optional
        The PSF k.
    bank : KernelBank or path, optional
        Several of them, instead.
    psf_domain : {"linear", "srgb"}, optional
    recenter : bool
        How the PSF is read, as in `read_psf`.
    preset : {"paper", "released"}
        Where the paper and its released data differ, take the values of one of them: "released" clips the scene to x_max before
        the convolution.
    x_max : float, optional
        Irradiance at which the sensor saturates; by default that of a sensor's noise, else 500.
    alpha : float, optional
        Of the tone mapping; images stay linear, so that it changes none.
    border : {"zero", "replicate", "reflect"}, optional
        What lies beyond the scene's border: darkness, its outermost pixels, or its mirror image.
    margin : int
        Pixels by which scenes are larger than the frame on each side: lamps there throw light into the frame.
    clip_ground_truth : bool
        Clip the scene to [0, x_max] before the convolution.
    noise : str
        n: "none", "gaussian:SIGMA" in units of irradiance, "sensor", "sensor:FILE.toml".
    seed : int
        Of the noise.
    domain : {"linear", "srgb"}, optional
        What the scenes hold; required for integers.
    """

    def __init__(
        self,
        psf=None,
        *,
        bank=None,
        psf_domain=None,
        recenter=False,
        preset="paper",
        x_max=None,
        alpha=None,
        border=None,
        margin=0,
        clip_ground_truth=False,
        noise="none",
        seed=0,
        domain=None,
    ):
        if (psf is None) == (bank is None):
            raise UdcError("name either a psf or a bank")
        self._given = dict(
            psf=psf,
            bank=bank,
            psf_domain=psf_domain,
            recenter=recenter,
            preset=preset,
            x_max=x_max,
            alpha=alpha,
            border=border,
            margin=margin,
            clip_ground_truth=clip_ground_truth,
            noise=noise,
            seed=seed,
            domain=domain,
        )
        if bank is not None and not isinstance(bank, KernelBank):
            bank = read_bank(bank)
        notices = []
        with files() as given:
            settings = {key: value for key, value in self._given.items() if key != "bank"}
            settings["psf"] = given.of(psf, "psf")
            self._native = _native.Degrader(bank, settings, notices)
            tell(notices, given)

    def __reduce__(self):
        given = dict(self._given)
        if isinstance(given["bank"], KernelBank):
            with files() as made:
                path = made.new("bank.safetensors")
                _native.write_bank(path, given["bank"], False)
                with open(path, "rb") as file:
                    given["bank"] = file.read()
        return _unpickled, (given,)

    def __len__(self):
        """The number of kernels."""
        return len(self._native)

    @property
    def names(self):
        """The names of the kernels, as datasets have them: r-12, r+03, or k01."""
        return self._native.names

    @property
    def info(self):
        """What is known of the images that it makes: the light at which they saturate, for `restore` and `write`."""
        return {"domain": "linear", **json.loads(self._native.info)}

    def __call__(self, scene, kernel=0, *, name="scene"):
        """Degrades a scene, float32 [H, W, 3], to the frame, float32 [H - 2·margin, W - 2·margin, 3].

        `kernel` is the index of one of the bank's kernels, or its name. `name` decides the noise, together with the seed and the
        kernel's name: scenes of different names have different noise. `udc synth` takes the names of the files without extension.
        """
        if isinstance(kernel, str):
            if kernel not in self.names:
                raise UdcError(f"kernel: must be one of {', '.join(self.names)}, found {kernel!r}")
            kernel = self.names.index(kernel)
        kernel = operator.index(kernel)
        if not 0 <= kernel < len(self):
            raise UdcError(f"kernel: must be from 0 to {len(self) - 1}, found {kernel}")
        degraded, notices = self._native.degrade_by(source(scene, "scene"), kernel, name)
        tell(notices)
        return degraded

    def ground_truth(self, scene):
        """C(x) of the frame: the scene as a camera without a display records it, without noise."""
        return self._native.ground_truth(source(scene, "scene"))


def _unpickled(given):
    if isinstance(given["bank"], bytes):
        with files() as made:
            path = made.new("bank.safetensors")
            with open(path, "wb") as file:
                file.write(given["bank"])
            given = {**given, "bank": read_bank(path)}
    return Degrader(**given)


def degrade(scene, psf=None, *, bank=None, kernel=None, name="scene", return_info=False, **formation):
    """Degrades a scene as `udc synth` does: C(x∗k + n).

    Parameters
    ----------
    scene : float32 [H, W, 3] or path
        Linear light x, in units of white of the longest exposure.
    psf : float32 [h, w, 3] or path, optional
    bank : KernelBank or path, optional
        The PSF k, or several of them.
    kernel : int or str, optional
        Index or name of the only kernel of the bank to take; by default all.
    name : str
        What decides the noise, together with the seed.
    return_info : bool
        Also return what is known of the result: the light at which it saturates.
    **formation :
        The image formation model: psf_domain, recenter, preset, x_max, alpha, border, margin, clip_ground_truth, noise, seed and
        domain, as in `Degrader`, which is faster for many scenes.

    Returns
    -------
    degraded : float32 [H, W, 3] less the margin; [K, H, W, 3] for all kernels of a bank
    info : dict, with return_info
    """
    degrader = Degrader(psf, bank=bank, **formation)
    if bank is None or kernel is not None:
        degraded = degrader(scene, 0 if kernel is None else kernel, name=name)
    else:
        degraded = np.stack([degrader(scene, index, name=name) for index in range(len(degrader))])
    return (degraded, degrader.info) if return_info else degraded
