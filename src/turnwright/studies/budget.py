"""Error budgets: a distribution for each set-up error, with its source or a stated assumption."""

from __future__ import annotations

import difflib
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from importlib import resources
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple, get_args

import numpy as np

from turnwright import _validate as validate
from turnwright._faults import read_table
from turnwright._io import bytes_of, read_toml
from turnwright._tables import Keyed, TableModel, refuse, write_table
from turnwright._validate import check_numbers, positive
from turnwright.errors import InputError, quote
from turnwright.job import TestPartKind
from turnwright.surface import zernike_order
from turnwright.units import Text, Thickness, Time, parse

if TYPE_CHECKING:
    from os import PathLike

    from numpy.typing import ArrayLike
    from pydantic import GetCoreSchemaHandler
    from pydantic_core import CoreSchema

    from turnwright._arrays import Floats

__all__ = ["MAX_DRAWS", "ErrorBudget", "Spread", "group_of", "unit_of"]

MAX_DRAWS = 10_000_000
"""Largest number of cases of a study."""


class _Kind(NamedTuple):
    numbers: tuple[str, ...]  # names of its parameters
    rule: str  # condition on the parameters


KINDS = MappingProxyType(
    {
        "normal": _Kind(("mean", "deviation"), "a deviation above 0"),
        "uniform": _Kind(("low", "high"), "low below high"),
        "triangular": _Kind(("low", "most likely", "high"), "numbers that ascend, low below high"),
        "truncated normal": _Kind(("mean", "deviation", "low", "high"), "a deviation above 0, low below high"),
    }
)
"""Distribution families, written as text such as ``normal(0, 2) um``."""

NAMED_ERRORS = MappingProxyType(
    {
        "tool offset x": "mm",
        "tool offset y": "mm",
        "tool offset z": "mm",
        "radius error": "mm",
        "squareness": "rad",
        "drift x": "mm",
        "drift z": "mm",
        "chuck tilt x": "rad",
        "chuck tilt y": "rad",
    }
)
"""Errors without an index, and their units."""

NUMBERED_ERRORS = (
    (re.compile(r"waviness P([2-9]|1[0-2])"), "mm"),
    (re.compile(r"waviness c([1-9])"), "mm/rad^{}"),
    (re.compile(r"servo [A-Z]"), "1"),
    (re.compile(r"mounting Z([1-9][0-9]?)"), "mm"),
    (re.compile(r"instrument Z([1-9][0-9]?)"), "mm"),
)
"""Errors with an index, such as the order of a term, and their units."""

TEST_PARTS: tuple[str, ...] = get_args(TestPartKind)
"""Test parts that can be cut and measured before the part."""

GROUPS_PER_CUT = ("drift", "mounting", "chuck tilt")
"""Groups that differ in every cut: a test part does not predict their values for the part."""

MIN_FRINGE_TERM = 4
"""Lower fringe terms are piston and tilt, which neither mount nor instrument determines."""

TAIL_PROBABILITY = 1e-9
"""Tail probability of the largest draw that a study allows for."""

_TEXT = re.compile(r"\s*([a-z ]+?)\s*\(([^()]*)\)\s*(\S*)\s*")


