"""Dataclasses as tables of a TOML file: their keys, how pydantic reads them, how they are written."""

from __future__ import annotations

import dataclasses
import sys
from abc import ABC, abstractmethod
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
    "ByName", "Columns", "Keyed", "Loaded", "Merged", "Numbers", "Plausible", "Sources", "TableModel", "adapter",
    "flat", "forget_adapters", "merged_fields", "named", "read_by", "refuse", "types_of", "write_table", "written_by",
]  # fmt: skip


class TableModel:
    """A dataclass that a file can describe: its fields carry their units, and unknown keys are refused."""

    __slots__ = ()
    __pydantic_config__: ClassVar[dict[str, Any]] = {"extra": "forbid", "arbitrary_types_allowed": True}
    file_keys: ClassVar[Mapping[str, str]] = {}
    """Keys that name a file with the value of a field, by field, where another key holds the value itself."""

    key_names: ClassVar[Mapping[str, str]] = {}
    """Keys of fields in a file, by field, where key and field have different names."""
    hidden: ClassVar[Collection[str]] = ()
    """Fields that a file does not have."""

    @classmethod
    def table_keys(cls) -> Mapping[str, Any]:
        """Return the keys that a file may have, with their types."""
        keys: dict[str, Any] = {}
        for name, kind in types_of(cls).items():
            if name in merged_fields(cls):
                keys |= merged_fields(cls)[name].table_keys()
            elif name not in cls.hidden:
                keys[cls.key_names.get(name, name)] = kind
        return keys | dict.fromkeys(cls.file_keys.values(), str)

    @classmethod
    def from_table(cls, table: dict[str, Any]) -> dict[str, Any]:
        """Return the table of a file with short forms expanded and keys named as the fields."""
        return table

    def to_table(self, table: dict[str, Any]) -> dict[str, Any]:
        """Return the table for a file from the fields that differ from their defaults."""
        return table

    @property
    def unstated(self) -> Collection[str]:
        """Fields that follow from the others and are not written."""
        return ()

    @classmethod
    def _build(cls, table: dict[str, Any], build: Callable[[Any], Any], _context: Any) -> Any:
        """Return the instance that a table describes; ``build`` takes a table whose keys are named as the fields."""
        from pydantic_core import InitErrorDetails, ValidationError  # noqa: PLC0415 - only files need pydantic

        if unknown := [key for key in table if key in {*cls.hidden, *cls.key_names, *merged_fields(cls)}]:
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
        for name, inner in merged_fields(cls).items():
            own_keys = types_of(cls)
            table[name] = {key: table.pop(key) for key in inner.table_keys() if key in table and key not in own_keys}
        try:
            return build(table)
        except ValidationError as error:
            raise _name_keys(error, named, merged_fields(cls)) from error

    @classmethod
    def _written(cls, value: Any, *, whole: bool) -> dict[str, Any]:
        return write_table(value, whole=whole)

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
        schema = handler(core)
        definition = handler.resolve_ref_schema(schema)
        fields = definition["properties"]
        fields |= {key: {"type": "string", "reads": name} for name, key in cls.file_keys.items()}
        fields = {cls.key_names.get(name, name): kind for name, kind in fields.items() if name not in cls.hidden}
        definition["properties"] = fields
        if "required" in definition:
            definition["required"] = [cls.key_names.get(name, name) for name in definition["required"]]
        for name, merged_class in merged_fields(cls).items():
            inner = handler.resolve_ref_schema(handler(adapter(merged_class).core_schema))
            definition["properties"] = inner["properties"] | {key: kind for key, kind in fields.items() if key != name}
            required = (key for key in definition.get("required", ()) if key != name)
            definition["required"] = [*inner["required"], *required]
        return schema


class Merged:
    """Annotation of a field whose keys, those of the class ``stated``, stand among those of its owner."""

    __slots__ = ("stated",)

    def __init__(self, stated: type[TableModel]) -> None:
        self.stated = stated

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        from pydantic_core import core_schema  # noqa: PLC0415 - only files need pydantic

        return core_schema.no_info_wrap_validator_function(
            lambda value, build: value if isinstance(value, source) else build(value),
            handler.generate_schema(self.stated),
        )


def merged_fields(cls: Any) -> Mapping[str, Any]:
    """Return the fields whose keys stand among those of the class, with the classes that the keys describe."""
    return _merged(cls)


@cache
def _merged(cls: Any) -> Mapping[str, Any]:
    notes = {name: get_args(kind)[1:] for name, kind in types_of(cls).items()}
    return {name: note.stated for name, field in notes.items() for note in field if isinstance(note, Merged)}


def written_by(write: Callable[..., Any]) -> Any:
    """Return a pydantic serializer that calls ``write(value, whole=...)``; ``whole`` includes defaults."""
    from pydantic_core import core_schema  # noqa: PLC0415 - only files need pydantic

    return core_schema.plain_serializer_function_ser_schema(
        lambda value, info: write(value, whole=not info.exclude_unset), info_arg=True
    )


