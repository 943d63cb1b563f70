"""Guesses that worker processes find by their names; imports nothing, which each of the processes would pay for."""

import os


def arched(t):
    """A guess that a process pool can pickle."""
    return [16 * t * (1 - t)]


class Unpicklable(Exception):
    """Holds what cannot be sent."""

    def __init__(self, message):
        super().__init__(message)
        self.held = lambda: None


class Unbuildable(Exception):
    """Can be sent, but not received."""

    def __init__(self, message, number):
        super().__init__(message)
        self.number = number


def dividing(t):
    return [1 / 0]


def unpicklable(t):
    raise Unpicklable("the table is open")


def unbuildable(t):
    raise Unbuildable("the table is closed", 3)


def deadly(t):
    """A guess that ends its process, as the system does when memory is short."""
    os._exit(1)


def pushed(t):
    """A guess of a control that a process pool can pickle."""
    return [6 - 12 * t]
