"""Macro arithmetic in programs: numbered variables, sums, products, comparisons."""

from __future__ import annotations

import operator
import re
from collections.abc import Callable

__all__ = ["Macros"]

NUMBER = re.compile(r"\s*([+-]?(?:\d+\.?\d*|\.\d+))")
VARIABLE = re.compile(r"\s*#\s*(\d{1,9})")
COMPARE = re.compile(r"(.+?)\s*(LT|LE|GT|GE|EQ|NE)\s*(.+)", re.IGNORECASE)
MAX_NESTING = 20
"""Brackets and signs inside one another."""
RELATIONS = {name: getattr(operator, name.lower()) for name in ("LT", "LE", "GT", "GE", "EQ", "NE")}


def next_of(text: str, at: int, signs: str) -> str:
    """Return the next character that is not blank, if it is one of ``signs``."""
    remainder = text[at:].lstrip()
    return remainder[0] if remainder and remainder[0] in signs else ""


class Macros:
    """The variables and expressions of a program; ``error`` makes an exception from the description of a fault.

    >>> macros = Macros(ValueError)
    >>> macros.variables[8] = 0.02
    >>> round(macros.value("[#8 + 1] * 2"), 12)
    2.04
    """

    def __init__(self, error: Callable[[str], Exception]) -> None:
        self.error = error
        self.variables: dict[int, float] = {}
        self.depth = 0

    def holds(self, condition: str) -> bool:
        """Whether a comparison, such as ``#1 LT 2``, is true."""
        match = COMPARE.fullmatch(condition.strip())
        if match is None:
            raise self.error(f"has a condition that cannot be read ({condition[:30]})")
        return bool(RELATIONS[match[2].upper()](self.value(match[1]), self.value(match[3])))

    def value(self, text: str) -> float:
        """Return the value of a whole expression."""
        self.depth = 0
        value, at = self._sum(text, 0)
        if text[at:].strip():
            raise self._unreadable(text)
        return value

    def _sum(self, text: str, at: int) -> tuple[float, int]:
        value, at = self._product(text, at)
        while sign := next_of(text, at, "+-"):
            other, at = self._product(text, text.index(sign, at) + 1)
            value = value + other if sign == "+" else value - other
        return value, at

    def _product(self, text: str, at: int) -> tuple[float, int]:
        value, at = self.factor(text, at)
        while sign := next_of(text, at, "*/"):
            other, at = self.factor(text, text.index(sign, at) + 1)
            if sign == "/" and other == 0:
                raise self.error("divides by 0")
            value = value * other if sign == "*" else value / other
        return value, at

    def factor(self, text: str, at: int) -> tuple[float, int]:
        """Return the value of a number, a variable or a bracket, and the position after it."""
        if match := NUMBER.match(text, at):
            return float(match[1]), match.end()
        if variable := VARIABLE.match(text, at):
            number = int(variable[1])
            if number not in self.variables:
                raise self.error(f"uses #{number}, which has no value")
            return self.variables[number], variable.end()
        self.depth += 1
        if self.depth > MAX_NESTING:
            raise self.error(f"nests more than {MAX_NESTING} brackets and signs")
        if sign := next_of(text, at, "+-"):
            value, at = self.factor(text, text.index(sign, at) + 1)
            value = -value if sign == "-" else value
        elif next_of(text, at, "["):
            value, at = self._sum(text, text.index("[", at) + 1)
            if not next_of(text, at, "]"):
                raise self._unreadable(text)
            at = text.index("]", at) + 1
        else:
            raise self._unreadable(text)
        self.depth -= 1
        return value, at

    def _unreadable(self, text: str) -> Exception:
        return self.error(f"has an expression that cannot be read ({text.strip()[:30]})")
