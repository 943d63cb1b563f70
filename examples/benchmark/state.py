"""State between solves: interrupts, forks and threads leave no wrong answer, and nothing hangs.

* A real signal stops a solve, whose mesh or data have just changed, at a random moment.  Then another problem with the
  same numbering is solved, and the stopped one again, both against answers that were found undisturbed.
* A process is forked while a thread solves; the child solves the same problem with the same graph.
* Threads solve the same and different problems at once.

Run it with ``python examples/benchmark/state.py``; it takes a few minutes, and prints counts.
"""

import multiprocessing
import platform
import signal
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from functools import cache

import casadi as ca
import numpy as np

import casadi_galerkin as cg

METHOD, INTERVALS = cg.Galerkin(degree=4), 12
MESHES = [np.linspace(0.0, 1.0, INTERVALS + 1) ** power for power in (1.0, 1.5, 0.7, 2.0)]
ENDS = [[0.5], [1.0], [1.5], [-0.8]]
SAME = 1e-11  # solves of the same problem from different guesses end within this
PATIENCE = 60  # seconds after which a child or a thread counts as hanging


class Stopped(BaseException):
    """What the signal raises; like KeyboardInterrupt, it is no Exception."""


def problems():
    """Three problems with the same numbering and the same sparsity, one of them quadratic."""
    pendulum = cg.BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2 + 3 * ca.cos(2 * x[0]), (0.0, 1.0), [0.0], [1.0])
    quartic = cg.BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2 + x[0] ** 4 / 4 + t * x[0], (0.0, 1.0), [0.0], [1.0])
    quadratic = cg.BoundaryProblem(lambda t, x, v: v[0] ** 2 - (1 + t) * x[0] ** 2, (0.0, 1.0), [0.0], [1.0])
    return pendulum, quartic, quadratic


def solved(transcription, case):
    """Node values for one choice of mesh and end."""
    mesh, end = MESHES[case // len(ENDS)], ENDS[case % len(ENDS)]
    return transcription.solve(end=end, mesh=mesh).polynomial.values


@cache
def answers():
    """Node values of all problems and cases, found undisturbed by graphs of their own."""
    cases = range(len(MESHES) * len(ENDS))
    return [[solved(cg.transcribe(p, METHOD, INTERVALS), case) for case in cases] for p in problems()]


def differs(values, expected):
    """Whether a solve gave another path."""
    return bool(np.max(np.abs(values - expected)) > SAME)


def interrupts(count, seed=0):
    """Stop solves at random moments; returns the numbers of solves that were stopped and of wrong answers after."""
    rng, expected = np.random.default_rng(seed), answers()
    transcriptions = [cg.transcribe(problem, METHOD, INTERVALS) for problem in problems()]
    for transcription in transcriptions:
        transcription.solve()
    stopped, wrong = 0, 0

    def stop(*_):
        raise Stopped

    before = signal.signal(signal.SIGALRM, stop)
    try:
        for _ in range(count):
            victim, other = rng.choice(len(transcriptions), 2, replace=False)
            case, next_case = rng.integers(len(expected[0]), size=2)
            try:
                signal.setitimer(signal.ITIMER_REAL, rng.uniform(1e-5, 6e-4))
                solved(transcriptions[victim], case)
                signal.setitimer(signal.ITIMER_REAL, 0)
            except (Stopped, SystemError) as error:  # the second where the signal met CasADi's own code
                if not isinstance(error, Stopped) and not isinstance(error.__cause__, Stopped):
                    raise
                stopped += 1
            for i, k in ((other, next_case), (victim, next_case), (victim, case)):
                wrong += differs(solved(transcriptions[i], k), expected[i][k])
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)
    return stopped, wrong


def _child(transcription, case, expected):
    """Solve in a forked process; its exit code tells whether the answer is right."""
    raise SystemExit(int(differs(solved(transcription, case), expected)))


def forks(count):
    """Fork beside a thread that solves; returns how many children hung and how many gave wrong answers."""
    expected = answers()
    transcriptions = [cg.transcribe(problem, METHOD, INTERVALS) for problem in problems()]
    ended, failures = threading.Event(), []

    def work():
        case = 0
        while not ended.is_set():
            case = (case + 1) % len(expected[0])
            if any(differs(solved(t, case), e[case]) for t, e in zip(transcriptions, expected, strict=True)):
                failures.append(case)

    thread = threading.Thread(target=work)
    thread.start()
    context, hung, wrong = multiprocessing.get_context("fork"), 0, 0
    for i in range(count):
        time.sleep(0.01 * (i % 7))
        k = i % len(transcriptions)
        child = context.Process(target=_child, args=(transcriptions[k], i % 16, expected[k][i % 16]))
        child.start()
        child.join(PATIENCE)
        hung += child.exitcode is None
        wrong += child.exitcode not in (0, None)
        child.kill()
    ended.set()
    thread.join(PATIENCE)
    return hung, wrong + len(failures)


def threads(count, workers=4):
    """Solve in threads, on shared and on own graphs; returns the number of wrong answers."""
    expected = answers()
    shared = [cg.transcribe(problem, METHOD, INTERVALS) for problem in problems()]

    def work(i):
        k, case = i % len(shared), (i // len(shared)) % len(expected[0])
        own = i % 5 == 0
        transcription = cg.transcribe(problems()[k], METHOD, INTERVALS) if own else shared[k]
        return differs(solved(transcription, case), expected[k][case])

    with ThreadPoolExecutor(workers) as pool:
        return sum(pool.map(work, range(count)))


def main(interrupted=3000, forked=12, threaded=1680):
    """Run all; returns the counts."""
    return {"interrupts": interrupts(interrupted), "forks": forks(forked), "threads": threads(threaded)}


if __name__ == "__main__":
    print(f"Python {platform.python_version()}, CasADi {ca.__version__}, NumPy {np.__version__}, {platform.machine()}")
    counts = main()
    print(f"of 3,000 solves {counts['interrupts'][0]} were stopped; {counts['interrupts'][1]} wrong answers followed")
    print(f"of 12 forks beside a solving thread {counts['forks'][0]} hung, {counts['forks'][1]} answers were wrong")
    print(f"of 1,680 solves in four threads {counts['threads']} were wrong")
