"""What the comparison with the literature runs: costs are found to the tolerance."""

import numpy as np
import pytest
from paths import script
from slow import slow

TO_TOL = ["low_thrust", "regulator", *slow("van_der_pol", "zermelo", "brachistochrone")]
OF_COST = ["crane", "chain", *slow("cart_pole", "hypersensitive", "moon_lander", "quadrotor", "robot_arm")]
OF_COST += slow("dubins", "hang_glider", "orbit_raising", "shuttle")
literature, guesses, test_set = script("literature"), script("guesses"), script("test_set")


@pytest.mark.parametrize("name", TO_TOL)
def test_published_path_and_cost_are_found_to_the_tolerance(name, monkeypatch):
    found_as_published(name, monkeypatch)


@pytest.mark.parametrize("name", OF_COST)
def test_published_cost_is_found_to_the_tolerance(name, monkeypatch):
    found_as_published(name, monkeypatch, of=lambda path: path.cost)


def found_as_published(name, monkeypatch, **of):
    monkeypatch.setattr(literature, "SECONDS", 100.0)  # whatever else the machine does
    tol = 1e-6
    case = literature.CASES[name]()
    found = literature.outcome(case, tol=tol, **of)
    assert found.said == ""
    assert found.estimate <= tol
    assert found.error <= (max(found.estimate, literature.KNOWN) if not of else tol)
    assert np.isnan(case.published) or case.exact == pytest.approx(case.published, rel=1e-3)  # of three digits


@pytest.mark.slow
def test_random_guesses_lead_to_the_same_costs_as_by_hand():
    problem = guesses.SCENES["cart-pole"][0]()
    programs = guesses.Ours(problem), guesses.ByHand(problem)
    ours, by_hand = (program.solve(guesses.guess(problem, seed=0))[0] for program in programs)
    assert ours == pytest.approx(by_hand, rel=1e-4)  # of different discretizations


@pytest.mark.slow
def test_a_dozen_of_cash_s_problems_are_solved_to_the_tolerance(capsys):
    errors = test_set.main(stiffness=(1e-4,))
    assert errors.shape == (len(test_set.PROBLEMS), 2) == (12, 2)
    assert np.all(errors[:, 0] <= 1)
    assert np.isfinite(errors[:, 1]).sum() >= 10  # what `solve_bvp` solves, too
    assert len(capsys.readouterr().out.splitlines()) == 13
