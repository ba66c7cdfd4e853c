"""The Python interface: names, types, a bench by statements, logs of anything, results that can be looked at."""

from __future__ import annotations

import json
import re
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from boards import HANG_S

import fiohost
from fiohost.bench import hand
from fiohost.errors import ConfigError, DataError, FiohostError, LimitError


def test_importing_loads_next_to_nothing_and_lists_its_names() -> None:
    code = (
        "import sys; before = set(sys.modules); import fiohost; new = set(sys.modules) - before\n"
        "assert 'numpy' not in sys.modules and 'click' not in sys.modules, new\n"
        "assert [n for n in new if n.startswith('fiohost')] == ['fiohost'], new\n"
        "print(*dir(fiohost))"
    )
    names = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    wanted = {"connect", "read_log", "simulate", "identify", "diagnose", "design", "plot", "Bench", "Log", "Model"}
    assert wanted <= set(names)
    assert set(fiohost.__all__) == set(names)
    for name in names:
        assert getattr(fiohost, name) is not None
    with pytest.raises(AttributeError, match="did you mean 'diagnose'"):
        _ = fiohost.diagnoze  # type: ignore[attr-defined]


def test_a_bench_is_driven_by_statements_and_keeps_its_log() -> None:
    with fiohost.connect("sim:ideal") as b:
        b.duty = 40
        b.sleep(1)
        assert b.time_s == pytest.approx(1.0)
        assert b.duty == 40.0
        assert b.angle_deg > 200.0
        assert b.speed_deg_s > 200.0
        while b.time_s < 3.0:  # one's own controller
            b.ref_deg = 90.0
            b.duty = max(-100.0, min(100.0, 1.5 * (90.0 - b.angle_deg)))
            b.sleep()
        assert b.angle_deg == pytest.approx(90.0, abs=2.0)
        log = b.log
        b.duty = None
        b.sleep(0.1)
        assert b.log.columns["c3"][-1] == b.log.columns["c4"][-1] == 0
    assert len(log) == 600
    assert log.duty_pct[0] == 40.0
    assert np.isnan(log.columns["ref_deg"][0])
    assert log.columns["ref_deg"][-1] == 90.0
    assert log.command_delay_ticks == 1
    with pytest.raises(Exception, match=r"closed|open"):
        b.sleep(1)


def test_statements_and_runs_take_turns_on_one_bench() -> None:
    with fiohost.connect("sim") as b:
        b.duty = 30
        b.sleep(0.5)
        driven = b.run("steps_from_rest")
        assert driven.metadata["experiment"] == "steps_from_rest"
        assert driven.begins_at_rest
        b.duty = -30
        b.sleep(0.5)
        assert b.angle_deg < 0.0 or b.speed_deg_s < 0.0
        assert b.time_s == pytest.approx(0.5)


def test_an_error_in_between_brakes_and_a_wrong_duty_is_refused_where_it_is_set() -> None:
    bench = fiohost.connect("sim")
    with pytest.raises(RuntimeError), bench as b:  # noqa: PT012 (what leaves the block is looked at)
        b.duty = 60
        b.sleep(0.5)
        loop = b._hand._thread
        raise RuntimeError
    assert bench._by_hand is None
    assert not loop.is_alive()  # it braked, and ended
    with fiohost.connect("sim") as b:
        with pytest.raises(LimitError):
            b.duty = 140
        with pytest.raises(LimitError):
            b.duty = float("nan")
        with pytest.raises(ConfigError, match="sleep"):
            b.sleep(-1)
        with pytest.raises(DataError, match="nothing was measured"):
            _ = b.log


