"""Arrays for the page: a header of a few words, and the numbers as they lie in memory.

A message is ``TW01``, the length of the header as four bytes (little-endian), the header as JSON, filled up with spaces
to a multiple of four bytes, and after it the arrays as little-endian float32, one after another. The header names them
with their shapes under ``arrays``; nan stands for no value. The page reads it without copying a number.
"""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

from turnwright.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import ArrayLike, NDArray

__all__ = ["MEDIA_TYPE", "pack", "unpack"]

MAGIC = b"TW01"
MEDIA_TYPE = "application/octet-stream"


def pack(header: Mapping[str, Any], arrays: Mapping[str, ArrayLike]) -> bytes:
    """Return a message of some arrays.

    Parameters
    ----------
    header
        What JSON takes; numbers in it are finite or ``None``.
    arrays
        By name. Any shape; they lose what float32 does not hold.

    >>> header, arrays = unpack(pack({"unit": "mm"}, {"z": [[1.0, 2.5]]}))
    >>> header["unit"], arrays["z"].tolist()
    ('mm', [[1.0, 2.5]])
    """
    import numpy as np  # noqa: PLC0415 - the server packs nothing, it only knows what a message is called

    with np.errstate(over="ignore"):  # what float32 cannot hold is infinite there
        numbers = {name: np.ascontiguousarray(values, dtype="<f4") for name, values in arrays.items()}
    whole = {**header, "arrays": [{"name": name, "shape": values.shape} for name, values in numbers.items()]}
    text = json.dumps(whole, ensure_ascii=False, allow_nan=False, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    return b"".join([MAGIC, len(text).to_bytes(4, "little"), text, *(values.tobytes() for values in numbers.values())])


def unpack(message: bytes) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """Return the header and the arrays of a message.

    Raises
    ------
    InputError
        If it is not one, or it is cut short.
    """
    import numpy as np  # noqa: PLC0415

    start = 8 + int.from_bytes(message[4:8], "little")
    if message[:4] != MAGIC or len(message) < start:
        raise InputError(
            f"{len(message)} bytes are not a message of arrays: it begins with {MAGIC.decode()} and a header"
        )
    header = json.loads(message[8:start])
    arrays, at = {}, start
    for one in header["arrays"]:
        count = int(np.prod(one["shape"], dtype=np.int64))
        if at + 4 * count > len(message):
            raise InputError(
                f"the message ends within {one['name']!r}, {len(message)} bytes are too few: send it again"
            )
        arrays[one["name"]] = np.frombuffer(message, "<f4", count, at).reshape(one["shape"])
        at += 4 * count
    return header, arrays
