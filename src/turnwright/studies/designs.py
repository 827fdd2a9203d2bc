"""What a study varies: ranges, lists and distributions over fields of a job; and the cases a design makes of it."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import product
from typing import TYPE_CHECKING, Any, Literal, TypeAlias, get_args

import numpy as np

from turnwright import _validate as validate
from turnwright.errors import InputError, UnitError
from turnwright.studies.fields import Field, Token, apply_changes, entry_at, find_field, get_job_data
from turnwright.units import convert, parse

if TYPE_CHECKING:
    from turnwright._arrays import Floats
    from turnwright.job import Job

__all__ = ["DESIGNS", "MAX_CASES", "Design", "Varied", "Vary", "design_cases", "get_job_value", "read_varied"]

Vary: TypeAlias = Any
"""A text such as "0.1..1 mm:10", a list of texts or numbers, or a frozen distribution of ``scipy.stats``."""

Design: TypeAlias = Literal["grid", "random", "sobol", "halton", "latin hypercube"]

DESIGNS: tuple[str, ...] = get_args(Design)

MAX_CASES = 1_000_000
"""Largest number of cases of a study."""

MIN_TAIL = 1e-12
"""Least tail probability: distributions without bounds are not evaluated at 0 and 1."""

NUMBER = r"[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?"
RANGE = re.compile(rf"({NUMBER})\s*([^.:]*?)\s*\.\.\s*({NUMBER})\s*([^.:]*?)\s*(?::\s*([0-9]+))?\s*(log)?")
DRAWN = re.compile(rf"(uniform|normal)\s*\(\s*({NUMBER})\s*,\s*({NUMBER})\s*\)\s*(.*)")
ONE = re.compile(rf"({NUMBER})\s*(.*)")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Varied:
    """A varied field and its values."""

    field: Field  # the field
    unit: str = ""  # unit of the values; empty if there is none
    values: tuple[Token, ...] = ()  # of a list or a counted range; empty for a range without a count or a distribution
    low: float | None = None  # ends of a range, ``None`` without one
    high: float | None = None
    log: bool = False
    drawn: Any = None  # distribution with ``ppf``, in the unit of the values

    @property
    def name(self) -> str:
        """The field's dotted name."""
        return self.field.name

    def at(self, share: Floats) -> list[Token]:
        """Return the values at cumulative probabilities between 0 and 1. (n,)."""
        from scipy import stats  # noqa: PLC0415 - costly to import

        share = np.clip(share, MIN_TAIL, 1 - MIN_TAIL)
        is_whole = self.field.kind == "whole"
        if self.drawn is not None:
            drawn = self.drawn
        elif self.low is None or self.high is None:
            return [self.values[int(pick)] for pick in stats.randint(0, len(self.values)).ppf(share)]
        else:
            low, high = self.low, self.high
            if is_whole:  # half a step beyond, so that the ends are as likely as the others
                low, high = math.ceil(low) - 0.5, math.floor(high) + 0.5
            drawn = stats.loguniform(low, high) if self.log else stats.uniform(low, high - low)
        drawn_values = drawn.ppf(share)
        return [round(float(value)) if is_whole else float(value) for value in drawn_values]


def read_varied(job: Job, name: str, given: Vary) -> Varied:
    """Parse the values of a varied field; plain numbers and distributions are in base units (mm, rad, mm/rev, rpm)."""
    field = find_field(job, name)
    varied = _read(field, given)
    tokens: list[Token] = [one for one in (varied.low, varied.high) if one is not None]
    for token in (*varied.values, *(tokens if not varied.values and field.kind != "whole" else ())):
        field.check(token, varied.unit)
    if field.kind == "whole" and math.floor(varied.high or 0.0) < math.ceil(varied.low or 0.0):
        raise InputError(f"{name} takes whole numbers, {varied.low:g} to {varied.high:g} has none: widen the range")
    if varied.log and not (varied.low or 0.0) > 0:
        raise InputError(f"{name}: a logarithmic range begins at {varied.low:g}, it must begin above 0: change it")
    return varied


