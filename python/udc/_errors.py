"""The exceptions of the package."""

import re


class UdcError(ValueError):
    """Something is wrong with what was given; the message says what to do."""


class UdcIOError(UdcError, OSError):
    """The system refused: a file that cannot be read or written."""


class UdcFileNotFoundError(UdcIOError, FileNotFoundError):
    """A file does not exist."""


class UdcFileExistsError(UdcIOError, FileExistsError):
    """A file exists and may not be replaced; pass overwrite=True to replace it."""


class UdcPermissionError(UdcIOError, PermissionError):
    """A file may not be read or written by this user."""


class UdcWarning(UserWarning):
    """Something is doubtful, and the result may be worse for it."""


# The system's numbers of ENOENT, EEXIST, EACCES and EPERM.
_KINDS = {2: UdcFileNotFoundError, 17: UdcFileExistsError, 13: UdcPermissionError, 1: UdcPermissionError}

_FLAG = re.compile(r"(?<![\w-])--([a-z]+(?:-[a-z]+)*)")


# The setting that a message begins with.
_KEY = re.compile(r"^[a-z]+(?:-[a-z]+)+(?=: )")


def in_python(text):
    """Names keywords where the command line has flags: `--psf-domain` becomes `psf_domain`."""
    text = _KEY.sub(lambda key: key.group(0).replace("-", "_"), text)
    return _FLAG.sub(lambda flag: flag.group(1).replace("-", "_"), text)


def exception(reason, number):
    """Makes the exception of a failure; `number` is the system's, None for one that is not the system's."""
    reason = in_python(reason)
    if number is None:
        return UdcError(reason)
    kind = _KINDS.get(number, UdcIOError)
    made = kind(reason)
    made.errno = number or None
    return made
