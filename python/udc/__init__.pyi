"""Images are float32 [H, W, 3] of linear light unless said otherwise, PSFs float32 [h, w, 3] of unit sum in each channel."""

from collections.abc import Sequence
from os import PathLike
from typing import Any, Literal, Optional, Union, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

__version__: str

_Path = Union[str, PathLike[str]]
#: [H, W, 3] float32 (float16, float64, uint8 and uint16 are converted), or the path of a file.
_Image = Union[ArrayLike, _Path]
#: [h, w, 3] of light, or the path of a file.
_Psf = Union[ArrayLike, _Path]
_Floats = NDArray[np.float32]
_Info = dict[str, Any]
_Display = Union[_Path, dict[str, Any]]
_Light = Literal["linear", "srgb"]
_Domain = Literal["linear", "tone-mapped", "srgb"]
_Definition = Literal["released", "float"]

class UdcError(ValueError): ...
class UdcIOError(UdcError, OSError): ...
class UdcFileNotFoundError(UdcIOError, FileNotFoundError): ...
class UdcFileExistsError(UdcIOError, FileExistsError): ...
class UdcPermissionError(UdcIOError, PermissionError): ...
class UdcWarning(UserWarning): ...

class KernelBank:
    """K PSFs of one size, their codes of b numbers, and the PCA basis of the codes."""
    @property
    def psfs(self) -> _Floats: ...  # [K, h, w, 3]
    @property
    def codes(self) -> _Floats: ...  # [K, b]
    @property
    def angles(self) -> Optional[list[float]]: ...  # degrees, counter-clockwise
    @property
    def names(self) -> list[str]: ...
    @property
    def mean(self) -> _Floats: ...  # [3·h·w]
    @property
    def components(self) -> _Floats: ...  # [b, 3·h·w]
    @property
    def explained_variance(self) -> _Floats: ...  # [b]
    def __len__(self) -> int: ...

class Degrader:
    def __init__(
        self,
        psf: Optional[_Psf] = None,
        *,
        bank: Optional[Union[KernelBank, _Path]] = None,
        psf_domain: Optional[_Light] = None,
        recenter: bool = False,
        preset: Literal["paper", "released"] = "paper",
        x_max: Optional[float] = None,
        alpha: Optional[float] = None,
        border: Optional[Literal["zero", "replicate", "reflect"]] = None,
        margin: int = 0,
        clip_ground_truth: bool = False,
        noise: str = "none",
        seed: int = 0,
        domain: Optional[_Light] = None,
    ) -> None: ...
    def __call__(self, scene: _Image, kernel: Union[int, str] = 0, *, name: str = "scene") -> _Floats: ...
    def __len__(self) -> int: ...
    def ground_truth(self, scene: _Image) -> _Floats: ...
    @property
    def names(self) -> list[str]: ...
    @property
    def info(self) -> _Info: ...

