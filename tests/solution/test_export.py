"""What is saved can be read again, with all digits and the names of the attributes it comes from."""

import csv
import io
import json
from functools import cache

import casadi as ca
import numpy as np
import pytest
from control_problems import double_integrator
from scenes import BY_NAME, oscillator_problem

import casadi_galerkin as cg
from casadi_galerkin.calculus.piecewise_polynomial import PiecewisePolynomial
from casadi_galerkin.solution.path import Path


@cache
def answers():
    """One of each kind, with the columns that it has."""
    orbit, moved = BY_NAME["Lambert"].solve(), cg.solve(double_integrator(), cg.Galerkin(3), 4)
    stepped = cg.solve(cg.InitialProblem(oscillator_problem().lagrangian, (0, 1), [0.0], velocity=[1.0]), tol=1e-6)
    places = [f"{name}[{i}]" for name in ("x", "velocity", "momentum") for i in range(3)]
    plain = ["t", "x[0]", "velocity[0]", "momentum[0]", "energy"]
    ends = [f"{end}_{name}[0]" for name in ("x", "momentum") for end in ("start", "end")]
    over = [{"end": [2.0]}, {"guess": lambda t: [np.nan]}, {"end": [3.0]}]
    swept = cg.sweep(oscillator_problem(), over, cg.Galerkin(3), 4)
    errors = [f"{of}error" for of in ("", "path_", "joint_")]
    costs = ["tol", "unknowns", "first_seconds", "solve_seconds", "iterations", *errors]
    traded = cg.trade(oscillator_problem(), [cg.Galerkin(3)], [2, 4], tolerances=[1e-3])
    return [
        (orbit, ["t", *places, "energy"]),
        (moved, [*plain, "control[0]", "costate[0]"]),
        (cg.compare(oscillator_problem(), cg.Galerkin(3), 4), ["t", "stepped", "shooting"]),
        (swept, ["failure", "action", "duration", *ends]),
        (stepped, plain),
        (traded, ["way", "method", "degree", "intervals", *costs, "failure"]),
    ]


@pytest.fixture(scope="module", params=range(6), ids=["global", "controls", "comparison", "sweep", "steps", "trade"])
def answer(request):
    return answers()[request.param]


def test_columns_have_the_names_of_the_attributes_and_one_length(answer):
    kept, names = answer
    table = kept.to_dict()
    assert list(table) == names
    assert len({len(column) for column in table.values()}) == 1
    assert json.loads(json.dumps(table)).keys() == table.keys()


