"""Prepares what the user hands over: arrays as planes, or as files where a whole file is asked for."""

import json
import logging
import os
import tempfile
import warnings
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from ._errors import UdcError, UdcWarning, in_python

_LOG = logging.getLogger("udc")

_LEVELS = {"info": logging.INFO, "debug": logging.DEBUG}


def is_path(given):
    return isinstance(given, (str, os.PathLike))


def path_of(path):
    """The text of a path, `~` resolved."""
    return str(Path(os.fsdecode(os.fspath(path))).expanduser())


def source(given, name):
    """An image for the compiled part: a path, or planes [C, H, W] of float32 with whether they were integers."""
    if is_path(given):
        return path_of(given)
    array = _array(given, name)
    if array.ndim == 2:
        array = array[:, :, np.newaxis]
    if array.ndim != 3 or array.shape[2] not in (1, 3):
        hint = ""
        if array.ndim == 3 and array.shape[0] in (1, 3):
            hint = "; planes become that by numpy.moveaxis(planes, 0, -1)"
        raise UdcError(f"{name}: expected an image [H, W, 3] or [H, W], found shape {list(array.shape)}{hint}")
    if 0 in array.shape:
        raise UdcError(f"{name}: expected an image of at least 1 × 1, found shape {list(array.shape)}")
    is_integer = array.dtype in (np.uint8, np.uint16)
    if is_integer:
        array = array.astype(np.float32) / np.float32(np.iinfo(array.dtype).max)
    elif array.dtype.kind == "f":
        with np.errstate(over="ignore"):
            array = array.astype(np.float32, copy=False)
    else:
        raise UdcError(f"{name}: expected float32 (also float16, float64, uint8, uint16), found {array.dtype}")
    return (np.moveaxis(array, 2, 0), is_integer, name)


def _array(given, name):
    try:
        array = np.asarray(given)
    except (TypeError, ValueError, RuntimeError) as error:
        raise UdcError(f"{name}: expected a path or an array: {error}") from error
    if array.dtype == object:
        raise UdcError(f"{name}: expected a path or an array of numbers, found {type(given).__name__}")
    return array


class Files:
    """Files of arrays, in a folder that is removed afterwards; paths are taken as they are."""

    def __init__(self):
        self._folder = None

    def of(self, given, name):
        """The path of what is given; None of None."""
        if given is None:
            return None
        if is_path(given):
            return path_of(given)
        path = self.new(name)
        # Without an extension, so that messages name the argument; files are recognised by their contents.
        with open(path, "wb") as file:
            np.save(file, np.ascontiguousarray(_array(given, name)))
        return path

    def of_each(self, given, name):
        """The paths of a list of files and arrays, or of one."""
        if given is None:
            return None
        if is_path(given) or (isinstance(given, np.ndarray) and given.ndim < 4):
            given = [given]
        return [self.of(item, f"{name}[{index}]") for index, item in enumerate(given)]

    def new(self, name):
        """The path of a file that is yet to be written."""
        if self._folder is None:
            self._folder = tempfile.TemporaryDirectory(prefix="udc-")
        return os.path.join(self._folder.name, name)

    def named(self, text):
        """A message without the folder."""
        return text if self._folder is None else text.replace(self._folder.name + os.sep, "")

    def close(self):
        if self._folder is not None:
            self._folder.cleanup()


@contextmanager
def files():
    """Gives files of arrays; errors name the arguments and not where they lay for a moment."""
    given = Files()
    try:
        yield given
    except UdcError as error:
        error.args = (given.named(str(error)),)
        raise
    finally:
        given.close()


def tell(notices, given=None, stacklevel=3):
    """Warns of what is doubtful; what else there is to tell goes to the log `udc`."""
    for level, text in notices:
        text = in_python(text if given is None else given.named(text))
        if level == "warning":
            warnings.warn(text, UdcWarning, stacklevel=stacklevel)
        else:
            _LOG.log(_LEVELS[level], "%s", text)


def info_text(info):
    """What is known of a capture, for the compiled part."""
    if info is None or isinstance(info, str):
        return info
    try:
        return json.dumps({key: _plain(value) for key, value in dict(info).items()})
    except (TypeError, ValueError) as error:
        raise UdcError(f"info: expected what read, fuse, degrade or restore return with return_info=True: {error}") from error


def _plain(value):
    return value.tolist() if isinstance(value, (np.ndarray, np.generic)) else value


def info_of(text):
    """What is known of a capture, for the user."""
    return {} if text is None else json.loads(text)
