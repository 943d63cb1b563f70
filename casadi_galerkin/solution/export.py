"""Solutions as tables of named columns, for other programs: a dict of lists, comma-separated values, NumPy archive."""

from __future__ import annotations

import csv
from abc import ABC, abstractmethod
from os import PathLike
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

Columns: TypeAlias = dict[str, np.ndarray]
File: TypeAlias = str | PathLike[str]


class Table(ABC):
    """Base class of results that have a table: named columns of equal length, for pandas and other programs.

    A column has the name of the attribute that it comes from, those of the components of a vector with their numbers.

    Examples
    --------
    >>> import casadi_galerkin as cg
    >>> fall = cg.BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2 - 8 * x[0], (0, 1), start=[0.0], end=[0.0])
    >>> table = cg.solve(fall, cg.Galerkin(degree=2), intervals=2).to_dict([0.0, 0.5, 1.0])
    >>> list(table), table["t"]
    (['t', 'x[0]', 'velocity[0]', 'momentum[0]', 'energy'], [0.0, 0.5, 1.0])
    """

    @abstractmethod
    def table(self, *args: Any, **kwargs: Any) -> Columns:
        """The columns by name, (K,) each, of numbers or strings; of a path at times, if these are given."""

    def to_dict(self, times: ArrayLike | None = None) -> dict[str, list[Any]]:
        """The `table`, of a path at times (K,), as lists of Python's own numbers, such as JSON and pandas take."""
        columns = self.table() if times is None else self.table(times)
        return {name: column.tolist() for name, column in columns.items()}

    def to_csv(self, file: File, times: ArrayLike | None = None) -> None:
        """Write the `table`, of a path at times (K,), to a file of comma-separated values, with all digits."""
        columns = self.to_dict(times)
        with file_path(file).open("w", newline="", encoding="utf-8") as opened:
            writer = csv.writer(opened)
            writer.writerow(columns)
            writer.writerows(zip(*columns.values(), strict=True))

    def to_npz(self, file: File, times: ArrayLike | None = None) -> None:
        """Write the `table`, of a path at times (K,), to an archive of arrays by name; `load` reads the path again."""
        arrays: dict[str, Any] = (self.table() if times is None else self.table(times)) | self._arrays()
        np.savez(file_path(file), **arrays)

    def _arrays(self) -> Columns:
        """What `load` makes a path of."""
        return {}


def file_path(file: File) -> Path:
    """The path of a file, given as a string or a path."""
    if not isinstance(file, (str, PathLike)):
        raise TypeError(f"file must be the path of a file, a string or a Path, got {file!r}")
    return Path(file)


def by_component(name: str, values: np.ndarray) -> Columns:
    """Columns of the components of a vector, (d, K), called ``name[0]`` and so on."""
    return {f"{name}[{i}]": row for i, row in enumerate(values)}