def test_files_give_back_every_digit(answer, tmp_path):
    kept, names = answer
    kept.to_csv(tmp_path / "kept.csv")
    kept.to_npz(tmp_path / "kept.npz")
    with (tmp_path / "kept.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    with np.load(tmp_path / "kept.npz") as archive:
        assert [name for name in archive if "." not in name] == names
        for name, column in kept.table().items():
            np.testing.assert_array_equal(archive[name], column)
            np.testing.assert_array_equal(np.array([row[name] for row in rows]).astype(column.dtype), column)


@pytest.mark.parametrize("file", [None, 3, io.StringIO()])
def test_what_is_no_path_of_a_file_is_refused(file):
    kept, _ = answers()[0]
    for write in (kept.to_csv, kept.to_npz):
        with pytest.raises(TypeError, match="file must be the path of a file, a string or a Path, got"):
            write(file)


def test_columns_at_the_joints_are_the_attributes():
    path = cg.solve(double_integrator(), cg.Galerkin(3), 4)
    table = path.table(path.t)
    for name in ("x", "velocity", "momentum"):
        np.testing.assert_array_equal(table[f"{name}[0]"], getattr(path, name)[0])
    np.testing.assert_array_equal(table["energy"], path.energy)
    np.testing.assert_array_equal(table["control[0]"], path.control(path.t)[0])
    np.testing.assert_array_equal(table["costate[0]"], path.costate(path.t)[0])


def swing(t, x, v):
    return v[0] ** 2 / 2 + ca.cos(x[0])


@pytest.mark.parametrize("kind", ["boundary", "steps"])
def test_columns_at_any_time_keep_the_accuracy_of_the_path(kind):
    of_kind = {
        "boundary": cg.BoundaryProblem(swing, (0, 4), [0.0], [1.0]),
        "steps": cg.InitialProblem(swing, (0, 4), [0.0], velocity=[1.5]),
    }
    path, times = cg.solve(of_kind[kind], tol=1e-10), [0.3, 3.9, 1.1]
    table = path.to_dict(times)
    assert table["t"] == times
    np.testing.assert_array_equal(table["x[0]"], path(times)[0])
    np.testing.assert_array_equal(table["velocity[0]"], path(times, 1)[0])
    np.testing.assert_array_equal(table["momentum[0]"], table["velocity[0]"])  # of unit mass
    np.testing.assert_allclose(table["energy"], path.energy[0], rtol=1e-7)


def test_without_times_there_are_enough_to_draw_and_all_joints():
    path = cg.solve(cg.BoundaryProblem(swing, (0, 4), [0.0], [1.0]), tol=1e-10)
    table = path.table()
    assert set(path.t) <= set(table["t"])
    assert np.all(np.diff(table["t"]) > 0)
    times = np.linspace(0, 4, 4000)
    drawn = np.interp(times, table["t"], table["x[0]"])
    assert np.max(np.abs(drawn - path(times)[0])) < 2e-3 * path.sizes[0]


def test_one_time_is_one_row_and_times_outside_are_refused():
    path = cg.solve(double_integrator(), cg.Galerkin(3), 4)
    assert path.to_dict(0.5)["x[0]"] == pytest.approx([0.5])
    for write in (path.table, path.to_dict, lambda times: path.to_csv("none.csv", times)):
        with pytest.raises(ValueError, match=r"times must lie within \[0.0, 1.0\], got \[2.0\]"):
            write([2.0])


def test_a_last_path_of_a_failure_is_written_too(tmp_path):
    path = cg.solve(double_integrator(), cg.Galerkin(3), 4)
    Path(path.polynomial).to_csv(tmp_path / "last.csv", times=[0.0, 1.0])
    assert (tmp_path / "last.csv").read_text().splitlines()[0] == "t,x[0]"


def test_a_saved_path_is_the_guess_of_a_next_solve(tmp_path):
    problem = cg.BoundaryProblem(swing, (0, 10), [0.0], [1.0])
    other = cg.paths(problem, intervals=20, count=2)[0]
    other.to_npz(tmp_path / "other.npz")
    read = cg.load(tmp_path / "other.npz")
    assert type(read) is Path
    np.testing.assert_array_equal(read(other.t), other.x)
    assert cg.solve(problem, tol=1e-8, guess=read).action == pytest.approx(other.action, rel=1e-8)
    assert cg.solve(problem, cg.Galerkin(8), 20, guess=read).iterations <= 1


def test_a_saved_optimum_is_the_guess_of_a_next_one_of_any_duration(tmp_path):
    path = cg.solve(double_integrator(), cg.Galerkin(3), 4)
    path.to_npz(str(tmp_path / "move.npz"))
    read, controls = cg.load(str(tmp_path / "move.npz"))
    np.testing.assert_array_equal(controls(path.t), path.control(path.t))
    again = cg.solve(double_integrator(), cg.Galerkin(3), 4, guess=(read, controls))
    assert again.cost == pytest.approx(path.cost, rel=1e-9)
    longer = cg.solve(double_integrator(t_span=(0.0, 2.0)), cg.Galerkin(3), 4, guess=(read, controls))
    assert longer.cost == pytest.approx(path.cost / 8, rel=1e-9)


def test_a_path_that_jumps_is_read_with_its_jumps(tmp_path):
    values = np.array([[0.0, 1.0, 2.0]])
    jumping = Path(PiecewisePolynomial(np.arange(3.0), np.array([0.0, 1.0]), values, np.array([[5.0, 2.0]])))
    jumping.to_npz(tmp_path / "jumping.npz")
    assert cg.load(tmp_path / "jumping.npz").before(1.0).tolist() == [5.0]


def test_a_file_without_a_path_is_refused(tmp_path):
    swept, _ = answers()[3]
    swept.to_npz(tmp_path / "swept.npz")
    swept[0].to_csv(tmp_path / "path.csv")
    for name in ("swept.npz", "path.csv"):
        with pytest.raises(ValueError, match=f"{name} holds no path; only to_npz of a path writes one"):
            cg.load(tmp_path / name)
    with pytest.raises(TypeError, match="file must be the path of a file, a string or a Path, got 3"):
        cg.load(3)


def test_a_sweep_of_a_control_problem_has_costs():
    table = cg.sweep(double_integrator(), [{}, {"end": [2.0]}], cg.Galerkin(3), 4).table()
    np.testing.assert_allclose(table["cost"], [6, 24], rtol=1e-6)


def test_a_sweep_without_answers_still_says_why():
    for failing in ([{"guess": lambda t: [np.nan]}], []):
        table = cg.sweep(oscillator_problem(), failing, cg.Galerkin(3), 4).to_dict()
        assert {"failure", "duration"} <= set(table)
        assert {len(column) for column in table.values()} == {len(failing)}


def test_a_sweep_has_a_row_for_a_failure_too():
    over = [{"end": [2.0]}, {"guess": lambda t: [np.nan]}]
    table = cg.sweep(oscillator_problem(), over, cg.Galerkin(3), 4).table()
    assert table["failure"][0] == ""
    assert "finite" in table["failure"][1]
    np.testing.assert_array_equal(np.isnan(table["end_x[0]"]), [False, True])


def test_a_sweep_over_parameters_has_their_columns_also_where_it_failed():
    fall = cg.BoundaryProblem(lambda t, x, v, p: v[0] ** 2 / 2 - p[0] * x[0], (0, 1), [0], [0], parameters=[1.0])
    over = [{"parameters": [2.0]}, {"parameters": [3.0], "guess": lambda t: [np.nan]}, {}]
    table = cg.sweep(fall, over, cg.Galerkin(2), 2).table()
    np.testing.assert_array_equal(table["parameters[0]"], [2.0, 3.0, 1.0])
    np.testing.assert_array_equal(np.isnan(table["action"]), [False, True, False])
