"""Check the language of the project: words that the trade does not use, and variables without a meaning.

Usage: python tools/check_words.py

Rules:

- `WORDS` occur nowhere in the text of `src`, `docs`, `examples` and the README: code, comments, docstrings, messages,
  the page.
- `TARGETS` are no targets of an assignment: a variable is named after what it holds. Fields of classes are names of
  their own. Functions have other names too, but for the class method `known`.
- The subject of a commit has at most 72 characters; longer ones of the last `COMMITS` are listed.
"""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[1]

WORDS = re.compile(
    r"\b(told|said|anew|whoever|foretold|foretells?|nobody|somebody|so-manieth|(?<![</])aside|beside|quicker)\b"
    r"|of it a half",
    re.IGNORECASE,
)
TARGETS = frozenset(
    ("found", "left", "known", "told", "said", "own", "kept", "given", "whole", "asked", "here", "rest")
)
COMMITS = 50
LONGEST_SUBJECT = 72


def files() -> Iterator[Path]:
    """Yield the files whose language is checked."""
    for folder, endings in (
        ("src", (".py", ".js", ".html", ".css", ".toml", ".j2")),
        ("docs", (".md", ".py")),
        ("examples", (".toml",)),
    ):
        for file in sorted((ROOT / folder).rglob("*")):
            parts = file.relative_to(ROOT).parts
            if file.suffix in endings and not {"vendor", "_build", "jupyter_execute"} & {*parts}:
                yield file
    yield ROOT / "README.md"


def words_in(file: Path) -> Iterator[str]:
    """Yield the places of words that the trade does not use."""
    for number, line in enumerate(file.read_text(encoding="utf-8").splitlines(), 1):
        for match in WORDS.finditer(line):
            yield f"{file.relative_to(ROOT)}:{number}: {match[0]!r}: use the word of the trade, or plain English"


def targets_in(file: Path) -> Iterator[str]:
    """Yield the assignments to a variable without a meaning."""
    tree = ast.parse(file.read_text(encoding="utf-8"))
    fields = {
        id(item.target)
        for one in ast.walk(tree)
        if isinstance(one, ast.ClassDef)
        for item in one.body
        if isinstance(item, ast.AnnAssign)
    }
    for node in ast.walk(tree):
        if (
            id(node) not in fields
            and isinstance(node, ast.Name)
            and isinstance(node.ctx, ast.Store)
            and node.id in TARGETS
        ):
            yield f"{file.relative_to(ROOT)}:{node.lineno}: {node.id!r} is assigned: name it after what it holds"
        elif isinstance(node, ast.FunctionDef) and node.name in TARGETS - {"known"}:
            yield f"{file.relative_to(ROOT)}:{node.lineno}: function {node.name!r}: name it after what it does"


def subjects() -> Iterator[str]:
    """Yield the subjects of commits that are too long."""
    log = subprocess.run(
        ["git", "log", f"-{COMMITS}", "--format=%h %s"], cwd=ROOT, capture_output=True, text=True, check=False
    )
    for line in log.stdout.splitlines():
        commit, _, subject = line.partition(" ")
        if len(subject) > LONGEST_SUBJECT:
            yield f"{commit}: the subject has {len(subject)} characters, the limit is {LONGEST_SUBJECT}"


def main() -> int:
    """Print what is wrong, and return 1 if anything is."""
    faults = [fault for file in files() for fault in words_in(file)]
    python = [file for file in files() if file.suffix == ".py"]
    faults += [fault for file in python for fault in targets_in(file)]
    print("\n".join([*faults, *subjects()]))
    if faults:
        print(f"{len(faults)} words to replace", file=sys.stderr)
    return bool(faults)


if __name__ == "__main__":
    sys.exit(main())