def _read(field: Field, given: Vary) -> Varied:
    if isinstance(given, str):
        return _read_text(field, given)
    if hasattr(given, "ppf"):
        if field.kind not in ("quantity", "number", "whole"):
            raise InputError(f"{field.name} is not a number, so it has no distribution: give a list of its values")
        return Varied(field=field, unit=_base_unit(field), drawn=given)
    if isinstance(given, Sequence | np.ndarray):
        return _read_list(field, list(given))
    return _read_list(field, [given])


def _base_unit(field: Field) -> str:
    return field.units[0] if field.units and field.units[0] != "1" else ""


def _read_list(field: Field, given: list[Any]) -> Varied:
    """Return the values of a list; all get the unit of the first text that has one."""
    if not given:
        raise InputError(f"{field.name} is varied over 0 values: give at least 1")
    plain = [one.item() if isinstance(one, np.generic) else one for one in given]
    if field.kind in ("text", "flag"):
        return Varied(field=field, values=tuple(_flag(field, one) for one in plain))
    if any(isinstance(one, str) for one in plain):
        return _in_one_unit(field, [one if isinstance(one, str) else f"{one!r} {_base_unit(field)}" for one in plain])
    for one in plain:
        if isinstance(one, bool) or not isinstance(one, int | float):
            raise InputError(f"{field.name} cannot be {one!r}: give numbers, or texts with a unit")
    is_whole = field.kind == "whole"
    return Varied(
        field=field,
        unit=_base_unit(field),
        values=tuple(one if is_whole else validate.number(one, field.name) for one in plain),
    )


def _flag(field: Field, one: Any) -> Token:
    if not isinstance(one, str):
        return one  # type: ignore[no-any-return] # checked by the field
    if field.kind == "flag" and one.strip() in ("true", "false"):
        return one.strip() == "true"
    return field.spelled(one.strip())


def _read_text(field: Field, text: str) -> Varied:
    if field.kind in ("text", "flag"):
        return _read_list(field, text.split(","))
    drawn = DRAWN.fullmatch(text.strip())
    if drawn:
        return _read_drawn(field, *drawn.groups())
    if ".." in text:
        between = RANGE.fullmatch(text.strip())
        if between is None:
            raise InputError(
                f"{field.name}: {text!r} is not a range: write it such as '0.1..1 mm:10', with the number of values "
                "after the colon, or '0.1..1 mm:10 log'"
            )
        return _read_range(field, text, *between.groups())
    if re.search(r"\d,\d", text):
        raise InputError(
            f"{field.name}: {text!r} has a comma between digits, which may separate values or be a decimal comma: "
            "write a decimal point, and a space after each comma that separates values"
        )
    return _in_one_unit(field, text.split(","))


def _in_one_unit(field: Field, texts: list[str]) -> Varied:
    """Return values of which some bear a unit: it serves all before it that bear none; the last heads the column."""
    read: list[tuple[str, str]] = []
    for text in texts:
        match = ONE.fullmatch(text.strip())
        if match is None:
            raise InputError(f"{field.name} cannot be {text.strip()!r}: write one number and one unit")
        read.append((match[1], match[2]))
    written = next((units for _, units in reversed(read) if units), "")
    unit = _unit(field, written, texts[-1])
    values = []
    for number, units in reversed(read):
        value, written = _number(field, number), units or written
        if written != unit:
            _unit(field, written, f"{number} {written}")
            try:
                value = convert(float(value), written, unit)
            except UnitError as error:
                raise UnitError(f"{field.name}: {error}") from error
        values.append(value)
    return Varied(field=field, unit=unit, values=tuple(reversed(values)))


def _number(field: Field, digits: str) -> Token:
    if field.kind == "whole":
        if re.fullmatch(r"[+-]?[0-9]+", digits) is None:
            raise InputError(f"{field.name} cannot be {digits}: it takes whole numbers, give one")
        return int(digits)
    return float(digits)


def _unit(field: Field, written: str, quoted: str) -> str:
    """Return the unit of a value after a check that it fits the field."""
    if field.kind != "quantity":
        if written:
            raise InputError(
                f"{field.name} takes a plain number, {quoted.strip()!r} has the unit {written!r}: leave it out"
            )
        return ""
    if field.over_time(written):
        return written
    errors: list[UnitError] = []
    for house_unit in field.units:
        try:
            parse(f"1 {written}", house_unit)
        except UnitError as error:
            errors.append(error)
        else:
            return written
    reason = str(errors[0]).replace(repr(f"1 {written}"), repr(quoted.strip()))
    raise UnitError(f"{field.name}: {reason}")


