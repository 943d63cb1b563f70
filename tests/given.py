"""Stand-ins for what other libraries hold numbers in."""

import numpy as np


class Series:
    """As in pandas, values that are found by their labels and converted in their order."""

    def __init__(self, labeled):
        self.labeled = labeled

    def __len__(self):
        return len(self.labeled)

    def __getitem__(self, label):
        return self.labeled[label]

    def to_numpy(self):
        return np.array(list(self.labeled.values()))


class Arraylike(Series):
    """The same without ``to_numpy``, as of other libraries."""

    to_numpy = None

    def __array__(self, dtype=None, copy=None):
        return np.array(list(self.labeled.values()), dtype=dtype)


class Quantity:
    """A number with a unit, or without, which alone makes it a number."""

    def __init__(self, value, unit=None):
        self.value, self.unit = value, unit

    def __float__(self):
        if self.unit:
            raise TypeError("has a unit")
        return self.value

    def __repr__(self):
        return f"{self.value} {self.unit}"
