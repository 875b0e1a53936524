"""Breeding in another process, so that the runs of a fit on a cluster do not wait for each other.

Breeding a population of 800 takes tens of milliseconds of one core. Five runs that breed in one process keep
sixty workers waiting; five processes do not. The other process runs
`sysid.fit.breeders.algorithms.breeder`, so the numbers are the same.
"""

from __future__ import annotations

import signal
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from typing import Any

from sysid.fit.breeders.algorithms import breeder
from sysid.fit.breeders.breeder import Breeder, Start
from sysid.types import FloatArray

# Of the process that breeds; it serves one breeder.
_BREEDER: dict[str, Breeder] = {}


class BreederApart(Breeder):
    """A breeder in another process; see `sysid.fit.breeders.algorithms.breeder` for the parameters."""

    def __init__(self, name: str, n_free: int, population: int, seed: int, start: Start | None) -> None:
        self._process = ProcessPoolExecutor(1, mp_context=get_context("spawn"), initializer=_deaf)
        self._call(_begin, name, n_free, population, seed, start)
        self._population: tuple[FloatArray, FloatArray] | None = None

    def _call(self, function: Any, *arguments: Any) -> Any:
        return self._process.submit(function, *arguments).result()

    def ask(self) -> FloatArray | None:
        """Return the candidates (P, n_free) to score next, or None when no new one can be bred."""
        points: FloatArray | None = self._call(_ask)
        return points

    def tell(self, cost: FloatArray, residuals: FloatArray | None = None) -> None:
        """Take the costs (P,) of the candidates last asked for."""
        self._population = self._call(_tell, cost)

    def population(self) -> tuple[FloatArray, FloatArray]:
        """Return points (P, n_free) and costs (P,) of the population, best first."""
        assert self._population is not None, "a population is known once it was scored"
        return self._population

    def close(self) -> None:
        """End the process."""
        self._process.shutdown(wait=False, cancel_futures=True)


def _deaf() -> None:
    # A terminal sends Ctrl-C to every process; the one that searches decides what it means.
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def _begin(name: str, n_free: int, population: int, seed: int, start: Start | None) -> None:
    _BREEDER["breeder"] = breeder(name, n_free, population, seed, start)


def _ask() -> FloatArray | None:
    return _BREEDER["breeder"].ask()


def _tell(cost: FloatArray) -> tuple[FloatArray, FloatArray]:
    _BREEDER["breeder"].tell(cost)
    return _BREEDER["breeder"].population()
