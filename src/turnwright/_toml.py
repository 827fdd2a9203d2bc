"""TOML as people save it: whatever is wrong with the text is one sentence."""

from __future__ import annotations

import tomllib
from typing import Any

from turnwright.errors import InputError


def read_toml(data: bytes, what: str) -> dict[str, Any]:
    """Return the tables of a TOML file, a byte order mark before them or not.

    Parameters
    ----------
    data
        The bytes of the file.
    what
        The file as a message names it.

    Raises
    ------
    InputError
        If the bytes are not UTF-8 or the text is not TOML.
    """
    try:
        return tomllib.loads(data.decode("utf-8-sig"))
    except UnicodeDecodeError as error:
        raise InputError(f"{what} is not UTF-8 text: save it as a plain text file") from error
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"{what} is not TOML, {error}: correct that place") from error
    except ValueError as error:  # Python reads no whole number of more than some thousand digits
        raise InputError(f"{what} holds a whole number of thousands of digits: shorten it") from error
    except RecursionError as error:
        raise InputError(f"{what} holds lists or tables within each other too deep to read: make them flat") from error
