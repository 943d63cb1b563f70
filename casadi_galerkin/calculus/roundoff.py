"""Constants of double precision, and the sizes of arrays that errors are relative to."""

import numpy as np

EPS = float(np.finfo(float).eps)
TINY = float(np.finfo(float).tiny)
ZERO = 1e-150  # size below which a component, or a duration, counts as zero: its square, an energy, underflows


def or_one(sizes: np.ndarray) -> np.ndarray:
    """Sizes to divide by: those that are positive, and one in place of all others."""
    return np.where(sizes > 0, sizes, 1.0)


def component_sizes(values: np.ndarray) -> np.ndarray:
    """Largest size in each row of (d, K), to which errors are relative; 1 for a component that is zero; (d,)."""
    largest = np.max(np.abs(values), axis=1)
    return np.where(largest >= ZERO, largest, 1.0)


def largest_of(values: np.ndarray, kinds: np.ndarray, count: int = 0) -> np.ndarray:
    """Largest of the values of every kind, of which there are at least `count`; NaN ignored, 0 for a kind without."""
    largest = np.zeros(max(count, kinds.max(initial=-1) + 1))
    np.fmax.at(largest, kinds, values)
    return largest