def set_threads(threads: int) -> None: ...
@overload
def read(path: _Path, *, domain: Optional[_Domain] = None, return_info: Literal[False] = False) -> Any: ...
@overload
def read(path: _Path, *, domain: Optional[_Domain] = None, return_info: Literal[True]) -> tuple[_Floats, _Info]: ...
def read_psf(path: _Path, *, domain: Optional[_Light] = None, recenter: bool = False) -> _Floats: ...
def read_bank(path: _Path) -> KernelBank: ...
def write(
    path: _Path,
    image: Union[ArrayLike, KernelBank],
    *,
    domain: Optional[Literal["linear", "tone-mapped", "display"]] = None,
    info: Optional[_Info] = None,
    bits: Optional[Literal[8, 16]] = None,
    color_space: Literal["srgb", "display-p3"] = "srgb",
    half: bool = False,
    overwrite: bool = False,
) -> None: ...
@overload
def fuse(
    pictures: Sequence[_Image],
    *,
    exposures: Optional[Sequence[float]] = None,
    estimate_exposures: bool = False,
    white: Optional[float] = None,
    black: Optional[float] = None,
    bayer: Optional[Literal["rggb", "bggr", "grbg", "gbrg"]] = None,
    white_balance: Optional[Sequence[float]] = None,
    merge: Literal["longest", "weighted"] = "longest",
    allow_motion: bool = False,
    dark: Optional[Sequence[_Image]] = None,
    dark_exposures: Optional[Sequence[float]] = None,
    domain: Optional[_Light] = None,
    mask: Optional[_Image] = None,
    point_source: bool = False,
    size: Optional[int] = None,
    normalize: Optional[Literal["channel", "total", "none"]] = None,
    return_info: Literal[False] = False,
) -> _Floats: ...
@overload
def fuse(pictures: Sequence[_Image], *, return_info: Literal[True], **settings: Any) -> tuple[_Floats, _Info]: ...
@overload
def simulate_psf(
    display: Optional[_Display] = None,
    *,
    random: Optional[int] = None,
    from_: Optional[_Psf] = None,
    size: Optional[int] = None,
    domain: Optional[_Light] = None,
    recenter: bool = False,
    turn: float = 0.0,
    scale: float = 0.0,
    defocus: float = 0.0,
    noise: float = 0.0,
    reach: Optional[int] = None,
    seed: int = 0,
    return_display: Literal[False] = False,
) -> _Floats: ...
@overload
def simulate_psf(
    display: Optional[_Display] = None, *, return_display: Literal[True], **settings: Any
) -> tuple[_Floats, Optional[dict[str, Any]]]: ...
def codes(
    psfs: Optional[Union[_Psf, Sequence[_Psf]]] = None,
    *,
    display: Optional[_Display] = None,
    size: Optional[int] = None,
    angles: Optional[Union[Sequence[float], str]] = None,
    dim: int = 5,
    domain: Optional[_Light] = None,
    recenter: bool = False,
) -> KernelBank: ...
def project(
    bank: Union[KernelBank, _Path], psf: _Psf, *, domain: Optional[_Light] = None, recenter: bool = False
) -> tuple[_Floats, float, bool]: ...
@overload
def degrade(
    scene: _Image,
    psf: Optional[_Psf] = None,
    *,
    bank: Optional[Union[KernelBank, _Path]] = None,
    kernel: Optional[Union[int, str]] = None,
    name: str = "scene",
    return_info: Literal[False] = False,
    psf_domain: Optional[_Light] = None,
    recenter: bool = False,
    preset: Literal["paper", "released"] = "paper",
    x_max: Optional[float] = None,
    alpha: Optional[float] = None,
    border: Optional[Literal["zero", "replicate", "reflect"]] = None,
    margin: int = 0,
    clip_ground_truth: bool = False,
    noise: str = "none",
    seed: int = 0,
    domain: Optional[_Light] = None,
) -> _Floats: ...
@overload
def degrade(
    scene: _Image, psf: Optional[_Psf] = None, *, return_info: Literal[True], **settings: Any
) -> tuple[_Floats, _Info]: ...
@overload
def restore(
    capture: _Image,
    psf: Optional[_Psf] = None,
    *,
    bank: Optional[Union[KernelBank, _Path]] = None,
    angle: Optional[Union[float, Literal["auto"]]] = None,
    field: Optional[_Path] = None,
    code: Optional[Union[ArrayLike, _Path]] = None,
    psf_domain: Optional[_Light] = None,
    recenter: bool = False,
    model: Optional[_Path] = None,
    method: Optional[Literal["wiener", "wiener-orieux", "richardson-lucy", "constrained", "joint"]] = None,
    refine: Optional[float] = None,
    true_highlights: bool = False,
    pose: Optional[_Path] = None,
    noise: Optional[str] = None,
    balance: Optional[float] = None,
    border: Optional[Literal["smooth", "periodic", "zero"]] = None,
    iterations: Optional[int] = None,
    mask_saturated: bool = False,
    seed: Optional[int] = None,
    domain: Optional[_Domain] = None,
    output_domain: Optional[Literal["linear", "tone-mapped"]] = None,
    highlights: Literal["restored", "keep", "blend"] = "restored",
    precision: Literal["f32", "bf16"] = "f32",
    tile: Optional[int] = None,
    max_memory: str = "2GiB",
    alpha: Optional[float] = None,
    x_max: Optional[float] = None,
    info: Optional[_Info] = None,
    return_info: Literal[False] = False,
) -> _Floats: ...
@overload
def restore(
    capture: _Image, psf: Optional[_Psf] = None, *, return_info: Literal[True], **settings: Any
) -> tuple[_Floats, _Info]: ...
def finish(
    image: _Image,
    *,
    domain: Optional[_Domain] = None,
    ccm: Optional[Union[ArrayLike, _Path]] = None,
    no_ccm: bool = False,
    reference: Optional[_Image] = None,
    orientation: Optional[int] = None,
    saturation: Optional[Sequence[float]] = None,
    baseline_exposure: Optional[float] = None,
    clip: Optional[float] = None,
    no_clip: bool = False,
    curve: Optional[Literal["gamma", "srgb", "aces", "none"]] = None,
    gamma: Optional[float] = None,
    max: Optional[float] = None,
    roll_off: Optional[Literal["hue", "channels"]] = None,
    color_space: Literal["srgb", "display-p3"] = "srgb",
    noise: Optional[Union[float, Literal["auto"]]] = None,
    clip_limit: Optional[float] = None,
    grid: Optional[int] = None,
    no_clahe: bool = False,
    bits: Literal[8, 16, 32] = 8,
    alpha: Optional[float] = None,
    x_max: Optional[float] = None,
    info: Optional[_Info] = None,
) -> NDArray[Any]: ...  # uint8, uint16 or float32 [H, W, 3], by bits
def psnr(
    image: _Image,
    ground_truth: _Image,
    *,
    definition: _Definition = "released",
    domain: Optional[_Domain] = None,
    alpha: float = 0.25,
    x_max: float = 500.0,
) -> float: ...  # dB
def ssim(
    image: _Image,
    ground_truth: _Image,
    *,
    definition: _Definition = "released",
    domain: Optional[_Domain] = None,
    alpha: float = 0.25,
    x_max: float = 500.0,
) -> float: ...
