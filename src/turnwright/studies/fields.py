"""Fields of a job by their dotted names as in the job file: type, unit, and how to change them."""

from __future__ import annotations

import copy
import difflib
import re
from collections import abc
from contextlib import suppress
from dataclasses import dataclass, replace
from fractions import Fraction
from types import NoneType, UnionType
from typing import TYPE_CHECKING, Annotated, Any, Literal, NamedTuple, TypeAlias, Union, get_args, get_origin

from pydantic import TypeAdapter, ValidationError

from turnwright._faults import keys_of, sentences
from turnwright._tables import types_of
from turnwright.errors import InputError, UnitError
from turnwright.job import HeightFile, Table
from turnwright.surface import Placed, Sum, Surface
from turnwright.units import parse, unit

if TYPE_CHECKING:
    from collections.abc import Mapping

    from turnwright.job import Job

__all__ = ["Data", "Field", "Token", "apply_changes", "entry_at", "find_field", "get_job_data"]

Token: TypeAlias = float | int | str | bool
"""A value of a field: a number in the field's unit, a whole or plain number, a text or a flag."""

_STEP = re.compile(r"\[[0-9]{1,9}\]|[^.\[\]]+")
_NAME = re.compile(r"[^.\[\]]+(?:\.[^.\[\]]+|\[[0-9]{1,9}\])*")
"""Keys separated by dots, and indices in brackets, counted from 1."""

PER_MINUTE = "mm/min"
"""Unit of a feed per time, which a job states per revolution."""

