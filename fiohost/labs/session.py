"""What the control lab's experiments share: the motor believed in, the bench, the limits, and runs side by side."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from fiohost.bench.connect import connect
from fiohost.bench.loop import Bench
from fiohost.control.controllers import PID, Controller
from fiohost.errors import ConfigError
from fiohost.labs.constants import MotorConstants
from fiohost.labs.ideal import play_ideal
from fiohost.labs.play import (
    IDEAL,
    NO_LIMITS,
    Law,
    Limits,
    OpenLaw,
    PositionLaw,
    Run,
    SpeedLaw,
    Torque,
    Way,
    bench_way,
    furniture,
    play_model,
    play_target,
    target_volts,
)
from fiohost.settings import nearest

SATURATION = {
    "both": Limits(4.5, 1.0),
    "voltage": Limits(4.5, None),
    "current": Limits(None, 1.0),
    "half": Limits(2.25, 1.0),  # half of the full voltage, for the arm (section D-1-6)
    "none": NO_LIMITS,
}
BENCHES = {  # beside each set of the text, the board that is to it what a bench is to its model
    "no_load": "sim:nxt_lego",
    "arm_measured": "sim:nxt_lego_arm",
    "arm_tuned": "sim:nxt_lego_arm",
    "elevator": "sim:nxt_lego_elevator",
}
DERIVATIVE_FILTER_S = 0.01  # a count in one tick of 5 ms is 100 deg/s
MakeLaw = Callable[[Way, float], Law]  # the way, and percent for a volt


@dataclass(frozen=True)
class Gains:
    """A controller in the text's units: volts per unit of error (rad, or rad/s), its integral and its derivative."""

    kp: float
    ki: float = 0.0
    kd: float = 0.0

    def __str__(self) -> str:
        parts = [f"Kp {self.kp:.3g}"]
        parts += [f"Ki {self.ki:.3g}"] if self.ki else []
        return ", ".join([*parts, f"Kd {self.kd:.3g}"] if self.kd else parts)

    def controller(self, way: Way, pct_per_volt: float) -> Controller:
        """The same in percent for an error in degrees (or deg/s): 1 rad of error is the text's 1 V."""
        scale = float(np.radians(1.0)) * pct_per_volt
        filter_s = min(DERIVATIVE_FILTER_S, 2.0 * way.sample_time_s)
        tracking_s = self.kp / self.ki if self.ki else 0.0  # the text's block lets the integral wind up
        return PID(
            self.kp * scale, self.ki * scale, self.kd * scale, way.sample_time_s, filter_s, True, tracking_s
        )  # fmt: skip


def position(gains: Gains, ref_deg: float) -> MakeLaw:
    """A position loop with a step of the reference, in degrees from where the shaft stands."""
    return lambda way, scale: PositionLaw(gains.controller(way, scale), np.array([ref_deg]))


def speed(gains: Gains, ref_rad_s: float) -> MakeLaw:
    """A speed loop with a step of the reference."""
    return lambda way, scale: SpeedLaw(gains.controller(way, scale), np.array([ref_rad_s]), way)


def volts(level: float | Callable[[np.ndarray], np.ndarray], duration_s: float) -> MakeLaw:
    """A voltage, constant or a function of time, in open loop."""

    def law(way: Way, scale: float) -> Law:
        times = np.arange(round(duration_s / way.sample_time_s) + 1) * way.sample_time_s
        times = times + (
            0.5 * way.sample_time_s if way is IDEAL else 0.0
        )  # what holds for a tick is that of its middle
        return OpenLaw(level(times) if callable(level) else np.full(times.size, level), scale)

    return law


