"""What the comparison with the literature runs: costs are found to the tolerance."""

import importlib

import numpy as np
import pytest
from paths import EXAMPLES

QUICK = ["cart_pole", "low_thrust", "hypersensitive", "moon_lander", "regulator", "van_der_pol", "zermelo", "crane"]


@pytest.fixture
def scripts(monkeypatch):
    for folder in (EXAMPLES, EXAMPLES / "benchmark"):
        monkeypatch.syspath_prepend(str(folder))
    return importlib.import_module


@pytest.mark.parametrize("name", [*QUICK, "robot_arm", "brachistochrone"])
def test_published_cost_is_found_to_the_tolerance(scripts, name):
    literature, tol = scripts("literature"), 1e-6
    case = literature.CASES[name]()
    found = literature.outcome(case, tol)
    assert found.said == ""
    assert found.estimate <= tol
    assert found.error <= max(found.estimate, literature.KNOWN)
    assert np.isnan(case.published) or case.exact == pytest.approx(case.published, rel=5e-4)


def test_random_guesses_lead_to_the_same_costs_as_by_hand(scripts):
    guesses = scripts("guesses")
    problem = guesses.SCENES["cart-pole"][0]()
    programs = guesses.Ours(problem), guesses.ByHand(problem)
    ours, by_hand = (program.solve(guesses.guess(problem, seed=0))[0] for program in programs)
    assert ours == pytest.approx(by_hand, rel=1e-4)  # of different discretizations
