"""How fast logs are read and written: 720,000 rows (an hour at 200 Hz) against pandas and pyarrow, in turn, in one run.

    python benchmarks/log_speed.py [--rows 720000] [--repeats 5] [--json F]

pandas and pyarrow are those of ``fiohost[data]``. The table is what a run writes: eight columns with times, duties,
bits, counts and angles. Each reads and writes the same numbers as CSV; fiohost also checks lengths, ranges and check
sums, which the others do not. ``rows as they come`` is the writer of a run, one system call a row, so that a killed
host loses none: it has no counterpart and is shown per row. Seconds are medians; those of the processor are of all
threads, and ratios are of them: a machine with other work stretches the clock of each by chance.
"""

from __future__ import annotations

import argparse
import json
import statistics
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas
import pyarrow
import pyarrow.csv

from fiohost.bench.log import Log, LogWriter
from fiohost.bench.table_log import write_log

ROWS, TICK_S, COUNTS = 720_000, 0.005, 720
AT_MOST = 2.0


def table(rows: int) -> dict[str, np.ndarray]:
    """What a run of random steps looks like."""
    rng = np.random.default_rng(1)
    duty = np.repeat(np.round(rng.uniform(-80.0, 80.0, rows // 200 + 1), 2), 200)[:rows]
    angle = np.cumsum(duty * 10.0 * TICK_S)
    counts = np.floor(angle / 360.0 * COUNTS)
    return {
        "time_s": np.arange(rows) * TICK_S, "duty_pct": duty, "c3": (duty > 0.0) * 1.0, "c4": (duty < 0.0) * 1.0,
        "pos": counts % COUNTS, "direction": (duty < 0.0) * 1.0, "ref_deg": np.round(angle, 1),
        "angle_deg": counts * 360.0 / COUNTS,
    }  # fmt: skip


def timed(work: Callable[[], object]) -> tuple[float, float]:
    """Seconds on the clock and of the processor."""
    began, began_cpu = time.perf_counter(), time.process_time()
    work()
    return time.perf_counter() - began, time.process_time() - began_cpu


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rows", type=int, default=ROWS)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    columns = table(given.rows)
    frame, arrow = pandas.DataFrame(columns), pyarrow.table(columns)
    metadata = {"sample_time_s": f"{TICK_S}", "counts_per_rev": f"{COUNTS}"}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        log, bare, out = folder / "log.csv", folder / "bare.csv", folder / "out.csv"
        write_log(log, columns, metadata)
        frame.to_csv(bare, index=False)
        read = Log.read(log)
        assert not read.dropped, read.dropped
        assert all(np.allclose(read.columns[key], frame[key], rtol=1e-8, atol=1e-12) for key in columns)

        def fresh(write: Callable[[], object]) -> Callable[[], object]:
            def work() -> object:
                out.unlink(missing_ok=True)
                return write()

            return work

        tried: dict[str, dict[str, Callable[[], object]]] = {
            "read": {
                "fiohost": lambda: Log.read(log),
                "pandas": lambda: pandas.read_csv(bare),
                "pyarrow": lambda: pyarrow.csv.read_csv(bare),
            },
            "write": {
                "fiohost": fresh(lambda: write_log(out, columns, metadata)),
                "pandas": fresh(lambda: frame.to_csv(out, index=False)),
                "pyarrow": fresh(lambda: pyarrow.csv.write_csv(arrow, out)),
            },
        }
        taken: dict[str, dict[str, list[tuple[float, float]]]] = {
            what: {who: [] for who in works} for what, works in tried.items()
        }
        for _ in range(given.repeats + 1):
            for what, works in tried.items():
                for who, work in works.items():
                    taken[what][who].append(timed(work))
        rows = list(zip(*(values.tolist() for values in columns.values()), strict=True))

        def as_they_come() -> None:
            with LogWriter(folder / "rows.csv", metadata) as writer:
                for row in rows:
                    writer.row(*row[:2], *map(int, row[2:6]), *row[6:])

        each_us = 1e6 * timed(as_they_come)[0] / given.rows
    median = {
        what: {who: [statistics.median(part) for part in zip(*runs[1:], strict=True)] for who, runs in by.items()}
        for what, by in taken.items()
    }
    ratios = {}
    print(f"{given.rows} rows, 8 columns; median of {given.repeats}")
    for what, by in median.items():
        for who, (clock, cpu) in by.items():
            print(f"{what:6} {who:8} {clock:7.3f} s  {cpu:7.3f} s of the processor")
        clock, cpu = (by["fiohost"][i] / min(by["pandas"][i], by["pyarrow"][i]) for i in (0, 1))
        ratios[what] = {"clock": clock, "processor": cpu}
        print(
            f"{what:6} fiohost: {cpu:.2f} times the processor's time of the faster of pandas and pyarrow (at most "
            f"{AT_MOST:g}); {clock:.2f} times on the clock"
        )
    print(f"rows as they come: {each_us:.1f} us a row")
    if given.json:
        told = {"rows": given.rows, "ratios": ratios, "median_s": median, "row_us": each_us}
        given.json.write_text(json.dumps(told) + "\n")


if __name__ == "__main__":
    main()