class ByName:
    """Annotation of a value that a job describes by a name or a file, and by what differs from it.

    ``table`` is the class of the job's table: its ``build`` makes the value, its ``table_of`` the table again.
    """

    __slots__ = ("table",)

    def __init__(self, table: type[Any]) -> None:
        self.table = table

    @property
    def keys(self) -> Mapping[str, Any]:
        """The keys of the table, with their types."""
        keys: Mapping[str, Any] = self.table.table_keys()
        return keys

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
    """Return a validation error of several sentences, each with its place below the table being read."""
    from pydantic_core import InitErrorDetails, PydanticCustomError, ValidationError  # noqa: PLC0415 - only files need it

    return ValidationError.from_exception_data(
        title,
        [
            InitErrorDetails(type=PydanticCustomError("sentence", "{text}", {"text": str(text)}), loc=place, input=data)
            for place, text in problems.items()
        ],
    )


def _name_keys(error: ValidationError, named: Mapping[str, str], merged: Collection[str]) -> ValidationError:
    """Return an error whose places are the keys of a file instead of the names of fields."""
    from pydantic_core import InitErrorDetails, PydanticCustomError, ValidationError  # noqa: PLC0415 - only files need it

    details = []
    for problem in error.errors(include_url=False):
        first, *inner = problem["loc"] or ("",)
        kind: Any = problem["type"]
        if kind == "sentence":
            kind = PydanticCustomError("sentence", "{text}", problem["ctx"])
        elif kind == "path_type":  # a type that pydantic's core does not know by its name
            kind = PydanticCustomError("path_type", "it is of another type")
        place = (named.get(str(first), first), *inner) if problem["loc"] and first not in merged else tuple(inner)
        details.append(InitErrorDetails(type=kind, loc=place, input=problem["input"], ctx=problem.get("ctx", {})))
    return ValidationError.from_exception_data(error.title, details) if named or merged else error


class Loaded(NamedTuple):
    """The name or file that a value was loaded from, and the value that was loaded."""

    name: str
    value: Any


class read_by:  # noqa: N801 - reads as a word inside Annotated[Gridded | None, read_by("correction")]
    """Annotation of a field that a job describes by the name of a file, or by a name that the job's reader looks up.

    Without such a reader text stays text. A value that was read from a file has its path in ``file``.
    """

    __slots__ = ("kind",)
    texts: ClassVar[tuple[type, ...]] = (str,)
    """Types that `read` accepts besides a path."""
    wrong: ClassVar[Any] = "path_type"
    """Pydantic's error type for any other value."""

    def __init__(self, kind: str) -> None:
        """Set the key of the reader in pydantic's context, which also has the folder of the job."""
        self.kind = kind

    def read(self, value: Any, info: Any) -> Any:
        """Return the reader's value of a text; without a reader text stays text."""
        context = info.context or {}
        reader = context.get("readers", {}).get(self.kind)
        return value if reader is None else reader(str(value), context["folder"])

    def show(self, value: Any) -> Any:
        """Return the name that `read` reads back to the same value."""
        return named(value)

    def __get_pydantic_core_schema__(self, source: Any, _handler: GetCoreSchemaHandler) -> CoreSchema:
        from pydantic_core import PydanticCustomError, core_schema  # noqa: PLC0415 - only files need pydantic

        kinds = tuple(kind for kind in get_args(source) or (source,) if isinstance(kind, type))

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
    """Annotation of an array that a file has as a list of plain numbers."""

    @classmethod
    def __get_pydantic_core_schema__(cls, _source: Any, _handler: GetCoreSchemaHandler) -> CoreSchema:
        from pydantic_core import core_schema  # noqa: PLC0415 - only files need pydantic

        return core_schema.list_schema(core_schema.float_schema(strict=True))


class Keyed(ABC):
    """Annotation of a value that a file has as a table."""

    __slots__ = ()

    @property
    @abstractmethod
    def keys(self) -> Mapping[str, Any]:
        """The keys of the table, with their types."""

    def name_of(self, key: str) -> str:
        """Return the name in the value that belongs to a key of the table."""
        return key

    def table_schema(self, handler: GetCoreSchemaHandler, *, required: bool = False) -> CoreSchema:
        """Return the pydantic schema of the table; all keys are required, or none."""
        from pydantic_core import core_schema  # noqa: PLC0415 - only files need pydantic

        fields = {
            key: core_schema.typed_dict_field(handler.generate_schema(kind), required=required)
            for key, kind in self.keys.items()
        }
        return core_schema.typed_dict_schema(fields, extra_behavior="forbid")


class Columns(Keyed):
    """Annotation of arrays of one length that a file has as lists by key, each multiplied by its factor."""

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
            return tuple(
                np.array(lists.get(key, ()), dtype=np.float64) * factor for key, factor in self.factors.items()
            )

        return core_schema.no_info_after_validator_function(arrays, self.table_schema(handler))


