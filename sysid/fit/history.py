"""What a search leaves behind: every generation of every stage of every run."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from sysid.fit.stopping import REASONS, StopReason
from sysid.shown import Brief
from sysid.types import FloatArray, IntArray


def summed(counts: Iterable[Mapping[str, int]]) -> dict[str, int]:
    """Return the sums of counts by name, in the order in which names appear."""
    total: dict[str, int] = {}
    for part in counts:
        for name, count in part.items():
            total[name] = total.get(name, 0) + count
    return total


@dataclass(frozen=True, eq=False)
class Generation:
    """What one generation left behind, `number` from 1 within its stage."""

    number: int
    # (P, n_free) population after the generation in the unit cube, best first [1].
    cube: FloatArray
    # (P,) NRMSE [1].
    cost: FloatArray
    # Candidates of this generation of which a simulation failed [1].
    failed: int
    # Candidates scored and simulations run since the run began [1], and its wall time [s].
    evaluations: int
    simulations: int
    elapsed: float
    algorithm: str = "ga"
    lowest: float = float("inf")

    @property
    def best(self) -> float:
        """Lowest NRMSE since the run began [1]."""
        return min(self.lowest, float(np.min(self.cost)))


@dataclass(frozen=True, eq=False, repr=False)
class StageHistory(Brief):
    """One algorithm's part of a run."""

    algorithm: str
    # (G, P, n_free) population after every generation in the unit cube, best first [1].
    cube: FloatArray
    # (G, P) NRMSE [1].
    cost: FloatArray
    # (G,) candidates scored in the generation of which a simulation failed [1].
    failed: IntArray
    # Candidates scored and simulations run in this stage [1].
    evaluations: int
    simulations: int
    # Wall time of this stage [s].
    wall_time: float
    stop_reason: StopReason
    # The failed candidates of every generation by cause [1]; empty where causes were not recorded.
    causes: tuple[Mapping[str, int], ...] = ()

    @property
    def failures(self) -> dict[str, int]:
        """Failed candidates of the whole stage by cause [1]."""
        return summed(self.causes)

    @property
    def ended(self) -> str:
        """Why the stage ended, in words."""
        return REASONS[self.stop_reason]


@dataclass(frozen=True, eq=False, repr=False)
class RunHistory(Brief):
    """Everything one run did: the search, then the finisher where there was one."""

    seed: int
    stages: tuple[StageHistory, ...]

    @property
    def best(self) -> FloatArray:
        """(G,) lowest NRMSE found until every generation, over all stages [1]."""
        lowest = np.concatenate([stage.cost.min(axis=1) for stage in self.stages])
        return np.minimum.accumulate(lowest)

    @property
    def median(self) -> FloatArray:
        """(G,) median NRMSE of the population after every generation, over all stages [1]."""
        return np.concatenate([np.median(stage.cost, axis=1) for stage in self.stages])

    @property
    def failed(self) -> IntArray:
        """(G,) failed candidates of every generation, over all stages [1]."""
        return np.concatenate([stage.failed for stage in self.stages])

    @property
    def failures(self) -> dict[str, int]:
        """Failed candidates by cause, over all stages [1]."""
        return summed(stage.failures for stage in self.stages)

    @property
    def best_point(self) -> FloatArray:
        """(n_free,) best individual of the run in the unit cube [1].

        Of an elitist algorithm (all but CMA-ES) it is the best of the last generation.
        """
        stage = min(self.stages, key=lambda s: float(s.cost.min()))
        generation, individual = np.unravel_index(int(np.argmin(stage.cost[::-1])), stage.cost.shape)
        return stage.cube[::-1][generation, individual]

    @property
    def evaluations(self) -> int:
        """Candidates scored [1]."""
        return sum(stage.evaluations for stage in self.stages)

    @property
    def simulations(self) -> int:
        """Simulations run [1]."""
        return sum(stage.simulations for stage in self.stages)

    @property
    def wall_time(self) -> float:
        """[s]."""
        return sum(stage.wall_time for stage in self.stages)

    @property
    def stop_reason(self) -> StopReason:
        """Why the last stage ended."""
        return self.stages[-1].stop_reason
