"""Change one field of a job, named by its keys in the job file."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import replace
from types import UnionType
from typing import TYPE_CHECKING, Annotated, Any, NoReturn, TypeVar, Union, get_args, get_origin

import numpy as np
from pydantic import ValidationError

from turnwright._faults import sentences, suggestion
from turnwright._tables import Keyed, TableModel, adapter, merged_fields, types_of
from turnwright.errors import InputError, JobError, quote
from turnwright.job.tables import context_of, with_interpolation
from turnwright.machine import Machine
from turnwright.pose import Pose
from turnwright.strategy import STRATEGIES, Strategy
from turnwright.surface import FAMILIES, Placed, Surface
from turnwright.units import Number, Text

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

__all__ = ["replace_field"]

Owner = TypeVar("Owner", bound="DataclassInstance")

_STEP = re.compile(r"([^.\[\]]+)((?:\[[0-9]{1,9}\])*)")
"""A key, and the indices of entries in the lists that it holds."""


def replace_field(job: Owner, name: str, value: Any) -> Owner:
    """Return the job with one field changed. See `turnwright.job.Job.replace`."""
    change = _Change(name, value)
    step, *steps = _steps(name)
    try:
        field, new = change.field(job, step, steps)
    except InputError as error:
        raise JobError(str(error) if str(error).startswith(name) else f"{name}: {error}") from error
    except (TypeError, ValueError, AttributeError) as error:  # from arrays and series, which no job file states
        raise JobError(f"{name} cannot be {quote(value)} ({error}): give another value") from error
    return replace(job, **{field: new})


def _steps(name: str) -> list[str]:
    parts = [_STEP.fullmatch(part) for part in name.split(".")]
    if None in parts:
        raise JobError(f"a field is named like strategy.feed or passes[1].feed, got {quote(name)}")
    return [step for part in parts if part for step in (part[1], *re.findall(r"\[[0-9]+\]", part[2]))]


class _Change:
    def __init__(self, name: str, value: Any) -> None:
        self.name, self.value = name, value

    def _within(self, held: Any, kind: Any, steps: list[str]) -> Any:
        """Return the value of a field of some type, changed at the keys and indices."""
        if not steps:
            return self._read(kind, self.value, self.name)
        step, *steps = steps
        if isinstance(held, tuple):
            return self._entry(held, kind, step, steps)
        if isinstance(held, Mapping):
            return self._keyed(held, kind, step, steps)
        return self._changed(held, step, steps)

    def _changed(self, held: Any, step: str, rest: list[str]) -> Any:
        if held is None:
            raise JobError(f"{self.name} is a key of a table that the job does not state: replace the whole table")
        if isinstance(held, Machine) and step in ("name", "file"):
            raise JobError(f"{self.name} selects another machine: replace machine with the result of Machine.load")
        if isinstance(held, Machine) and step == "interpolation":
            return with_interpolation(held, self._within(held.controller.interpolation, Text, rest))
        if isinstance(held, Surface) and step == "placed":
            inner, pose = (held.surface, held.pose) if isinstance(held, Placed) else (held, Pose())
            pose = self._within(pose, Pose, rest)
            return inner.placed(shift=pose.shift, rotation=pose.rotation, tilt=pose.tilt)
        if isinstance(held, Surface | Strategy) and step in ("family", "kind"):
            raise JobError(f"{self.name} cannot change alone: replace the whole {self.name.removesuffix('.' + step)}")
        for name, inner in merged_fields(type(held)).items() if isinstance(held, TableModel) else ():
            if step in inner.table_keys() and step not in types_of(type(held)):
                return replace(held, **{name: self._changed(getattr(held, name), step, rest)})
        if isinstance(held, Placed):
            return replace(held, surface=self._changed(held.surface, step, rest))
        name, new = self.field(held, step, rest)
        return replace(held, **{**dict.fromkeys(held.unstated), name: new})

    def field(self, owner: Any, step: str, rest: list[str]) -> tuple[str, Any]:
        """Return the name of a field of an object by its key, and its new value."""
        if not isinstance(owner, TableModel):
            raise JobError(f"{self.name} is not a field of this job: the value before {step} has no fields")
        kinds = {name: kind for name, kind in types_of(type(owner)).items() if name not in owner.hidden}
        names = {owner.key_names.get(name, name): name for name in kinds}
        if step not in names:
            self._unknown(step, names)
        name = names[step]
        held = getattr(owner, name)
        series = owner.series.get(name) if isinstance(owner, Surface) else None
        if series is None or (series.key is None and rest):
            return name, self._within(held, kinds[name], rest)
        if series.key is None or not rest:
            return name, self.value
        return name, {**dict(held), series.key(rest[0]): self._within(None, Number, rest[1:])}

    def _keyed(self, held: Mapping[Any, Any], kind: Any, step: str, rest: list[str]) -> Any:
        note = next((one for one in get_args(kind) if isinstance(one, Keyed)), None)
        if note is not None:
            if step not in note.keys:
                self._unknown(step, note.keys)
            return {**held, note.name_of(step): self._within(None, note.keys[step], rest)}
        if step not in held:
            self._unknown(step, map(str, held))
        inner = next((get_args(one)[1] for one in _kinds(kind) if get_origin(one) is Mapping), Any)
        return {**held, step: self._within(held[step], inner, rest)}

    def _entry(self, held: tuple[Any, ...], kind: Any, step: str, rest: list[str]) -> Any:
        """Return a list with one entry changed, selected by its name or by its number from 1."""
        names = [getattr(one, "name", None) for one in held]
        index = int(step[1:-1]) - 1 if step.startswith("[") else names.index(step) if step in names else -1
        if not 0 <= index < len(held):
            raise JobError(
                f"{self.name} is not a field of this job: {step} is none of the {len(held)} entries, which count from "
                "[1]"
            )
        if not rest:  # the type of the list has the type of its entries
            above = self.name.removesuffix(step).removesuffix(".")
            return self._read(kind, (*held[:index], self.value, *held[index + 1 :]), above)
        kinds = next((get_args(one) for one in _kinds(kind) if get_origin(one) is tuple), (Any, ...))
        new = self._within(held[index], kinds[0] if kinds[-1] is ... else kinds[index], rest)
        return (*held[:index], new, *held[index + 1 :])

    def _read(self, kind: Any, value: Any, path: str) -> Any:
        """Return a value as a field of this type holds it."""
        by_keys = any(isinstance(one, Keyed) for part in (kind, *get_args(kind)) for one in get_args(part))
        if isinstance(value, np.ndarray) or (by_keys and not isinstance(value, Mapping)):
            return value  # arrays, which no job file states: their class checks them
        try:
            return adapter(kind).validate_python(value, context=context_of(".") | {"plain": True})
        except ValidationError as error:
            raise JobError("\n".join(sentences(error, kind, {**FAMILIES, **STRATEGIES}, path=path))) from error

    def _unknown(self, step: str, known: Any) -> NoReturn:
        raise JobError(f"{self.name} is not a field of this job: {suggestion(step, known)}")


def _kinds(kind: Any) -> Iterator[Any]:
    """Yield the types that a field may have, without annotations."""
    if get_origin(kind) is Annotated:
        yield from _kinds(get_args(kind)[0])
    elif get_origin(kind) in (Union, UnionType):
        for one in get_args(kind):
            yield from _kinds(one)
    else:
        yield kind
