"""What is wrong with a table of a file, in sentences that name the field, the value, what it must be and the remedy."""

from __future__ import annotations

import difflib
import re
from dataclasses import is_dataclass
from itertools import islice
from types import NoneType, UnionType
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple, TypeVar, Union, get_args, get_origin

from turnwright._tables import ByName, Keyed, Stated, adapter
from turnwright.errors import InputError, shortened, shown

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence

    from pydantic import ValidationError

__all__ = ["faults", "keys_of", "read_table", "sentences", "suggestion"]

T = TypeVar("T")

MOST_FAULTS = 30
"""Of what is wrong with a file, this many sentences are written: they are corrected from the first on."""

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
    """Return the keys of the table that a value of a type is read from, with their types; ``None`` if from none."""
    bare, *notes = get_args(annotation) if get_origin(annotation) is Annotated else (annotation,)
    for one in notes:
        if isinstance(one, Keyed | ByName):
            return one.keys
    return bare.table_keys() if isinstance(bare, type) and issubclass(bare, Stated) and is_dataclass(bare) else None


def _tables_in(annotation: Any) -> Iterator[Mapping[str, Any]]:
    """Yield the keys of the tables that a field may hold."""
    keys = keys_of(annotation)
    if keys is not None:
        yield keys
        return
    for inner in get_args(annotation):
        yield from _tables_in(inner)


class _Place(NamedTuple):
    """Where something is wrong: the dotted path, the keys of its table, the field of several kinds and the kind."""

    path: str
    keys: Mapping[str, Any]
    choice: str = ""  # the path of a field that may be of several kinds, none of which the value is
    kind: str = ""  # which of them this is about


def _place(root: Any, loc: tuple[str | int, ...], tags: Mapping[str, Any], path: str) -> _Place:
    """Return the place of a field below the path of the root, counting from 1 in lists."""
    several = False
    choice = kind = ""
    keys = owner = keys_of(root) or {}
    for step in loc:
        if isinstance(step, int):
            path += f"[{step + 1}]"
        elif step in tags and step not in keys:
            keys = keys_of(tags[step]) or {}
        elif several:
            choice, kind = path, step  # pydantic's own name of the kind, which is no key of the job
        else:
            path += f".{step}" if path else step
            owner = keys
            field = keys.get(step)
            keys = next(_tables_in(field), keys) if field is not None else keys
            several = field is not None and _of_several_kinds(field)
            continue
        several = False
    return _Place(path, owner, choice, kind)


def _of_several_kinds(annotation: Any) -> bool:
    """Whether a field may be of more than one kind, besides not being there."""
    if get_origin(annotation) is Annotated:
        return _of_several_kinds(get_args(annotation)[0]) and not any(
            hasattr(one, "__get_pydantic_core_schema__") for one in get_args(annotation)[1:]
        )
    if get_origin(annotation) not in (Union, UnionType):
        return False
    return sum(one is not NoneType for one in get_args(annotation)) > 1


def sentences(error: ValidationError, root: Any, tags: Mapping[str, Any], what: str = "", path: str = "") -> list[str]:
    """Return one sentence for each thing that is wrong: the field, the value, what it must be, the remedy.

    Parameters
    ----------
    error
        What pydantic found.
    root
        The table that was read.
    tags
        Tables by the key that chooses them, which pydantic puts into the place of an error.
    what
        The file, as each sentence is to name it.
    path
        Where the root stands.
    """
    found = dict.fromkeys(sentence for _, sentence in faults(error, root, tags, path))
    # One without a place, such as " is 3, it must be a table", is about all of the file.
    return [f"{what or 'it'}{one}" if one.startswith(" ") else f"{what}: {one}" if what else one for one in found]


def faults(error: ValidationError, root: Any, tags: Mapping[str, Any], path: str = "") -> Iterator[tuple[str, str]]:
    """Yield the place of each thing that is wrong, such as ``passes[1].feed``, and its sentence. See `sentences`."""
    choices: dict[str, dict[str, list[_Fault]]] = {}
    found: list[_Fault | str] = []
    for problem in islice(error.errors(include_url=False), MOST_FAULTS):
        fault = _Fault(_place(root, problem["loc"], tags, path), problem)
        choice, kind = fault.place.choice, fault.place.kind
        if not choice:
            found.append(fault)
            continue
        if choice not in choices:
            found.append(choice)
        choices.setdefault(choice, {}).setdefault(kind, []).append(fault)
    for one in found:
        yield from _nearest(one, choices[one]) if isinstance(one, str) else [one.said]
    if error.error_count() > MOST_FAULTS:
        yield "", f"{error.error_count() - MOST_FAULTS} more places are wrong: correct these first"


