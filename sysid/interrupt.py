"""Ctrl-C while a command runs, where a compiler would lose it too; the SIGTERM of a scheduler is the same.

An exception that is raised in a callback of LLVM ends there: ctypes prints and forgets it. So the handler
looks whether it interrupts llvmlite, and then comes again a moment later.
"""

import _thread
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

# Pause between two attempts [s].
_AGAIN = 0.05


def raise_interrupt(signum: int, frame: FrameType | None) -> None:
    """Raise KeyboardInterrupt, as a handler of SIGINT; inside llvmlite a moment later."""
    while frame is not None:
        if str(frame.f_globals.get("__name__", "")).startswith("llvmlite."):
            later = threading.Timer(_AGAIN, _thread.interrupt_main)
            later.daemon = True
            later.start()
            return
        frame = frame.f_back
    raise KeyboardInterrupt


@contextmanager
def heard_interrupts() -> Iterator[None]:
    """Let Ctrl-C and SIGTERM end the block; nothing changes where Python would not raise it."""
    in_main = threading.current_thread() is threading.main_thread()
    if not in_main or signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        yield
        return
    signal.signal(signal.SIGINT, raise_interrupt)
    # Whoever listens to Ctrl-C inside the block hears SIGTERM as well.
    before = signal.signal(signal.SIGTERM, lambda signum, frame: signal.raise_signal(signal.SIGINT))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, signal.default_int_handler)
        signal.signal(signal.SIGTERM, before)
