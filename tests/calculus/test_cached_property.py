"""A property that is found when it is first asked for: once, and without a lock that a fork may find taken."""

import multiprocessing
import os
import threading

import numpy as np
import pytest

from casadi_galerkin.calculus.cached_property import cached_property


class Counted:
    """Counts how often its property is found, after a call that may wait."""

    def __init__(self, before=lambda: None):
        self.before, self.found = before, 0

    @cached_property
    def value(self):
        """What is found."""
        self.before()
        self.found += 1
        return self.found


def test_a_value_is_found_once_by_every_instance():
    one, other = Counted(), Counted()
    assert (one.value, one.value, other.value) == (1, 1, 1)
    assert (one.found, other.found) == (1, 1)


def test_an_array_is_kept_as_it_was_found():
    class Named:
        @cached_property
        def value(self):
            return np.ones(2)

    named = Named()
    with pytest.raises(ValueError, match="read-only"):
        named.value *= 2.0


def test_the_class_shows_the_words_of_the_method():
    assert Counted.value.__doc__ == "What is found."


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs forks")
@pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning")
def test_a_process_forked_while_a_thread_finds_a_value_finds_its_own():
    """Until Python 3.12 the property of the standard library has one lock for all instances."""
    begun, done = threading.Event(), threading.Event()

    def wait():
        begun.set()
        done.wait()

    thread = threading.Thread(target=lambda: Counted(wait).value)
    thread.start()
    begun.wait()
    child = multiprocessing.get_context("fork").Process(target=lambda: Counted().value)
    child.start()
    child.join(60)
    hangs = child.is_alive()
    child.kill()
    done.set()
    thread.join()
    assert not hangs
