"""The report as an engineer reads it: size in units, the picture of the effect, both errors, what remains."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from desktop import Chromium, needed, until
from report_case import curve, diagnosis, error, parameter, series

from fiohost.bench.log import Log
from fiohost.estimation.record import Record, record_from_log
from fiohost.judging.metrics import judge
from fiohost.motor.effect import effect
from fiohost.motor.model import Model
from fiohost.motor.simulate import Excitation, free_run
from fiohost.motor.state import BRAKE, DRIVE
from fiohost.report.effect_curve import effect_curves, equation_words
from fiohost.report.page import render, write_page
from fiohost.report.physical import Physical, constants_of, headline, size_rows
from fiohost.report.plots import plot_series
from fiohost.report.records import MOST_ROWS, records_script
from fiohost.report.residual import residual_of, white_words
from fiohost.report.series import SeriesPlot

TICK_S = 0.005


def test_an_equation_carries_its_numbers_and_units() -> None:
    told = {"level_pct": parameter(2.2849, "%"), "phase_deg": parameter(-31.04, "deg")}
    assert equation_words(effect("gravity_load"), told) == "load = 2.285 % * sin(theta + (-31.04 deg))"
    assert equation_words(effect("quadratic_drag"), {"pct_at_1000_deg_s": 1.5}).startswith("load = 1.500 % * (omega")
    sag = {"ratio": 0.2, "smoothing": "capacitor"}
    assert "(1 + 0.2000 * d**2)" in equation_words(effect("supply_sag"), sag)


def made(truth: Model, seconds: float = 20.0, error_deg: float = 0.0) -> Record:
    """A record of a motor: a slow sine through both directions, read in half degrees."""
    time_s = np.arange(round(seconds / TICK_S)) * TICK_S
    duty = 30.0 * np.sin(2 * np.pi * 0.1 * time_s)
    acting = np.concatenate([[0.0], duty])
    modes = np.where(acting == 0.0, BRAKE, DRIVE)
    angle = free_run(truth, Excitation(time_s, time_s, acting, modes), 0.0)
    angle = angle + error_deg * np.sin(np.radians(angle))  # of the sensor, once a turn
    read = np.floor(2.0 * angle) / 2.0
    return record_from_log(Log.from_columns({"time_s": time_s, "duty_pct": duty, "angle_deg": read}), "run")


def found_by(model: Model, name: str, record: Record) -> Any:
    """As much of a diagnosis as the pictures need."""
    stage = SimpleNamespace(fit=SimpleNamespace(model=model), judgements=[judge(record, model)])
    return SimpleNamespace(final=stage, steps=[SimpleNamespace(effect=name)], train=(record,))


def weight(phase_deg: float) -> Model:
    return Model(
        ("coulomb_friction", "gravity_load"), {"gravity_load.level_pct": 5.0, "gravity_load.phase_deg": phase_deg}
    )


def off_the_curve(model: Model, name: str, record: Record) -> float:
    """How far the data of the picture lie from its line, in percent of duty rms."""
    (picture,) = effect_curves(found_by(model, name, record))
    x, y = picture.points["data"]
    (line,) = picture.lines.values()
    assert len(x) > 40
    assert picture.found
    return float(np.sqrt(np.mean((np.interp(x, picture.x, line) - y) ** 2)))


def test_the_data_of_a_load_lie_on_its_curve_where_the_model_is_right_and_off_it_where_it_is_not() -> None:
    record = made(weight(40.0))
    assert off_the_curve(weight(40.0), "gravity_load", record) < 0.3
    (picture,) = effect_curves(found_by(weight(40.0), "gravity_load", record))
    (line,) = picture.lines.values()
    assert picture.y_label.startswith("load torque, + opposes")  # the picture is that of the equation above it
    assert np.interp(0.0, picture.x, line) == pytest.approx(5.0 * np.sin(np.deg2rad(40.0)), abs=0.01)
    assert off_the_curve(weight(100.0), "gravity_load", record) > 1.0


def test_friction_is_drawn_over_the_speed_and_a_map_of_the_duty_over_the_duty() -> None:
    model = Model(("coulomb_friction", "stribeck_friction"), {"stribeck_friction.extra_pct": 2.0})
    record = made(model)
    (picture,) = effect_curves(found_by(model, "stribeck_friction", record))
    assert picture.x_label == "speed (deg/s)"
    (line,) = picture.lines.values()
    slow, fast = np.interp((20.0, 250.0), picture.x, line)
    assert slow > 1.0 > fast > 0.0  # against the motion, as the equation has it, and gone at speed
    dead = Model(("coulomb_friction", "input_deadband"), {"input_deadband.level_pct": 4.0})
    (picture,) = effect_curves(found_by(dead, "input_deadband", made(dead)))
    (line,) = picture.lines.values()
    assert picture.x_label == "commanded duty (%)"
    assert np.interp((20.0, -20.0), picture.x, line) == pytest.approx((-4.0, 4.0))


@pytest.mark.parametrize("name", ["encoder_eccentricity", "shaft_angle_error"])
def test_an_error_of_the_sensor_is_drawn_over_the_turn_and_its_data_lie_on_it(name: str) -> None:
    sizes = {"level_deg": 3.0} if name == "encoder_eccentricity" else {"level_1_deg": 3.0}
    if name == "shaft_angle_error":
        sizes |= {"level_2_deg": 0.0, "level_3_deg": 0.0}
    bent = Model(("coulomb_friction",)).with_effect(name, sizes)
    (picture,) = effect_curves(found_by(bent, name, made(Model(("coulomb_friction",)), error_deg=3.0)))
    (line,), (points,) = picture.lines.values(), picture.points.values()
    assert np.ptp(line) > 5.0
    assert points[1] == pytest.approx(np.interp(points[0], picture.x, line), abs=0.1)
    assert "3.000 deg" in (picture.equation or "")


def test_the_largest_order_is_the_size_and_a_true_phase_is_shown_on_the_turn_of_the_one_found() -> None:
    told = diagnosis()
    parameters = {"level_1_deg": parameter(0.24, "deg"), "level_3_deg": parameter(-0.47, "deg"),
                  "phase_1_deg": parameter(-153.4, "deg")}  # fmt: skip
    told["steps"][0] |= {"effect": "shaft_angle_error", "parameters": parameters}
    told["final"]["parameters"]["shaft_angle_error.phase_1_deg"] = parameters["phase_1_deg"]
    assert headline(told) == "shaft angle error -0.470 deg"
    seal = {"reduced": {"shaft_angle_error": {"phase_1_deg": 206.6}, "linear": {"gain_deg_s_per_pct": 10.0}}}
    page = render(title="t", diagnosis=told, seal=seal)
    assert re.search(r"shaft angle error, phase 1</th><td class=\"n\">-153.40</td><td class=\"n\">-153.40</td>", page)
    assert "linear, gain</th>" in page


def test_an_effect_with_a_past_or_in_the_structure_has_no_such_curve() -> None:
    for name in ("backlash", "transport_delay", "friction_warm_up"):
        model = Model(("coulomb_friction", name))
        assert effect_curves(found_by(model, name, made(model, 4.0))) == []


def test_sizes_are_told_in_volts_amperes_and_newton_metres_as_far_as_known() -> None:
    told = {**diagnosis(), "constants": {"full_scale_V": 9.0, "R_ohm": 6.0, "Kt_Nm_per_A": 0.3}}
    (row,) = size_rows(told)
    assert row["value"] == "2.400 % of duty"
    assert row["physical"] == "0.216 V, 0.0360 A, 0.0108 N m"
    assert headline(told) == "gravity load 2.40 % of duty (0.216 V, 0.0360 A, 0.0108 N m)"
    told["constants"] = {"full_scale_V": 9.0}
    assert headline(told) == "gravity load 2.40 % of duty (0.216 V)"
    assert headline(diagnosis()) == "gravity load 2.40 % of duty"
    page = render(title="t", diagnosis={**diagnosis(), "constants": {"full_scale_V": 9.0, "R_ohm": 6.0}})
    assert "0.216 V, 0.0360 A" in page
    assert "at the shaft" not in render(title="t", diagnosis=diagnosis())


def test_volts_come_from_the_heads_of_logs_that_agree() -> None:
    assert constants_of([{"supply_V": "9"}, {"supply_V": "9.0"}]) == Physical(9.0)
    assert constants_of([{"supply_V": "9"}, {"supply_V": "12"}]) == Physical()
    assert constants_of([{"full_scale": "24", "full_scale_unit": "V"}]) == Physical(24.0)
    assert constants_of([{"full_scale": "255", "full_scale_unit": ""}]) == Physical()


def left_of(noise: np.ndarray) -> list[str]:
    one = series(samples=len(noise))
    left = residual_of(replace(one, after=one.measured - noise, quantum=0.5))
    assert left is not None
    return white_words(left, None)


def test_whiteness_is_said_in_words() -> None:
    noise = np.random.default_rng(3).normal(0.0, 0.1, 4000)
    assert "as good as white" in " ".join(left_of(noise))
    smooth = np.convolve(noise, np.ones(40) / 40, "same")
    said = " ".join(left_of(smooth))
    assert "not white" in said
    seconds = float(re.search(r"follow for ([\d.]+) s", said)[1])  # type: ignore[index]
    assert 0.05 < seconds < 0.2  # a mean over 40 ticks of 5 ms


def test_the_verdict_and_the_size_come_first_and_the_rest_is_folded(tmp_path: Path) -> None:
    found = replace(curve(), found=True, equation="load = 2.4 % * sin(theta)")
    page = write_page(
        tmp_path / "page.html", title="t", diagnosis=diagnosis(), series=[series("train"), series()],
        curves=[found, curve()],
    ).read_text(encoding="utf-8")  # fmt: skip
    order = ["Missing from linear", "gravity load 2.40 % of duty", "What was found", "Error before and after",
             "random_steps.csv: held out", "What remains", "The rest", "<details>"]  # fmt: skip
    places = [page.index(text) for text in order]
    assert places == sorted(places)
    folded = page[page.index("<details>") :]
    for text in ("Parameters of", "candidates and what became", "logs one by one", "logs used for the fit"):
        assert text in folded
    rows = [row for row in re.findall(r"<tr[^>]*>(.*?)</tr>", page, re.DOTALL) if "<td" in row]
    assert len(rows) == len({" ".join(row.split()) for row in rows}), "a row stands twice"
    assert "0.000" not in re.sub(r"<svg.*?</svg>|<script.*?</script>", "", page, flags=re.DOTALL)
    assert "{&#39;" not in page
    assert "[{" not in re.sub(r"<script.*?</script>", "", page, flags=re.DOTALL)


def test_candidates_of_one_outcome_share_a_row() -> None:
    few = [{"effect": name, "score": 0.01, "rejected_because": "scores less"} for name in ("backlash", "duty_curve")]
    some = [{"effect": "cogging_torque", "score": 0.4, "rejected_because": "removes 2 % of what windows leave"}]
    page = render(title="t", diagnosis={**diagnosis(), "candidates": [*some, *few]})
    assert page.count("scores less") == 1
    assert "backlash 1.0 %, duty curve 1.0 %" in page


def test_the_error_of_a_long_record_is_drawn_as_a_band_with_its_mean() -> None:
    figure = plot_series(series(samples=4000))
    for axes in figure.axes[1:3]:
        (mean,) = [line for line in axes.lines if len(line.get_xdata()) > 2]
        assert len(mean.get_xdata()) <= 250
        assert "band: least to greatest" in axes.get_title(loc="left")
    short = plot_series(series(samples=300)).axes[1]
    assert max(len(line.get_xdata()) for line in short.lines) == 300


def test_the_seed_is_printed_in_full_and_the_truth_beside_what_was_found() -> None:
    seal = {
        "seed": 1356600123, "effects": ["gravity_load"], "truth": ["gain 10.1 deg/s per %"],
        "reduced": {"gravity_load": {"level_pct": 2.41}}, "si": {"R_ohm": 5.5},
    }  # fmt: skip
    page = render(title="t", diagnosis=diagnosis(), seal=seal)
    assert "1356600123" in page
    assert re.search(r"gravity load, level</th><td class=\"n\">2.4100</td><td class=\"n\">2.4000</td>", page)


def test_many_long_records_stay_below_four_megabytes() -> None:
    many = [series("train", 60_000) for _ in range(8)]
    page = render(title="t", diagnosis=diagnosis(), series=many)
    assert len(page) < 4_000_000
    data = json.loads(re.search(r"const RECORDS = (.*?);\n", records_script(many))[1])  # type: ignore[index]
    assert sum(len(one["time"]) for one in data) <= 1.1 * MOST_ROWS
    whole = many[0]
    kept = data[0]
    assert max(kept["measured"]) == whole.measured.max()
    assert whole.before is not None
    peak = float(np.max(whole.measured - whole.before))
    assert max(m - b for m, b in zip(kept["measured"], kept["before"], strict=True)) == pytest.approx(peak, abs=1e-3)


ZOOM = """<script>
const [element, plots] = drawnRecords[0];
const blue = c => { const d = c.getContext("2d").getImageData(0, 0, c.width, c.height).data; let n = 0;
  for (let i = 0; i < d.length; i += 4) if (d[i + 2] > 150 && d[i] < 100 && d[i + 3] > 200) n++; return n; };
