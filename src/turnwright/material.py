"""The material: its cutting coefficients and its critical chip thickness."""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from importlib import resources
from pathlib import Path
from types import MappingProxyType
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike

from turnwright._arrays import Floats, Value, frozen
from turnwright._faults import read_table
from turnwright._io import bytes_of, read_toml
from turnwright._tables import Columns, Sources, TableModel
from turnwright._validate import between, check_angle, check_numbers, positive, whole_number
from turnwright.errors import InputError
from turnwright.units import Angle, Flag, Length, Number, Text, plain, say_length

__all__ = ["CriticalThickness", "CuttingCoefficient", "Lobes", "Material"]

MAX_LOBES = 24
MAX_RAKE = np.deg2rad(80)
"""Largest rake of a table of factors, either way. [rad]"""


def _bare(name: str) -> str:
    """Return a name without case, spaces and punctuation: IRG 26 and irg-26 are the same."""
    return re.sub("[^a-z0-9]", "", name.casefold())


@dataclass(frozen=True, slots=True, kw_only=True)
class Lobes(TableModel):
    """Variation of a crystal's property around the part: 1 + amplitude cos(count (angle - maximum)).

    Parameters
    ----------
    count
        Maxima per revolution: 3 on the (111) plane of germanium, 4 on (001).
    amplitude
        Half of the peak-to-valley variation, relative to the mean.
    maximum
        Azimuth of one maximum on the part; it depends on how the crystal is mounted. [rad]

    Raises
    ------
    InputError
        If the count is not an integer from 1 to 24, or the amplitude is not below 1.
    """

    count: Annotated[int, plain()]
    amplitude: Number
    maximum: Angle = 0.0

    def __post_init__(self) -> None:
        check_numbers(self)
        object.__setattr__(self, "count", whole_number(self.count, "lobes count", 1, MAX_LOBES))
        between(self.amplitude, "lobes amplitude", 0.0, 0.99, "of the mean")
        check_angle(self.maximum, "lobes maximum")

    def factor(self, angle: ArrayLike) -> Floats:
        """Return the property over its mean at azimuths of the part. Any shape [1]."""
        phase = self.count * (np.asarray(angle, dtype=np.float64) - self.maximum)
        return np.asarray(1.0 + self.amplitude * np.cos(phase))


Curve = tuple[Floats, Floats]
"""Ascending positions and the factors there; linear interpolation, constant extrapolation. ((n,), (n,))"""


_BY_RAKE = Columns(at_deg=math.pi / 180, factor=1.0)


def _curve(curve: tuple[ArrayLike, ArrayLike], name: str) -> Curve:
    at, factor = frozen(curve[0], f"{name} positions"), frozen(curve[1], f"{name} factors")
    if at.size < 2 or at.shape != factor.shape or not (np.diff(at) > 0).all() or not (factor > 0).all():
        raise InputError(
            f"{name} has {at.size} positions and {factor.size} factors, it needs equal numbers of both, at least 2, "
            "positions ascending and factors above 0: sort and complete it"
        )
    return at, factor


def _by_rake(curve: Curve, name: str) -> Curve:
    rake, factor = _curve(curve, name)
    for end in rake[[0, -1]]:
        check_angle(end, f"a position of {name}", -MAX_RAKE, MAX_RAKE)
    return rake, factor


def _uncertainty(value: float | None, name: str, unit: str) -> None:
    if value is not None and value < 0:
        raise InputError(f"the uncertainty of {name} is {value:g} {unit}, it must be at least 0: correct it")


