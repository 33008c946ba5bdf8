"""Under-display camera imaging: from a measured panel to a restored photograph.

Images are float32 [H, W, 3], red, green and blue, row 0 on top; PSFs are float32 [h, w, 3], each channel of unit sum, with the
centre at index N // 2 of both axes. Light is linear irradiance, 1 being white of the longest exposure, unless an argument
says otherwise. Wherever an image or a PSF is asked for, the path of a file does as well.

Functions compute what the commands of the same name do, to the bit; keyword arguments are the commands' flags, with their
defaults. What is doubtful is warned of (UdcWarning), what else there is to tell goes to the log "udc" of `logging`.

Returned arrays are views of planar memory, [3, H, W] in C order, with the axes moved: numpy.ascontiguousarray copies them to
interleaved memory where a library asks for that. Planar arrays are taken in by one straight copy, others are rearranged in it.
Other threads of Python go on while a function computes, and Ctrl-C ends it.
"""

import logging

from ._degrade import Degrader, degrade
from ._errors import (
    UdcError,
    UdcFileExistsError,
    UdcFileNotFoundError,
    UdcIOError,
    UdcPermissionError,
    UdcWarning,
)
from ._files import KernelBank, project, read, read_bank, read_psf, write
from ._metrics import psnr, ssim
from ._native import VERSION as __version__
from ._native import set_threads
from ._psf import codes, fuse, simulate_psf
from ._restore import finish, restore

__all__ = [
    "Degrader",
    "KernelBank",
    "UdcError",
    "UdcFileExistsError",
    "UdcFileNotFoundError",
    "UdcIOError",
    "UdcPermissionError",
    "UdcWarning",
    "__version__",
    "codes",
    "degrade",
    "finish",
    "fuse",
    "project",
    "psnr",
    "read",
    "read_bank",
    "read_psf",
    "restore",
    "set_threads",
    "simulate_psf",
    "ssim",
    "write",
]

logging.getLogger("udc").addHandler(logging.NullHandler())