setTimeout(() => {
  const before = blue(plots[2].ctx.canvas), fine = plots[2].fine;
  plots[0].setScale("x", {min: 5, max: 6});
  setTimeout(() => {
    document.title = JSON.stringify({panels: plots.length, drawn: before > 200, coarse: fine !== true,
      zoomed: plots.map(p => [p.scales.x.min, p.scales.x.max]), fine: plots[2].fine,
      folded: document.querySelectorAll(".record:not(.drawn)").length});
  }, 200);
}, 200);
</script></body>"""


def test_records_zoom_together_in_a_browser_without_a_network(tmp_path: Path) -> None:
    needed("chromium")
    page = tmp_path / "page.html"
    page.write_text(
        render(title="t", diagnosis=diagnosis(), series=[series("train"), series()]).replace("</body>", ZOOM)
    )
    with Chromium(tmp_path / "profile") as browser:
        browser.shown(page)
        told = json.loads(until(lambda: (title := browser.value("document.title")).startswith("{") and title))
    assert told["panels"] == 4  # output, both errors, duty
    assert told["drawn"]
    assert told["coarse"]
    assert told["zoomed"] == [[5, 6]] * 4
    assert told["fine"], "far zoomed in the error itself is drawn"
    assert told["folded"] == 1, "what is folded away is drawn when it is unfolded"


def test_a_record_without_a_final_model_shows_the_declared_one() -> None:
    alone: SeriesPlot = replace(series(), after=None)
    page = render(title="t", diagnosis={**diagnosis(), "verdict": "no_missing_effect", "steps": []}, series=[alone])
    assert "What is left on random_steps.csv is 12.7 deg rms" in page
    confirm = {"file": "fresh.csv", "before": error(18.0), "after": error(18.0)}
    assert "On a fresh record" in render(title="t", diagnosis=diagnosis(), confirm=confirm)
