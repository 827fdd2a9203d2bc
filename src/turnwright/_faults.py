"""Validation errors of a table as sentences that name the field, the value, what is allowed and the remedy."""

from __future__ import annotations

import difflib
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import is_dataclass
from itertools import islice
from types import NoneType, UnionType
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple, TypeVar, Union, get_args, get_origin

from turnwright._tables import ByName, Keyed, TableModel, adapter
from turnwright.errors import InputError, quote, shorten_message

if TYPE_CHECKING:
    from pydantic import ValidationError

__all__ = ["faults", "keys_of", "read_table", "sentences", "suggestion"]

T = TypeVar("T")

MAX_FAULTS = 30
_KINDS = {
    "float_type": "a plain number without a unit or quotes",
    "finite_number": "a finite number",
    "int_type": "a whole number without a unit or quotes",
    "int_from_float": "a whole number",
    "string_type": "text in quotes",
    "bool_type": "true or false",
    "path_type": "the name of a file in quotes",
    "tuple_type": "a list such as [..., ...]",
    "dict_type": "a table",
    "model_type": "a table",
    "model_attributes_type": "a table",
    "dataclass_type": "a table",
    "list_type": "a list such as [..., ...]",
}


def keys_of(annotation: Any) -> Mapping[str, Any] | None:
    """Return the keys of the table that states a value of a type, with their types; ``None`` if no table does."""
    bare, *notes = get_args(annotation) if get_origin(annotation) is Annotated else (annotation,)
    for note in notes:
        if isinstance(note, Keyed | ByName):
            return note.keys
    return bare.table_keys() if isinstance(bare, type) and issubclass(bare, TableModel) and is_dataclass(bare) else None


def _tables_in(annotation: Any) -> Iterator[Mapping[str, Any]]:
    keys = keys_of(annotation)
    if keys is not None:
        yield keys
        return
    for inner in get_args(annotation):
        yield from _tables_in(inner)


class _Place(NamedTuple):
    """The place of a fault: dotted path, keys of its table; for a field of several kinds also that field and kind."""

    path: str
    keys: Mapping[str, Any]
    choice: str = ""  # the path of a field that may be of several kinds
    kind: str = ""  # the kind that this fault is about


def _place(root: Any, loc: tuple[str | int, ...], tags: Mapping[str, Any], path: str) -> _Place:
    """Return the place of a field below the path of the root, counting from 1 in lists."""
    is_choice = False
    choice = kind = ""
    keys = owner = keys_of(root) or {}
    for step in loc:
        if isinstance(step, int):
            path += f"[{step + 1}]"
        elif step in tags and step not in keys:
            keys = keys_of(tags[step]) or {}
        elif is_choice:
            choice, kind = path, step  # pydantic's name of the kind is not a key of the job
        else:
            path += f".{step}" if path else step
            owner = keys
            field = keys.get(step)
            keys = next(_tables_in(field), keys) if field is not None else keys
            is_choice = field is not None and _has_several_kinds(field)
            continue
        is_choice = False
    return _Place(path, owner, choice, kind)


def _has_several_kinds(annotation: Any) -> bool:
    """Whether a field may hold more than one kind of value, None not counted."""
    if get_origin(annotation) is Annotated:
        return _has_several_kinds(get_args(annotation)[0]) and not any(
            hasattr(note, "__get_pydantic_core_schema__") for note in get_args(annotation)[1:]
        )
    if get_origin(annotation) not in (Union, UnionType):
        return False
    return sum(kind is not NoneType for kind in get_args(annotation)) > 1


def sentences(error: ValidationError, root: Any, tags: Mapping[str, Any], what: str = "", path: str = "") -> list[str]:
    """Return one sentence for each fault: the field, the value, what it must be, the remedy.

    ``root`` is the type of the table that was read and ``path`` its path; ``tags`` are tables by the key that chooses
    them, which pydantic puts into the place of an error; ``what`` is the file as each sentence names it.
    """
    texts = dict.fromkeys(sentence for _, sentence in faults(error, root, tags, path))
    # A sentence without a place, such as " is 3, it must be a table", is about the file.
    return [f"{what or 'it'}{text}" if text.startswith(" ") else f"{what}: {text}" if what else text for text in texts]


def faults(error: ValidationError, root: Any, tags: Mapping[str, Any], path: str = "") -> Iterator[tuple[str, str]]:
    """Yield the place of each fault, such as ``passes[1].feed``, and its sentence. See `sentences`."""
    choices: dict[str, dict[str, list[_Fault]]] = {}
    faults_in_order: list[_Fault | str] = []
    for problem in islice(error.errors(include_url=False), MAX_FAULTS):
        fault = _Fault(_place(root, problem["loc"], tags, path), problem)
        choice, kind = fault.place.choice, fault.place.kind
        if not choice:
            faults_in_order.append(fault)
            continue
        if choice not in choices:
            faults_in_order.append(choice)
        choices.setdefault(choice, {}).setdefault(kind, []).append(fault)
    for entry in faults_in_order:
        yield from _nearest(entry, choices[entry]) if isinstance(entry, str) else [entry.report]
    if error.error_count() > MAX_FAULTS:
        yield "", f"{error.error_count() - MAX_FAULTS} more keys are wrong: correct these first"


