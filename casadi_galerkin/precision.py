"""What a double can tell."""

import numpy as np

EPS = float(np.finfo(float).eps)
TINY = float(np.finfo(float).tiny)
ZERO = 1e-150  # size below which a component counts as zero everywhere: its square, an energy, underflows