@dataclass
class Session:
    """One sitting at the bench. ``limits`` are what was asked for, and what the ideal model has. Model and target share
    those that the bench can have, ``bench_limits``: no target gives more than full duty, and only a simulated one has a
    supply whose current can be limited.
    """

    constants: MotorConstants
    bench: Bench
    folder: Path
    limits: Limits = SATURATION["both"]
    notes: list[str] = field(default_factory=list)
    logs: dict[str, str] = field(default_factory=dict)
    said: Callable[[str], None] = lambda text: None  # what is being done now

    @classmethod
    @contextmanager
    def open(
        cls, target: str, constants: str, folder: Path, *, seed: int | None = None, saturation: str = "both",
        said: Callable[[str], None] = lambda text: None,
    ) -> Iterator[Session]:  # fmt: skip
        """Read the constants, open the target; *said* is told what is being done. Raises FiohostError."""
        if saturation not in SATURATION:
            raise ConfigError(f"unknown saturation {saturation!r}; {nearest(saturation, SATURATION)}")
        known = MotorConstants.load(constants)
        with connect(target, seed=seed) as bench:
            session = cls(known, bench, folder, SATURATION[saturation], said=said)
            full = target_volts(bench, known)
            if abs(full - known.supply_V) > 1e-3 * known.supply_V:
                session.note(
                    f"full duty is {full:g} V on the target and {known.supply_V:g} V in the constants; "
                    "the loops are the same in volts"
                )
            if session.limits.amperes is not None and furniture(bench) is None:
                session.note(
                    "nothing limits the target's current: model and target are without the limit of 1 A, the ideal "
                    "model has it"
                )
            yield session

    @property
    def target(self) -> str:
        return self.bench.transport.name

    @property
    def way(self) -> Way:
        return bench_way(self.bench)

    @property
    def full_V(self) -> float:
        return target_volts(self.bench, self.constants)

    @property
    def bench_limits(self) -> Limits:
        """The limits of model and target alike."""
        volts = self.full_V if self.limits.volts is None else min(self.limits.volts, self.full_V)
        return Limits(volts, None if furniture(self.bench) is None else self.limits.amperes)

    @property
    def presses(self) -> bool:
        """Whether somebody can press on the target's shaft."""
        return furniture(self.bench) is not None

    def note(self, text: str) -> None:
        if text not in self.notes:
            self.notes.append(text)

    def ideal(
        self, law: MakeLaw, duration_s: float, limits: Limits, constants: MotorConstants | None = None,
        torque: Torque | None = None,
    ) -> Run:  # fmt: skip
        """The text's block diagram, with limits of its own and, where given, other constants."""
        q = constants or self.constants
        return play_ideal(q, law(IDEAL, q.pct_per_volt), duration_s, limits=limits, torque=torque)

    def model(self, law: MakeLaw, duration_s: float, torque: Torque | None = None) -> Run:
        """The model at the bench's own ticks, delay and counts."""
        q = self.constants
        law_ = law(self.way, q.pct_per_volt)
        return play_model(q, law_, duration_s, self.way, limits=self.bench_limits, torque=torque)

    def on_target(
        self, case: str, law: MakeLaw, duration_s: float, torque: Torque | None = None,
        metadata: Mapping[str, str] | None = None,
    ) -> Run:  # fmt: skip
        """The target; its log is kept under the name of the case."""
        if torque is not None and not self.presses:
            self.note(f"nothing presses on {self.target}: the disturbance is on the model only")
            torque = None
        self.said(f"{case}: {duration_s:.3g} s on {self.target}")
        path = self.folder / f"{case}.csv"
        about = {"experiment": case, **(metadata or {})}
        run = play_target(
            self.bench, law(self.way, 100.0 / self.full_V), duration_s, self.full_V, log_path=path,
            metadata=about, limits=self.bench_limits, torque=torque,
        )  # fmt: skip
        self.logs[f"log {case}"] = str(path)
        return run

    def three(self, case: str, law: MakeLaw, duration_s: float, torque: Torque | None = None) -> tuple[Run, Run, Run]:
        """Ideal, model and target; the ideal run has the session's limits too."""
        return (
            self.ideal(law, duration_s, self.limits, torque=torque),
            self.model(law, duration_s, torque),
            self.on_target(case, law, duration_s, torque),
        )

    def animate_motor(self, name: str, run: Run, ref_deg: float | None = None) -> None:
        """A moving picture of the shaft in a run, beside the pictures."""
        from fiohost.report.animation import animate_motor

        path = self.folder / f"{name}.gif"
        ref = None if ref_deg is None else np.full(len(run.time_s), ref_deg)
        animate_motor(path, run.time_s, run.angle_deg, ref, f"{name.replace('_', ' ')}, {run.name}, {self.target}")
        self.logs["animation"] = str(path)
