"""A time limit of one solve is no limit of the next, though both use what was built once."""

import time
from contextlib import suppress

import pytest
from control_problems import cart_pole
from scenes import BY_NAME

import casadi_galerkin as cg
from casadi_galerkin.solvers.deadline import limited, until

BUILT_ONCE = {
    "boundary": (BY_NAME["long pendulum, index 0"].problem, cg.Galerkin(8)),
    "control": (cart_pole(), cg.Galerkin(4)),
}


@pytest.mark.parametrize("name", BUILT_ONCE)
def test_a_limit_is_of_one_solve_only(name):
    problem, method = BUILT_ONCE[name]
    known = cg.transcribe(problem, method, 20).solve(solver=cg.ipopt)
    transcription = cg.transcribe(problem, method, 20)
    for _ in range(2):
        with suppress(cg.ConvergenceError), until(time.perf_counter() + 1e-3):
            transcription.solve(solver=cg.ipopt)
    assert transcription.solve(solver=cg.ipopt).action == pytest.approx(known.action, rel=1e-9)


def test_time_that_is_up_stops_a_solve_and_is_forgotten():
    transcription = cg.transcribe(cart_pole(), cg.Galerkin(4), 20)
    with until(time.perf_counter()), pytest.raises(cg.ConvergenceError, match="IPOPT stopped with 'Maximum"):
        transcription.solve()
    assert transcription.solve().cost == pytest.approx(58.807, abs=1e-2)


def test_no_rescue_begins_after_the_time_is_up():
    problem, method = BUILT_ONCE["boundary"]
    transcription = cg.transcribe(problem, method, 20)
    with until(time.perf_counter()), pytest.raises(cg.ConvergenceError, match="the time was up") as caught:
        transcription.solve()
    assert "IPOPT" not in str(caught.value)


def test_a_shorter_limit_of_the_user_is_kept():
    with until(time.perf_counter() + 60):
        assert limited({"max_wall_time": 0.5}) == {"max_wall_time": 0.5}
        assert limited({})["max_wall_time"] == pytest.approx(60, abs=10)
