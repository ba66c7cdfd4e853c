"""The Python interface: logs of anything, models on them, diagnoses that can be looked at. Imported when first used.

``connect`` and ``design`` are those of the bench and of the control room; everything here takes a log in any of its
forms: a Log, the name of a file (a log or any table that import understands), or a pandas DataFrame. One string is one
log.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, TypeAlias, Union, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fiohost import strict_json
from fiohost.bench.log import Log
from fiohost.errors import ConfigError, DataError
from fiohost.estimation.logs import Identification
from fiohost.estimation.logs import identify as identify_logs
from fiohost.importing.automatic import read_any
from fiohost.importing.convert import log_from_table
from fiohost.importing.found import Answers
from fiohost.importing.map import TableMap
from fiohost.motor.model import Model

if TYPE_CHECKING:
    import pandas
    from matplotlib.figure import Figure

    from fiohost.discover.diagnose import Diagnosis as Found
    from fiohost.result_types import DiagnosisResult, ParameterResult

    Source: TypeAlias = Union[Log, str, Path, pandas.DataFrame]  # noqa: UP007 (made at run time by nobody)

Array = NDArray[np.float64]


def read_log(
    source: Source,
    *,
    table_map: str | Path | None = None,
    time: str | None = None,
    command: str | None = None,
    measured: str | None = None,
    unit: str | None = None,
    full_scale: float | None = None,
    counts_per_rev: float | None = None,
    sample_time_s: float | None = None,
) -> Log:
    """Read a log, or make one of a foreign table: by a map, or by what is found and what is said here.

    ``time``, ``command`` and ``measured`` name columns, ``unit`` is that of the measured one, ``full_scale`` what of
    the command is 100 %, in its own unit. What was found stands in ``log.metadata["understood"]``. Raises FiohostError.
    """
    answers = Answers(time, command, measured, unit, full_scale, counts_per_rev, sample_time_s)
    if table_map is not None:
        if answers != Answers() or not isinstance(source, (str, Path)):
            raise ConfigError("a map says all of a table in a file: leave the other arguments away")
        return log_from_table(Path(source), TableMap.load(table_map))
    return read_any([source], answers)[0]


def read_logs(
    sources: Source | Sequence[Source],
    *,
    time: str | None = None,
    command: str | None = None,
    measured: str | None = None,
    unit: str | None = None,
    full_scale: float | None = None,
    counts_per_rev: float | None = None,
    sample_time_s: float | None = None,
) -> list[Log]:
    """Several logs; foreign tables of the same columns are understood together, with what is said here as
    :func:`read_log` takes it. Raises FiohostError.
    """
    answers = Answers(time, command, measured, unit, full_scale, counts_per_rev, sample_time_s)
    return read_any(_listed(sources), answers)


def to_dataframe(log: Log) -> pandas.DataFrame:
    """The columns of a log as a pandas DataFrame, its output too where that comes from counts. Raises ConfigError."""
    columns = {**log.columns, log.output_name: log.output}
    frame = _pandas().DataFrame({name: np.array(values) for name, values in columns.items()})
    frame.attrs["metadata"] = dict(log.metadata)
    return frame


def identify(
    logs: Source | Sequence[Source],
    method: str = "pem",
    *,
    fitted: str | None = None,
    kp_pct_per_deg: float | None = None,
) -> Identification:
    """K, tau, zeta and omega_n from logs; see :func:`fiohost.estimation.logs.identify`. Raises FiohostError."""
    return identify_logs(read_logs(logs), method, fitted=fitted, kp_pct_per_deg=kp_pct_per_deg)


@dataclass(frozen=True, repr=False)
class Simulation:
    """A free run of a model, arrays (rows,): output in ``unit``; ``log`` and ``error_rms`` where it was of a log."""

    time_s: Array
    duty_pct: Array
    output: Array
    output_name: str
    unit: str
    model: Model
    log: Log | None = None
    error_rms: float | None = None

    def __repr__(self) -> str:
        off = "" if self.error_rms is None else f", {self.error_rms:.4g} {self.unit} rms from the log"
        return f"<Simulation of {self.model.expression}: {len(self.time_s)} rows of {self.output_name}{off}>"

    def to_dataframe(self) -> pandas.DataFrame:
        """Time, duty, simulated output, and the measured one beside. Raises ConfigError without pandas."""
        columns = {"time_s": self.time_s, "duty_pct": self.duty_pct, f"simulated_{self.output_name}": self.output}
        if self.log is not None:
            columns[self.output_name] = self.log.output
        return _pandas().DataFrame(columns)

    def plot(self) -> Figure:
        """Output and duty over time, the measured output and the error too where there is a log."""
        from fiohost.report.log_plot import plot_logs
        from fiohost.report.log_series import LogSeries, series_of

        if self.log is not None:
            series = series_of(self.log, simulated=self.output, model=self.model.expression)
        else:
            tick_s = float(self.time_s[1] - self.time_s[0])
            series = LogSeries(
                self.model.expression, self.unit, self.time_s, self.output, np.gradient(self.output, tick_s),
                f"{self.unit}/s", self.duty_pct, tick_s,
            )  # fmt: skip
        return plot_logs([series], f"{self.model.expression}, simulated")


def simulate(
    source: Source | ArrayLike, model: str | Path | Model = "linear", *, sample_time_s: float = 0.005
) -> Simulation:
    """A model on the commands of a log, from the state that its first second tells; or on an array of duties in
    percent, one each *sample_time_s*, from rest at 0 degrees. Raises FiohostError.
    """
    motor = _model(model)
    if isinstance(source, (Log, str, Path)) or hasattr(source, "columns"):
        from fiohost.circle.replay import replay

        log = read_logs(source)[0]
        found = replay(log, motor)
        rms = float(found.errors.free_run_rms)
        return Simulation(found.time_s, log.duty_pct, found.output, found.output_name, found.unit, motor, log, rms)
    from fiohost.motor.simulate import Excitation, free_run
    from fiohost.motor.state import BRAKE, DRIVE

    duty = np.atleast_1d(np.asarray(source, dtype=np.float64))
    if duty.ndim != 1 or duty.size < 2 or not np.all(np.abs(duty) <= 100.0):
        raise DataError("duties are a list of two numbers or more within -100 to 100 %")
    if not 1e-5 <= sample_time_s <= 3600.0:
        raise ConfigError(f"sample_time_s = {sample_time_s:g} is not within 1e-05 to 3600 s")
    time_s: Array = np.arange(duty.size, dtype=np.float64) * sample_time_s
    acting = np.concatenate([[0.0], duty])
    modes = np.where(acting == 0.0, BRAKE, DRIVE)
    angle = free_run(motor, Excitation(time_s, time_s, acting, modes), 0.0)
    return Simulation(time_s, duty, angle, "angle_deg", "deg", motor)


@dataclass(frozen=True)
class Diagnosis:
    """What a declared model lacks. ``result`` is the JSON, schema ``fiohost.diagnosis/1``; ``model`` the best usable
    one, curves of no name in it where something stays unexplained; ``found`` what made it.
    """

    result: DiagnosisResult
    model: Model
    found: Found = field(repr=False)

    @property
    def verdict(self) -> str:
        """``no_missing_effect``, ``explained`` or ``unexplained``."""
        return str(self.result["verdict"])

    @property
    def effects(self) -> list[str]:
        """Names of the effects that were found, in the order in which they came in."""
        return [str(step["effect"]) for step in self.result.get("steps") or []]

    @property
    def parameters(self) -> dict[str, float | str]:
        """Values of the final model by name; intervals and units are in ``result``."""
        return {name: parameter["value"] for name, parameter in self._final.items()}

    @property
    def _final(self) -> dict[str, ParameterResult]:
        """Parameters of the final model; none where the raw data ended the diagnosis."""
        final = self.result.get("final")
        return final["parameters"] if final else {}

    def summary(self) -> str:
        """The verdict, the errors and the parameters as text."""
        from io import StringIO

        from rich.console import Console

        from fiohost.report.tables import error_table, parameter_table
        from fiohost.report.words import verdict_sentence

        text = StringIO()
        # a notebook would else be given colours, which print() shows as signs
        console = Console(file=text, width=132, highlight=False, color_system=None, force_jupyter=False)
        for table in (error_table(self.result), parameter_table(self.result)):
            console.print()
            console.print(table)
        lines = [line.rstrip() for line in text.getvalue().splitlines()]
        return "\n".join([verdict_sentence(self.result), *lines]).rstrip()

    def plot(self) -> Figure:
        """The record that proves it, held out where there is one: measured, before and after, and both errors."""
        from fiohost.report.diagnosis import series_of
        from fiohost.report.plots import plot_series

        return plot_series(series_of(self.found)[0])

    def report(self, path: str | Path) -> Path:
        """Write the whole page: a file that ends with .html, or ``report.html`` in a folder. Raises FiohostError."""
        from fiohost.report.diagnosis import curves_of, series_of
        from fiohost.report.page import write_page

        path = Path(path)
        page = path if path.suffix.lower() in (".html", ".htm") else path / "report.html"
        series, curves = series_of(self.found), curves_of(self.found)
        return write_page(page, title="Diagnosis", diagnosis=self.result, series=series, curves=curves)

    def to_json(self, path: str | Path | None = None) -> str:
        """The result as strict JSON text, written to a file too where one is named. Raises FiohostError."""
        from fiohost.files import write_output

        text = strict_json.text(dict(self.result), ascii_only=True)
        if path is not None:
            write_output(path, text)
        return text

    def to_dataframe(self) -> pandas.DataFrame:
        """One row a parameter of the final model: value, unit, interval, whether it is identifiable. Raises ConfigError
        without pandas.
        """
        rows = [
            {
                "parameter": name,
                "value": p["value"],
                "unit": p["unit"],
                "ci95_low": (p["ci95"] or (None, None))[0],
                "ci95_high": (p["ci95"] or (None, None))[1],
                "identifiable": p["identifiable"],
            }
            for name, p in self._final.items()
        ]
        return _pandas().DataFrame(rows).set_index("parameter")

    def _repr_html_(self) -> str:
        """For notebooks: the verdict, the picture and the parameters."""
        from html import escape

        from fiohost.report.plots import as_svg
        from fiohost.report.words import interval, number, verdict_sentence

        rows = "".join(
            f"<tr><td>{escape(str(name))}</td><td>{number(p['value'], 5)}</td><td>{interval(p)}</td>"
            f"<td>{escape(str(p['unit']))}</td></tr>"
            for name, p in self._final.items()
        )
        head = "<tr><th>parameter</th><th>value</th><th>95 % interval</th><th>unit</th></tr>"
        return (
            f"<p><b>{escape(verdict_sentence(self.result))}</b></p><div>{as_svg(self.plot())}</div>"
            f"<table>{head}{rows}</table>"
        )

    def __str__(self) -> str:
        return self.summary()


def diagnose(
    logs: Source | Sequence[Source],
    holdout: Source | Sequence[Source] = (),
    model: str | Path | Model = "linear",
    *,
    table_map: str | Path | None = None,
    library: Sequence[str] | None = None,
    seed: int = 0,
    limits: bool = False,
    tolerance_pct: float = 0.0,
    own_seconds: float = 10.0,
    constants: str | None = None,
    say: Callable[[str], None] = lambda text: None,
) -> Diagnosis:
    """Name what a declared model lacks, from training logs; held-out logs only report.

    ``model`` is an expression such as ``linear+coulomb_friction``, a model file or a Model; ``library`` restricts the
    effects that are tried; what is left below ``tolerance_pct`` of the motion does not matter; ``own_seconds`` of each
    held-out log say what is its own (0: nothing is). ``constants`` is a set or file of the motor's constants, by which
    the report says volts, amperes and newton metres; ``say`` hears of progress. Raises FiohostError.
    """
    from fiohost.circle.evidence import diagnose as run
    from fiohost.circle.evidence import read_logs as by_map
    from fiohost.discover.result import to_json
    from fiohost.labs.constants import MotorConstants
    from fiohost.report.physical import constants_of

    motor = MotorConstants.load(constants) if constants else None
    train, held = _listed(logs), _listed(holdout)
    if table_map is not None:
        tables = [Path(s) if isinstance(s, str) else s for s in (*train, *held)]
        read = by_map([s for s in tables if isinstance(s, (Log, Path))], table_map)
    else:
        read = read_any([*train, *held])  # tables of one bench are understood together, whatever their role
    found = run(
        read[: len(train)],
        read[len(train) :],
        _model(model),
        library=library,
        seed=seed,
        limits=limits,
        tolerance_pct=tolerance_pct,
        own_seconds=own_seconds,
        say=say,
    )
    result = {**to_json(found), "constants": constants_of([log.metadata for log in read], motor).to_json()}
    return Diagnosis(cast("DiagnosisResult", result), found.in_hand, found)


def plot(
    logs: Source | Sequence[Source],
    *,
    phase: bool = False,
    spectrum: bool = False,
    against: str | Path | Model | None = None,
    path: str | Path | None = None,
) -> Figure:
    """Draw logs over time, as a phase plane or as a spectrum, a model beside them; *path* writes the picture too.

    Raises FiohostError.
    """
    from fiohost.circle.evidence import unique_names
    from fiohost.report.log_plot import plot_logs, plot_phase, plot_spectrum
    from fiohost.report.log_series import series_of
    from fiohost.report.pictures import save_figure

    read = read_logs(logs)
    if not read:
        raise DataError("there is no log to draw")
    series = [series_of(log, name) for log, name in zip(read, unique_names(read), strict=True)]
    if against is not None:
        runs = [simulate(log, against) for log in read]
        series = [
            replace(one, simulated=run.output, model=run.model.expression)
            for one, run in zip(series, runs, strict=True)
        ]
    draw = plot_phase if phase else plot_spectrum if spectrum else plot_logs
    figure = draw(series, ", ".join(one.name for one in series)[:110])
    if path is not None:
        save_figure(figure, path)
    return figure


def _listed(sources: Source | Sequence[Source]) -> list[Source]:
    """One source is a list of one."""
    if isinstance(sources, (Log, str, Path)) or not isinstance(sources, Sequence):
        return [sources]
    return list(sources)


def _model(model: str | Path | Model) -> Model:
    return model if isinstance(model, Model) else Model.parse(str(model))


def _pandas() -> ModuleType:
    try:
        return importlib.import_module("pandas")
    except ImportError:
        raise ConfigError("tables of pandas need pandas: pip install 'fiohost[data]'") from None
