"""Mechanics of the cut: uncut chip thickness, cutting forces and the ductile regime."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