def _read_drawn(field: Field, kind: str, first: str, second: str, units: str) -> Varied:
    from scipy import stats  # noqa: PLC0415 - costly to import

    unit = _unit(field, units, f"1 {units}")
    one, two = float(first), float(second)
    if kind == "uniform":
        if not -math.inf < one < two < math.inf:
            raise InputError(
                f"{field.name}: uniform({first}, {second}) does not ascend between two finite numbers: give the lower "
                "end first"
            )
        return Varied(field=field, unit=unit, low=one, high=two)
    if not (math.isfinite(one) and 0 < two < math.inf):
        raise InputError(f"{field.name}: normal({first}, {second}) has no spread: give a deviation above 0")
    return Varied(field=field, unit=unit, drawn=stats.norm(one, two))


def _read_range(
    field: Field, text: str, first: str, first_units: str, last: str, units: str, count: str | None, log: str | None
) -> Varied:
    """Return a range; its values are those of exact decimals, so 0.1..1:10 holds 0.3 and not 0.30000000000000004."""
    unit = _unit(field, units, f"{last} {units}")
    if first_units and first_units != units:
        raise InputError(f"{field.name}: {text!r} has two units, {first_units!r} and {units!r}: write one, at the end")
    low, high = float(first), float(last)
    if not math.isfinite(low) or not math.isfinite(high) or low == high:
        raise InputError(f"{field.name}: {text!r} has no width: give two different ends")
    if count is None:
        return Varied(field=field, unit=unit, low=min(low, high), high=max(low, high), log=bool(log))
    number = int(count)
    if not 2 <= number <= MAX_CASES:
        raise InputError(
            f"{field.name}: {text!r} has {number} values, it needs from 2 to {MAX_CASES:_}: change the count"
        )
    if log:
        if not min(low, high) > 0:
            raise InputError(
                f"{field.name}: {text!r} is logarithmic and reaches {min(low, high):g}, it must be above 0: change it"
            )
        values = [float(value) for value in np.geomspace(low, high, number)]
        values[0], values[-1] = low, high
    else:
        start, width = Fraction(first), Fraction(last) - Fraction(first)
        values = [float(start + width * index / (number - 1)) for index in range(number)]
    if field.kind == "whole":
        if log:
            values = list(dict.fromkeys(float(round(value)) for value in values))
        if any(value != round(value) for value in values):
            odd = next(value for value in values if value != round(value))
            raise InputError(f"{field.name} takes whole numbers, {text!r} holds {odd:.6g}: choose another count")
        tokens: tuple[Token, ...] = tuple(round(value) for value in values)
    else:
        tokens = tuple(values)
    return Varied(field=field, unit=unit, values=tokens, low=min(low, high), high=max(low, high), log=bool(log))


def design_cases(
    job: Job,
    varied: Sequence[Varied],
    *,
    design: str | Sequence[Mapping[str, Any]] = "grid",
    count: int | None = None,
    seed: int | None = None,
) -> tuple[tuple[Varied, ...], list[tuple[Token, ...]]]:
    """Return the varied fields, and the cases of a study: for each a value of every field, in the fields' order.

    A grid has every value with every other, the last field fastest. A list of cases names its fields itself.
    """
    if not isinstance(design, str):
        if varied:
            raise InputError(
                f"a list of cases names its fields itself, and {varied[0].name} is varied as well: leave one out"
            )
        fields, rows = _read_cases(job, design)
    else:
        fields = tuple(varied)
        if not fields:
            raise InputError("nothing is varied: name at least 1 field of the job with its values")
        names = [one.name for one in fields]
        places = [one.field.place for one in fields]
        for name, place in zip(names, places, strict=True):
            if places.count(place) > 1:
                raise InputError(f"{name} is varied {places.count(place)} times, the limit is 1: keep one of them")
        rows = _make_grid(fields, count) if design == "grid" else _draw_cases(fields, design, count, seed)
    if not rows:
        raise InputError("the design has 0 cases: give at least 1")
    apply_changes(get_job_data(job), [(one.field, one.unit, token) for one, token in zip(fields, rows[0], strict=True)])
    return fields, rows


