"""TOML as people save it: whatever is wrong with the text is one sentence."""

from __future__ import annotations

import re
import tomllib
from typing import Any

from turnwright.errors import InputError

LARGEST = 1 << 20
"""Bytes of a file: Python reads about a megabyte of TOML a second, and large tables have files of their own."""

MOST_BITS = 14_000
"""Of a whole number; Python writes out none of more than 4300 digits."""


TWICE = (
    (re.compile(r"Cannot overwrite a value (\(.*\))"), "a key is given twice"),
    (re.compile(r"Cannot declare .* twice (\(.*\))"), "a table is given twice"),
)
"""What Python says of keys that are repeated, and what it means."""


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
        If the bytes are too many or not UTF-8, or the text is not TOML or holds a number of thousands of digits.
    """
    if len(data) > LARGEST:
        raise InputError(
            f"{what} has {len(data):,} bytes, the limit is {LARGEST:,}: keep long tables of numbers in files of their "
            "own, which it names"
        )
    try:
        table = tomllib.loads(data.decode("utf-8-sig"))
    except UnicodeDecodeError as error:
        raise InputError(f"{what} is not UTF-8 text: save it as a plain text file") from error
    except tomllib.TOMLDecodeError as error:
        reason = next((f"{said} {place[1]}" for sign, said in TWICE if (place := sign.search(str(error)))), str(error))
        raise InputError(f"{what} is not TOML, {reason}: correct that place") from error
    except ValueError as error:
        raise _too_many_digits(what) from error
    except RecursionError as error:
        raise InputError(f"{what} holds lists or tables within each other too deep to read: make them flat") from error
    waiting: list[Any] = [table]
    while waiting:
        one = waiting.pop()
        if isinstance(one, dict | list):
            waiting.extend(one.values() if isinstance(one, dict) else one)
        elif isinstance(one, int) and one.bit_length() > MOST_BITS:
            raise _too_many_digits(what)
    return table


def _too_many_digits(what: str) -> InputError:
    return InputError(f"{what} holds a whole number of thousands of digits: shorten it")
