"""First-order low-pass: what a thermal mass, a creeping polymer or a drying body does."""

import math

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

Array = NDArray[np.float64]


def lowpass_coefficients(sample_period_s: float, tau_s: float) -> tuple[float, float, float]:
    """Return (a, b0, b1) of the exact low-pass for inputs that are straight lines between samples.

        y[n] = a y[n-1] + b0 x[n] + b1 x[n-1],   a = exp(-dt/tau),
        b0 = 1 - (tau/dt)(1 - a),                b1 = (tau/dt)(1 - a) - a

    Args:
        sample_period_s: dt > 0, seconds.
        tau_s: time constant, seconds; 0 or less passes the input through.
    """
    if tau_s <= 0.0:
        return 0.0, 1.0, 0.0
    ratio = sample_period_s / tau_s
    share = -math.expm1(-ratio) / ratio
    return math.exp(-ratio), 1.0 - share, share - math.exp(-ratio)


def lowpass(x: Array, sample_period_s: float, tau_s: float) -> Array:
    """Return x filtered by tau dy/dt + y = x, exactly for piecewise linear x, at rest at x[0].

    Args:
        x: [..., n], uninterrupted stretches along the last axis.
        sample_period_s: seconds between samples.
        tau_s: time constant, seconds; 0 or less returns x.
    """
    if tau_s <= 0.0 or x.size == 0:
        return x.copy()
    a, b0, b1 = lowpass_coefficients(sample_period_s, tau_s)
    y = np.empty_like(x)
    y[..., 0] = x[..., 0]
    if x.shape[-1] > 1:
        # With y = x at the first sample the state of the direct form II transposed is this.
        state = (b1 + a) * x[..., :1]
        y[..., 1:] = lfilter([b0, b1], [1.0, -a], x[..., 1:], zi=state)[0]
    return y


def lowpass_slope(x: Array, y: Array, sample_period_s: float, tau_s: float) -> Array:
    """Return dy/dtau of `y = lowpass(x, sample_period_s, tau_s)`, per second.

    Differentiating tau dy/dt + y = x gives tau dz/dt + z = -dy/dt with z = dy/dtau; since
    dy/dt = (x - y) / tau, z is the low-pass of (y - x) / tau. The filter is exact only for
    straight lines, so this is correct to the order of (dt/tau)^2.

    Args:
        x: [..., n] input.
        y: [..., n] output for it.
        sample_period_s: seconds between samples.
        tau_s: time constant > 0, seconds.
    """
    return lowpass((y - x) / tau_s, sample_period_s, tau_s)
