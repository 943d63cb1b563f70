"""What is saved can be read again, with all digits and the names of the attributes it comes from."""

import csv
import io
import json
from functools import cache

import numpy as np
import pytest
from control_problems import double_integrator
from scenes import BY_NAME, oscillator_problem

import casadi_galerkin as cg


@cache
def answers():
    """One of each kind, with the columns that it has."""
    orbit, moved = BY_NAME["Lambert"].solve(), cg.solve(double_integrator(), cg.Galerkin(3), 4)
    places = [f"{name}[{i}]" for name in ("x", "velocity", "momentum") for i in range(3)]
    plain = ["t", "x[0]", "velocity[0]", "momentum[0]", "energy"]
    ends = [f"{end}_{name}[0]" for name in ("x", "momentum") for end in ("start", "end")]
    over = [{"end": [2.0]}, {"guess": lambda t: [np.nan]}, {"end": [3.0]}]
    swept = cg.sweep(oscillator_problem(), over, cg.Galerkin(3), 4)
    errors = [f"{of}error" for of in ("", "path_", "joint_", "functional_", "energy_")]
    costs = ["tol", "unknowns", "first_seconds", "solve_seconds", "iterations", *errors]
    traded = cg.trade(oscillator_problem(), [cg.Galerkin(3)], [2, 4], tolerances=[1e-3])
    return [
        (orbit, ["t", *places, "energy"]),
        (moved, [*plain, "control[0]", "costate[0]"]),
        (cg.compare(oscillator_problem(), cg.Galerkin(3), 4), ["t", "stepped", "shooting"]),
        (swept, ["failure", "action", "duration", *ends]),
        (traded, ["way", "method", "degree", "intervals", *costs, "failure"]),
    ]


@pytest.fixture(scope="module", params=range(5), ids=["trajectory", "controls", "comparison", "sweep", "trade"])
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
        assert list(archive) == names
        for name, column in kept.table().items():
            np.testing.assert_array_equal(archive[name], column)
            np.testing.assert_array_equal(np.array([row[name] for row in rows]).astype(column.dtype), column)


@pytest.mark.parametrize("file", [None, 3, io.StringIO()])
def test_what_is_no_path_of_a_file_is_refused(file):
    kept, _ = answers()[0]
    for write in (kept.to_csv, kept.to_npz):
        with pytest.raises(TypeError, match="file must be the path of a file, a string or a Path, got"):
            write(file)


def test_columns_are_the_attributes_at_the_joints():
    path = cg.solve(double_integrator(), cg.Galerkin(3), 4)
    table = path.table()
    for name in ("x", "velocity", "momentum"):
        np.testing.assert_array_equal(table[f"{name}[0]"], getattr(path, name)[0])
    np.testing.assert_array_equal(table["control[0]"], path.control(path.t)[0])
    np.testing.assert_array_equal(table["costate[0]"], path.costate(path.t)[0])


def test_a_sweep_of_a_control_problem_has_costs():
    table = cg.sweep(double_integrator(), [{}, {"end": [2.0]}], cg.Galerkin(3), 4).table()
    np.testing.assert_allclose(table["cost"], [6, 24], rtol=1e-6)


def test_a_sweep_without_answers_still_says_why():
    for failing in ([{"guess": lambda t: [np.nan]}], []):
        table = cg.sweep(oscillator_problem(), failing, cg.Galerkin(3), 4).to_dict()
        assert list(table) == ["failure", "duration"]
        assert len(table["failure"]) == len(failing)


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
    np.testing.assert_array_equal(table["p[0]"], [2.0, 3.0, 1.0])
    np.testing.assert_array_equal(np.isnan(table["action"]), [False, True, False])