class Sources:
    """Annotation of texts by the dotted name of the field they belong to; in a file, nested tables."""

    @classmethod
    def __get_pydantic_core_schema__(cls, _source: Any, _handler: GetCoreSchemaHandler) -> CoreSchema:
        from pydantic_core import core_schema  # noqa: PLC0415 - only files need pydantic

        texts = core_schema.dict_schema(core_schema.str_schema(), core_schema.str_schema(strict=True))
        return core_schema.no_info_before_validator_function(flat, texts)


def flat(table: Any, prefix: str = "") -> Any:
    """Return a nested table with dotted keys."""
    if not isinstance(table, Mapping):
        return table
    flattened: dict[str, Any] = {}
    for key, value in table.items():
        flattened |= flat(value, f"{prefix}{key}.") if isinstance(value, Mapping) else {f"{prefix}{key}": value}
    return flattened


class Plausible(Keyed):
    """Annotation of sizes of error sources (standard deviations), by the name of the source; in a file by its key.

    Each source has its unit, and a description for forms; the size of ``slopes`` may also be given as a slope.
    """

    __slots__ = ("slopes", "texts", "units")

    def __init__(self, units: Mapping[str, str], texts: Mapping[str, str], slopes: Collection[str] = ()) -> None:
        self.units, self.texts, self.slopes = units, texts, slopes

    @property
    def keys(self) -> Mapping[str, Any]:
        """The types of the sizes by their keys in a file."""
        return {
            key_of(name): Annotated[float, unit(symbol, *(("1",) if name in self.slopes else ()), above=0.0)]
            for name, symbol in self.units.items()
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
        schema = dict(handler(core))
        for name, text in self.texts.items():
            schema["properties"][key_of(name)]["description"] = text
        return schema


def named(value: Any) -> str | None:
    """Return the name by which a job refers to a value that was read from a file; raise if it was not."""
    if value is None or isinstance(value, str):
        return value
    if not (file := getattr(value, "file", "")):
        raise InputError(
            f"a {type(value).__name__} was not read from a file, a job needs the name of one: write it to a file first"
        )
    return str(file)


def adapter(annotation: Any) -> TypeAdapter[Any]:
    """Return the pydantic adapter of a type, which reads and writes it."""
    return _adapter(annotation)


@cache
def _adapter(annotation: Any) -> TypeAdapter[Any]:
    from pydantic import TypeAdapter  # noqa: PLC0415 - only files need pydantic

    return TypeAdapter(annotation)


def forget_adapters() -> None:
    """Clear the cache of adapters, after a surface family was added."""
    _adapter.cache_clear()


def types_of(cls: Any) -> Mapping[str, Any]:
    """Return the types of the input fields of a dataclass, with their units, by name."""
    return _types(cls)


@cache
def _types(cls: Any) -> Mapping[str, Any]:
    types: dict[str, Any] = {}
    names = [field.name for field in dataclasses.fields(cls) if field.init]
    for base in reversed(cls.__mro__):
        annotations = {name: kind for name, kind in vars(base).get("__annotations__", {}).items() if name in names}
        namespace = SimpleNamespace(__annotations__=annotations)
        types |= get_type_hints(namespace, vars(sys.modules[base.__module__]), include_extras=True)
    return {name: types[name] for name in names}


def write_table(value: Any, *, whole: bool = False, base: Any = None) -> dict[str, Any]:
    """Return a dataclass as a table, quantities as text: the fields that differ from their defaults, or all.

    With a ``base``, another instance of the class, the table has the fields that differ from it.
    """
    table: dict[str, Any] = {}
    for field in dataclasses.fields(value):
        if not field.init or field.name in value.unstated or field.name in value.hidden:
            continue
        entry = getattr(value, field.name)
        default = _default(field) if base is None else getattr(base, field.name)
        if entry is not None and (whole or not same(entry, default)):
            key = value.file_keys.get(field.name, "") if getattr(entry, "file", "") else ""
            kind = types_of(type(value))[field.name]
            if field.name in merged_fields(type(value)):
                table |= _inner(value, field.name, whole=whole)
                continue
            table[key or value.key_names.get(field.name, field.name)] = (
                named(entry) if key else _dump(kind, entry, whole=whole)
            )
    return dict(value.to_table(table))


def _inner(value: Any, name: str, *, whole: bool) -> dict[str, Any]:
    entry, required = getattr(value, name), merged_fields(type(value))[name]
    if type(entry) is not required:
        raise InputError(
            f"{name} of a {type(value).__name__} is a {type(entry).__name__}, a job file allows a "
            f"{required.__name__} only"
        )
    return write_table(entry, whole=whole)


def _default(field: dataclasses.Field[Any]) -> Any:
    return field.default if field.default_factory is dataclasses.MISSING else field.default_factory()


def _dump(kind: Any, value: Any, *, whole: bool) -> Any:
    """Return a value as data; on failure raise the cause, not the error of pydantic."""
    from pydantic_core import PydanticSerializationError  # noqa: PLC0415 - only files need it

    try:
        return adapter(kind).dump_python(value, mode="json", exclude_unset=not whole)
    except PydanticSerializationError as error:
        raise error.__cause__ or error from None
