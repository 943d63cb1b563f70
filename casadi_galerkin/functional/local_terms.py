"""Terms of the functional at single places: at the ends, or at every node whose position is not given.

A term is a small SX Function of a few entries y of the vector u, the same Function at K places.  Its `rows` are added
to the stationarity conditions of these entries, and its `jacobian` is the derivative of the rows by y.  End actions,
end conditions and holonomic constraints are such terms; with a multiplier μ among y, the rows of μ·g(x) are
(μ·∂g/∂x, g).
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from casadi_galerkin.calculus.cached_property import cached_property
from casadi_galerkin.functional.embedding import Summation, gathered
from casadi_galerkin.functional.mapping import one_by_one
from casadi_galerkin.functional.numbering import Numbering
from casadi_galerkin.problems.callables import sizes_of_terms


@dataclass(frozen=True)
class LocalTerm:
    """A term of the functional at one or several places.

    Attributes
    ----------
    function : Function (y (n), t (q), parameters, given) -> added, rows (n,), jacobian (n, n), sparse.  `added` are the
        end action and, if there is a second entry, the work of given momenta, which `Trajectory.action` leaves out
    entries : (n, K), entries of u that are y at every place
    times : (q K, N + 1), matrix from the joints to the times of every place
    symmetric : whether the jacobian is symmetric, that is, whether the rows are the gradient of a function
    """

    function: ca.Function
    entries: np.ndarray
    times: ca.DM
    symmetric: bool

    def evaluated(self, u: ca.MX, joints: ca.MX, parameters: ca.MX, given: ca.MX) -> list[ca.MX]:
        """`added` (1 or 2, K), rows (n, K) and nonzeros of the jacobian (nnz, K)."""
        added, rows, jacobian = self._at_places(self.function, u, joints, parameters, given)
        return [added, rows, ca.reshape(ca.MX(jacobian.nz[:]), -1, self.entries.shape[1])]

    def sizes(self, u: ca.MX, joints: ca.MX, parameters: ca.MX, given: ca.MX) -> ca.MX:
        """Sums of the sizes of all terms that the rows are made of, (n, K)."""
        return self._at_places(self._sizes, u, joints, parameters, given)[0]

    @cached_property
    def _sizes(self) -> ca.Function:
        symbols = self.function.sx_in()
        return ca.Function("sizes", symbols, [sizes_of_terms(self.function(*symbols)[1], symbols)])

    def _at_places(
        self, function: ca.Function, u: ca.MX, joints: ca.MX, parameters: ca.MX, given: ca.MX
    ) -> list[ca.MX]:
        """A Function of the same arguments as `function` at all places."""
        size, count = self.entries.shape
        y = ca.reshape(u.get_nz(False, self.entries.ravel(order="F").tolist()), size, count)
        t = ca.reshape(ca.mtimes(ca.MX(self.times), joints), self.function.size1_in(1), count)
        return one_by_one(function, count, (2, 3)).call([y, t, parameters, given])

    def gathered(self, numbering: Numbering, rows: ca.MX) -> ca.MX:
        """Rows (n, K) summed for every unknown."""
        return gathered(numbering, self.entries.ravel(order="F"), rows)

    def matrix(self, numbering: Numbering, jacobian: ca.MX) -> ca.MX:
        """The term's part of ∇²S, from the nonzeros of its jacobian at all places."""
        pattern = (np.array(index, dtype=int) for index in self.function.sparsity_out(2).get_triplet())
        rows, columns = (self.entries[index].ravel(order="F") for index in pattern)
        return Summation(numbering.free, rows, columns, np.arange(len(rows))).matrix(jacobian)
