"""Word to a user who waits for numba: once, and only where it compiles."""

from functools import cache

from numba.core.event import Event, Listener, register

from sysid.journal import tell


class _Compiling(Listener):
    """Says at the first compilation of a process why nothing else is printed for a while."""

    def __init__(self, name: str) -> None:
        self._name = name

    def on_start(self, event: Event) -> None:
        if self._name:
            tell(f"compiling {self._name}, once per version: under a minute")
        self._name = ""

    def on_end(self, event: Event) -> None:
        pass


@cache
def tell_of_kernel(name: str) -> None:
    """Let a simulation say that it must first be compiled; code on disk is loaded in silence."""
    register("numba:compile", _Compiling(name))
