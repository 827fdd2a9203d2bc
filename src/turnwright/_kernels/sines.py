"""Two crossed sine waves with their derivatives."""

from turnwright._kernels import jit
from turnwright._kernels.trig import sincos


@jit
def wave(position, amplitude, wavenumber, phase, order, out):
    """Fill row k of ``out`` (order + 1, n) with the k-th derivative of one sine wave."""
    first = amplitude * wavenumber
    second = first * wavenumber
    if order == 0:
        for i in range(position.size):
            sine, _ = sincos(wavenumber * position[i] + phase)
            out[0, i] = amplitude * sine
    elif order == 1:
        for i in range(position.size):
            sine, cosine = sincos(wavenumber * position[i] + phase)
            out[0, i] = amplitude * sine
            out[1, i] = first * cosine
    else:
        for i in range(position.size):
            sine, cosine = sincos(wavenumber * position[i] + phase)
            out[0, i] = amplitude * sine
            out[1, i] = first * cosine
            out[2, i] = -second * sine