@dataclass(frozen=True, slots=True, kw_only=True)
class Spread:
    """The distribution of an error.

    Parameters
    ----------
    kind
        ``"normal"``, ``"uniform"``, ``"triangular"`` or ``"truncated normal"``.
    numbers
        Of a normal distribution mean and standard deviation; of a uniform one its ends; of a triangular one low, most
        likely and high; of a truncated normal one mean, standard deviation, low and high. In the unit of the error:
        mm, rad or their ratios.
    source
        Source of the values, or ``"assumed: ..."`` with the reason.

    Raises
    ------
    InputError
        If the distribution is unknown or invalid, or has no source.

    >>> spread = Spread.read("uniform(-1, 1) um", "mm", source="assumed: a dial indicator")
    >>> float(spread.quantile(0.75)), round(spread.deviation * 1e3, 4)
    (0.0005, 0.5774)
    """

    kind: str
    numbers: tuple[float, ...]
    source: str

    def __post_init__(self) -> None:
        check_numbers(self)
        validate.instance_of(self.source, str, "the source of a distribution")
        if not isinstance(self.kind, str) or self.kind not in KINDS:
            raise InputError(f"the distribution {self.kind!r} is not one of {', '.join(KINDS)}: choose one of them")
        family = KINDS[self.kind]
        validate.instance_of(self.numbers, Sequence, f"the numbers of the {self.kind} distribution")
        numbers = tuple(validate.number(one, f"a number of the {self.kind} distribution") for one in self.numbers)
        if len(numbers) != len(family.numbers):
            raise InputError(
                f"{self.kind} has {len(numbers)} numbers, it needs {len(family.numbers)} "
                f"({', '.join(family.numbers)}): complete or correct them"
            )
        object.__setattr__(self, "numbers", numbers)
        n = self.numbers
        right = n[1] > 0 if "normal" in self.kind else n[0] < n[-1] and list(n) == sorted(n)
        if not right or (self.kind == "truncated normal" and not n[2] < n[3]):
            raise InputError(f"{self.kind}({', '.join(f'{one:g}' for one in n)}) is invalid, it needs {family.rule}")
        if not self.source.strip():
            raise InputError(f"{self.kind} has no source: state it, or 'assumed: ...' with the reason")

    @classmethod
    def read(cls, text: object, unit: str, *, source: str) -> Spread:
        """Parse a text such as ``normal(0, 2) um`` into a distribution in the given unit."""
        match = _TEXT.fullmatch(text) if isinstance(text, str) else None
        if match is None:
            example = "" if unit == "1" else " um" if unit == "mm" else f" {unit}"
            raise InputError(f"{text!r} is not a distribution: write it such as 'normal(0, 0.5){example}'")
        kind, inside, written = match.groups()
        numbers = tuple(parse(f"{one.strip()} {written}".strip(), unit) for one in inside.split(","))
        return cls(kind=kind, numbers=numbers, source=source)

    def text(self, unit: str) -> str:
        """Return the distribution as text that `read` accepts."""
        return f"{self.kind}({', '.join(repr(one) for one in self.numbers)}) {'' if unit == '1' else unit}".strip()

    def format(self, unit: str) -> str:
        """Return the distribution as text in um or urad, for display."""
        friendly = {"mm": "um", "rad": "urad"}.get(unit, unit)
        factor = {"mm": 1e3, "rad": 1e6}.get(unit, 1.0)
        inside = ", ".join(f"{one * factor:.6g}" for one in self.numbers)
        return f"{self.kind}({inside}) {'' if unit == '1' else friendly}".strip()

    def quantile(self, chance: ArrayLike) -> Floats:
        """Return the quantile function at a probability, any shape."""
        return np.asarray(_scipy(self.kind, self.numbers).ppf(chance), dtype=np.float64)[()]

    def density_halved(self, values: Floats) -> Floats:
        """Return the density of values with half the spread about the same mean, over the full-spread density. (n,)."""
        distribution = _scipy(self.kind, self.numbers)
        return np.asarray(
            2 * distribution.pdf(2 * values - distribution.mean()) / distribution.pdf(values), dtype=np.float64
        )

    @property
    def deviation(self) -> float:
        """Standard deviation."""
        return float(_scipy(self.kind, self.numbers).std())

    @property
    def mean(self) -> float:
        """Mean."""
        return float(_scipy(self.kind, self.numbers).mean())

    @property
    def largest(self) -> float:
        """Largest magnitude that a study allows for: the quantile at ``TAIL_PROBABILITY`` of either tail."""
        return float(np.abs(self.quantile([TAIL_PROBABILITY, 1 - TAIL_PROBABILITY])).max())


@cache
def _scipy(kind: str, numbers: tuple[float, ...]) -> Any:
    from scipy import stats  # noqa: PLC0415 - costly to import

    a, b = numbers[:2]
    if kind == "normal":
        return stats.norm(a, b)
    if kind == "uniform":
        return stats.uniform(a, b - a)
    if kind == "triangular":
        high = numbers[2]
        return stats.triang((b - a) / (high - a), a, high - a)
    low, high = numbers[2:]
    return stats.truncnorm((low - a) / b, (high - a) / b, a, b)


