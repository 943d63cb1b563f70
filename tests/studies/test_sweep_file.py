"""A sweep that is kept in a file is solved once: what the file has is read, and only the rest is solved."""

import signal
import subprocess
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import pytest
from scenes import bratu_problem
from sent_guesses import arched

import casadi_galerkin as cg
from casadi_galerkin.studies.sweep_file import SweepFile

METHOD, INTERVALS = cg.Galerkin(degree=4), 6
VARIATIONS = [{"parameters": [rate]} for rate in np.linspace(0.1, 4.0, 130).tolist()]  # the last ones have no path
ALL = len(VARIATIONS)


def same(one, other):
    """Whether two sweeps have bitwise the same answers, and failures with the same words."""
    return all(
        str(a) == str(b)
        if isinstance(a, Exception)
        else np.array_equal(a.polynomial.values, b.polynomial.values) and np.array_equal(a.t, b.t)
        for a, b in zip(one, other, strict=True)
    )


def swept(file=None, variations=VARIATIONS, **given):
    return cg.sweep(bratu_problem(), variations, METHOD, INTERVALS, file=file, **given)


@pytest.fixture
def solves(monkeypatch):
    """The number of solves so far, as the length of a list."""
    done, solve = [], cg.Transcription.solve
    monkeypatch.setattr(cg.Transcription, "solve", lambda *given, **named: done.append(1) or solve(*given, **named))
    return done


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A file with all answers, and these."""
    file = tmp_path_factory.mktemp("sweep") / "whole.sweep"
    return file, swept(file)


@pytest.mark.slow
def test_what_the_file_has_is_not_solved_again(whole, solves):
    file, first = whole
    assert same(swept(file), first)
    assert same(swept(str(file)), first)
    assert not solves
    assert 0 < len(first.failures) < ALL  # they are not tried again, either


@pytest.mark.parametrize(("lost", "solved"), [(1, 4), (10**9, ALL)])  # chunks of six, the last one of four
@pytest.mark.slow
def test_a_chunk_that_was_cut_off_is_solved_again(whole, solves, tmp_path, lost, solved):
    file, first = whole
    cut, written = tmp_path / "cut.sweep", file.read_bytes()
    cut.write_bytes(written[:-lost])
    assert same(swept(cut), first)
    assert len(solves) == solved
    assert cut.read_bytes()[:200] == written[:200]
    assert len(cut.read_bytes()) == pytest.approx(len(written), rel=0.02)  # but for the seconds that it took


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            {"method": cg.Galerkin(3)},
            "a sweep of another problem, method, mesh or tol: delete it, or give",
        ),
        ({"intervals": 7}, "a sweep of another problem, method, mesh or tol"),
        ({"tol": 1e-6}, "a sweep of another problem, method, mesh or tol"),
        ({"problem": bratu_problem().varied({"end": [0.1]})}, "a sweep of another problem, method, mesh or tol"),
        ({"variations": VARIATIONS[1:]}, "a sweep of other variations"),
        ({"variations": [{**VARIATIONS[0], "guess": arched}, *VARIATIONS[1:]]}, "a sweep of other variations"),
    ],
)
def test_the_file_of_another_sweep_is_refused_before_any_solve(whole, solves, change, message):
    file, _ = whole
    given = {"problem": bratu_problem(), "variations": VARIATIONS, "method": METHOD, "intervals": INTERVALS, **change}
    with pytest.raises(ValueError, match=rf"whole\.sweep holds the answers of {message}"):
        cg.sweep(**given, file=file)
    assert not solves


def test_another_file_is_refused_and_left_as_it_was(tmp_path):
    other = tmp_path / "table.csv"
    other.write_text("t,x\n0,1\n", encoding="utf-8")
    with pytest.raises(ValueError, match=r"table\.csv is not the file of a sweep: give another name"):
        swept(other)
    assert other.read_text(encoding="utf-8") == "t,x\n0,1\n"
    with pytest.raises(TypeError, match="file must be the path of a file, a string or a Path, got 3"):
        swept(3)


def test_a_guess_that_no_file_can_hold_is_refused(tmp_path):
    with pytest.raises(TypeError, match="the guess of variation 1 cannot be pickled"):
        swept(tmp_path / "guess.sweep", [{}, {"guess": lambda t: [t]}])


def test_failures_are_kept_and_what_was_cut_short_is_not(tmp_path):
    file = SweepFile(tmp_path / "some.sweep", b"problem", b"variations")
    file.keep([0, 1], [1.0, cg.ConvergenceError("no path")])
    file.keep([2, 3], [1.0, cg.CutShort("the worker failed")])
    again = SweepFile(tmp_path / "some.sweep", b"problem", b"variations")
    assert str(again.get([0, 1])[1]) == "no path"
    assert again.get([2, 3]) is None


@pytest.mark.slow
def test_an_interrupted_sweep_goes_on_where_it_was(tmp_path, solves, monkeypatch):
    file, solve = tmp_path / "begun.sweep", cg.Transcription.solve

    def interrupted(*given, **named):
        if len(solves) == 50:
            raise KeyboardInterrupt
        return solve(*given, **named)

    with monkeypatch.context() as context:
        context.setattr(cg.Transcription, "solve", interrupted)
        first = swept(file)
    assert sum(isinstance(answer, cg.CutShort) for answer in first) == ALL - 50
    again = swept(file)
    assert len(solves) <= ALL + 5  # a chunk less one
    assert not any(isinstance(answer, cg.CutShort) for answer in again)
    assert same(again, swept())


@pytest.mark.slow
def test_workers_and_neighbors_give_the_same_from_a_file(tmp_path):
    rates = [{"parameters": [rate]} for rate in np.linspace(0.1, 3.5, 30).tolist()]
    here = cg.sweep(bratu_problem(), rates, tol=1e-6)
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as pool:
        for executor in (pool, None):
            assert same(cg.sweep(bratu_problem(), rates, tol=1e-6, file=tmp_path / "n", executor=executor), here)
    written = (tmp_path / "n").read_bytes()
    (tmp_path / "n").write_bytes(written[: len(written) // 2])
    assert same(cg.sweep(bratu_problem(), rates, tol=1e-6, file=tmp_path / "n"), here)


THOUSAND = """
import sys
import numpy as np
from scenes import bratu_problem
import casadi_galerkin as cg

