"""Binary message of arrays for the page.

A message is ``TW01``, the length of the header as four bytes (little-endian), the header as JSON, padded with spaces to
a multiple of four bytes, and the arrays as little-endian float32, one after another. The header lists their names and
shapes under ``arrays``; nan is a missing value. The page reads the arrays without copying.
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
    """Pack arrays into a message.

    Parameters
    ----------
    header
        JSON data; numbers are finite or ``None``.
    arrays
        Arrays of any shape by name; converted to float32.

    >>> header, arrays = unpack(pack({"unit": "mm"}, {"z": [[1.0, 2.5]]}))
    >>> header["unit"], arrays["z"].tolist()
    ('mm', [[1.0, 2.5]])
    """
    import numpy as np  # noqa: PLC0415 - the server imports this module only for its constants

    with np.errstate(over="ignore"):  # overflow becomes infinite
        numbers = {name: np.ascontiguousarray(values, dtype="<f4") for name, values in arrays.items()}
    document = {**header, "arrays": [{"name": name, "shape": values.shape} for name, values in numbers.items()]}
    text = json.dumps(document, ensure_ascii=False, allow_nan=False, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    return b"".join([MAGIC, len(text).to_bytes(4, "little"), text, *(values.tobytes() for values in numbers.values())])


def unpack(message: bytes) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """Return the header and the arrays of a message; raise an InputError if it is truncated or not a message."""
    import numpy as np  # noqa: PLC0415

    start = 8 + int.from_bytes(message[4:8], "little")
    if message[:4] != MAGIC or len(message) < start:
        raise InputError(
            f"a message of arrays must begin with {MAGIC.decode()} and a header, got {len(message)} other bytes"
        )
    header = json.loads(message[8:start])
    arrays, at = {}, start
    for one in header["arrays"]:
        count = int(np.prod(one["shape"], dtype=np.int64))
        if at + 4 * count > len(message):
            raise InputError(f"the message of {len(message)} bytes is truncated in {one['name']!r}")
        arrays[one["name"]] = np.frombuffer(message, "<f4", count, at).reshape(one["shape"])
        at += 4 * count
    return header, arrays
