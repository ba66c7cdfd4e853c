"""Faults on request: what a bad line or clock, a reset, a lost supply do on the wire, and what the host does then."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from hypothesis import given, settings
from hypothesis import strategies as st

from fiohost.bench.connect import connect
from fiohost.bench.experiment import ControlSettings, Experiment
from fiohost.bench.log import Log
from fiohost.bench.seal import find_seed
from fiohost.bench.signals import Square, Staircase
from fiohost.cli.main import cli
from fiohost.errors import TelemetryTimeoutError
from fiohost.transport.simulated import SimulatedTransport
from firmware_model import Board, FaultyBoard, load_plant
from firmware_model.faults import PARAMETERS
from firmware_model.plants import make_plant

MOTOR = {"supply_V": 9.0, "R_ohm": 5.5, "Kt_Nm_per_A": 0.34, "Ke_Vs_per_rad": 0.487, "J_kgm2": 3e-3, "coulomb_Nm": 0.02}
STAIRS = Experiment("stairs", [Staircase(levels=(30.0, -60.0, 80.0), step_s=0.5, duration_s=3.0)])
FORWARD = struct.pack("<fBB58x", 50.0, 1, 0)
BRAKE = struct.pack("<fBB58x", 0.0, 1, 1)


def faulty(seed: int | None = 1, **faults: float | str) -> FaultyBoard:
    plant = make_plant({**MOTOR, "faults": faults}, "test")
    assert plant.faults is not None
    return FaultyBoard(Board(plant, seed=seed), plant.faults, seed=seed)


def plain(seed: int | None = 1) -> Board:
    return Board(make_plant(MOTOR, "test"), seed=seed)


def pos_of(report: bytes) -> int:
    return int(struct.unpack_from("<BH", report)[1])


def drive(board: FaultyBoard, steps: int, report: bytes | None = FORWARD) -> list[list[bytes]]:
    return [board.step(report) for _ in range(steps)]


# ---- on the wire ---------------------------------------------------------------------------------------------------


def test_without_faults_the_line_changes_nothing() -> None:
    hurt, whole = faulty(), plain()
    assert drive(hurt, 300) == [[whole.step(FORWARD)] for _ in range(300)]


def test_faults_are_drawn_by_the_seed() -> None:
    some = {"report_drop_ratio": 0.1, "report_corrupt_ratio": 0.1, "tick_jitter_s": 0.001}
    assert drive(faulty(3, **some), 300) == drive(faulty(3, **some), 300)
    assert drive(faulty(3, **some), 300) != drive(faulty(4, **some), 300)


@pytest.mark.parametrize("ratio", [0.02, 0.3])
def test_reports_are_dropped_doubled_and_cut_as_often_as_asked(ratio: float) -> None:
    n, spread = 4000, 4.0 * np.sqrt(ratio * (1 - ratio) / 4000)
    dropped = [len(came) for came in drive(faulty(direction="to_host", report_drop_ratio=ratio), n)]
    assert set(dropped) == {0, 1}
    assert dropped.count(0) / n == pytest.approx(ratio, abs=spread)
    doubled = drive(faulty(direction="to_host", report_double_ratio=ratio), n)
    assert sum(len(came) == 2 for came in doubled) / n == pytest.approx(ratio, abs=spread)
    assert all(came[0] == came[-1] for came in doubled)
    cut = [len(came[0]) for came in drive(faulty(direction="to_host", report_cut_ratio=ratio), n)]
    assert sum(size < 64 for size in cut) / n == pytest.approx(ratio, abs=spread)


def test_damaged_reports_keep_their_length_and_differ_in_a_burst() -> None:
    whole = plain()
    for came in drive(faulty(direction="to_host", report_corrupt_ratio=1.0), 300):
        good = whole.step(FORWARD)
        wrong = [i for i, (a, b) in enumerate(zip(came[0], good, strict=True)) if a != b]
        assert len(came[0]) == 64
        assert not wrong or wrong[-1] - wrong[0] < 8


def test_late_reports_come_later_in_their_order() -> None:
    board = faulty(direction="to_host", report_late_ratio=0.1, report_late_s=0.012)
    came, whole = drive(board, 1000), plain()
    sent = [whole.step(FORWARD) for _ in range(1000)]
    flat = [report for one in came for report in one]
    assert flat == sent[: len(flat)]
    assert {len(one) for one in came} >= {0, 1, 4}  # three ticks late: that one comes with the three behind it


def test_a_command_lost_on_its_way_leaves_the_outputs_as_they_were() -> None:
    board = faulty(direction="to_board", report_drop_ratio=1.0)
    drive(board, 100)
    assert len({pos_of(came[0]) for came in drive(board, 100)}) == 1
    half = faulty(direction="to_board", report_drop_ratio=0.5)
    whole = plain()
    seen, told = drive(half, 300), [whole.step(FORWARD) for _ in range(300)]
    assert abs(pos_of(seen[-1][0]) - pos_of(told[-1])) < 30  # after the first that arrives the outputs hold


def test_the_clock_runs_fast_or_slow_by_parts_per_million() -> None:
    slow, whole = faulty(clock_ppm=-20000.0), plain()
    drive(slow, 2000)
    for _ in range(2000):
        whole.step(FORWARD)
    assert slow._board._motor.time_s / whole._motor.time_s == pytest.approx(1.0 / 0.98, rel=1e-9)


def test_late_ticks_are_single_and_do_not_shift_the_others() -> None:
    board = faulty(tick_jitter_s=0.001, tick_late_ratio=0.02, tick_late_s=0.012)
    begun = []
    for _ in range(2000):
        begun.append(board._began_s)
        board.step(FORWARD)
    late = np.array(begun) - 0.005 * np.arange(2000)
    spans = np.diff(begun)
    assert spans.min() > 0.0
    assert late.min() >= 0.0
    assert late.max() < 0.026
    assert 0.0003 < np.median(late) < 0.0007
    assert np.mean(late > 0.0115) == pytest.approx(0.02, abs=0.015)
    assert board._board._motor.time_s == pytest.approx(board._began_s)


def test_a_reset_in_mid_run_starts_the_count_anew_with_outputs_off_and_runs_on() -> None:
    board = faulty(reset_at_s=1.0, reset_lasts_s=0.03)
    before = drive(board, 200)
    assert pos_of(before[-1][0]) > 100
    gone = drive(board, 6)
    assert gone == [[]] * 6
    held = drive(board, 40, None)
    assert 0 < pos_of(held[0][0]) < 60  # counted from zero while it coasts
    coasting = np.diff([pos_of(came[0]) for came in held])
    assert coasting[-1] < coasting[0]
    again = drive(board, 200)
    assert all(len(came) == 1 for came in again)
    speed = (pos_of(again[-1][0]) - pos_of(again[-11][0])) % 720
    assert speed == pytest.approx((pos_of(before[-1][0]) - pos_of(before[-11][0])) % 720, abs=2)


def test_a_lost_supply_lets_the_motor_coast_while_the_board_goes_on() -> None:
    board = faulty(supply_lost_at_s=1.0, supply_back_at_s=3.0)
    counts = np.array([pos_of(came[0]) for came in drive(board, 900)])
    moved = (np.diff(counts) + 360) % 720 - 360
    assert moved[180:199].mean() > 4.0
    assert np.all(moved[500:600] == 0)  # friction alone has stopped it
    assert moved[210:300].mean() > 2.0  # not at once
    assert moved[750:].mean() > 4.0  # and back at its speed, nobody having said a word


@settings(max_examples=40, deadline=None)
@given(
    st.lists(st.one_of(st.none(), st.binary(max_size=70), st.just(FORWARD)), max_size=80),
    st.fixed_dictionaries({}, optional={q.key: st.floats(0.0, min(q.upper, 1.0)) for q in PARAMETERS if not q.choices}),
    st.integers(0, 1000),
)
def test_any_bytes_on_any_line_leave_the_task_alive(reports: list[bytes | None], faults: dict, seed: int) -> None:
    if faults.get("supply_back_at_s", 1e9) <= faults.get("supply_lost_at_s", 1e8):
        faults.pop("supply_back_at_s")
    board = faulty(seed, **faults)
    for one in reports:
        for telemetry in board.step(one):
            assert len(telemetry) <= 64
    board._faults = {**board._faults, "reset_at_s": 1e9, "supply_lost_at_s": 1e9}
    told = board._board.step(BRAKE)
    assert len(told) == 64
    assert 0 <= pos_of(told) <= 719


# ---- what the host makes of it -------------------------------------------------------------------------------------


def plant_with(folder: Path, **faults: float | str) -> str:
    path = folder / "faulty.toml"
    lines = [f"{key} = {value!r}" for key, value in MOTOR.items()]
    lines += ["[faults]", *(f'{k} = "{v}"' if isinstance(v, str) else f"{k} = {v!r}" for k, v in faults.items())]
    path.write_text("\n".join(lines) + "\n")
    return f"sim:{path}"


@pytest.fixture
def last_sent(monkeypatch: pytest.MonkeyPatch) -> list[bytes]:
    """Every report that the host sends."""
    sent: list[bytes] = []
    send = SimulatedTransport.send

    def watched(self: SimulatedTransport, report: bytes) -> None:
        sent.append(report)
        send(self, report)

    monkeypatch.setattr(SimulatedTransport, "send", watched)
    return sent


LOST = {"report_drop_ratio": 0.05}
CASES: dict[str, dict[str, float | str]] = {
    "dropped": LOST,
    "dropped_to_board": {**LOST, "direction": "to_board", "report_drop_ratio": 0.5},
    "half_dropped": {"report_drop_ratio": 0.5},
    "all_dropped": {"report_drop_ratio": 1.0},
    "doubled": {"report_double_ratio": 0.2},
    "late": {"report_late_ratio": 0.1, "report_late_s": 0.012},
    "very_late": {"report_late_ratio": 0.01, "report_late_s": 0.2, "direction": "to_host"},
    "cut": {"report_cut_ratio": 0.05},
    "all_cut": {"report_cut_ratio": 1.0},
    "corrupt": {"report_corrupt_ratio": 0.05},
    "half_corrupt": {"report_corrupt_ratio": 0.5},
    "jitter": {"tick_jitter_s": 0.002, "tick_late_ratio": 0.01, "tick_late_s": 0.02},
    "clock": {"clock_ppm": -5000.0},
    "reset": {"reset_at_s": 1.3},
    "long_reset": {"reset_at_s": 1.3, "reset_lasts_s": 2.0},
    "supply": {"supply_lost_at_s": 1.0, "supply_back_at_s": 2.0},
    "supply_gone": {"supply_lost_at_s": 1.0},
}
STOP = {"all_dropped", "very_late", "all_cut", "long_reset"}  # 50 ms without a good report
EITHER = {"half_dropped", "half_corrupt"}


@pytest.mark.parametrize("case", CASES)
def test_a_run_completes_or_ends_with_one_sentence_and_the_motor_never_runs_on(
    case: str, tmp_path: Path, last_sent: list[bytes]
) -> None:
    experiment = tmp_path / "stairs.toml"
    experiment.write_text(
        'schema = "fiohost.experiment/1"\n[[command]]\n'
        'kind = "staircase"\nlevels_pct = [30.0, -60.0, 80.0]\nstep_s = 0.5\nduration_s = 3.0\n'
    )
    log_path = tmp_path / "run.csv"
    target = plant_with(tmp_path, **CASES[case])
    result = CliRunner().invoke(
        cli, ["run", str(experiment), "--target", target, "--seed", "2", "--log", str(log_path)]
    )
    assert last_sent[-1] == BRAKE
    log_text = log_path.read_text()
    if case in STOP or (case in EITHER and result.exit_code):
        assert result.exit_code == 1
        assert "Traceback" not in result.output
        first = result.stderr.strip().splitlines()[0]
        assert "50 ms" in first or "expected" in first or "reports" in first
        assert "# ending: stopped" in log_text
        return
    assert result.exit_code == 0, result.output
    log = Log.parse(log_text)
    assert log.metadata["ending"] == "complete"
    assert len(log) > 250
    assert np.rint(log.time_s / 0.005).max() <= 599
    gaps = 600 - len(log)
    if case in ("dropped", "cut", "corrupt", "late"):
        assert 0 < gaps < 200
        assert any("ticks are missing" in note for note in log.dropped)
    if case in ("doubled", "jitter", "clock", "supply", "dropped_to_board"):
        assert gaps == 0


@pytest.mark.parametrize("seed", range(12))
def test_after_a_run_on_a_bad_line_the_shaft_stands(seed: int, tmp_path: Path) -> None:
    """A brake may be lost or arrive as another command; the bench sees by its readings whether the shaft stands."""
    target = plant_with(tmp_path, report_drop_ratio=0.2, report_corrupt_ratio=0.2)
    bench = connect(target, seed=seed)
    try:
        with bench:
            bench.drive(80.0, 0.5)
    except TelemetryTimeoutError:
        pass
    line = bench.transport._step.__self__  # type: ignore[attr-defined]
    motor = line._board._motor
    before = motor.count
    for _ in range(100):
        line._board.step(None)
    assert abs(motor.count - before) <= 2


def test_what_happened_to_the_reports_is_counted(tmp_path: Path) -> None:
    target = plant_with(
        tmp_path, direction="to_host", report_drop_ratio=0.03, report_cut_ratio=0.03, report_double_ratio=0.03
    )
    with connect(target, seed=1) as bench:
        log = bench.run(STAIRS)
        told = bench.statistics
    assert told.silent > 0
    assert told.refused > 0
    assert told.passed_over > 0
    assert 600 - len(log) <= told.silent + told.refused
    for words in ("without telemetry", "refused", "surplus"):
        assert words in log.metadata["tick_statistics"]


def test_a_reset_and_a_lost_supply_show_only_in_what_was_measured(tmp_path: Path) -> None:
    """The heads of the logs are the same, whatever was wrong: only rows and the count of reports can tell."""
    heads = []
    for faults in ({"reset_at_s": 1.3}, {"supply_lost_at_s": 1.0}, {"clock_ppm": 100.0}):
        with connect(plant_with(tmp_path, **faults), seed=1) as bench:
            log = bench.run(STAIRS)
        known = {"run_id", "start_time", "tick_statistics", "bench_time_s"}
        heads.append({key: value for key, value in log.metadata.items() if key not in known})
    assert heads[0] == heads[1] == heads[2]


def test_a_loop_closed_through_a_bad_line_still_follows(tmp_path: Path) -> None:
    square = Experiment(
        "square",
        reference=[Square(low=170.0, high=190.0, period_s=2.0, duration_s=6.0)],
        control=ControlSettings(u_plus_pct=2.0, u_minus_pct=-2.0),
    )
    target = plant_with(tmp_path, report_drop_ratio=0.03, report_cut_ratio=0.03, tick_jitter_s=0.001)
    with connect(target, seed=1) as bench:
        log = bench.run(square)
    ref = log.columns["ref_deg"]
    settled = np.flatnonzero(np.diff(ref) != 0)
    assert np.abs(log.output[settled] - ref[settled]).max() < 5.0


def test_a_sealed_bench_with_faults_tells_them_by_its_wire_and_by_unseal(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    logs = {}
    for target in ("sim:sealed", "sim:sealed-faulty"):
        with connect(target, seed=77) as bench:
            logs[target] = bench.run(STAIRS, tmp_path / f"{target[4:]}.csv")
        assert find_seed(str(tmp_path / f"{target[4:]}.csv")) == 77
    assert len(logs["sim:sealed"]) != len(logs["sim:sealed-faulty"]) or not np.array_equal(
        logs["sim:sealed"].output, logs["sim:sealed-faulty"].output
    )
    metadata = logs["sim:sealed-faulty"].metadata
    assert not {"plant", "supply_V", "faults"} & set(metadata)
    told = CliRunner().invoke(cli, ["unseal", "77"]).stdout
    assert "faults, as sim:sealed-faulty" in told


def test_the_shipped_plants_have_no_faults() -> None:
    for name in ("default", "ideal"):
        assert load_plant(name).faults is None
