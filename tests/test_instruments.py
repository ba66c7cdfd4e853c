"""The lab's furniture beside the wire: what it shows, and that nobody reaches it from the wire."""

from __future__ import annotations

import ast
import types
from pathlib import Path

import numpy as np
import pytest

import fiohost
from fiohost.bench.connect import connect
from fiohost.bench.loop import Bench, Tick
from fiohost.errors import ConfigError
from fiohost.transport.base import Transport
from fiohost.transport.instruments import Instruments
from fiohost.transport.profile import TargetProfile
from fiohost.transport.traced import TracedTransport

GRAVITY_M_S2 = 9.81
PACKAGE = Path(fiohost.__file__).parent


def test_the_meters_show_60_milliampere_without_load_and_the_supply() -> None:
    with connect("sim", seed=1) as bench:
        meters = Instruments.of(bench)
        seen: list[tuple[float, float]] = []
        bench.drive(100.0, 3.0, progress=lambda tick: seen.append((meters.current_A, meters.voltage_V)))
        assert seen[-1][0] == pytest.approx(0.060, abs=0.0005)
        assert seen[-1][1] == pytest.approx(9.0, abs=1e-6)


@pytest.mark.parametrize(("torque_Nm", "way"), [(0.533, 1), (0.539, 0), (0.573, 0), (0.580, -1)])
def test_a_hanging_mass_stalls_the_motor_at_0_536_newton_metre_and_1_63_ampere(torque_Nm: float, way: int) -> None:
    """Kt V / R less the dry friction is lifted; up to both together is held; more pulls the shaft back."""
    with connect("sim", seed=1) as bench:
        lab = Instruments.of(bench)
        currents: list[float] = []

        def hang(tick: Tick) -> None:
            if tick.time_s >= 0.005:  # once the motor pulls
                lab.hang_mass(torque_Nm / GRAVITY_M_S2 / 0.5, 0.5)
            currents.append(lab.current_A)

        log = bench.drive(100.0, 3.0, progress=hang, progress_every_s=0.005)
    moved = log.output[-1] - log.output[-200]
    assert np.sign(moved) == way
    if not way:
        assert currents[-1] == pytest.approx(1.63, abs=0.005)


def test_a_hand_on_the_shaft_turns_it_when_it_presses_more_than_friction() -> None:
    with connect("sim", seed=1) as bench:
        lab = Instruments.of(bench)
        lab.disturb(0.019)
        assert abs(bench.drive(0.0, 0.5, standby=True).output[-1]) < 1.0
        lab.disturb(0.030)
        assert bench.drive(0.0, 0.5, standby=True).output[-1] > 5.0
        lab.disturb(0.0)


def test_a_supply_lets_no_more_current_through_than_it_is_set_to_and_all_of_it_again() -> None:
    with connect("sim", seed=1) as bench:
        lab = Instruments.of(bench)

        def strongest() -> float:
            seen: list[float] = []
            bench.drive(100.0, 0.3, progress=lambda tick: seen.append(lab.current_A), progress_every_s=0.005)
            return max(seen)

        free = strongest()
        lab.limit_current(0.5)
        assert strongest() == pytest.approx(0.5, abs=1e-6)
        lab.limit_current(None)
        assert strongest() == pytest.approx(free, rel=0.05)
        assert free > 1.0
        with pytest.raises(ConfigError, match="current limit"):
            lab.limit_current(0.0)


@pytest.mark.parametrize("bad", [float("nan"), float("inf")])
def test_nonsense_is_refused(bad: float) -> None:
    with connect("sim") as bench:
        lab = Instruments.of(bench)
        with pytest.raises(ConfigError, match="finite"):
            lab.disturb(bad)
        with pytest.raises(ConfigError, match="hanging mass"):
            lab.hang_mass(bad, 0.01)
        with pytest.raises(ConfigError, match="hanging mass"):
            lab.hang_mass(-1.0, 0.01)


def test_traffic_that_is_shown_in_hex_hides_no_meter() -> None:
    with connect("sim") as bench:
        bench.transport = TracedTransport(bench.transport)
        assert Instruments.of(bench).current_A == 0.0


def test_a_sealed_and_a_real_bench_have_no_instruments(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    for target in ("sim:sealed", "sim:sealed-faulty"):
        with connect(target, seed=1) as bench, pytest.raises(ConfigError, match="nothing but its wire"):
            Instruments.of(bench)

    class Cable(Transport):
        name = "hid:0001"
        facts: dict[str, str] = {}  # noqa: RUF012

        def open(self) -> None: ...

        def send(self, report: bytes) -> None: ...

        def receive(self, timeout_s: float) -> bytes:
            return bytes(64)

        def close(self) -> None: ...

    with Bench(Cable(), TargetProfile.load()) as bench, pytest.raises(ConfigError, match="meters on your table"):
        Instruments.of(bench)


# ---- the wall ------------------------------------------------------------------------------------------------------


def reachable(root: object, depth: int = 5) -> list[object]:
    """All objects that public names lead to."""
    seen: dict[int, object] = {}
    level = [root]
    for _ in range(depth):
        following = []
        for item in level:
            names = [name for name in dir(item) if not name.startswith("_")]
            parts = [getattr(item, name, None) for name in names]
            if isinstance(item, dict):
                parts += list(item.values())
            elif isinstance(item, (list, tuple)):
                parts += list(item)
            for found in parts:
                if id(found) not in seen and not isinstance(found, (str, bytes, int, float, types.ModuleType)):
                    seen[id(found)] = found
                    following.append(found)
        level = following
    return list(seen.values())


@pytest.mark.parametrize("target", ["sim", "sim:sealed"])
def test_no_public_name_of_the_line_leads_to_the_board(
    target: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    with connect(target, seed=1) as bench:
        found = reachable(bench.transport)
        assert len(found) > 10
        for item in found:
            where = getattr(item, "__module__", None) or type(item).__module__
            assert not str(where).startswith("firmware_model"), item
            assert "instruments" not in str(where), item


def imported_by(path: Path) -> set[str]:
    """Modules that a file imports, wherever in it."""
    found: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: a relative import"
            found |= {str(node.module), *(f"{node.module}.{alias.name}" for alias in node.names)}
    return found


def file_of(module: str) -> Path | None:
    if module.split(".")[0] != "fiohost":
        return None
    place = PACKAGE.joinpath(*module.split(".")[1:])
    return next((p for p in (place.with_suffix(".py"), place / "__init__.py") if p.is_file()), None)


@pytest.mark.parametrize("room", ["discover", "estimation", "motor"])
def test_what_judges_a_log_can_never_import_the_instruments(room: str) -> None:
    """Not by itself and not by anything that it imports, at whatever moment."""
    waiting = sorted((PACKAGE / room).rglob("*.py"))
    assert waiting
    done: set[Path] = set()
    while waiting:
        path = waiting.pop()
        if path in done:
            continue
        done.add(path)
        for module in imported_by(path):
            assert module.split(".")[0] != "firmware_model", f"{path} imports {module}"
            assert module != "fiohost.transport.instruments", f"{path} imports {module}"
            following = file_of(module)
            # the package's own __init__ names the public functions and loads them when they are asked for
            if following is not None and following != PACKAGE / "__init__.py":
                waiting.append(following)


def test_only_labs_seal_and_circle_s_end_use_the_instruments() -> None:
    users = {
        path.relative_to(PACKAGE).as_posix()
        for path in PACKAGE.rglob("*.py")
        if any(module.startswith("fiohost.transport.instruments") for module in imported_by(path))
    }
    assert {user for user in users if not user.startswith("labs/")} == {"cli/bench.py", "cli/circle.py"}
