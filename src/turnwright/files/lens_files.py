"""Reading lens files of Zemax and CODE V."""

from __future__ import annotations

from os import PathLike
from pathlib import Path

from turnwright.errors import InputError
from turnwright.files import codev_lens, zemax_lens
from turnwright.files.base import read_contents
from turnwright.files.lens import LensFile
from turnwright.files.numbers import text_of

__all__ = ["read_lens"]

MAX_LENS_BYTES = 32 << 20


def read_lens(path: str | PathLike[str], *, radii: bool | None = None) -> LensFile:
    """Read a lens file of Zemax (``.zmx``) or CODE V (``.seq``).

    Words that cannot change the shape of a surface are known by name. Any other word makes its surface one that cannot
    be cut, with the reason in `LensSurface.fault`; in the description of the whole lens it is refused.

    Parameters
    ----------
    path
        The file, in 8-bit text or UTF-16.
    radii
        Whether the surfaces of a CODE V file without ``RDM`` begin with their radius (or their curvature).

    Raises
    ------
    InputError
        If the file cannot be read, is of another program, or states something that could change every surface.

    Sources
    -------
    [Zemax]_ and [CODEV]_ give words, types of surfaces and their formulas.
    """
    file = Path(path)
    data = read_contents(file, MAX_LENS_BYTES)
    text = text_of(data)
    if text is None and b"\0" in data[:4]:  # UTF-16 without a byte order mark
        text = data.decode("utf-16-le" if data[1:2] == b"\0" else "utf-16-be", "replace")
    if text is None:
        raise InputError(f"{file} is not text: lens files are .zmx of Zemax and .seq of CODE V")
    if zemax_lens.SIGNATURE.match(text):
        return zemax_lens.read(file, text)
    if codev_lens.is_codev(text):
        return codev_lens.read(file, text, radii)
    raise InputError(f"{file} is not a lens file of Zemax (.zmx) or CODE V (.seq): export it from one of them")
