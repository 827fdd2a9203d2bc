"""Small lens files for tests."""

import numpy as np

R, K = 40.0, -0.7
ZMX = """VERS 140124 258 36214
MODE SEQ
NAME test lens
UNIT {unit} X W X CM MR CPMM
ENPD 5
WAVM 1 0.55 1
PWAV 1
SURF 0
  TYPE STANDARD
  CURV 0.0
  DISZ INFINITY
{surfaces}
SURF {last}
  TYPE STANDARD
  CURV 0.0
  DISZ 0
"""


def write_zmx(path, *surfaces, unit="MM", encoding="utf-8"):
    """Write a Zemax file with these surfaces after the object, and return its path."""
    blocks = "\n".join(f"SURF {n}\n" + "\n".join(f"  {line}" for line in one) for n, one in enumerate(surfaces, 1))
    path.write_bytes(ZMX.format(unit=unit, surfaces=blocks, last=len(surfaces) + 1).encode(encoding))
    return path


def block(kind, parameters=None, extra=None, radius=R, conic=K, diameter=5.0, glass="N-BK7", thickness=3.0):
    """Return the lines of one surface."""
    lines = [f"TYPE {kind}", f'CURV {1 / radius!r} 0 0 0 0 ""' if radius else "CURV 0.0", f"CONI {conic!r}"]
    lines += [f"PARM {place} {value!r}" for place, value in (parameters or {}).items()]
    lines += [f'XDAT {place} {value!r} 0 0 1 0 0 ""' for place, value in (extra or {}).items()]
    lines += [f"DISZ {thickness!r}", f'DIAM {diameter!r} 1 0 0 1 ""']
    return [*lines, f"GLAS {glass} 0 0 1.5 40 0 0 0 0 0 0"] if glass else lines


EVEN = {1: 1e-4, 2: -2e-5, 3: 3e-7, 4: 1e-9, 5: -2e-11, 6: 1e-13, 7: 2e-15, 8: -1e-17}
ODD = {1: 2e-3, 2: 1e-4, 3: -3e-5, 4: 2e-6, 5: 1e-7, 6: 3e-9, 7: -2e-10, 8: 1e-11}


ZERNIKES = {place: 1e-3 * (-1) ** place / (place + 1) for place in range(1, 12)}
ZERNIKE_DATA = {1: 11, 2: 6.0} | {place + 2: value for place, value in ZERNIKES.items()}


Q_DATA = {4: 1e-2, 5: -2e-3, 6: 3e-4, 7: 1e-4}


def grid_block(columns=9, rows=7, step=(1.5, 2.0), unit=0, missing=()):
    """Return a GRID_SAG of heights x + 10 y + x y / 7, and these heights by (column, row from the top)."""
    x = (np.arange(columns) - (columns - 1) / 2) * step[0] + 0.1
    y = ((rows - 1) / 2 - np.arange(rows)) * step[1] - 0.2
    z = (x + 10 * y[:, None] + x * y[:, None] / 7) * 1e-3
    lines = block("GRID_SAG", {0: 0.0} | EVEN)
    lines.append(f"GDAT {columns} {rows} {step[0]!r} {step[1]!r} {unit} 0.1 -0.2")
    for place, height in enumerate(z.ravel(), 1):
        lines.append(f"GARR {place} {float(height)!r} 0 0 0 {int(place in missing)}")
    return lines, x, y, z
