"""The drawings of the documentation: a module draws one sheet, `make drawings` writes them all."""

from importlib import import_module
from pathlib import Path

HERE = Path(__file__).parent
IMAGES = HERE.parent / "images" / "drawings"
NAMES = tuple(sorted(one.stem for one in HERE.glob("[a-z]*.py") if one.stem != "sheet"))


def drawn(name):
    """Return the text of a drawing's file."""
    return import_module(f"{__name__}.{name}").draw().svg()
