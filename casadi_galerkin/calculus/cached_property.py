"""A property that is computed when it is first used, and kept; an array is read-only.

Before Python 3.12, ``functools.cached_property`` holds a lock while it computes: a child that was forked while another
thread of its parent did so hung when it used the same property.  Here two threads may compute the same value twice.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from functools import cached_property
else:

    class cached_property:
        """Decorator of a method without arguments, which the value then replaces in the instance."""

        def __init__(self, find: Callable[[Any], Any]) -> None:
            self._find, self.__doc__ = find, find.__doc__

        def __set_name__(self, owner: type, name: str) -> None:
            self._name = name

        def __get__(self, instance: Any, owner: type | None = None) -> Any:
            if instance is None:
                return self
            value = instance.__dict__[self._name] = self._find(instance)
            if isinstance(value, np.ndarray):
                value.flags.writeable = False  # whoever changed it would change what the instance is
            return value


__all__ = ["cached_property"]