_SAID: dict[str, Callable[[Any, Mapping[str, Any]], str]] = {
    "missing": lambda _, __: "is missing and has no default: add it",
    "literal_error": lambda value, context: f"is {shown(value)}, it must be {context['expected']}: choose one of them",
    "union_tag_invalid": lambda _, context: (
        f"has the {context['discriminator'].strip(chr(39))} {context['tag']!r}, which is not known: "
        f"{suggestion(context['tag'], re.findall(chr(39) + '(.*?)' + chr(39), context['expected_tags']))}"
    ),
    "union_tag_not_found": lambda _, context: (
        f"lacks the key {context['discriminator'].strip(chr(39))}, which says what it is: add it"
    ),
    "greater_than_equal": lambda value, context: f"is {shown(value)}, it must be at least {context['ge']}: increase it",
    "less_than_equal": lambda value, context: f"is {shown(value)}, it must be at most {context['le']}: reduce it",
    "too_long": lambda _, context: (
        f"has {context['actual_length']} values, the limit is {context['max_length']}: remove some"
    ),
    "too_short": lambda _, context: (
        f"has {context['actual_length']} values, it needs {context['min_length']}: add some"
    ),
    "string_too_short": lambda _, __: "is empty, it must be text in quotes: write it so",
    "string_pattern_mismatch": lambda value, _: (
        f"is {shown(value)}, it may hold up to 30 letters, digits, - and _: rename it"
    ),
}


def _sentence(path: str, keys: Mapping[str, Any], problem: Mapping[str, Any]) -> str:
    kind, value, context = problem["type"], problem["input"], problem.get("ctx", {})
    if kind in ("extra_forbidden", "unexpected_keyword_argument"):
        return f"{path} is not a known key: {suggestion(path.rpartition('.')[2], keys)}"
    if kind in _SAID:
        return f"{path} {_SAID[kind](value, context)}"
    if kind == "float_type" and isinstance(value, int) and not isinstance(value, bool):
        return f"{path} is beyond the range of numbers, about 1e308: give a smaller value"
    if kind in _KINDS:
        return f"{path} is {shown(value)}, it must be {_KINDS[kind]}: write it so"
    text = str(context.get("error") or context.get("text") or problem["msg"])
    return f"{path}: {text}" if path else text


class _Fault(NamedTuple):
    """One thing that is wrong."""

    place: _Place
    problem: Mapping[str, Any]

    @property
    def said(self) -> tuple[str, str]:
        """Its place and its sentence."""
        path, keys, *_ = self.place
        return shortened(path), shortened(_sentence(path, keys, self.problem))

    @property
    def distance(self) -> int:
        """How far the value is from being of the kind: wrong within it, of its form, of another form, no such thing."""
        kind = self.problem["type"]
        if self.place.path != self.place.choice:
            return 0
        if kind in _KINDS or kind == "literal_error":
            return 3
        return 1 if kind in _SAID else 2


def _nearest(path: str, kinds: Mapping[str, Sequence[_Fault]]) -> Iterator[tuple[str, str]]:
    """Yield what is wrong with a value as the kind that it is nearest to, or, if it is none, what it may be."""
    nearest = min(kinds.values(), key=lambda faults: max(one.distance for one in faults))
    if max(one.distance for one in nearest) < 3:
        yield from (one.said for one in nearest)
        return
    allowed = [
        one.problem["ctx"]["expected"] if one.problem["type"] == "literal_error" else _KINDS[one.problem["type"]]
        for faults in kinds.values()
        for one in faults
    ]
    value = shown(next(iter(kinds.values()))[0].problem["input"])
    yield shortened(path), f"{path} is {value}, it must be {' or '.join(allowed)}: write it so"


def suggestion(key: str, known: Iterable[str]) -> str:
    """Say which key was probably meant, else which there are."""
    if not (known := list(known)):
        return "there is none here, leave it out"
    close = difflib.get_close_matches(key.lower(), known, n=1)
    return f"did you mean {close[0]!r}?" if close else f"the known ones are {', '.join(known)}, use one of them"


def read_table(cls: type[T], table: Mapping[str, Any], what: str) -> T:
    """Return what the table of a file describes.

    Parameters
    ----------
    cls
        The class.
    table
        As TOML reads.
    what
        The file, as a message names it.

    Raises
    ------
    InputError
        With a sentence for each thing that is wrong.
    """
    from pydantic import ValidationError  # noqa: PLC0415 - only files need it

    try:
        found: T = adapter(cls).validate_python(table)
    except ValidationError as error:
        raise InputError("\n".join(sentences(error, cls, {}, what))) from error
    return found
