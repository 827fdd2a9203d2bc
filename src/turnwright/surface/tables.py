"""Surfaces in a job file: a table with its ``family``, or a list of such tables, which are added."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping
from typing import TYPE_CHECKING, Annotated, Any

from pydantic import ValidationError
from pydantic_core import InitErrorDetails, core_schema
from typing_extensions import TypeAliasType, TypedDict

from turnwright._tables import adapter, refuse, write_table, written_by
from turnwright.errors import InputError, JobError, UnitError, quote
from turnwright.pose import Pose
from turnwright.surface.base import FAMILIES, Surface
from turnwright.surface.compound import Placed
from turnwright.units import parse

if TYPE_CHECKING:
    from pydantic import GetCoreSchemaHandler, GetJsonSchemaHandler
    from pydantic_core import CoreSchema

__all__ = ["AnySurface", "built", "json_schema_of", "table_of"]

MAX_POWER = 99
"""Power of 1/mm in the unit of a coefficient."""

MAX_COEFFICIENT = 1e100
"""Size of a coefficient, in mm to its power; powers of larger ones overflow."""

UNITS = ("mm", "um", "nm", "m", "in")
"""Units of length of a series."""


class _Where(TypedDict):
    placed: Pose


def built(cls: type[Any], table: dict[str, Any], build: Callable[[Any], Any], context: Any) -> Any:
    """Return the surface that a table describes; ``build`` makes it from the fields of its class."""
    placement = table.get("placed")
    table = {name: value for name, value in table.items() if name not in ("family", "placed")}
    if placement is not None:
        placement = adapter(_Where).validate_python({"placed": placement}, context=context)["placed"]
    if cls.formula_units:
        _check_units(cls, table)
    missing = [InitErrorDetails(type="missing", loc=(key,), input=table) for key in cls.needed if key not in table]
    if missing:
        raise ValidationError.from_exception_data(cls.__name__, missing)
    surface = build(_with_coefficients(cls, table))
    surface = getattr(surface, "heights", surface)  # of a family whose heights are in a file
    if placement is None:
        return surface
    return surface.placed(shift=placement.shift, rotation=placement.rotation, tilt=placement.tilt)


def json_schema_of(cls: type[Any], schema: dict[str, Any], handler: GetJsonSchemaHandler) -> dict[str, Any]:
    """Return the JSON schema of a family, including the keys common to all families."""
    properties = dict(schema["properties"])
    for name, series in cls.series.items():
        entry = {"type": ["number", "string"]}
        kind = {"type": "array", "items": entry} if series.key is None else {
            "type": "object", "additionalProperties": entry,
        }  # fmt: skip
        properties[name] = {**properties[name], **kind}
    if cls.series:
        properties["units"] = {"type": "string", "enum": list(UNITS)}
    required = ["family", *schema.get("required", ()), *cls.needed]
    if cls.formula_units:
        properties["units"] = {"type": "string", "const": cls.formula_units}
        required.append("units")
    return {
        **schema,
        "properties": {
            "family": {"type": "string", "const": cls.family},
            **properties,
            "placed": handler(adapter(Pose).core_schema),
        },
        "required": required,
    }


class _Family:
    """Annotation of a table that is read as the family that it names."""

    @classmethod
    def __get_pydantic_core_schema__(cls, _source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        tagged = core_schema.tagged_union_schema(
            {name: handler.generate_schema(family) for name, family in FAMILIES.items()}, discriminator="family"
        )

        def read(value: Any, build: Callable[[Any], Any]) -> Any:
            if isinstance(value, Surface):
                return value
            return build({"family": "sum", "terms": value} if isinstance(value, list | tuple) else value)

        return core_schema.no_info_wrap_validator_function(read, tagged, serialization=written_by(table_of))


AnySurface = TypeAliasType("AnySurface", Annotated[Any, _Family])
"""A surface of any family."""


def table_of(surface: Surface, *, whole: bool = False) -> dict[str, Any]:
    """Return the table of a surface in a job file; ``whole`` includes default values.

    Raises
    ------
    InputError
        If a job file has no family for the surface, or its heights are not in a file.
    """
    if isinstance(surface, Placed):
        table = table_of(surface.surface, whole=whole)
        if "placed" in table:
            table = {"family": "sum", "terms": [table]}
        return {**table, "placed": write_table(surface.pose, whole=whole)}
    stated = surface.stated
    if (family := getattr(stated, "family", "")) not in FAMILIES:
        raise InputError(
            f"a job file has no family for a {type(surface).__name__}, it has {', '.join(FAMILIES)}: write its "
            "heights to a file and name that file"
        )
    table = write_table(stated, whole=whole)
    for name, series in stated.series.items():
        if name in table:
            table |= {"units": "mm", name: series.written(table[name])}
    if stated.formula_units:
        table["units"] = stated.formula_units
    return {"family": family, **table}


def _check_units(cls: type[Any], table: dict[str, Any]) -> None:
    """Remove the units of a formula from a table; raise unless they are there and right."""
    units = table.pop("units", None)
    if units == cls.formula_units:
        return
    fault = (
        InitErrorDetails(type="missing", loc=("units",), input=table)
        if units is None
        else InitErrorDetails(
            type="literal_error", loc=("units",), input=units, ctx={"expected": repr(cls.formula_units)}
        )
    )
    raise ValidationError.from_exception_data(cls.__name__, [fault])


def _with_coefficients(cls: type[Any], table: dict[str, Any]) -> dict[str, Any]:
    """Return a table with its coefficients in powers of mm; plain numbers are in powers of ``units``."""
    if not cls.series:
        return table
    units = table.pop("units", None)
    if units is not None:
        try:
            parse(f"1 {units}", "mm")
        except UnitError as error:
            raise refuse(cls.__name__, {("units",): error}, units) from error
    problems: dict[tuple[str | int, ...], Exception | str] = {}
    for name, series in cls.series.items():
        terms = table.get(name)
        if terms is None:
            continue
        if not isinstance(terms, Mapping if series.key else list | tuple):
            raise ValidationError.from_exception_data(
                cls.__name__,
                [InitErrorDetails(type="dict_type" if series.key else "list_type", loc=(name,), input=terms)],
            )
        entries = list(terms.items() if isinstance(terms, Mapping) else enumerate(terms))
        problems |= {(name, key): error for key, error in _duplicate_errors(key for key, _ in entries).items()}
        values: dict[Any, float] = {}
        for key, value in entries:
            try:
                place = key if series.key is None else series.key(str(key))
                values[place] = _coefficient(value, units, series.power(place))
            except (UnitError, JobError) as error:
                problems[name, key] = error
        table[name] = values if series.key else tuple(values.values())
    if problems:
        raise refuse(cls.__name__, problems, table)
    return table


def _coefficient(value: object, units: str | None, power: int) -> float:
    if abs(power) > MAX_POWER:
        raise JobError(f"its unit is mm^{power}, the limit is mm^-{MAX_POWER}, a degree of {MAX_POWER + 1}: remove it")
    if units is not None and isinstance(value, int | float) and not isinstance(value, bool):
        value = f"{value!r} {_power_of(units, power)}"
    if not isinstance(value, str):
        raise UnitError(f"{value!r} has no unit: write it as text with a unit, or give the units of the formula once")
    coefficient = parse(value, _power_of("mm", power))
    if abs(coefficient) > MAX_COEFFICIENT:
        raise JobError(f"{quote(value)} is beyond {MAX_COEFFICIENT:g} {_power_of('mm', power)}: check its exponent")
    return coefficient


def _power_of(units: str, power: int) -> str:
    if power == 0:
        return "1"
    raised = units if abs(power) == 1 else f"{units}^{abs(power)}"
    return raised if power > 0 else f"1/{raised}"


def _duplicate_errors(keys: Iterable[object]) -> dict[Any, JobError]:
    """Return the errors of keys that mean the same as an earlier one."""
    first_keys: dict[tuple[int, ...], object] = {}
    return {
        key: JobError(f"the key {key!r} means the same as {first!r}: remove one")
        for key in keys
        if (first := first_keys.setdefault(tuple(map(int, re.findall("-?[0-9]{1,9}", str(key)))), key)) != key
    }
