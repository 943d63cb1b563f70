"""A casadi.Callback with exact derivatives: a Function that exists in the process that made it only."""

import casadi as ca

import casadi_galerkin as cg


class Known(ca.Callback):
    """A function of one number and, if it is given, its derivative."""

    def __init__(self, value, derivative=None):
        super().__init__()
        self.value, self.derivative = value, derivative
        self.construct("known")

    def eval(self, values):
        return [self.value(values[0])]

    def has_jacobian(self):
        return self.derivative is not None

    def get_jacobian(self, name, inputs, outputs, options):
        x, y = ca.MX.sym("x"), ca.MX.sym("y")
        return ca.Function(name, [x, y], [self.derivative(x)], inputs, outputs, options)


MINUS_COSINE = Known(lambda x: -ca.cos(x))
MINUS_SINE = Known(lambda x: -ca.sin(x), MINUS_COSINE)
COSINE = Known(ca.cos, MINUS_SINE)  # Functions of it do not keep it, or its derivatives, alive


def pendulum_with_callback():
    """The pendulum over two seconds."""
    return cg.BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2 + COSINE(x[0]), (0, 2), [0.0], [1.0])