TOUCHED: dict[str, tuple[str, ...]] = {
    "spindle_speed": ("spindle_speeds",),
    "spindle_speeds": ("spindle_speed",),
}
"""Fields that exclude each other: where one is varied, the other is no longer stated."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Field:
    """A field of a job."""

    name: str  # name as requested, such as ``passes.finish.feed``
    place: tuple[str | int, ...]  # keys in the data of the job
    units: tuple[str, ...]  # allowed units, the base unit first; empty if there is none
    kind: Literal["quantity", "number", "whole", "flag", "text"]  # what it holds
    annotation: Any  # type annotation of the field
    among: int = 0  # length of the list that it is an entry of; 0 if any length is allowed

    @property
    def is_feed(self) -> bool:
        """Whether it is an advance per revolution, which may be given over time."""
        return self.units == ("mm/rev",)

    def over_time(self, units: str) -> bool:
        """Return whether these units state a feed per time."""
        if not self.is_feed:
            return False
        with suppress(UnitError):
            parse(f"1 {units}", PER_MINUTE)
            return True
        return False

    def written(self, token: Token, units: str) -> Token:
        """Return a value as it is written in a job file."""
        return f"{float(token)!r} {units}".rstrip() if self.kind == "quantity" and not isinstance(token, str) else token

    def spelled(self, text: str) -> Token:
        """Return the allowed word that a text states: a whole number if the field accepts numbers."""
        for one in _alternatives(self.annotation):
            words = get_args(_bare(one)) if get_origin(_bare(one)) is Literal else ()
            if _bare(one) is int and text.isdigit():
                return int(text)
            for word in words:
                if str(word) == text:
                    return word  # type: ignore[no-any-return] # a text or a number
        return text

    def check(self, token: Token, units: str) -> None:
        """Raise if the field does not accept a value, regardless of other fields."""
        if self.over_time(units):
            if not float(token) > 0:
                raise InputError(f"{self.name}: {token!r} {units} is not above 0 {units}: give a larger value")
            return
        try:
            TypeAdapter(self.annotation).validate_python(self.written(token, units))
        except ValidationError as error:
            raise InputError(sentences(error, Table, {}, self.name)[0]) from error


class Data(NamedTuple):
    """The data of a job, as in a job file."""

    stated: dict[str, Any]  # without defaults
    whole: dict[str, Any]  # with defaults


def get_job_data(job: Job) -> Data:
    """Return the data of a job."""
    return Data(job.table(), job.table(whole=True))


def find_field(job: Job, name: str) -> Field:
    """Return a field of a job by its dotted name, as in the job file, such as ``simulation.patches[1].pixel``.

    Entries of a list are identified by name or by an index from 1 in brackets. The job need not state a value.
    """
    if not isinstance(name, str):
        raise InputError(f"{name!r} is no name of a field: write it as in the job file, such as 'tool.nose_radius'")
    steps = _STEP.findall(name) if _NAME.fullmatch(name) else name.split(".")
    value: Any = job
    annotation: Any = type(job)
    place: list[str | int] = []
    units: tuple[str, ...] | None = None
    among = 0
    for number, step in enumerate(steps):
        before = _joined(steps[:number])
        if isinstance(value, Sum) and step.startswith("["):
            place.append("terms")  # a sum may be written as a list
            value, annotation = value.terms, types_of(Sum)["terms"]
        table = _table(value, annotation)
        if table is not None:
            if step not in table:
                raise InputError(_unknown_field(name, before, step, list(table)))
            units = _unit_of_entry(value, step, steps[number + 1 :])
            annotation = table[step]
            value = _value_at(value, step)
            place.append(step)
        elif _is_mapping(annotation):
            value = None if value is None else _entry(value, step)
            annotation = get_args(_bare(annotation))[1]
            place.append(step)
        else:
            index = _index(name, before, step, value, annotation)
            among = 0 if _element(annotation, 99) is not None else _length(None, annotation)
            annotation = _element(annotation, index)
            value = value[index] if value is not None and index < len(value) else None
            place.append(index)
    if _table(value, annotation) is not None or _is_mapping(annotation) or _element(annotation, 0) is not None:
        raise InputError(
            f"{name} is {_inside(value, annotation)}: vary one of its values, such as "
            f"{_joined([name, _allowed_value(value, annotation)])}"
        )
    return replace(_leaf(name, tuple(place), annotation, units), among=among if isinstance(place[-1], int) else 0)


def _leaf(name: str, place: tuple[str | int, ...], annotation: Any, units: tuple[str, ...] | None) -> Field:
    reader = _unit_in(annotation)
    if units is not None:
        return Field(name=name, place=place, units=units, kind="quantity", annotation=Any)
    if reader is not None:
        return Field(name=name, place=place, units=reader.units, kind="quantity", annotation=annotation)
    plain = {_bare(one) for one in _alternatives(annotation)}
    kinds = {str: "text", bool: "flag", int: "whole", float: "number"}
    kind = next((kinds[one] for one in kinds if one in plain), "text")
    return Field(name=name, place=place, units=(), kind=kind, annotation=annotation)  # type: ignore[arg-type] # one of them


def _unit_of_entry(value: Any, step: str, rest: list[str]) -> tuple[str, ...] | None:
    """Return the unit of a coefficient, which depends on its index in a series."""
    if len(rest) != 1:
        return None
    if step == "waviness" and rest[0].startswith("["):
        return (f"mm/rad^{rest[0][1:-1]}",)
    value = value.surface if isinstance(value, Placed) else value
    if isinstance(value, Surface) and step in value.series:
        series = value.series[step]
        power = series.power(series.key(rest[0]) if series.key else int(rest[0][1:-1]) - 1)
        return (f"mm^{power}" if power > 0 else f"1/mm^{-power}" if power < 0 else "1",)
    return None


def _alternatives(annotation: Any) -> list[Any]:
    """Return the alternatives of a type, without ``None``."""
    bare = _bare(annotation)
    if get_origin(bare) in (UnionType, Union):
        return [one for part in get_args(bare) if part is not NoneType for one in _alternatives(part)]
    return [annotation]


def _bare(annotation: Any) -> Any:
    while get_origin(annotation) is Annotated:
        annotation = get_args(annotation)[0]
    return annotation


def _table(value: Any, annotation: Any) -> Mapping[str, Any] | None:
    """Return the keys, with their types, of the table that a field holds or may hold."""
    if isinstance(value, Placed):
        return _table(value.surface, annotation)
    if isinstance(value, Surface):
        return keys_of(HeightFile if isinstance(value.stated, HeightFile) else type(value))
    if value is not None and (keys := keys_of(type(value))) is not None:
        return keys
    return next((keys for one in _alternatives(annotation) if (keys := keys_of(one)) is not None), None)


def _value_at(value: Any, step: str) -> Any:
    """Return the value of a key of a table; ``None`` if there is none, or if only a file has the key."""
    if isinstance(value, Placed):
        if step == "placed":
            return value.pose
        return _value_at(value.surface, step)
    return getattr(getattr(value, "source", None) or value, step, None)


def _is_mapping(annotation: Any) -> bool:
    return any(get_origin(_bare(one)) in (dict, abc.Mapping) for one in _alternatives(annotation))


def _element(annotation: Any, index: int) -> Any:
    """Return the type of an entry of a list; ``None`` if it has no such entry."""
    for one in _alternatives(annotation):
        bare = _bare(one)
        if get_origin(bare) is tuple:
            inner = get_args(bare)
            if len(inner) == 2 and inner[1] is Ellipsis:
                return inner[0]
            return inner[index] if index < len(inner) else None
    return None


def _joined(steps: list[str]) -> str:
    return ".".join(filter(None, steps)).replace(".[", "[")


def _entry(value: Any, step: str) -> Any:
    return next((one for key, one in dict(value).items() if str(key) == step), None)


def _index(name: str, before: str, step: str, value: Any, annotation: Any) -> int:
    """Return the index of a list entry that is identified by name or index."""
    if _element(annotation, 0) is None:
        raise InputError(f"{name} is not a field of this job, {before} has no fields: vary {before} itself")
    names = [str(getattr(one, "name", "")) for one in value or ()]
    if step in names:
        return names.index(step)
    tables = any(_table(one, None) is not None for one in value or ())
    index = int(step[1:-1]) - 1 if step.startswith("[") else -1
    if index < 0 or _element(annotation, index) is None or (tables and index >= len(names)):
        choices = [one for one in names if one] or [f"[1] to [{max(_length(value, annotation), 1)}]"]
        raise InputError(_unknown_field(name, before, step, choices))
    if value is None and _table(None, _element(annotation, 0)) is not None:
        raise InputError(f"{name} is not a field of this job, {before} has no entries: add one to the job")
    return index


def _length(value: Any, annotation: Any) -> int:
    return len(value) if value else sum(_element(annotation, index) is not None for index in range(10))


def _unknown_field(name: str, before: str, step: str, known: list[str]) -> str:
    close = difflib.get_close_matches(step.lower(), known, n=1, cutoff=0.5)
    remedy = (
        f"did you mean {_joined([before, close[0]])}?"
        if close
        else f"{before or 'a job'} has {', '.join(known)}, use one of them"
    )
    return f"{name} is not a field of this job: {remedy}"


def _inside(value: Any, annotation: Any) -> str:
    return "a table" if _table(value, annotation) is not None or _is_mapping(annotation) else "a list"


def _allowed_value(value: Any, annotation: Any) -> str:
    table = _table(value, annotation)
    if table is not None:
        return next(iter(table))
    if _is_mapping(annotation):
        return str(next(iter(dict(value)))) if value else "2"
    return str(getattr(value[0], "name", "[1]")) if value else "[1]"


def _unit_in(annotation: Any) -> unit | None:
    if isinstance(annotation, unit):
        return annotation
    for inner in get_args(annotation):
        inner_unit = _unit_in(inner)
        if inner_unit is not None:
            return inner_unit
    return None


def apply_changes(base: Data, changes: list[tuple[Field, str, Token]]) -> dict[str, Any]:
    """Return the data of a job with some fields changed, each to a value in a unit.

    A feed per time is divided by the spindle speed of the same case, with one rounding.
    """
    data: dict[str, Any] = copy.deepcopy(base.stated)
    for field, units, token in sorted(changes, key=lambda one: one[0].over_time(one[1])):
        value = field.written(token, units)
        if field.over_time(units):
            value = f"{_per_turn(field, float(token), units, data)!r} mm/rev"
        _set_value(base.whole, data, field, value)
    return data


def _per_turn(field: Field, token: float, units: str, data: Mapping[str, Any]) -> float:
    tables = [data["strategy"]]
    if field.place[0] == "passes":
        tables.insert(0, data["passes"][field.place[1]])
    for table in tables:
        if "spindle_speed" in table:
            rpm = parse(table["spindle_speed"], "rpm")
            return float(Fraction(parse(f"{token!r} {units}", PER_MINUTE)) / Fraction(rpm))
        if "spindle_speeds" in table:
            break
    raise InputError(
        f"{field.name} is given in {units}, and the job states no single spindle speed to divide it by: state or vary "
        "strategy.spindle_speed, or give the feed per rev"
    )


def _set_value(complete: Any, data: dict[str, Any], field: Field, value: Token) -> None:
    """Set the value of a field, and create tables and lists on its path that the file leaves out."""
    node: Any = data
    for number, step in enumerate(field.place):
        last = number == len(field.place) - 1
        complete = entry_at(complete, step)
        if isinstance(step, int):
            while len(node) <= max(step, field.among - 1 if last else 0):
                node.append(_zero(field, len(node)))
            key: Any = step
        else:
            key = next((key for key in node if str(key) == step), step)
            for other in TOUCHED.get(step, ()):
                node.pop(other, None)
        if last:
            node[key] = value
            return
        if isinstance(node, dict) and node.get(key) is None:
            node[key] = [] if isinstance(field.place[number + 1], int) else {}
            if isinstance(complete, list):
                node[key] = _stated(complete)
        node = node[key]


def entry_at(whole: Any, step: str | int) -> Any:
    """Return an entry of a table or a list; ``None`` if there is none."""
    if isinstance(whole, dict):
        return next((one for key, one in whole.items() if str(key) == str(step)), None)
    return whole[step] if isinstance(whole, list) and isinstance(step, int) and step < len(whole) else None


def _stated(whole: Any) -> Any:
    if isinstance(whole, dict):
        return {key: _stated(one) for key, one in whole.items() if one is not None}
    return [_stated(one) for one in whole] if isinstance(whole, list) else whole


def _zero(field: Field, index: int) -> Token:
    """Return the zero that fills a list before a changed entry."""
    if "waviness" in field.place:
        return f"0 mm/rad^{index + 1}"
    if not field.units or field.units[0].startswith("1/"):
        return 0.0
    return f"0 {field.units[0]}"
