"""Constant-switching-pace symmetric random sequence: the insulin test that reveals an impulse response.

Parker, Doyle & Peppas 1999, eq. (5), as a special case of the CSRS: three levels, and pulses far enough apart
for the answer to each to die out before the next.
"""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
from jax import Array

from glucoloop.identification import _check
from glucoloop.refusal import Refusal


def design_csrs(
    memory: int,
    amplitude_mU_min: float,
    samples: int | None = None,
    pulses: int | None = None,
    *,
    seed: int = 0,
) -> Array:
    """Pulses of +a and -a in equal numbers, at a constant pace of at least `memory` samples.

    The first pulse is at sample 0 and the last at least `memory` samples before the end. By default the record
    is the shortest there is: +a at sample 0, -a at sample M, 2 M samples.

    Parameters
    ----------
    memory : int
        M, the samples after which the patient's response to a pulse has died out.
    amplitude_mU_min : float
        a, at most the basal rate, since insulin cannot be taken back [mU/min].
    samples : int, optional
        Length N of the record. By default M for each pulse.
    pulses : int, optional
        Number of pulses, even. By default as many as fit.
    seed : int
        Decides the order of the signs when there is more than one pair; one pair is always +a, -a.

    Returns
    -------
    Array, shape (N,)
        Insulin deviation, held over each sample [mU/min].

    Raises
    ------
    ValueError
        If an argument is out of bounds, or the pulses don't fit in the record.
    """
    memory = _check.whole_number("The memory", memory, 1)
    amplitude = _check.positive("The amplitude", amplitude_mU_min, "mU/min")
    if pulses is None:
        length = 2 * memory if samples is None else _check.whole_number("The number of samples", samples, 1)
        pulses = 2 * max(1, length // (2 * memory))
    else:
        pulses = _check.whole_number("The number of pulses", pulses, 2)
        if pulses % 2:
            raise Refusal(f"{pulses} pulses are an odd number: +a and -a come in equal numbers, use {pulses + 1}.")
        length = pulses * memory if samples is None else _check.whole_number("The number of samples", samples, 1)
    if length < pulses * memory:
        raise Refusal(
            f"A record of {length} samples is too short: {pulses} pulses that are {memory} samples apart "
            f"need at least {pulses * memory} samples. Lengthen the record or shorten the memory."
        )

    signs = np.tile([1.0, -1.0], pulses // 2)
    if pulses > 2:
        signs = np.random.default_rng(seed).permutation(signs)
    insulin = np.zeros(length)
    insulin[np.arange(pulses) * (length // pulses)] = amplitude * signs
    return jnp.asarray(insulin)