_SENTENCES: dict[str, Callable[[Any, Mapping[str, Any]], str]] = {
    "missing": lambda _, __: "is missing and has no default: add it",
    "literal_error": lambda value, context: f"is {quote(value)}, it must be {context['expected']}: choose one of them",
    "union_tag_invalid": lambda _, context: (
        f"has the {context['discriminator'].strip(chr(39))} {context['tag']!r}, which is not known: "
        f"{suggestion(context['tag'], re.findall(chr(39) + '(.*?)' + chr(39), context['expected_tags']))}"
    ),
    "union_tag_not_found": lambda _, context: (
        f"lacks the key {context['discriminator'].strip(chr(39))}, which names its kind: add it"
    ),
    "greater_than_equal": lambda value, context: f"is {quote(value)}, it must be at least {context['ge']}: increase it",
    "less_than_equal": lambda value, context: f"is {quote(value)}, it must be at most {context['le']}: reduce it",
    "too_long": lambda _, context: (
        f"has {context['actual_length']} values, the limit is {context['max_length']}: remove some"
    ),
    "too_short": lambda _, context: (
        f"has {context['actual_length']} values, it needs {context['min_length']}: add some"
    ),
    "string_too_short": lambda _, __: "is empty, it must be text in quotes: state it",
    "string_pattern_mismatch": lambda value, _: (
        f"is {quote(value)}, it may hold up to 30 letters, digits, - and _: rename it"
    ),
}


def _sentence(path: str, keys: Mapping[str, Any], problem: Mapping[str, Any]) -> str:
    kind, value, context = problem["type"], problem["input"], problem.get("ctx", {})
    if kind in ("extra_forbidden", "unexpected_keyword_argument"):
        return f"{path} is not a known key: {suggestion(path.rpartition('.')[2], keys)}"
    if kind in _SENTENCES:
        return f"{path} {_SENTENCES[kind](value, context)}"
    if kind == "float_type" and isinstance(value, int) and not isinstance(value, bool):
        return f"{path} is beyond the range of numbers, about 1e308: give a smaller value"
    if kind in _KINDS:
        return f"{path} is {quote(value)}, it must be {_KINDS[kind]}: correct it"
    text = str(context.get("error") or context.get("text") or problem["msg"])
    return f"{path}: {text}" if path else text


class _Fault(NamedTuple):
    place: _Place
    problem: Mapping[str, Any]

    @property
    def report(self) -> tuple[str, str]:
        """Place and sentence."""
        path, keys, *_ = self.place
        return shorten_message(path), shorten_message(_sentence(path, keys, self.problem))

    @property
    def distance(self) -> int:
        """Distance of the value from the kind: 0 fault inside it, 1 wrong value, 2 other fault, 3 another type."""
        kind = self.problem["type"]
        if self.place.path != self.place.choice:
            return 0
        if kind in _KINDS or kind == "literal_error":
            return 3
        return 1 if kind in _SENTENCES else 2


def _nearest(path: str, kinds: Mapping[str, Sequence[_Fault]]) -> Iterator[tuple[str, str]]:
    """Yield the faults of a value as the nearest kind, or, where none is near, the kinds that are allowed."""
    nearest = min(kinds.values(), key=lambda faults: max(fault.distance for fault in faults))
    if max(fault.distance for fault in nearest) < 3:
        yield from (fault.report for fault in nearest)
        return
    allowed = [
        fault.problem["ctx"]["expected"] if fault.problem["type"] == "literal_error" else _KINDS[fault.problem["type"]]
        for faults in kinds.values()
        for fault in faults
    ]
    value = quote(next(iter(kinds.values()))[0].problem["input"])
    yield shorten_message(path), f"{path} is {value}, it must be {' or '.join(allowed)}: correct it"


def suggestion(key: str, known: Iterable[str]) -> str:
    """Return the most similar key as a remedy, or the list of known keys."""
    if not (keys := list(known)):
        return "no key is allowed here, leave it out"
    close = difflib.get_close_matches(key.lower(), keys, n=1)
    return f"did you mean {close[0]!r}?" if close else f"the known ones are {', '.join(keys)}, use one of them"


def read_table(cls: type[T], table: Mapping[str, Any], what: str) -> T:
    """Return the instance of a class that the table of a file describes; ``what`` is the file as a message names it.

    Raises
    ------
    InputError
        With a sentence for each fault.
    """
    from pydantic import ValidationError  # noqa: PLC0415 - only files need it

    try:
        instance: T = adapter(cls).validate_python(table)
    except ValidationError as error:
        raise InputError("\n".join(sentences(error, cls, {}, what))) from error
    return instance
