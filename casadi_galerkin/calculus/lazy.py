"""A property that is found when it is first asked for, and kept.

``functools.cached_property`` holds a lock meanwhile until Python 3.12: a process forked while another thread of the
parent was finding such a property hung when it asked for it.  Here two threads may find the same value twice.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from functools import cached_property as lazy
else:

    class lazy:
        """Decorate a method without arguments; its value takes its place in the instance."""

        def __init__(self, find: Callable[[Any], Any]) -> None:
            self._find, self.__doc__ = find, find.__doc__

        def __set_name__(self, owner: type, name: str) -> None:
            self._name = name

        def __get__(self, instance: Any, owner: type | None = None) -> Any:
            if instance is None:
                return self
            value = instance.__dict__[self._name] = self._find(instance)
            return value


__all__ = ["lazy"]
