"""The file of a sweep: lines that say which one it is, and then pickles of the answers, one chunk after the other.

A chunk that a crash has cut off is dropped when the file is opened again, and solved again.
"""

from __future__ import annotations

import pickle
from collections.abc import Sequence
from hashlib import sha256
from typing import Any

from casadi_galerkin.solution.errors import ConvergenceError
from casadi_galerkin.solution.export import File, file_path

FIRST_LINE = b"answers of a casadi_galerkin sweep"


class CutShort(ConvergenceError):
    """A solve that something else ended: its worker failed, or the sweep was interrupted.  A path may well exist.

    Examples
    --------
    >>> import casadi_galerkin as cg
    >>> issubclass(cg.CutShort, cg.ConvergenceError)
    True
    """


class SweepFile:
    """The answers of the chunks that are solved; chunks are given by the numbers of their variations.

    Parameters
    ----------
    file : a string or a Path
    problem, variations : bytes that are the same for the same sweep, of the problem and how it is solved, and of all
        variations

    Raises
    ------
    ValueError
        where the file holds another sweep, or something else
    """

    def __init__(self, file: File, problem: bytes, variations: bytes) -> None:
        self._path, self._kept = file_path(file), dict[tuple[int, ...], list[Any]]()
        lines = [FIRST_LINE, *(sha256(given).hexdigest().encode() for given in (problem, variations))]
        if not self._path.exists() or self._path.stat().st_size == 0:
            self._append(b"".join(line + b"\n" for line in lines))
        with self._path.open("r+b") as opened:
            first, of_problem, of_variations = (opened.readline()[:-1] for _ in lines)
            if first != FIRST_LINE:
                raise ValueError(f"{file} is not the file of a sweep: give another name")
            if (of_problem, of_variations) != (lines[1], lines[2]):
                what = "of other variations" if of_problem == lines[1] else "of another problem, method, mesh or tol"
                raise ValueError(f"{file} holds the answers of a sweep {what}: delete it, or give another name")
            end = opened.tell()
            while True:
                try:
                    numbers, answers = pickle.load(opened)
                except Exception:  # the end, or a chunk that was cut off, which may raise anything
                    break
                self._kept[numbers], end = answers, opened.tell()
            opened.truncate(end)

    def get(self, numbers: Sequence[int]) -> list[Any] | None:
        """The answers of a chunk, if the file has them."""
        return self._kept.get(tuple(numbers))

    def keep(self, numbers: Sequence[int], answers: list[Any]) -> None:
        """Write the answers of a chunk, unless one was cut short: it is then solved again."""
        if not any(isinstance(answer, CutShort) for answer in answers):
            self._append(pickle.dumps((tuple(numbers), answers)))

    def _append(self, written: bytes) -> None:
        with self._path.open("ab") as opened:
            opened.write(written)