file, log = sys.argv[1:]
solve = cg.Transcription.solve

def logged(*given, **named):
    with open(log, "ab", buffering=0) as opened:
        opened.write(b".")
    return solve(*given, **named)

cg.Transcription.solve = logged
rates = [{"parameters": [rate]} for rate in np.linspace(0.1, 3.5, 1000).tolist()]
cg.sweep(bratu_problem(), rates, cg.Galerkin(4), 6, file=file)
"""


@pytest.mark.slow
def test_a_thousand_problems_killed_at_a_random_moment_are_resumed(tmp_path):
    file, log = tmp_path / "thousand.sweep", tmp_path / "log"
    log.touch()
    moment = np.random.default_rng(0).integers(1, 1000)
    command = [sys.executable, "-c", THOUSAND, str(file), str(log)]
    paths = {"PYTHONPATH": f"{Path(cg.__file__).parents[1]}:{Path(__file__).parents[1]}"}
    with subprocess.Popen(command, env=paths) as killed:
        while killed.poll() is None and log.stat().st_size < moment:
            time.sleep(0.001)
        killed.send_signal(signal.SIGKILL)
    assert file.stat().st_size > 0
    subprocess.run(command, env=paths, check=True)
    assert 1000 <= log.stat().st_size <= 1016  # chunks have sixteen
    rates = [{"parameters": [rate]} for rate in np.linspace(0.1, 3.5, 1000).tolist()]
    before = log.stat().st_size
    resumed = cg.sweep(bratu_problem(), rates, METHOD, INTERVALS, file=file)
    assert log.stat().st_size == before
    assert same(resumed, cg.sweep(bratu_problem(), rates, METHOD, INTERVALS))
