# ruff: noqa: E501 (a table a line)
"""Made-up tables as people's loggers write them: one motor, many files. Each is made when asked for."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

STEP_S = 0.005
ROWS = 1200
GAIN_DEG_S, LAG_S = 6.0, 0.08  # per percent; of the motor that all tables measure
COUNTS = 2800


@dataclass(frozen=True)
class Run:
    """What was measured: times, duty in percent, angle in deg, speed in deg/s, current in A."""

    time_s: np.ndarray
    duty: np.ndarray
    angle: np.ndarray
    speed: np.ndarray
    current: np.ndarray


def run(step_s: float = STEP_S, rows: int = ROWS, both_ways: bool = True) -> Run:
    """Steps of duty on a motor with lag, simulated exactly."""
    levels = (
        np.array([40.0, -30.0, 60.0, -55.0, 20.0, 0.0]) if both_ways else np.array([40.0, 30.0, 60.0, 55.0, 20.0, 45.0])
    )
    duty = np.repeat(levels, -(-rows // len(levels)))[:rows]
    keep = np.exp(-step_s / LAG_S)
    speed, angle = np.zeros(rows), np.zeros(rows)
    for k in range(1, rows):
        end = GAIN_DEG_S * duty[k - 1]
        speed[k] = end + (speed[k - 1] - end) * keep
        angle[k] = angle[k - 1] + end * step_s + (speed[k - 1] - end) * LAG_S * (1.0 - keep)
    current = 0.02 * (duty - speed / GAIN_DEG_S) + 0.05
    return Run(np.arange(rows) * step_s, duty, angle, speed, current)


@dataclass(frozen=True)
class Case:
    """One table: how to write it, what must become of it, and what must be said to import it."""

    name: str
    make: Callable[[Path], None]
    column: str = "angle_deg"  # of the log
    answers: tuple[str, ...] = ()
    tolerance: float = 0.6  # of the output, in the log's unit
    duty_tolerance: float = 0.5
    quantum: float | None = None
    beside: str = ""
    unknown: str = ""  # what the refusal says, where it must be refused without answers
    needs: str = ""
    rows: int = ROWS
    step_s: float = STEP_S
    full_range: float = 100.0  # duty of a full scale in the table, where it was assumed to be another
    values: Mapping[str, Any] = field(default_factory=dict)


def text(
    head: str, row: Callable[[Run, int], str], *, encoding: str = "utf-8", end: str = "\n", above: str = "", below: str = "",
    source: Callable[[], Run] = run,
) -> Callable[[Path], None]:  # fmt: skip
    """A writer of a table of text: lines above, the head, a row for each sample, lines below."""

    def make(path: Path) -> None:
        made = source()
        lines = [*([above] if above else []), *([head] if head else [])]
        lines += [row(made, k) for k in range(len(made.time_s))]
        lines += [below] if below else []
        path.write_bytes((end.join(lines) + end).encode(encoding))

    return make


def german(value: float, digits: int = 4) -> str:
    return f"{value:.{digits}f}".replace(".", ",")


def counts(r: Run, k: int) -> int:
    return int(np.floor(r.angle[k] / 360.0 * COUNTS))


def _clock(t: float, mark: str = ".") -> str:
    t += 9 * 3600 + 30 * 60
    return f"{int(t // 3600):02d}:{int(t // 60 % 60):02d}:{int(t % 60):02d}{mark}{round(t % 1 * 1000) % 1000:03d}"


def _mat(path: Path) -> None:
    from scipy.io import savemat

    r = run()
    savemat(path, {"log": {"time_s": r.time_s, "u_pct": r.duty, "theta_rad": np.deg2rad(r.angle)}, "Ts": STEP_S})


def _simulink(path: Path) -> None:
    from scipy.io import savemat

    r = run()
    savemat(
        path, {"t": r.time_s[:, None], "duty_pct": r.duty[:, None], "angle_deg": r.angle[:, None], "meta": "bench 3"}
    )


def _mat73(path: Path) -> None:
    import h5py

    r = run()
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, values in (("time_s", r.time_s), ("u_V", 0.12 * r.duty), ("omega_rad_s", np.deg2rad(r.speed))):
            file.create_dataset(name, data=values[None, :]).attrs["MATLAB_class"] = np.bytes_("double")
    data = path.read_bytes()
    path.write_bytes(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(512, b" ") + data[512:])


def _hdf5(path: Path) -> None:
    import h5py

    r = run()
    with h5py.File(path, "w") as file:
        group = file.create_group("run1")
        for name, unit, values in (
            ("time", "ms", 1e3 * r.time_s),
            ("duty", "%", r.duty),
            ("speed", "rpm", r.speed / 6.0),
        ):
            group.create_dataset(name, data=values).attrs["units"] = unit


def _parquet(path: Path) -> None:
    import pandas

    r = run()
    stamps = pandas.Timestamp("2026-11-22 09:30") + pandas.to_timedelta(r.time_s, unit="s")
    pandas.DataFrame({"timestamp": stamps, "duty_pct": r.duty, "position_deg": r.angle}).to_parquet(path)


def _repeated(path: Path) -> None:
    r = run()
    rows = [
        f"22.11.2026 {_clock(np.floor(t + 1e-9))[:8]};{german(u)};{german(a)}"
        for t, u, a in zip(r.time_s, r.duty, r.angle, strict=True)
    ]
    path.write_text("\n".join(["Zeit;Tastgrad [%];Winkel [Grad]", *rows]) + "\n", encoding="utf-8")


def _holes(path: Path) -> None:
    r = run()
    rows = [f"{r.time_s[k]:.3f},{r.duty[k]:g},{'' if k % 100 == 7 else f'{r.angle[k]:.3f}'}" for k in range(ROWS)]
    path.write_text("\n".join(["time_s,duty_pct,angle_deg", *rows]) + "\n")


ONE_WAY = lambda: run(both_ways=False)  # noqa: E731

CASES: tuple[Case, ...] = (
    Case("plain", text("t [s],duty [%],angle [deg]", lambda r, k: f"{r.time_s[k]:.3f},{r.duty[k]:g},{r.angle[k]:.4f}")),
    Case(
        "german excel", text(
            "Zeit [s];Spannung [V];Winkel [°]",
            lambda r, k: f"{german(r.time_s[k], 3)};{german(0.24 * r.duty[k])};{german(r.angle[k])}",
            encoding="cp1252", end="\r\n", above="Prüfstand 3;;\r\nVersorgung: 24 V;;\r\nDatum: 22.11.2026;;",
        ), duty_tolerance=0.1,
    ),
    Case(
        "utf-16 tabs", text(
            "Time (ms)\tPWM (%)\tPosition (rad)",
            lambda r, k: f"{1e3 * r.time_s[k]:.1f}\t{r.duty[k]:g}\t{np.deg2rad(r.angle[k]):.6f}", encoding="utf-16", end="\r\n",
        ),
    ),
    Case(
        "utf-8 with mark", text(
            "t,u,y", lambda r, k: f"{r.time_s[k]:.3f},{r.duty[k]:g},{r.angle[k]:.3f}", encoding="utf-8-sig", end="\r\n"
        ), answers=("--unit", "deg", "--full-scale", "100"), unknown="the unit of the output 'y'",
    ),
    Case(
        "units in a second row", text(
            "Time,Channel Duty,Channel Angle\n(ms),(%),(deg)\n",
            lambda r, k: f"{1e3 * r.time_s[k]:.3f},{r.duty[k]:.2f},{r.angle[k]:.3f}",
        ),
    ),
    Case(
        "german dates", text(
            "Zeitstempel;Stellgröße (%);Drehzahl (1/min)",
            lambda r, k: f"22.11.2026 {_clock(r.time_s[k], ',')};{german(r.duty[k])};{german(r.speed[k] / 6.0, 3)}",
            encoding="cp1252",
        ), column="speed_deg_s",
    ),
    Case(
        "iso dates", text(
            "timestamp,duty_cycle,position_deg",
            lambda r, k: f"2026-11-22T{_clock(r.time_s[k])}Z,{r.duty[k] / 100:.4f},{r.angle[k]:.3f}",
        ),
    ),
    Case(
        "clock past midnight", text(
            "time|pwm|angle_deg",
            lambda r, k: f"{(23 + int((59 * 60 + 58 + r.time_s[k]) // 3600)) % 24:02d}:{int((59 * 60 + 58 + r.time_s[k]) // 60 % 60):02d}:"
            f"{(58 + r.time_s[k]) % 60:06.3f}|{r.duty[k]:g}|{r.angle[k]:.3f}",
        ),
    ),
    Case(
        "milliseconds of a board", text(
            "millis,pwm,encoder_deg", lambda r, k: f"{53412 + round(1e3 * r.time_s[k])},{round(2.55 * r.duty[k])},{r.angle[k]:.2f}"
        ), answers=("--full-scale", "255"), duty_tolerance=0.5,
    ),
    Case(
        "microseconds that wrap", text(
            "micros,duty_pct,angle_deg",
            lambda r, k: f"{(2**32 - 2_000_000 + round(1e6 * r.time_s[k])) % 2**32},{r.duty[k]:g},{r.angle[k]:.2f}",
        ),
    ),
    Case(
        "epoch", text("time,duty_pct,angle_deg", lambda r, k: f"{1.79e9 + r.time_s[k]:.3f},{r.duty[k]:g},{r.angle[k]:.2f}"),
    ),
    Case(
        "stamps of whole seconds", _repeated,
    ),
    Case(
        "rpm and amperes", text(
            "t_s,u_V,n_rpm,i_A", lambda r, k: f"{r.time_s[k]:.3f},{0.12 * r.duty[k]:.3f},{r.speed[k] / 6:.4f},{r.current[k]:.4f}"
        ), column="speed_deg_s", answers=("--full-scale", "12"), beside="current_A", duty_tolerance=0.1,
    ),
    Case(
        "supply beside", text(
            "Time [s];Motor Voltage [V];Supply [V];Position [deg];Current [mA]",
            lambda r, k: f"{german(r.time_s[k], 3)};{german(0.12 * r.duty[k])};{german(12.0)};{german(r.angle[k])};{german(1e3 * r.current[k])}",
        ), beside="current_A", duty_tolerance=0.1,
    ),
    Case(
        "counts that wrap", text(
            "# encoder: 2800 counts per rev\ntime_s,duty_pct,counts", lambda r, k: f"{r.time_s[k]:.3f},{r.duty[k]:g},{counts(r, k) % COUNTS}"
        ), quantum=360 / COUNTS,
    ),
    Case(
        "a 16-bit counter", text(
            "time_s,duty_pct,counts", lambda r, k: f"{r.time_s[k]:.3f},{r.duty[k]:g},{(65_000 + 20 * counts(r, k)) % 65_536}"
        ), answers=("--counts-per-rev", str(20 * COUNTS)), unknown="how many counts", values={"zeroed": True},
    ),
    Case(
        "counts that go on", text(
            "time_s,duty_pct,encoder [counts]", lambda r, k: f"{r.time_s[k]:.3f},{r.duty[k]:g},{counts(r, k)}"
        ), answers=("--counts-per-rev", str(COUNTS)), unknown="how many counts", quantum=360 / COUNTS,
    ),
    Case(
        "an angle of one turn without unit", text(
            "time_s,duty_pct,theta", lambda r, k: f"{r.time_s[k]:.3f},{r.duty[k]:g},{np.deg2rad(r.angle[k]) % (2 * np.pi):.5f}"
        ),
    ),
    Case(
        "volts with full scale", text(
            "t (s), command (V of 12 V), angle (deg)", lambda r, k: f"{r.time_s[k]:.3f}, {0.12 * r.duty[k]:.3f}, {r.angle[k]:.3f}"
        ), duty_tolerance=0.1,
    ),
    Case(
        "volts of nobody knows what", text(
            "t [s],u [V],angle [deg]", lambda r, k: f"{r.time_s[k]:.3f},{0.12 * r.duty[k]:.3f},{r.angle[k]:.3f}"
        ), duty_tolerance=0.2, full_range=60.0,
    ),
    Case(
        "speed without sign", text(
            "t [s],duty [%],speed [deg/s]", lambda r, k: f"{r.time_s[k]:.3f},{r.duty[k]:g},{abs(r.speed[k]):.3f}"
        ), column="speed_deg_s", tolerance=25.0,
    ),
    Case(
        "command without sign", text(
            "t [s],pwm,angle [deg]", lambda r, k: f"{r.time_s[k]:.3f},{abs(r.duty[k]):g},{r.angle[k]:.3f}"
        ), unknown="the sign of the command",
    ),
    Case(
        "coarse speed", text(
            "t,u [V],w [rad/s]", lambda r, k: f"{r.time_s[k]:.3f},{0.05 * r.duty[k]:.3f},{np.rint(np.deg2rad(r.speed[k]) / 0.45) * 0.45:.4f}"
        ), column="speed_deg_s", tolerance=15.0, answers=("--full-scale", "5"), quantum=float(np.rad2deg(0.45)),
    ),
    Case(
        "numpy", text(
            "# t_s duty_pct angle_deg", lambda r, k: f"{r.time_s[k]:.18e} {r.duty[k]:.18e} {r.angle[k]:.18e}"
        ),
    ),
    Case(
        "labview", text(
            "X_Value\tDuty (%)\tAngle (deg)\tComment", lambda r, k: f"{german(r.time_s[k], 6)}\t{german(r.duty[k], 6)}\t{german(r.angle[k], 6)}\t",
            above="LabVIEW Measurement\t\nWriter_Version\t2\nSeparator\tTab\nDecimal_Separator\t,\n***End_of_Header***\t\nChannels\t2\n***End_of_Header***\t",
            end="\r\n",
        ),
    ),
    Case(
        "oscilloscope", text(
            "Time,Channel A,Channel B", lambda r, k: f"{r.time_s[k]:.3f},{0.05 * r.duty[k]:.3f},{r.speed[k] / 100:.3f}",
            above="Model,DPO2024\nSample Interval,5e-03",
        ), unknown="which column",
    ),
    Case(
        "names of nothing", text("", lambda r, k: f"{r.time_s[k]:.3f},{r.duty[k]:g},{r.angle[k]:.3f}"), unknown="no row has names"
    ),
    Case(
        "text below", text(
            "time_s,duty_pct,angle_deg", lambda r, k: f"{r.time_s[k]:.3f},{r.duty[k]:g},{r.angle[k]:.3f}",
            below="Measurement ended by user\nTotal: 1200 samples",
        ),
    ),
    Case("empty cells", _holes, rows=ROWS - 12),
    Case(
        "target and actual", text(
            "Zeit/s;Soll-Winkel/Grad;Ist-Winkel/Grad;PWM/%",
            lambda r, k: f"{german(r.time_s[k], 3)};{german(90.0)};{german(r.angle[k])};{german(r.duty[k])}",
        ), beside="ref_deg",
    ),
    Case(
        "units behind every number", text(
            "Time;Duty;Angle", lambda r, k: f"{r.time_s[k]:.3f} s;{r.duty[k]:g} %;{r.angle[k]:.3f} deg"
        ),
    ),
    Case(
        "quotes and thousands", text(
            '"Time (s)","Duty (%)","Angle (deg)"', lambda r, k: f'"{r.time_s[k]:.3f}","{r.duty[k]:g}","{r.angle[k] * 100:,.2f}"'
        ), tolerance=60.0, values={"factor": 100.0},
    ),
    Case(
        "a torque", text("t [s],torque [Nm],angle [rad]", lambda r, k: f"{r.time_s[k]:.3f},{0.01 * r.duty[k]:.4f},{np.deg2rad(r.angle[k]):.5f}"),
        full_range=100.0,
    ),
    Case("matlab", _mat, values={"suffix": ".mat"}),
    Case("matlab vectors", _simulink, values={"suffix": ".mat"}),
    Case("matlab 7.3", _mat73, column="speed_deg_s", answers=("--full-scale", "12"), needs="h5py", values={"suffix": ".mat"}, duty_tolerance=0.1),
    Case("hdf5", _hdf5, column="speed_deg_s", needs="h5py", values={"suffix": ".h5"}),
    Case("parquet", _parquet, needs="pyarrow", values={"suffix": ".parquet"}),
)  # fmt: skip