def _make_grid(fields: tuple[Varied, ...], count: int | None) -> list[tuple[Token, ...]]:
    if count is not None:
        raise InputError(
            f"the values of a grid set the number of its cases, {count} are requested: choose design = sobol"
        )
    for one in fields:
        if not one.values:
            raise InputError(
                f"{one.name} has no single values for a grid: write their number after a colon, such as "
                "'0.1..1 mm:10', or choose another design, such as sobol"
            )
    cases = math.prod(len(one.values) for one in fields)
    if cases > MAX_CASES:
        raise InputError(
            f"the grid has {cases:_} cases, the limit is {MAX_CASES:_}: use fewer values, or a random design"
        )
    return list(product(*(one.values for one in fields)))


def _draw_cases(
    fields: tuple[Varied, ...], design: str, count: int | None, seed: int | None
) -> list[tuple[Token, ...]]:
    if design not in DESIGNS:
        raise InputError(f"design is {design!r}, it must be {', '.join(DESIGNS)}: choose one of them")
    if count is None:
        raise InputError(f"the design {design!r} needs a number of cases, 1 to {MAX_CASES:_}: state it")
    count = validate.whole_number(count, f"the number of cases of the design {design!r}", 1, MAX_CASES)
    shares = _draw_unit_points(
        design, len(fields), count, None if seed is None else validate.whole_number(seed, "the seed", 0)
    )
    return list(zip(*(one.at(shares[:, number]) for number, one in enumerate(fields)), strict=True))


def _draw_unit_points(design: str, width: int, count: int, seed: int | None) -> Floats:
    """Return points of the unit cube. (count, width)."""
    if design == "random":
        return np.random.default_rng(seed).random((count, width))
    from scipy.stats import qmc  # noqa: PLC0415 - costly to import

    if design == "sobol":  # balanced in powers of two, of which the first ones are taken
        return np.asarray(qmc.Sobol(width, seed=seed).random_base2(math.ceil(math.log2(count)))[:count])  # type: ignore[call-arg, unused-ignore]
    if design == "halton":
        return np.asarray(qmc.Halton(width, seed=seed).random(count))  # type: ignore[call-arg, unused-ignore]
    return np.asarray(qmc.LatinHypercube(width, seed=seed).random(count))  # type: ignore[call-arg, unused-ignore]


def _read_cases(job: Job, design: Sequence[Mapping[str, Any]]) -> tuple[tuple[Varied, ...], list[tuple[Token, ...]]]:
    if not design:
        raise InputError("the list of cases is empty: give at least 1")
    for number, case in enumerate(design, 1):
        if not isinstance(case, Mapping):
            raise InputError(f"case {number} of the list is {case!r}: write a mapping from fields to values")
    names = list(design[0])
    for number, case in enumerate(design, 1):
        if list(case) != names and set(case) != set(names):
            raise InputError(
                f"case {number} of the list has {', '.join(case)}, the first has {', '.join(names)}: name the same"
            )
    fields = tuple(read_varied(job, name, [case[name] for case in design]) for name in names)
    return fields, [tuple(one.values[number] for one in fields) for number in range(len(design))]


def get_job_value(job: Job, varied: Varied) -> Token | None:
    """Return the value of a field in the job, in the unit in which it is varied; ``None`` if the job states none."""
    data: Any = job.table(whole=True)
    for step in varied.field.place:
        data = entry_at(data, step)
    if varied.field.kind != "quantity" or data is None:
        return data if isinstance(data, int | float | str) else None
    if not isinstance(data, str):  # a coefficient of a series, which is in the base unit after parsing
        return convert(float(data), varied.field.units[0], varied.unit or "1")
    if varied.field.over_time(varied.unit):
        speed = job.strategy.spindle_rpm
        return None if speed is None else convert(parse(data, "mm/rev") * speed, "mm/min", varied.unit)
    for house_unit in varied.field.units:
        try:
            parse(f"1 {varied.unit}", house_unit)
            return parse(data, varied.unit or "1")
        except UnitError:
            continue
    return None
