"""Dataclasses as the tables of a TOML file: which fields they have, how pydantic reads one, how one is written."""

from __future__ import annotations

import dataclasses
import sys
from collections.abc import Callable, Collection, Mapping
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, NamedTuple, get_args, get_type_hints

import numpy as np

from turnwright._arrays import Floats, same
from turnwright._validate import key_of
from turnwright.errors import InputError
from turnwright.units import unit, write

if TYPE_CHECKING:
    from pydantic import GetCoreSchemaHandler, GetJsonSchemaHandler, TypeAdapter
    from pydantic_core import CoreSchema, ValidationError

__all__ = [
    "ByName", "Columns", "Keyed", "Loaded", "Merged", "Numbers", "Plausible", "Sources", "Stated", "adapter", "flat",
    "forget_adapters", "merged", "named", "read_by", "refuse", "types_of", "written", "written_by",
]  # fmt: skip


class Stated:
    """A dataclass that a file can state: its fields carry their units, and unknown keys are refused."""

    __slots__ = ()
    __pydantic_config__: ClassVar[dict[str, Any]] = {"extra": "forbid", "arbitrary_types_allowed": True}
    file_keys: ClassVar[Mapping[str, str]] = {}
    """Keys that name the file of a field, by the field, where its own key is for values."""

    key_names: ClassVar[Mapping[str, str]] = {}
    """Keys of fields in a file, by the field, where they are not called alike."""
    hidden: ClassVar[Collection[str]] = ()
    """Fields that no file states."""

    @classmethod
    def table_keys(cls) -> Mapping[str, Any]:
        """Return the keys that a file can state, with their types."""
        found: dict[str, Any] = {}
        for name, kind in types_of(cls).items():
            if name in merged(cls):
                found |= merged(cls)[name].table_keys()
            elif name not in cls.hidden:
                found[cls.key_names.get(name, name)] = kind
        return found | dict.fromkeys(cls.file_keys.values(), str)

    @classmethod
    def from_table(cls, table: dict[str, Any]) -> dict[str, Any]:
        """Return the table of a file with its short forms written out, keys as the fields are called."""
        return table

    def to_table(self, table: dict[str, Any]) -> dict[str, Any]:
        """Return the fields that are not as by default as a file states them."""
        return table

    @property
    def unstated(self) -> Collection[str]:
        """Fields that follow from the others, so that no file states them."""
        return ()

    @classmethod
    def _build(cls, table: dict[str, Any], build: Callable[[Any], Any], _context: Any) -> Any:
        """Return what a table states; ``build`` makes it of a table whose keys are called as the fields."""
        from pydantic_core import InitErrorDetails, ValidationError  # noqa: PLC0415 - only files need pydantic

        if unknown := [key for key in table if key in {*cls.hidden, *cls.key_names, *merged(cls)}]:
            wrong = [InitErrorDetails(type="extra_forbidden", loc=(key,), input=table) for key in unknown]
            raise ValidationError.from_exception_data(cls.__name__, wrong)
        table = cls.from_table(table)
        named = {name: key for name, key in cls.file_keys.items() if table.get(key) is not None}
        for name, key in named.items():
            if table.get(name) is not None:
                raise InputError(f"{name} and {key} are both given, only one can be right: remove one")
            if isinstance(table[key], str):
                table[key] = Path(table[key])
        named |= cls.key_names
        table |= {name: table.pop(key) for name, key in named.items() if key in table}
        for name, one in merged(cls).items():
            table[name] = {key: table.pop(key) for key in one.table_keys() if key in table and key not in types_of(cls)}
        try:
            return build(table)
        except ValidationError as error:
            raise _at_keys(error, named, merged(cls)) from error

    @classmethod
    def _written(cls, value: Any, *, whole: bool) -> dict[str, Any]:
        """Return the table that states a value."""
        return written(value, whole=whole)

    @classmethod
    def __get_pydantic_core_schema__(cls, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        from pydantic_core import core_schema  # noqa: PLC0415 - only files need pydantic

        def read(value: Any, build: Callable[[Any], Any], info: Any) -> Any:
            return cls._build(dict(value), build, info.context) if isinstance(value, Mapping) else build(value)

        return core_schema.with_info_wrap_validator_function(
            read,
            handler(source),
            ref=f"{cls.__module__}.{cls.__qualname__}:{id(cls)}",
            serialization=written_by(cls._written),
        )

    @classmethod
    def __get_pydantic_json_schema__(cls, core: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        found = handler(core)
        place = handler.resolve_ref_schema(found)
        fields = place["properties"]
        fields |= {key: {"type": "string", "reads": name} for name, key in cls.file_keys.items()}
        fields = {cls.key_names.get(name, name): kind for name, kind in fields.items() if name not in cls.hidden}
        place["properties"] = fields
        for name, one in merged(cls).items():
            inner = handler.resolve_ref_schema(handler(adapter(one).core_schema))
            place["properties"] = inner["properties"] | {key: kind for key, kind in fields.items() if key != name}
            place["required"] = [*inner["required"], *(key for key in place.get("required", ()) if key != name)]
        return found


class Merged:
    """The annotation of a field whose own keys a file states among those of its owner.

    Parameters
    ----------
    stated
        The class of what a file states there.
    """

    __slots__ = ("stated",)

    def __init__(self, stated: type[Stated]) -> None:
        self.stated = stated

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        from pydantic_core import core_schema  # noqa: PLC0415 - only files need pydantic

        return core_schema.no_info_wrap_validator_function(
            lambda value, build: value if isinstance(value, source) else build(value),
            handler.generate_schema(self.stated),
        )


def merged(cls: Any) -> Mapping[str, Any]:
    """Return the fields whose keys a file states among those of the class, with what it states there."""
    return _merged(cls)


@cache
def _merged(cls: Any) -> Mapping[str, Any]:
    notes = {name: get_args(kind)[1:] for name, kind in types_of(cls).items()}
    return {name: one.stated for name, found in notes.items() for one in found if isinstance(one, Merged)}


def written_by(write: Callable[..., Any]) -> Any:
    """Return how pydantic writes a value by a function of it and of whether its defaults are wanted, too."""
    from pydantic_core import core_schema  # noqa: PLC0415 - only files need pydantic

    return core_schema.plain_serializer_function_ser_schema(
        lambda value, info: write(value, whole=not info.exclude_unset), info_arg=True
    )


class ByName:
    """The annotation of a value that a job states by a name or a file, with what differs from it.

    Parameters
    ----------
    table
        What a job says; its ``build`` makes the value and its ``table_of`` the table again.
    """

    __slots__ = ("table",)

    def __init__(self, table: type[Any]) -> None:
        self.table = table

    @property
    def keys(self) -> Mapping[str, Any]:
        """The keys of the table, with their types."""
        found: Mapping[str, Any] = self.table.table_keys()
        return found

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        from pydantic_core import core_schema  # noqa: PLC0415 - only files need pydantic

        def read(value: Any, check: Callable[[Any], Any]) -> Any:
            return value if isinstance(value, source) else check(value).build()

        return core_schema.no_info_wrap_validator_function(
            read,
            handler.generate_schema(self.table),
            serialization=core_schema.plain_serializer_function_ser_schema(self.table.table_of),
        )


def refuse(title: str, problems: Mapping[tuple[str | int, ...], Exception | str], data: object) -> ValidationError:
    """Return a validation error of several sentences, each at its own place below the table being read."""
    from pydantic_core import InitErrorDetails, PydanticCustomError, ValidationError  # noqa: PLC0415 - only files need it

    return ValidationError.from_exception_data(
        title,
        [
            InitErrorDetails(type=PydanticCustomError("sentence", "{text}", {"text": str(text)}), loc=place, input=data)
            for place, text in problems.items()
        ],
    )


def _at_keys(error: ValidationError, named: Mapping[str, str], merged: Collection[str]) -> ValidationError:
    """Return an error whose places are the keys of a file, where these are not those of the fields."""
    from pydantic_core import InitErrorDetails, PydanticCustomError, ValidationError  # noqa: PLC0415 - only files need it

    found = []
    for one in error.errors(include_url=False):
        first, *rest = one["loc"] or ("",)
        kind: Any = one["type"]
        if kind == "sentence":
            kind = PydanticCustomError("sentence", "{text}", one["ctx"])
        elif kind == "path_type":  # which pydantic's core does not know by its name
            kind = PydanticCustomError("path_type", "it is of another type")
        place = (named.get(str(first), first), *rest) if one["loc"] and first not in merged else tuple(rest)
        found.append(InitErrorDetails(type=kind, loc=place, input=one["input"], ctx=one.get("ctx", {})))
    return ValidationError.from_exception_data(error.title, found) if named or merged else error


class Loaded(NamedTuple):
    """What a value was loaded from: the name or the file, and what that states."""

    name: str
    value: Any


class read_by:  # noqa: N801 - reads as a word inside Annotated[Gridded | None, read_by("correction")]
    """A field that a job states by the name of a file, or by another name, which the job's own reader looks up.

    Without such a reader text stays text. A value that was read from a file has its path in ``file``.
    """

    __slots__ = ("kind",)
    texts: ClassVar[tuple[type, ...]] = (str,)
    """What a file states and `read` takes, besides a path."""
    wrong: ClassVar[Any] = "path_type"
    """What pydantic calls it if a file states anything else."""

    def __init__(self, kind: str) -> None:
        """Take the name of the reader, which stands with the folder of the job in pydantic's context."""
        self.kind = kind

    def read(self, value: Any, info: Any) -> Any:
        """Return what the reader makes of text; without one text stays text."""
        context = info.context or {}
        reader = context.get("readers", {}).get(self.kind)
        return value if reader is None else reader(str(value), context["folder"])

    def show(self, value: Any) -> Any:
        """Return the name that `read` takes back to the same value."""
        return named(value)

    def __get_pydantic_core_schema__(self, source: Any, _handler: GetCoreSchemaHandler) -> CoreSchema:
        from pydantic_core import PydanticCustomError, core_schema  # noqa: PLC0415 - only files need pydantic

        kinds = tuple(one for one in get_args(source) or (source,) if isinstance(one, type))

        def read(value: Any, info: Any) -> Any:
            if isinstance(value, (*self.texts, Path)):
                return self.read(value, info)
            if isinstance(value, kinds):
                return value
            raise PydanticCustomError(self.wrong, "it is of another type")

        return core_schema.with_info_plain_validator_function(
            read, serialization=core_schema.plain_serializer_function_ser_schema(self.show)
        )

    def __get_pydantic_json_schema__(self, _core: CoreSchema, _handler: GetJsonSchemaHandler) -> dict[str, Any]:
        return {"type": "string", "reads": self.kind}


class Numbers:
    """The annotation of an array that a file states as a list of plain numbers."""

    @classmethod
    def __get_pydantic_core_schema__(cls, _source: Any, _handler: GetCoreSchemaHandler) -> CoreSchema:
        from pydantic_core import core_schema  # noqa: PLC0415 - only files need pydantic

        return core_schema.list_schema(core_schema.float_schema(strict=True))


class Keyed:
    """The annotation of a value that a file states as a table of its own keys."""

    __slots__ = ()

    @property
    def keys(self) -> Mapping[str, Any]:
        """The keys of the table, with their types."""
        raise NotImplementedError

    def name_of(self, key: str) -> str:
        """Return what the value calls a key of the table."""
        return key

    def table_schema(self, handler: GetCoreSchemaHandler, *, required: bool = False) -> CoreSchema:
        """Return how pydantic reads the table, of which any key may be left out, or none."""
        from pydantic_core import core_schema  # noqa: PLC0415 - only files need pydantic

        fields = {
            key: core_schema.typed_dict_field(handler.generate_schema(kind), required=required)
            for key, kind in self.keys.items()
        }
        return core_schema.typed_dict_schema(fields, extra_behavior="forbid")


class Columns(Keyed):
    """The annotation of arrays of one length that a file states as lists by their keys, each with its factor."""

    __slots__ = ("factors",)

    def __init__(self, **factors: float) -> None:
        self.factors = factors

    @property
    def keys(self) -> Mapping[str, Any]:
        """The keys of the table, with their types."""
        return dict.fromkeys(self.factors, Annotated[Any, Numbers])

    def __get_pydantic_core_schema__(self, _source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        from pydantic_core import core_schema  # noqa: PLC0415 - only files need pydantic

        def arrays(lists: Mapping[str, Any]) -> tuple[Floats, ...]:
            return tuple(np.array(lists.get(key, ()), dtype=np.float64) * one for key, one in self.factors.items())

        return core_schema.no_info_after_validator_function(arrays, self.table_schema(handler))


class Sources:
    """The annotation of texts by the dotted names of the facts that they belong to, which a file states as tables."""

    @classmethod
    def __get_pydantic_core_schema__(cls, _source: Any, _handler: GetCoreSchemaHandler) -> CoreSchema:
        from pydantic_core import core_schema  # noqa: PLC0415 - only files need pydantic

        texts = core_schema.dict_schema(core_schema.str_schema(), core_schema.str_schema(strict=True))
        return core_schema.no_info_before_validator_function(flat, texts)


def flat(table: Any, prefix: str = "") -> Any:
    """Return a nested table with dotted keys."""
    if not isinstance(table, Mapping):
        return table
    found: dict[str, Any] = {}
    for key, value in table.items():
        found |= flat(value, f"{prefix}{key}.") if isinstance(value, Mapping) else {f"{prefix}{key}": value}
    return found


class Plausible(Keyed):
    """Sizes of error sources, each one standard deviation: by the name of the source, in a file by its key.

    Parameters
    ----------
    units
        Of each source.
    texts
        What a form says of it.
    slopes
        Sources whose size is an angle that may be given as a slope, too.
    """

    __slots__ = ("slopes", "texts", "units")

    def __init__(self, units: Mapping[str, str], texts: Mapping[str, str], slopes: Collection[str] = ()) -> None:
        self.units, self.texts, self.slopes = units, texts, slopes

    @property
    def keys(self) -> Mapping[str, Any]:
        """The types of the sizes by their keys in a file."""
        return {
            key_of(name): Annotated[float, unit(one, *(("1",) if name in self.slopes else ()), above=0.0)]
            for name, one in self.units.items()
        }

    def name_of(self, key: str) -> str:
        """Return the name of the source that has a key."""
        return next(name for name in self.units if key_of(name) == key)

    def __get_pydantic_core_schema__(self, _source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        from pydantic_core import core_schema  # noqa: PLC0415 - only files need pydantic

        names = {key_of(name): name for name in self.units}
        return core_schema.no_info_after_validator_function(
            lambda sizes: {names[key]: size for key, size in sizes.items()}, self.table_schema(handler),
            serialization=core_schema.plain_serializer_function_ser_schema(
                lambda sizes: {key_of(name): write(size, self.units[name]) for name, size in sizes.items()}
            ),
        )  # fmt: skip

    def __get_pydantic_json_schema__(self, core: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        found = dict(handler(core))
        for name, text in self.texts.items():
            found["properties"][key_of(name)]["description"] = text
        return found


def named(value: Any) -> str | None:
    """Return the name by which a job states a value that was read from a file.

    Raises
    ------
    InputError
        If it was read from none.
    """
    if value is None or isinstance(value, str):
        return value
    if not (file := getattr(value, "file", "")):
        raise InputError(
            f"a job file names the file of a {type(value).__name__}, and this was read from none: write it"
        )
    return str(file)


def adapter(annotation: Any) -> TypeAdapter[Any]:
    """Return how pydantic reads and writes a type."""
    return _adapter(annotation)


def forget_adapters() -> None:
    """Have types read again, as after a surface family was added."""
    _adapter.cache_clear()


@cache
def _adapter(annotation: Any) -> TypeAdapter[Any]:
    from pydantic import TypeAdapter  # noqa: PLC0415 - only files need pydantic

    return TypeAdapter(annotation)


def types_of(cls: Any) -> Mapping[str, Any]:
    """Return the types of the fields of a dataclass that a caller states, with their units, by name."""
    return _types(cls)


@cache
def _types(cls: Any) -> Mapping[str, Any]:
    types: dict[str, Any] = {}
    own = [field.name for field in dataclasses.fields(cls) if field.init]
    for base in reversed(cls.__mro__):
        mine = {name: kind for name, kind in vars(base).get("__annotations__", {}).items() if name in own}
        stated = SimpleNamespace(__annotations__=mine)
        types |= get_type_hints(stated, vars(sys.modules[base.__module__]), include_extras=True)
    return {name: types[name] for name in own}


def written(value: Any, *, whole: bool = False, base: Any = None) -> dict[str, Any]:
    """Return a dataclass as a table, quantities as text: the fields that are not as by default, or the whole of it.

    With a ``base``, another value of the class, it has the fields that are not as there.
    """
    table: dict[str, Any] = {}
    for field in dataclasses.fields(value):
        if not field.init or field.name in value.unstated or field.name in value.hidden:
            continue
        held = getattr(value, field.name)
        default = _default(field) if base is None else getattr(base, field.name)
        if held is not None and (whole or not same(held, default)):
            key = value.file_keys.get(field.name, "") if getattr(held, "file", "") else ""
            kind = types_of(type(value))[field.name]
            if field.name in merged(type(value)):
                table |= _inner(value, field.name, whole=whole)
                continue
            table[key or value.key_names.get(field.name, field.name)] = (
                named(held) if key else _dumped(kind, held, whole=whole)
            )
    return dict(value.to_table(table))


def _inner(value: Any, name: str, *, whole: bool) -> dict[str, Any]:
    """Return the keys of a field that a file states among those of its owner."""
    held, stated = getattr(value, name), merged(type(value))[name]
    if type(held) is not stated:
        raise InputError(
            f"a job file has no {type(value).__name__} over a {type(held).__name__}: take a {stated.__name__}"
        )
    return written(held, whole=whole)


def _default(field: dataclasses.Field[Any]) -> Any:
    return field.default if field.default_factory is dataclasses.MISSING else field.default_factory()


def _dumped(kind: Any, value: Any, *, whole: bool) -> Any:
    """Return a value as data; what it cannot be stated for is said as such, not as an error of pydantic."""
    from pydantic_core import PydanticSerializationError  # noqa: PLC0415 - only files need it

    try:
        return adapter(kind).dump_python(value, mode="json", exclude_unset=not whole)
    except PydanticSerializationError as error:
        raise error.__cause__ or error from None
