"""Why a part is off: measured maps against the marks that tool and machine leave, by exact contact."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
