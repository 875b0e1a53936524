"""Descriptions of drops: the quality of their logs, what they excite, their contacts and resting places."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from sysid.fit.result import FitResult
from sysid.fit.story import ReadTrial, Story
from sysid.gear.beyond_window import centre_of_mass, read_drop
from sysid.gear.drops import lowpass_of
from sysid.gear.model import PARAMETERS, EventKind, simulate
from sysid.gear.out_of_plane import tell_limits
from sysid.gear.plausible import notice_contradictions, notice_odd_vehicle
from sysid.gear.problem import ONE_TOUCHDOWN, GearProblem
from sysid.gear.stated import CENTRE, RELEASE, SURFACE
from sysid.trials.look import inspect_recording, log_quality
from sysid.types import FloatArray


class GearStory(Story[GearProblem]):
    """Descriptions of the drops of a problem."""

    @property
    def keys(self) -> Mapping[str, str]:
        """Offsets and places by the key that states them."""
        places = dict.fromkeys((row.name for row in SURFACE), "point")
        return {RELEASE.name: "release", **places} | {row.name: "centre_of_mass_offset" for row in CENTRE}

    @property
    def accuracy(self) -> Mapping[str, object]:
        """The law and the tolerance."""
        law = self.problem.campaign.surface.law
        return {"friction_law": law, "accuracy_of_a_simulation": self.problem.tolerance}

    @property
    def filters(self) -> Mapping[str, object]:
        """The low-pass at the rate of the first drop."""
        lowpass = lowpass_of(self.problem.campaign, self.problem.drops[0].motion.rate)
        if lowpass is None:
            return {"kind": "none"}
        return lowpass.design() | {"simulation_filtered": self.problem.campaign.filter.filter_simulation}

    def read(self, fit: FitResult, values: FloatArray) -> list[ReadTrial]:
        """Return where and when every drop rests, its largest pitch, its touchdowns, and how it ends.

        Slope and release of a drop that was not fitted have the errors that the campaign states of them.
        """
        own = self.problem.with_rows_of_all
        board, rows = own.campaign.surface.board_length, self.drawn(fit, values)
        table, how = own.space.table, own.simulation
        return [read_drop(drop, table, rows, board, **how) for drop in own.drops]

    def quality(self) -> list[dict[str, object]]:
        """Return how good every log is, and how its fall begins and ends."""
        campaign, out = self.problem.campaign, []
        notice_odd_vehicle(campaign)
        trials = {trial.name: trial for trial in campaign.trials}
        for drop in self.problem.drops:
            assert drop.recording is not None
            flight, motion = drop.flight, drop.motion
            report = inspect_recording(drop.recording, campaign.vehicle.gravity)
            notice_contradictions(campaign, trials[drop.name], report.drop)
            window = (motion.time >= drop.time[0]) & (motion.time <= drop.time[-1])
            tilt = np.nanmax(np.abs([motion.roll[window], motion.yaw[window]]))
            # Error of the g of a parabola through n samples of noise σ over a time T: σ sqrt(720/n)/T².
            fall = drop.touchdown - flight.start
            count = fall * motion.rate
            error = float(flight.noise[1] * np.sqrt(720.0 / count) / fall**2) if count > 3 else np.nan
            stated = ("slope_deg", "release", "touchdown", "impact_speed", "notes")
            out.append({
                **log_quality(drop.name, drop.use, report),
                **{key: drop.provenance[key] for key in stated},
                "noise": dict(zip(("x", "z", "pitch"), flight.noise.tolist(), strict=True)),
                "gravity": flight.measured_gravity,
                "gravity_error": error,
                "held": flight.held,
                "lost_in_window": int(np.sum(~motion.valid[window])),
                "out_of_plane_deg": float(np.degrees(tilt)),
            })  # fmt: skip
        return out

    def excitation(self) -> dict[str, object]:
        """Return the ranges of slopes [deg], impact speeds [m/s] and largest pitch rates [rad/s]."""
        drops = self.problem.fitted.drops
        rates = [np.gradient(drop.target.measured[:, 4], 1 / drop.motion.rate) for drop in drops]
        spans = {
            "slope_deg": [float(np.degrees(drop.slope)) for drop in drops],
            "impact_speed": [drop.impact_speed for drop in drops],
            "pitch_rate": [float(np.nanmax(np.abs(rate))) for rate in rates],
        }
        return {name: [min(values), max(values)] for name, values in spans.items()}

    def about(self) -> dict[str, object]:
        """Return where the centre of mass is, seen from the stated one; tell how straight drops must fall."""
        tell_limits(self.problem)
        return {"centre_of_mass": centre_of_mass(self.problem.drops, self.problem.campaign)}

    def contacts(self, trial: int, row: FloatArray) -> FloatArray:
        """Return when feet touch (k,) [s] in a prediction, on the drop's clock; within 5 ms: once."""
        drop = self.problem.drops[trial]
        run = simulate(
            row[: len(PARAMETERS)], drop.slope, drop.initial_state, drop.simulated_time,
            surface=self.problem.campaign.surface.law, tolerance=self.problem.tolerance,
        )  # fmt: skip
        out: list[float] = []
        last: dict[str, float] = {}
        for event in run.events:
            if event.kind is EventKind.TOUCHDOWN:
                if event.time - last.get(event.foot, -1.0) > ONE_TOUCHDOWN:
                    out.append(event.time)
                last[event.foot] = event.time
        return drop.time[0] + np.array(out)
