"""The paper by hand: embed, evaluate, integrate, in NumPy alone, beside what the package's graph computes.

The functional of the pendulum, S = ∫ L(x̄, dx̄/dt) Δ_w t, and its gradient, the left-hand sides of the discrete
Euler-Lagrange equations, follow from one sparse matrix E and one weight vector ω:

    (x̄, dx̄/dt) = E X̄,      S = ω · L,      ∇S = Eᵀ (ω ∂L/∂x, ω ∂L/∂v).
"""

import casadi as ca
import numpy as np

import casadi_galerkin as cg

METHOD = cg.Galerkin(degree=3, quadrature=cg.lobatto(4))
MESH = np.array([0.0, 0.2, 0.45, 0.75, 1.0])  # a time scale need not be uniform


def by_hand(values):
    """Discrete functional and its gradient by all node values X̄; returns (S, ∇S, number of quadrature points)."""
    calculus = cg.DiscreteCalculus(METHOD, MESH)
    entries, (rows, columns) = calculus.operator()
    embed = np.zeros((2 * len(calculus.weights), len(values)))
    np.add.at(embed, (rows, columns), entries)
    x, v = np.split(embed @ values, 2)  # embed
    integrand, by_x, by_v = v**2 / 2 + np.cos(x), -np.sin(x), v  # evaluate
    action = calculus.integral(integrand)[-1]  # integrate
    return action, embed.T @ np.concatenate((calculus.weights * by_x, calculus.weights * by_v))


def main():
    """Compare at a path that is not a solution, and check that the solver's answer makes the gradient vanish."""
    problem = cg.BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2 + ca.cos(x[0]), (0.0, 1.0), [0.0], [1.0])
    graph = cg.transcribe(problem, METHOD, mesh=MESH)
    nodes = cg.DiscreteCalculus(METHOD, MESH).node_times
    trial = nodes + 0.3 * np.sin(np.pi * nodes)  # node values X̄ of some path between the ends
    action, gradient = by_hand(trial)
    given = (trial[1:-1], trial[:1], trial[-1:], MESH)
    difference = gradient[1:-1] - np.array(graph.gradient(*given)).ravel()
    path = graph.solve()
    solved_action, solved_gradient = by_hand(path(nodes)[0])
    return {
        "graph": graph,
        "nodes": nodes,
        "trial": trial,
        "path": path,
        "action": action,
        "action of the graph": float(graph.action(*given)),
        "largest difference of the gradients": np.max(np.abs(difference)),
        "action at the solution": solved_action,
        "action reported": path.action,
        "largest gradient at the solution": np.max(np.abs(solved_gradient[1:-1])),
        "momenta by hand": np.array([-solved_gradient[0], solved_gradient[-1]]),
        "momenta reported": path.momentum[0, [0, -1]],
    }


def draw(answer):
    """Draw the trial path and the solution with their nodes, and the pattern of ∇²S; returns the figure."""
    graph, nodes, trial, path = (answer[name] for name in ("graph", "nodes", "trial", "path"))
    left, right = cg.panels(columns=2, size=(6.0, 3.0))
    path.plot(left, labels=["x"])
    times = np.linspace(0, 1, 200)
    left.plot(times, cg.DiscreteCalculus(METHOD, MESH).emb(trial[None, :])(times)[0], color="0.6")
    left.plot(nodes, trial, ".", color="0.6")
    left.legend(left.lines[::2], ["critical path", "trial path"], fontsize="small")
    left.set_title("Two paths with their nodes")
    graph.plot_hessian(right)
    return left.figure


if __name__ == "__main__":
    answer = main()
    for what, number in list(answer.items())[4:]:
        print(f"{what:36} {number}")
    draw(answer).savefig("calculus.png")