def test_in_real_time_the_duty_of_a_program_that_does_not_come_again_is_taken_back(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(hand, "HOLD_S", 0.1)
    with fiohost.connect("sim", realtime=True) as b:
        b.duty = 40
        b.sleep(0.3)
        assert b.log.duty_pct[-1] == 40.0  # a sleep is no absence
        end = time.monotonic() + HANG_S
        while b._hand._command.duty_pct != 0.0 and time.monotonic() < end:
            time.sleep(0.02)
        assert b.duty == 0.0
        b.duty = 20
        b.sleep(0.1)
        assert b.log.duty_pct[-1] == 20.0


def test_what_ends_the_loop_is_told_at_the_next_statement() -> None:
    with fiohost.connect("sim", limits={"travel_deg": 90.0}) as b:
        b.duty = 50
        with pytest.raises(FiohostError, match="travel"):
            b.sleep(5)
        with pytest.raises(FiohostError, match="travel"):
            b.duty = 10


def test_duties_are_simulated_and_bad_ones_refused() -> None:
    run = fiohost.simulate([40.0] * 400, "linear")
    assert run.output[0] == 0.0
    assert run.output[-1] > 700.0
    assert run.plot().axes
    with pytest.raises(DataError, match="within -100 to 100"):
        fiohost.simulate([400.0] * 4)
    with pytest.raises(DataError):
        fiohost.simulate([1.0])


@pytest.fixture(scope="module")
def found() -> Any:
    with fiohost.connect("sim", seed=3) as b:
        logs = [b.run("steps_from_rest"), b.run("sine_slow")]
    return SimpleNamespace(
        logs=logs, result=fiohost.diagnose(logs[0], logs[1], "linear", library=["coulomb_friction", "constant_load"])
    )


def test_a_diagnosis_can_be_read_drawn_kept_and_shown(found: Any, tmp_path: Path) -> None:
    d = found.result
    assert d.effects == ["coulomb_friction"]
    assert "coulomb friction" in d.summary().splitlines()[0]
    assert d.parameters["coulomb_friction.level_pct"] == pytest.approx(3.0, abs=1.5)
    told = json.loads(d.to_json(tmp_path / "d.json"))
    assert told["schema"] == "fiohost.diagnosis/1"
    assert json.loads((tmp_path / "d.json").read_text()) == told
    assert len(d.plot().axes) >= 3
    assert d.report(tmp_path / "one.html").stat().st_size > 20_000
    assert d.report(tmp_path / "folder").name == "report.html"
    page = d._repr_html_()
    assert "<svg" in page
    assert "coulomb_friction.level_pct" in page
    assert "http" not in page.replace("http://www.w3.org", "")
    pandas = pytest.importorskip("pandas", reason="pandas IS NOT INSTALLED: frames are not tested")
    frame = d.to_dataframe()
    assert isinstance(frame, pandas.DataFrame)
    assert frame.loc["linear.tau_s", "unit"] == "s"


def test_what_a_notebook_prints_is_short_and_plain(found: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rich.console._is_jupyter", lambda: True)  # where rich colours what it is not asked to
    assert "\x1b" not in found.result.summary()
    assert "coulomb_friction.level_pct" in found.result.summary()
    run = fiohost.simulate(found.logs[0], "linear")
    controller = fiohost.design("linear", "p", steps_deg=[20.0], overshoot_pct=60.0, settling_s=2.0)
    for shown in (found.logs[0], run, controller):
        assert len(repr(shown)) < 250, repr(shown)
    assert re.search(r"kp_pct_per_deg +[\d.]+\n", str(controller))
    assert "asked for" in str(controller)


def test_one_log_is_one_log_whatever_it_is_named_by(found: Any, tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    with fiohost.connect("sim") as b:
        b.run("steps_from_rest", path)
    one, many = fiohost.identify(str(path)), fiohost.identify([path, found.logs[1]])
    assert len(one.curves) == 1
    assert len(many.curves) == 2
    figure = fiohost.plot(str(path), against="linear+coulomb_friction", path=tmp_path / "p.png")
    assert len(figure.axes) == 4
    assert (tmp_path / "p.png").stat().st_size > 10_000
    assert fiohost.plot([path, found.logs[1]], spectrum=True).axes
    assert fiohost.plot(path, phase=True).axes
    run = fiohost.simulate(path, "linear+coulomb_friction")
    assert run.error_rms is not None
    assert len(run.output) == len(fiohost.read_log(path))


def test_frames_of_pandas_go_in_and_come_out(found: Any) -> None:
    pandas = pytest.importorskip("pandas", reason="pandas IS NOT INSTALLED: frames are not tested")
    frame = fiohost.to_dataframe(found.logs[0])
    assert {"time_s", "duty_pct", "angle_deg"} <= set(frame.columns)
    renamed = pandas.DataFrame(
        {"t [s]": frame["time_s"], "u [V]": 0.12 * frame["duty_pct"], "phi [deg]": frame["angle_deg"]}
    )
    log = fiohost.read_log(renamed, full_scale=12.0)
    np.testing.assert_allclose(log.output, found.logs[0].output)
    assert fiohost.identify(renamed, fitted="duty").value("tau_s") > 0.0
    with pytest.raises(DataError, match="unit of the output"):
        fiohost.read_log(renamed.rename(columns={"phi [deg]": "y"}), full_scale=12.0)


@pytest.mark.long
def test_the_page_on_python_runs_as_it_stands(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("pandas", reason="pandas IS NOT INSTALLED: the page on Python is not run")
    monkeypatch.chdir(tmp_path)
    page = Path(__file__).resolve().parent.parent / "docs" / "python.md"
    blocks = re.findall(r"```python\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL)
    assert len(blocks) == 4
    for block in blocks:
        exec(compile(block, str(page), "exec"), {})
    for name in ("own_controller.png", "diagnosis.html", "proof.png", "diagnosis.json"):
        assert (tmp_path / name).stat().st_size > 1000, name


def test_bringing_the_shaft_to_rest_ends_driving_by_statements() -> None:
    with fiohost.connect("sim") as b:
        b.duty = 40
        b.sleep(0.2)
        b.settle()
        assert b._by_hand is None
        assert np.ptp(b.drive(0.0, 0.1).output) <= 0.5  # nobody drives on behind it
