"""Solutions as tables of named columns, for other programs: a dict of lists, comma-separated values, NumPy archive."""

from __future__ import annotations

import csv
from abc import ABC, abstractmethod
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np


class Table(ABC):
    """Base class of solutions that have a table of named columns of equal length.

    Examples
    --------
    >>> import casadi_galerkin as cg
    >>> fall = cg.BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2 - 8 * x[0], (0, 1), start=[0.0], end=[0.0])
    >>> table = cg.solve(fall, cg.Galerkin(degree=2), intervals=2).to_dict()
    >>> list(table), table["t"]
    (['t', 'x[0]', 'velocity[0]', 'momentum[0]', 'energy'], [0.0, 0.5, 1.0])
    """

    @abstractmethod
    def table(self) -> dict[str, np.ndarray]:
        """The columns by name, (K,) each, of numbers or strings."""

    def to_dict(self) -> dict[str, list[Any]]:
        """The columns by name as lists of Python's own numbers and strings, such as JSON takes."""
        return {name: column.tolist() for name, column in self.table().items()}

    def to_csv(self, file: str | Path) -> None:
        """Write the columns to a file of comma-separated values, under a line of their names, with all digits."""
        columns = self.to_dict()
        with _path(file).open("w", newline="", encoding="utf-8") as opened:
            writer = csv.writer(opened)
            writer.writerow(columns)
            writer.writerows(zip(*columns.values(), strict=True))

    def to_npz(self, file: str | Path) -> None:
        """Write the columns to an archive that ``numpy.load`` reads by their names."""
        columns: dict[str, Any] = self.table()
        np.savez(_path(file), **columns)


def _path(file: str | Path) -> Path:
    """The path of a file, given as a string or a path."""
    if not isinstance(file, (str, PathLike)):
        raise TypeError(f"file must be the path of a file, a string or a Path, got {file!r}")
    return Path(file)


def by_component(name: str, values: np.ndarray) -> dict[str, np.ndarray]:
    """Columns of the components of a vector, (d, K), called ``name[0]`` and so on."""
    return {f"{name}[{i}]": row for i, row in enumerate(values)}
