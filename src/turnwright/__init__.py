"""Turnwright: from an optical prescription to a proven program for a diamond-turning lathe, and back.

The names that carry the idea, and the modules that hold the rest (``turnwright.metrology``). They stand in the stub
next to this file, and each is imported at its first use, so that ``import turnwright`` costs nothing.
"""

import pkgutil
from importlib.metadata import version

import lazy_loader

__getattr__, _list_names, _names = lazy_loader.attach_stub(__name__, __file__)
__all__ = list(set(_names) - {module.name for module in pkgutil.iter_modules(__path__)})
__version__ = version("turnwright")


def __dir__() -> list[str]:
    return [*_list_names(), "__version__"]
