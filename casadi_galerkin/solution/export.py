"""Solutions as tables of named columns, for other programs: a dict of lists, comma-separated values, NumPy archive."""

from __future__ import annotations

import csv
from abc import ABC, abstractmethod
from os import PathLike
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

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
    def table(self) -> Columns:
        """The columns by name, (K,) each, of numbers or strings."""

    def to_dict(self) -> dict[str, list[Any]]:
        """The columns by name as lists of Python's own numbers and strings, such as JSON and pandas take."""
        return as_lists(self.table())

    def to_csv(self, file: File) -> None:
        """Write the columns to a file of comma-separated values, under a line of their names, with all digits."""
        write_csv(file, self.table())

    def to_npz(self, file: File) -> None:
        """Write the columns to an archive that ``numpy.load`` reads by their names."""
        write_npz(file, self.table())


def as_lists(columns: Columns) -> dict[str, list[Any]]:
    """Columns as lists."""
    return {name: column.tolist() for name, column in columns.items()}


def write_csv(file: File, columns: Columns) -> None:
    """Write columns as comma-separated values."""
    with file_path(file).open("w", newline="", encoding="utf-8") as opened:
        writer = csv.writer(opened)
        writer.writerow(columns)
        writer.writerows(zip(*as_lists(columns).values(), strict=True))


def write_npz(file: File, arrays: dict[str, Any]) -> None:
    """Write arrays to an archive."""
    np.savez(file_path(file), **arrays)


def file_path(file: File) -> Path:
    """The path of a file, given as a string or a path."""
    if not isinstance(file, (str, PathLike)):
        raise TypeError(f"file must be the path of a file, a string or a Path, got {file!r}")
    return Path(file)


def by_component(name: str, values: np.ndarray) -> Columns:
    """Columns of the components of a vector, (d, K), called ``name[0]`` and so on."""
    return {f"{name}[{i}]": row for i, row in enumerate(values)}