def _around(rake: Curve | None, lobes: Lobes | None, at_rake: ArrayLike, at_angle: ArrayLike) -> Floats:
    by_rake = np.ones(()) if rake is None else np.interp(np.asarray(at_rake, dtype=np.float64), *rake)
    by_angle = np.ones(()) if lobes is None else lobes.factor(at_angle)
    return np.asarray(by_rake * by_angle)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CuttingCoefficient(TableModel, Value):
    r"""Specific cutting force: force on the edge per cross-section of the uncut chip.

    .. math:: K(t, \gamma, \psi) = K_0 \, (t / t_0)^{-m} \, f_t(t) \, f_\gamma(\gamma) \, f_\psi(\psi)

    Parameters
    ----------
    value
        The coefficient K₀, where every factor is 1. [N/mm²]
    uncertainty
        Its standard uncertainty; ``None`` if not known. [N/mm²]
    exponent
        Exponent m of the size effect, the decrease with chip thickness; 0 for none.
    reference_thickness
        Chip thickness t₀ at which the power is 1; required with an exponent. [mm]
    thickness
        Factor by chip thickness, linear over its logarithm and constant beyond the ends. ((n,) [mm], (n,))
    rake
        Factor by rake. ((n,) [rad], (n,))
    lobes
        Factor by the azimuth of the part, for a crystal.
    stated
        Range of chip thickness that the source covers; ``None`` if it gives none. [mm]

    Raises
    ------
    InputError
        If a value is not positive, an uncertainty is below zero, or a table is wrong.

    Examples
    --------
    >>> falling = CuttingCoefficient(value=2000.0, exponent=0.5, reference_thickness=1e-4)
    >>> falling.at([1e-4, 4e-4]).tolist()
    [2000.0, 1000.0]
    """

    key_names = MappingProxyType({"value": "n_per_mm2", "uncertainty": "uncertainty_n_per_mm2"})
    value: Number
    uncertainty: Number | None = None
    exponent: Number = 0.0
    reference_thickness: Length | None = None
    thickness: Annotated[Curve, Columns(at_nm=1e-6, factor=1.0)] | None = None
    rake: Annotated[Curve, _BY_RAKE] | None = None
    lobes: Lobes | None = None
    stated: tuple[Length, Length] | None = None

    def __post_init__(self) -> None:
        check_numbers(self)
        object.__setattr__(self, "value", positive(self.value, "a cutting coefficient", "N/mm^2"))
        _uncertainty(self.uncertainty, "a cutting coefficient", "N/mm^2")
        between(self.exponent, "the exponent of a cutting coefficient", -2.0, 2.0, "(a power)")
        if self.reference_thickness is not None:
            positive(self.reference_thickness, "reference_thickness", "mm")
        elif self.exponent:
            raise InputError("a cutting coefficient with an exponent needs a reference_thickness: give it in mm")
        for name, read in (("thickness", _curve), ("rake", _by_rake)):
            curve = getattr(self, name)
            if curve is not None:
                object.__setattr__(self, name, read(curve, f"the {name} of a cutting coefficient"))
        if self.thickness is not None and not self.thickness[0][0] > 0:
            raise InputError("the thickness of a cutting coefficient must begin above 0 mm: correct its first position")
        if self.stated is not None and not 0 <= self.stated[0] < self.stated[1]:
            low, high = self.stated
            raise InputError(
                f"stated of a cutting coefficient is {low:g} to {high:g} mm, it must ascend from 0 mm or more: "
                "correct it"
            )

    @property
    def constant(self) -> bool:
        """Whether it is the same for every chip thickness."""
        return self.exponent == 0.0 and self.thickness is None

    def at(self, thickness: ArrayLike, *, rake: ArrayLike = 0.0, angle: ArrayLike = 0.0) -> Floats:
        """Return the coefficient at chip thicknesses, rakes and azimuths. Broadcast [N/mm²].

        Parameters
        ----------
        thickness
            Uncut chip thickness; 0 and below count as 1e-9 mm. Any shape [mm]
        rake
            Effective rake. Broadcast [rad]
        angle
            Azimuth of the part. Broadcast [rad]
        """
        value = self.value * _around(self.rake, self.lobes, rake, angle)
        chip = np.maximum(np.asarray(thickness, dtype=np.float64), 1e-9)
        if self.exponent and self.reference_thickness is not None:
            value = value * (chip / self.reference_thickness) ** -self.exponent
        if self.thickness is not None:
            value = value * np.interp(np.log(chip), np.log(self.thickness[0]), self.thickness[1])
        return np.asarray(value * np.ones(np.broadcast(chip, np.asarray(rake), np.asarray(angle)).shape))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CriticalThickness(TableModel, Value):
    """Critical chip thickness: uncut chips thicker than this fracture (ductile-to-brittle transition).

    Parameters
    ----------
    value
        The thickness where every factor is 1. [mm]
    uncertainty
        Its standard uncertainty; ``None`` if not known. [mm]
    rake
        Factor by rake. ((n,) [rad], (n,))
    lobes
        Factor by the azimuth of the part, for a crystal.

    Raises
    ------
    InputError
        If the value is not positive, the uncertainty is below zero, or a table is wrong.
    """

    value: Length
    uncertainty: Length | None = None
    rake: Annotated[Curve, _BY_RAKE] | None = None
    lobes: Lobes | None = None

    def __post_init__(self) -> None:
        check_numbers(self)
        object.__setattr__(self, "value", positive(self.value, "a critical thickness", "mm"))
        _uncertainty(self.uncertainty, "a critical thickness", "mm")
        if self.rake is not None:
            object.__setattr__(self, "rake", _by_rake(self.rake, "the rake of a critical thickness"))

    @property
    def doubt(self) -> float:
        """Expanded relative uncertainty (k = 2) of the value; 0 where none is known."""
        return 0.0 if self.uncertainty is None else 2 * self.uncertainty / self.value

    @property
    def safe(self) -> float:
        """Lower limit of the confidence interval over the value, at least 0: thinner chips are ductile."""
        return max(1 - self.doubt, 0.0)

    def at(self, *, rake: ArrayLike = 0.0, angle: ArrayLike = 0.0) -> Floats:
        """Return the critical thickness at effective rakes and azimuths of the part. Broadcast [mm]."""
        shape = np.broadcast(np.asarray(rake), np.asarray(angle)).shape
        return np.asarray(self.value * _around(self.rake, self.lobes, rake, angle) * np.ones(shape))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Material(TableModel, Value):
    """A workpiece material: cutting forces and ductile regime.

    Parameters
    ----------
    name
        Name of the material.
    aliases
        Other names accepted in a job: Ge, germanium.
    cutting
        Coefficient Kc of the force along the cutting direction; ``None`` if not known.
    thrust
        Coefficient Kt of the force normal to the edge, in the rake plane.
    critical
        Critical chip thickness; ``None`` for a material that is ductile at any chip thickness.
    brittle_plateau
        Whether the force per width of edge is constant for chips above the critical thickness.
    brittle_force
        Cutting force and thrust force on that plateau, as fractions of those at the critical thickness. [1]
    fracture_ratio
        Depth of a crack below the edge, as a multiple of the thickness of the chip that started it.
    sources
        Source of each value, by field ("cutting.value"); assumed values are marked.
    notes
        Remarks on the range of validity.

    Raises
    ------
    InputError
        If the material has no name, or only one of its coefficients.

    Examples
    --------
    >>> glass = Material.load("irg26")
    >>> cutting, thrust = glass.coefficients(300e-6)
    >>> float(cutting), float(thrust)
    (1489.0, 816.0)
    >>> glass.sources["cutting.value"]
    'Troutman 2016, orthogonal cutting of IRG 26 in the ductile regime: 1489 +- 62 N/mm2'
    """

    name: Text
    aliases: tuple[Text, ...] = ()
    cutting: CuttingCoefficient | None = None
    thrust: CuttingCoefficient | None = None
    critical: CriticalThickness | None = None
    brittle_plateau: Flag = False
    brittle_force: tuple[Number, Number] = (1.0, 1.0)
    fracture_ratio: Number | None = None
    sources: Annotated[Mapping[str, str], Sources] = field(default_factory=dict)
    notes: Text = ""

    def __post_init__(self) -> None:
        check_numbers(self)
        object.__setattr__(self, "sources", MappingProxyType(dict(self.sources)))
        if not self.name:
            raise InputError("a material has no name: give it one")
        if (self.cutting is None) != (self.thrust is None):
            raise InputError(f"material {self.name!r} has one of two cutting coefficients: give cutting and thrust")
        if self.fracture_ratio is not None:
            positive(self.fracture_ratio, "fracture_ratio", "mm per mm of chip")
        if len(self.brittle_force) != 2:
            count = len(self.brittle_force)
            raise InputError(f"brittle_force has {count} values, it needs 2: give cutting force and thrust")
        ratios = tuple(between(ratio, "brittle_force", 0.0, 1.0, "of the force") for ratio in self.brittle_force)
        object.__setattr__(self, "brittle_force", ratios)
        if min(ratios) < 1 and not self.brittle_plateau:
            raise InputError(f"material {self.name!r} has a brittle_force and no brittle_plateau: set that too")
        if self.brittle_plateau and self.critical is None:
            raise InputError(f"material {self.name!r} has a brittle_plateau and no critical thickness: give that too")

    @classmethod
    def known(cls) -> tuple[str, ...]:
        """Return the names of the materials that come with Turnwright."""
        folder = resources.files("turnwright") / "materials"
        return tuple(sorted(Path(file.name).stem for file in folder.iterdir() if file.name.endswith(".toml")))

    @classmethod
    def named(cls, name: str) -> str | None:
        """Return the member of `known` for a name, ignoring case, spaces and punctuation; ``None`` if there is none.

        >>> Material.named("AL 6061-T6"), Material.named("Ge"), Material.named("IRG26x")
        ('aluminium-6061', 'germanium-111', None)
        """
        return _names().get(_bare(name))

    @classmethod
    def suggest(cls, name: str) -> str:
        """Return the remedy for an unknown name: the most similar names, or all where none is similar.

        >>> Material.suggest("germanum")
        "did you mean 'germanium' or 'germanium (111)'?"
        """
        names = {alias: alias for alias in _names()} | {_bare(spelling): spelling for spelling in _spellings()}
        close = difflib.get_close_matches(_bare(name)[:60], names, n=3, cutoff=0.7)
        if close:
            return f"did you mean {' or '.join(repr(names[match]) for match in close)}?"
        return f"the known ones are {', '.join(cls.known())}"

    @classmethod
    def load(cls, name: str | Path) -> Material:
        """Return a material that comes with Turnwright, or one described in a file of the same form.

        Parameters
        ----------
        name
            One of `known`, ignoring case, spaces and punctuation, or the path of a ``.toml`` file.

        Raises
        ------
        InputError
            If there is no such material, or its file is wrong; the message names the key.
        """
        named = cls.named(str(name))
        if named is not None:
            data = _read_supplied(named)
        else:
            remedy = f"{cls.suggest(str(name))}; name one of them, or give the path of a .toml file"
            data = bytes_of(Path(name), "material file", remedy)
        table = read_toml(data, f"material file {str(name)!r}")
        return read_table(cls, table, f"material file {str(name)!r}")

    def caution(self, thickness: float) -> str:
        """Return a warning about forces at a chip thickness [mm]; empty where the source covers it.

        >>> Material.load("copper-ofhc").caution(1e-3)
        'forces are an estimate: the coefficients are stated for chips of 100 um to 1 mm'
        >>> Material.load("irg26").caution(300e-6)
        ''
        """
        coefficients = (self.cutting, self.thrust)
        ranges = [each.stated for each in coefficients if each is not None and each.stated is not None]
        if not ranges:
            return ""
        low, high = max(first for first, _ in ranges), min(last for _, last in ranges)
        # A plateau covers the chips above the critical thickness.
        if low <= thickness and (thickness <= high or self.brittle_plateau):
            return ""
        covered = f"{say_length(low, 4)} to {say_length(high, 4)}"
        return f"forces are an estimate: the coefficients are stated for chips of {covered}"

    def coefficients(
        self, thickness: ArrayLike, *, rake: ArrayLike = 0.0, angle: ArrayLike = 0.0
    ) -> tuple[Floats, Floats]:
        """Return the coefficients Kc and Kt, constant force above the critical thickness where there is a plateau.

        Parameters
        ----------
        thickness
            Uncut chip thickness. Any shape [mm]
        rake, angle
            Effective rake and azimuth of the part. Broadcast [rad]

        Returns
        -------
        cutting, thrust
            Each of the broadcast shape [N/mm²]

        Raises
        ------
        InputError
            If the material has no coefficients.
        """
        if self.cutting is None or self.thrust is None:
            raise InputError(
                f"material {self.name!r} has no cutting coefficients, forces need 2: give cutting and thrust in a "
                "material file"
            )
        chip = np.asarray(thickness, dtype=np.float64)
        factors = [np.ones(()), np.ones(())]
        if self.brittle_plateau and self.critical is not None:
            limit = self.critical.at(rake=rake, angle=angle)
            plateau = limit / np.maximum(chip, limit)
            factors = [np.where(chip > limit, ratio * plateau, 1.0) for ratio in self.brittle_force]
            chip = np.minimum(chip, limit)
        cutting, thrust = (
            np.asarray(coefficient.at(chip, rake=rake, angle=angle) * factor)
            for coefficient, factor in zip((self.cutting, self.thrust), factors, strict=True)
        )
        return cutting, thrust


def _read_supplied(name: str) -> bytes:
    return (resources.files("turnwright") / "materials" / f"{name}.toml").read_bytes()


@cache
def _spellings() -> dict[str, str]:
    spellings = {}
    for material in Material.known():
        table = read_toml(_read_supplied(material), f"material file {material!r}")
        spellings.update(dict.fromkeys([material, table["name"], *table.get("aliases", ())], material))
    return spellings


@cache
def _names() -> dict[str, str]:
    return {_bare(spelling): material for spelling, material in _spellings().items()}