def unit_of(name: str) -> str:
    """Return the unit of an error by its name."""
    validate.instance_of(name, str, "the name of an error")
    if name in NAMED_ERRORS:
        return NAMED_ERRORS[name]
    for pattern, unit in NUMBERED_ERRORS:
        match = pattern.fullmatch(name)
        if match is not None:
            return unit.format(match.group(1)) if "{}" in unit else unit
    examples = [*NAMED_ERRORS, "waviness P3", "waviness c4", "servo Z", "mounting Z5", "instrument Z5"]
    near = difflib.get_close_matches(name, examples, n=1)
    remedy = f"did you mean {near[0]!r}?" if near else f"the known ones are {', '.join(examples)} and so on, name one"
    raise InputError(f"a budget cannot have the error {name!r}: {remedy}")


def group_of(name: str) -> str:
    """Return the group of an error; ``drift`` of a test part and ``drift`` of the part are different groups."""
    cut, _, error = name.partition(": ")
    plain = error or cut
    group = plain if plain in {"radius error", "squareness"} else plain.rpartition(" ")[0]
    return f"{cut}: {group}" if error else group


class Errors(Keyed):
    """Annotation of a mapping from error names to distributions, each with its source, for budget files."""

    keys: Mapping[str, Any] = MappingProxyType({"spread": Text, "source": Text})

    def __get_pydantic_core_schema__(self, _source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        from pydantic_core import core_schema  # noqa: PLC0415 - only files need pydantic

        return core_schema.no_info_after_validator_function(
            _spreads,
            core_schema.dict_schema(core_schema.str_schema(), self.table_schema(handler, required=True)),
            serialization=core_schema.plain_serializer_function_ser_schema(
                lambda held: {
                    name: {"spread": one.text(unit_of(name)), "source": one.source} for name, one in held.items()
                }
            ),
        )


def _spreads(entries: Mapping[str, Mapping[str, str]]) -> dict[str, Spread]:
    spreads: dict[str, Spread] = {}
    problems: dict[tuple[str | int, ...], Exception | str] = {}
    for name, one in entries.items():
        try:
            spreads[name] = Spread.read(one["spread"], unit_of(name), source=one["source"])
        except InputError as error:
            problems[name,] = error
    if problems:
        raise refuse("errors", problems, entries)
    return spreads


@dataclass(frozen=True, slots=True, kw_only=True)
class ErrorBudget(TableModel):
    r"""Error budget: the distributions of the errors of tool, machine and mount when a part is cut.

    Parameters
    ----------
    errors
        A distribution for each name: ``tool offset x``, ``y``, ``z``; ``radius error``; ``waviness P3`` and so on, a
        Legendre polynomial over the arc of the edge, by its root mean square, or ``waviness c3``, a power of the
        sweep; ``squareness``; ``servo X`` (any axis), the relative deviation of its natural frequency from that of
        the machine file; ``drift x`` and ``drift z``, the displacement of the tool relative to the part at the end
        of the cut; ``mounting Z5`` and so on, a fringe Zernike term over the clear aperture by which the mount
        deforms the part during the cut; ``chuck tilt x`` and ``y``, the tilt of the part in the chuck;
        ``instrument Z5`` and so on, the error of the instrument that measures a test part.
    noise
        Standard deviation of each measured height. [mm]
    settling
        Time constant of an exponentially settling drift; ``None`` for a linear drift. [s]
    test_parts
        Test parts that are cut and measured before the part: any of ``"tilted flat"`` and ``"concave sphere"``.
    name
        Name of the budget.

    Raises
    ------
    InputError
        If an error is unknown, or a number is out of range.

    Notes
    -----
    Drift, mounting and chuck tilt are drawn independently for every cut. Tool, slides and servos keep their errors
    between test part and part.
    """

    errors: Annotated[Mapping[str, Spread], Errors()]
    noise: Thickness
    settling: Time | None = None
    test_parts: tuple[Text, ...] = TEST_PARTS
    name: Text = ""

    def __post_init__(self) -> None:
        check_numbers(self)
        validate.instance_of(self.errors, Mapping, "the errors of a budget")
        if not self.errors:
            raise InputError("a budget has 0 errors, it needs at least 1: state the spread of a set-up error")
        for name in self.errors:
            _ = unit_of(name)
            if name.startswith(("mounting", "instrument")):
                term = int(name.rpartition("Z")[2])
                if term < MIN_FRINGE_TERM:
                    raise InputError(
                        f"{name} is piston or tilt, the first fringe term allowed is Z{MIN_FRINGE_TERM}: leave it out"
                    )
                zernike_order(term, "fringe")
        kinds = {name[9] for name in self.errors if name.startswith("waviness")}
        if len(kinds) > 1:
            raise InputError("waviness has terms P and terms c, only one kind is allowed: leave the other out")
        if self.noise < 0:
            raise InputError(f"the noise is {self.noise:g} mm, it must be at least 0 mm: give its standard deviation")
        if self.settling is not None:
            positive(self.settling, "settling", "s")
        named = [str(one) for one in self.test_parts] if isinstance(self.test_parts, list | tuple) else []
        if not named or sorted(named) != sorted(one for one in TEST_PARTS if one in named):
            raise InputError(
                f"test_parts is {quote(self.test_parts)}, it must be a list of names, of {', '.join(TEST_PARTS)}: name "
                "each once"
            )
        object.__setattr__(self, "errors", MappingProxyType(dict(self.errors)))
        object.__setattr__(self, "test_parts", tuple(self.test_parts))

    def __reduce__(self) -> tuple[Any, ...]:
        return ErrorBudget.read, (self.table(),)

    @classmethod
    def read(cls, table: Mapping[str, Any]) -> ErrorBudget:
        """Return the budget described by a mapping with quantities as text, as parsed from TOML."""
        return read_table(cls, table, "the budget")

    @classmethod
    def load(cls, path: str | PathLike[str]) -> ErrorBudget:
        """Read a budget file.

        Raises
        ------
        InputError
            If the file cannot be read, is not TOML, or describes no budget.
        """
        path = Path(validate.path(path, "the budget file"))
        what = f"budget file {str(path)!r}"
        return read_table(cls, read_toml(bytes_of(path, "budget file"), what), what)

    @classmethod
    def typical(cls) -> ErrorBudget:
        """Return the default budget of Turnwright, in which every value is a stated assumption."""
        file = resources.files("turnwright") / "budgets" / "typical.toml"
        return cls.read(read_toml(file.read_bytes(), "the typical budget"))

    def table(self) -> dict[str, Any]:
        """Return the budget as a mapping for `read`, with all digits."""
        return write_table(self, whole=True)

    def unit(self, name: str) -> str:
        """Return the unit of an error of the part or of a test part."""
        if not isinstance(name, str) or (plain := name.rpartition(": ")[2]) not in self.errors:
            raise InputError(f"the budget has no error {name!r}, it has {', '.join(self.errors)}: name one of them")
        return unit_of(plain)

    def only(self, *groups: str) -> ErrorBudget:
        """Return the budget with only the errors of some groups, such as ``"tool offset"`` and ``"drift"``."""
        selected = {name: spread for name, spread in self.errors.items() if group_of(name) in list(map(str, groups))}
        if not selected:
            every = ", ".join(dict.fromkeys(map(group_of, self.errors)))
            raise InputError(
                f"no error of the budget is in the groups {', '.join(map(str, groups))}, its groups are {every}: name "
                "some"
            )
        return replace(self, errors=selected)

    def inputs(self, *, correction: bool) -> dict[str, Spread]:
        """Return all random inputs of a case; with a correction, also those of each test part."""
        part = {name: spread for name, spread in self.errors.items() if group_of(name) != "instrument"}
        if not correction:
            return part
        per_cut = {
            name: spread for name, spread in self.errors.items() if group_of(name) in {*GROUPS_PER_CUT, "instrument"}
        }
        return part | {f"{kind}: {name}": spread for kind in self.test_parts for name, spread in per_cut.items()}

    def draw(self, count: int, *, seed: int, correction: bool) -> dict[str, Floats]:
        """Return independent random draws of all inputs. Each (count,).

        The draws of the part are the same with and without a correction.
        """
        count, seed = (
            validate.whole_number(count, "the number of draws", 1, MAX_DRAWS),
            validate.whole_number(seed, "the seed", 0),
        )
        drawn = {}
        for name, spread in self.inputs(correction=correction).items():
            entropy = [seed, *name.encode()]
            drawn[name] = spread.quantile(np.random.default_rng(entropy).random(count))
        return drawn

    def largest(self, *names: str) -> float:
        """Return the sum of `Spread.largest` over the errors whose names begin with one of ``names``."""
        return sum(spread.largest for name, spread in self.errors.items() if name.startswith(names))
