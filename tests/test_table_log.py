"""Logs written at once: what is read back is what was given, with and without pyarrow."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from fiohost.bench import table_log
from fiohost.bench.integrity import WHOLE, judge
from fiohost.bench.log import Log
from fiohost.bench.table_log import log_text, rows_text, write_log
from fiohost.errors import FiohostError

# What is larger than 1e12 is no reading: a log takes it for a missing one.
NUMBERS = st.floats(-1e12, 1e12) | st.just(float("nan"))


@pytest.mark.parametrize("with_pyarrow", [True, False])
@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(values=st.lists(NUMBERS, min_size=2, max_size=30))
def test_every_number_comes_back(values: list[float], with_pyarrow: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(table_log, "LARGE_CELLS", 1)
    if not with_pyarrow:
        monkeypatch.setitem(sys.modules, "pyarrow", None)
    time_s = np.arange(len(values)) * 0.005
    text = log_text({"time_s": time_s, "duty_pct": time_s, "angle_deg": time_s, "x": np.array(values)}, {"a": "b"})
    log = Log.parse(text.decode())
    np.testing.assert_array_equal(log.columns["x"], values)
    np.testing.assert_array_equal(log.time_s, time_s)
    assert judge(text).state == WHOLE
    assert judge(text).rows == len(values)


def test_a_written_log_says_what_it_was_given_and_stays_one_file(tmp_path: Path) -> None:
    columns = {"time_s": np.arange(4) * 0.01, "duty_pct": np.array([0.0, 50.0, -50.0, 1e-5]), "speed_deg_s": np.ones(4)}
    path = write_log(tmp_path / "log.csv", columns, {"sample_time_s": "0.01", "note": "two\nlines", "empty": ""})
    text = path.read_text()
    assert text.splitlines()[:4] == [
        "# schema: fiohost.log/1", "# sample_time_s: 0.01", "# note: two lines", "time_s,duty_pct,speed_deg_s",
    ]  # fmt: skip
    log = Log.read(path)
    assert log.dropped == ()
    np.testing.assert_array_equal(log.duty_pct, columns["duty_pct"])
    with pytest.raises(FiohostError, match="exists"):
        write_log(path, columns, {})


def test_rows_are_short_where_numbers_are() -> None:
    assert (
        rows_text({"a": np.array([1.0, -0.25, np.nan]), "b": np.array([1e22, 0.1, 3.0])}) == b"1,1e+22\n-0.25,0.1\n,3\n"
    )
